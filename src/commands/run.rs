//! `periscope run`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use periscope::campaign::Campaign;
use periscope::cancel::Cancel;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::rejects::MaxRejects;
use periscope::pipeline::roots;
use periscope::pipeline::run::{self as runner, Outcome, RunError, Settings};
use periscope::pipeline::shards;
use periscope::pipeline::spec::Spec;
use periscope::store::runs::{Ending, RunRecord};
use periscope::store::{Digest, Shelf, StoreError};

use super::aftermath;
use super::interrupt::{cancel_on_signals, is_interruption};
use super::machine::{Machine, size};
use super::watch;

/// Time between two attempts to open a folder that another run holds.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Arguments of `run`.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools, reason = "flags of the command line")]
pub struct Run {
    /// Pipeline file (TOML): one heading per table
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
    #[command(flatten)]
    machine: Machine,
    /// Wait while another run holds the result folder, instead of failing
    #[arg(long)]
    wait: bool,
    /// Follow a measurement in progress: run again whenever files have arrived, until Ctrl-C
    #[arg(long)]
    watch: bool,
    /// With --watch: end when no file has arrived for this many seconds
    #[arg(long, value_name = "SECONDS", requires = "watch")]
    idle: Option<u64>,
    /// Stop if more than this many records are rejected, or more than this share of all, such as 5%
    #[arg(long, value_name = "N|P%")]
    max_rejects: Option<MaxRejects>,
    /// First read all raw files again, even those with the recorded size and time of change
    #[arg(long)]
    rehash: bool,
    /// Exit with 1 if any input was rejected
    #[arg(long)]
    strict: bool,
    /// Bytes to read at a time; results do not depend on it
    #[arg(long, value_name = "SIZE", value_parser = size, help_heading = "Tuning")]
    batch: Option<usize>,
    /// Most batches in a channel between two stages; results do not depend on it
    #[arg(long, value_name = "N", help_heading = "Tuning")]
    channel: Option<usize>,
}

/// Loads campaigns, and checks that their names differ: rows of equal names would mix.
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

/// What to run, and into which folder.
#[derive(Clone)]
pub struct Job<'a> {
    /// The parsed pipeline.
    pub spec: &'a Spec,
    /// Its file.
    pub pipeline: &'a Path,
    /// Parameters changed on the command line.
    pub set: &'a [String],
    /// The campaigns.
    pub campaigns: &'a [Campaign],
    /// The result folder, open for writing.
    pub shelf: &'a Shelf,
    /// Last wanted table.
    pub until: Option<&'a str>,
    /// How to use the machine.
    pub settings: Settings,
    /// How to show progress.
    pub style: Style,
    /// The shards that must be finished first.
    pub shards: Option<&'a shards::Job>,
}

impl Job<'_> {
    /// A record of a run that starts now.
    pub fn record(&self) -> Result<RunRecord> {
        let campaigns = self.campaigns.iter().map(|campaign| (campaign.name.as_str(), campaign.root.as_path()));
        Ok(RunRecord::start(self.pipeline, self.set, campaigns)?)
    }

    /// Plans and runs; prints warnings of the survey. The record of the run is on the shelf from its start on.
    pub fn execute(&self, record: &mut RunRecord) -> Result<Outcome> {
        self.shelf.write_run(record)?;
        let outcome = Cancel::catch(|| self.compute(&mut record.tables)).map_err(Into::into).flatten();
        let ending = match &outcome {
            Ok(outcome) => {
                record.rejects = outcome.rejects;
                record.passes.clone_from(&outcome.passes);
                Ending::Done
            }
            Err(error) if is_interruption(error) => Ending::Interrupted,
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

    /// The same. If a stage fails, it also prints what was rejected before.
    pub fn execute_and_tell(&self, record: &mut RunRecord) -> Result<Outcome> {
        let outcome = self.execute(record);
        if let Err(error) = &outcome
            && matches!(error.downcast_ref(), Some(RunError::Stage { .. }))
        {
            // The caller prints the failure itself last, whether this succeeds or not.
            let _ = aftermath::tell_rejects(self.shelf);
        }
        outcome
    }

    /// Collects the lineages of the complete tables in `whole`, even if it fails.
    fn compute(&self, whole: &mut BTreeMap<String, Digest>) -> Result<Outcome> {
        let progress = Progress::new(self.style);
        if let Some(shards) = self.shards {
            shards.join(self.shelf, &self.settings, &progress, &mut |warning| eprintln!("warning: {warning}"))?;
        }
        let mut plan = Plan::new(self.spec, self.campaigns, self.shelf, self.until)?;
        for warning in plan.warnings() {
            eprintln!("warning: {warning}");
        }
        if let Some(shards) = self.shards {
            shards.check(&plan)?;
        }
        let outcome = runner::run(&mut plan, &self.settings, &progress);
        let steps = self.spec.steps.iter().zip(&plan.tables);
        let kept = steps.filter(|(step, table)| step.keep && table.wanted && table.complete());
        whole.extend(kept.filter_map(|(step, table)| Some((step.heading.clone(), table.lineage()?))));
        Ok(outcome?)
    }
}

/// Opens a result folder for writing; with `wait`, waits for its holder.
pub fn open(out: &Path, wait: bool) -> Result<Shelf> {
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
    args.machine.start()?;
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
    let job = Job {
        spec: &spec,
        pipeline: &args.pipeline,
        set: &args.set,
        campaigns: &campaigns,
        shelf: &shelf,
        until: args.until.as_deref(),
        settings: args.machine.settings(settings),
        style: args.machine.style(),
        shards: None,
    };
    cancel_on_signals(&job.settings.cancel)?;
    let outcome = if args.watch {
        watch::follow(&job, &args.campaign, args.idle.map(Duration::from_secs))?
    } else {
        job.execute_and_tell(&mut job.record()?)?
    };
    aftermath::tell(&spec, &outcome, &shelf, args.strict)
}
