//! `periscope run`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::rejects::MaxRejects;
use periscope::pipeline::roots;
use periscope::pipeline::run::{self as runner, Outcome, RunError, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::runs::{Ending, RunRecord};
use periscope::store::{Digest, Shelf, StoreError};

use super::SOME_REJECTED;
use super::aftermath;
use super::interrupt::stop_on_signals;
use super::watch;

/// Time between two looks at a folder that another run holds.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Arguments of `run`.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools, reason = "flags of the command line")]
pub struct Run {
    /// Pipeline file (TOML): one heading a table
    pipeline: PathBuf,
    /// Campaign folder, with a campaign.toml; may be given several times for one scene
    #[arg(long, required = true, value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Result folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Stop after this table
    #[arg(long, value_name = "TABLE")]
    until: Option<String>,
    /// Change a parameter of the pipeline, such as `onsets.threshold_sigma=6`
    #[arg(long, value_name = "TABLE.PARAM=VALUE")]
    set: Vec<String>,
    /// Worker threads (default: one a core)
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Memory for raw samples under way, such as 512MiB
    #[arg(long, value_name = "SIZE", value_parser = size)]
    memory: Option<usize>,
    /// Wait where another run holds the result folder, instead of giving up
    #[arg(long)]
    wait: bool,
    /// Follow a capture that is under way: run again whenever files have come, until Ctrl-C
    #[arg(long)]
    watch: bool,
    /// With --watch: end when no file has come for so many seconds
    #[arg(long, value_name = "SECONDS", requires = "watch")]
    idle: Option<u64>,
    /// Stop when more than so many records are set aside, or more than such a share of all, such as 5%
    #[arg(long, value_name = "N|P%")]
    max_rejects: Option<MaxRejects>,
    /// How to show progress
    #[arg(long, value_enum, default_value = "auto")]
    progress: ProgressKind,
    /// Read all raw files again first, also those of which size and time of change are as recorded
    #[arg(long)]
    rehash: bool,
    /// Exit with 1 when any input was set aside
    #[arg(long)]
    strict: bool,
    /// Bytes that are read at a time; no byte of the result depends on it
    #[arg(long, value_name = "SIZE", value_parser = size, help_heading = "Tuning")]
    batch: Option<usize>,
    /// Batches that a channel between two stages holds; no byte of the result depends on it
    #[arg(long, value_name = "N", help_heading = "Tuning")]
    channel: Option<usize>,
}

/// How to show progress.
#[derive(Clone, Copy, ValueEnum)]
pub enum ProgressKind {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// A bar
    Bar,
    /// A line a pass, and now and then one in between
    Lines,
    /// A JSON object a line
    Json,
    /// Nothing
    None,
}

impl From<ProgressKind> for Style {
    fn from(kind: ProgressKind) -> Self {
        match kind {
            ProgressKind::Auto => Self::auto(),
            ProgressKind::Bar => Self::Bar,
            ProgressKind::Lines => Self::Lines,
            ProgressKind::Json => Self::Json,
            ProgressKind::None => Self::Silent,
        }
    }
}

/// Reads `512MiB`, `64M`, `1GB`, `4096`.
pub fn size(text: &str) -> Result<usize, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let number: usize =
        number.parse().map_err(|_| format!("`{text}` does not begin with a whole number; write 512MiB"))?;
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kib" => 1 << 10,
        "kb" => 1000,
        "m" | "mib" => 1 << 20,
        "mb" => 1_000_000,
        "g" | "gib" => 1 << 30,
        "gb" => 1_000_000_000,
        _ => {
            return Err(format!("`{unit}` is no unit of size; write KiB, MiB or GiB"));
        }
    };
    number.checked_mul(factor).ok_or_else(|| format!("`{text}` is too much"))
}

/// Loads campaigns, and makes sure that their names differ: rows of equal names would mix.
pub fn campaigns(folders: &[PathBuf]) -> Result<Vec<Campaign>> {
    let mut campaigns: Vec<Campaign> = Vec::new();
    for folder in folders {
        let campaign = Campaign::load(folder)?;
        if let Some(other) = campaigns.iter().find(|other| other.name == campaign.name) {
            if other.root.canonicalize().ok() == folder.canonicalize().ok() {
                bail!("--campaign {} is given twice; take one out", folder.display());
            }
            bail!(
                "campaigns {} and {} are both named `{}`; change `name` in one campaign.toml",
                other.root.display(),
                folder.display(),
                campaign.name
            );
        }
        campaigns.push(campaign);
    }
    Ok(campaigns)
}

/// Uses so many worker threads.
pub fn use_threads(threads: Option<usize>) -> Result<()> {
    if threads == Some(0) {
        bail!("--threads 0: give at least 1");
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build_global()
        .context("cannot start the worker threads")
}

/// What is to be run, and into which folder.
#[derive(Clone)]
pub struct Job<'a> {
    /// The pipeline, parsed.
    pub spec: &'a Spec,
    /// Its file.
    pub pipeline: &'a Path,
    /// Parameters changed on the command line.
    pub set: &'a [String],
    /// The campaigns.
    pub campaigns: &'a [Campaign],
    /// The result folder, open for writing.
    pub shelf: &'a Shelf,
    /// Last table that is wanted.
    pub until: Option<&'a str>,
    /// How the run uses the machine.
    pub settings: Settings,
    /// How it shows progress.
    pub style: Style,
}

impl Job<'_> {
    /// A record of a run that starts now.
    pub fn record(&self) -> Result<RunRecord> {
        let campaigns = self.campaigns.iter().map(|campaign| (campaign.name.as_str(), campaign.root.as_path()));
        Ok(RunRecord::start(self.pipeline, self.set, campaigns)?)
    }

    /// Plans and runs; prints warnings of the survey. Beside the tables lies the record of the run, from its start on.
    pub fn execute(&self, record: &mut RunRecord) -> Result<Outcome> {
        self.shelf.write_run(record)?;
        let outcome = self.compute(&mut record.tables);
        let ending = match &outcome {
            Ok(outcome) => {
                record.rejects = outcome.rejects;
                record.passes.clone_from(&outcome.passes);
                Ending::Done
            }
            Err(error) if matches!(error.downcast_ref(), Some(RunError::Interrupted { .. })) => Ending::Interrupted,
            Err(error) => {
                record.failure = Some(format!("{error:#}"));
                Ending::Failed
            }
        };
        record.end(ending);
        let written = self.shelf.write_run(record);
        let outcome = outcome?;
        written?;
        Ok(outcome)
    }

    /// Gives the lineages of the tables that are whole, also where it fails.
    fn compute(&self, whole: &mut BTreeMap<String, Digest>) -> Result<Outcome> {
        let mut plan = Plan::new(self.spec, self.campaigns, self.shelf, self.until)?;
        for warning in plan.warnings() {
            eprintln!("warning: {warning}");
        }
        let outcome = runner::run(&mut plan, &self.settings, &Progress::new(self.style));
        let steps = self.spec.steps.iter().zip(&plan.tables);
        let kept = steps.filter(|(step, table)| step.keep && table.wanted && table.complete());
        whole.extend(kept.filter_map(|(step, table)| Some((step.heading.clone(), table.lineage()?))));
        Ok(outcome?)
    }
}

/// Opens a result folder for writing; waits for whoever holds it, if asked to.
fn open(out: &Path, wait: bool) -> Result<Shelf> {
    let mut is_told = false;
    loop {
        match Shelf::open(out) {
            Err(error @ StoreError::Busy { .. }) if wait => {
                if !is_told {
                    eprintln!("waiting: {error}");
                    is_told = true;
                }
                std::thread::sleep(LOOK_AGAIN);
            }
            opened => return Ok(opened?),
        }
    }
}

/// The command.
pub fn run(args: &Run) -> Result<ExitCode> {
    use_threads(args.threads)?;
    let spec = Spec::load(&args.pipeline, &args.set)?;
    let campaigns = campaigns(&args.campaign)?;
    let shelf = open(&args.out, args.wait)?;
    if args.rehash {
        roots::rehash(&campaigns, &shelf)?;
    }
    let defaults = Settings::default();
    let settings = Settings {
        batch_bytes: args.batch.unwrap_or(defaults.batch_bytes),
        channel_batches: args.channel.unwrap_or(defaults.channel_batches),
        max_rejects: args.max_rejects,
        ..defaults
    };
    let least = settings.least_memory();
    let settings = Settings { memory_bytes: args.memory.unwrap_or(settings.memory_bytes.max(least)), ..settings };
    let job = Job {
        spec: &spec,
        pipeline: &args.pipeline,
        set: &args.set,
        campaigns: &campaigns,
        shelf: &shelf,
        until: args.until.as_deref(),
        settings,
        style: args.progress.into(),
    };
    stop_on_signals(&job.settings.stop)?;
    let outcome = if args.watch {
        watch::follow(&job, &args.campaign, args.idle.map(Duration::from_secs))?
    } else {
        match job.execute(&mut job.record()?) {
            Ok(outcome) => outcome,
            Err(error) => {
                if matches!(error.downcast_ref(), Some(RunError::Stage { .. })) {
                    // The failure itself is told last, whatever becomes of this.
                    let _ = aftermath::tell_rejects(&shelf);
                }
                return Err(error);
            }
        }
    };
    let out = args.out.display();
    for step in &spec.steps {
        if let Some(record) = outcome.tables.get(&step.heading) {
            let rows: u64 = record.rows(&step.node.tables()[0].name);
            let made = if outcome.computed.contains(&step.heading) { "computed" } else { "reused" };
            println!("{:24} {rows:>10} rows  {made:8}  {out}/{}", step.heading, step.heading);
        }
    }
    aftermath::tell_empty(&spec, &outcome);
    if outcome.rejects > 0 {
        aftermath::tell_rejects(&shelf)?;
        return Ok(if args.strict { ExitCode::FAILURE } else { ExitCode::from(SOME_REJECTED) });
    }
    Ok(ExitCode::SUCCESS)
}
