//! `periscope run`.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use clap::builder::{OsStringValueParser, TypedValueParser};
use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::recorded::{lineages, recorded};
use periscope::pipeline::rejects::MaxRejects;
use periscope::pipeline::roots;
use periscope::pipeline::run::{self as runner, Outcome, RunError, Settings};
use periscope::pipeline::shards;
use periscope::pipeline::spec::{BuiltIn, Definition, Reference, Spec};
use periscope::pipeline::timeline::Timeline;
use periscope::store::runs::RunRecord;
use periscope::store::{Digest, Left, Shelf, StoreError};

use super::aftermath;
use super::interrupt::{cancel_on_signals, is_interruption};
use super::machine::{Machine, size};
use super::output::{Output, note};
use super::watch;

/// Time between two attempts to open a folder that another run holds.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// Arguments of `run`.
#[derive(Args)]
#[allow(clippy::struct_excessive_bools, reason = "flags of the command line")]
pub struct Run {
    /// Pipeline: a name that `periscope pipelines` lists, or a file (TOML) [default: scene, or the one for mirrors,
    /// strips or a relay wall that campaign.toml declares]
    #[arg(value_parser = reference())]
    pipeline: Option<Reference>,
    /// Campaign folder, with a campaign.toml; may be given several times for one scene
    #[arg(long, required = true, value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Result folder (default: `<campaign>-results`, next to the campaign)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Stop after this table
    #[arg(long, value_name = "TABLE")]
    until: Option<String>,
    /// Change a parameter of the pipeline, such as `onsets.threshold_sigma=6`
    #[arg(long, value_name = "TABLE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    pub machine: Machine,
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
    /// First read all raw files again, even those with the recorded size, times and inode
    #[arg(long)]
    rehash: bool,
    /// Write what each stage does when into this file, for Perfetto (https://ui.perfetto.dev)
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Exit with 1 if any input was left out or rejected, or a result is empty
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    output: Output,
    /// Bytes to read at a time; results do not depend on it
    #[arg(long, value_name = "SIZE", value_parser = size, help_heading = "Tuning")]
    batch: Option<usize>,
    /// Most batches in a channel between two stages; results do not depend on it
    #[arg(long, value_name = "N", help_heading = "Tuning")]
    channel: Option<usize>,
}

/// Reads which pipeline a user means: here, so that a folder in its place is the first thing to be refused.
pub fn reference() -> impl TypedValueParser<Value = Reference> {
    OsStringValueParser::new().try_map(|text| Reference::new(Path::new(&text), Path::new("")))
}

/// The pipeline that was named, else the one for what the campaigns declare.
pub fn or_declared(named: Option<&Reference>, campaigns: &[Campaign]) -> Reference {
    named.cloned().unwrap_or_else(|| {
        let (pipeline, reason) = BuiltIn::for_campaigns(campaigns);
        if let Some(reason) = reason {
            note!("pipeline {}: campaign.toml has {reason}", pipeline.name);
        }
        Reference::BuiltIn(pipeline)
    })
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
    /// Its name, or the absolute path of its file.
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
        Ok(RunRecord::start(self.pipeline.to_owned(), self.set, campaigns)?)
    }

    /// Plans and runs; prints warnings of the survey. The record of the run is on the shelf from its start on.
    pub fn execute(&self, record: &mut RunRecord) -> Result<Outcome> {
        recorded(self.shelf, record, |whole| self.compute(whole), is_interruption)
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
            shards.join(self.shelf, &self.settings, &progress, &mut |warning| note!("warning: {warning}"))?;
        }
        let mut plan = Plan::new(self.spec, self.campaigns, self.shelf, self.until)?;
        aftermath::tell_left_out(&plan);
        if let Some(shards) = self.shards {
            shards.check(&plan)?;
        }
        let outcome = runner::run(&mut plan, &self.settings, &progress);
        whole.extend(lineages(&plan));
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
                    note!("waiting: {error}");
                    is_told = true;
                }
                std::thread::sleep(LOOK_AGAIN);
            }
            opened => {
                let shelf = opened?;
                for Left { path, why } in shelf.leftovers() {
                    note!(
                        "warning: {} was left by a run that was killed, and cannot be removed: {why}",
                        path.display()
                    );
                }
                return Ok(shelf);
            }
        }
    }
}

/// The result folder: as given, or the folder of the one campaign with `-results` behind its name.
pub fn results(out: Option<&Path>, campaigns: &[PathBuf]) -> Result<PathBuf> {
    match (out, campaigns) {
        (Some(out), _) => Ok(out.to_owned()),
        (None, [campaign]) => next_to(campaign),
        (None, _) => bail!("{} campaigns make one result folder; give it with --out DIR", campaigns.len()),
    }
}

/// The folder next to a campaign for its results.
fn next_to(campaign: &Path) -> Result<PathBuf> {
    let with_suffix = |name: &OsStr| {
        let mut name = name.to_owned();
        name.push("-results");
        name
    };
    if let Some(name) = campaign.file_name() {
        return Ok(campaign.with_file_name(with_suffix(name)));
    }
    // `.` and `..` have a name only seen from above.
    let absolute = campaign.canonicalize().with_context(|| format!("campaign {}", campaign.display()))?;
    let name = absolute.file_name().with_context(|| {
        format!("{} has no folder next to it for results; give one with --out DIR", absolute.display())
    })?;
    let here: PathBuf = campaign.components().filter(|part| *part != Component::CurDir).collect();
    Ok(here.join("..").join(with_suffix(name)))
}

/// A trace that begins now.
fn timeline(file: &Path) -> Result<Arc<Timeline>> {
    let begin = || Timeline::new(Box::new(BufWriter::new(File::create(file)?)));
    Ok(Arc::new(begin().with_context(|| format!("the trace {}", file.display()))?))
}

/// The command.
pub fn run(args: &Run) -> Result<ExitCode> {
    let out = results(args.out.as_deref(), &args.campaign)?;
    let campaigns = campaigns(&args.campaign)?;
    let reference = or_declared(args.pipeline.as_ref(), &campaigns);
    let mut definition = Definition::load(&reference)?;
    definition.set(&args.set)?;
    let spec = Spec::new(&definition)?;
    let shelf = args.machine.folder(open(&out, args.wait)?);
    if args.rehash {
        roots::rehash(&campaigns, &shelf)?;
    }
    let defaults = Settings::default();
    let settings = Settings {
        batch_bytes: args.batch.unwrap_or(defaults.batch_bytes),
        channel_batches: args.channel.unwrap_or(defaults.channel_batches),
        max_rejects: args.max_rejects,
        timeline: args.trace.as_deref().map(timeline).transpose()?,
        ..defaults
    };
    let job = Job {
        spec: &spec,
        pipeline: &reference.absolute()?,
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
    if let Some((timeline, file)) = job.settings.timeline.as_ref().zip(args.trace.as_ref()) {
        timeline.finish().with_context(|| format!("the trace {}", file.display()))?;
    }
    let is_incomplete = aftermath::tell(&spec, &outcome, &shelf, args.output.format)?;
    Ok(aftermath::exit_code(is_incomplete, args.strict))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_lie_next_to_their_campaign() {
        let results = |campaign: &str| results(None, &[campaign.into()]).unwrap();
        assert_eq!(results("my-campaign"), Path::new("my-campaign-results"));
        assert_eq!(results("my-campaign/"), Path::new("my-campaign-results"));
        assert_eq!(results("./lab/day.2/."), Path::new("./lab/day.2-results"));
        assert_eq!(results("/lab/day"), Path::new("/lab/day-results"));
        let here = std::env::current_dir().unwrap();
        let name = format!("../{}-results", here.file_name().unwrap().display());
        assert_eq!(results("."), Path::new(&name));
        assert_eq!(results("./."), Path::new(&name));
        assert!(super::results(None, &["a".into(), "b".into()]).unwrap_err().to_string().contains("--out DIR"));
        assert!(super::results(None, &["/".into()]).unwrap_err().to_string().contains("--out DIR"));
        assert_eq!(super::results(Some(Path::new("c")), &["a".into(), "b".into()]).unwrap(), Path::new("c"));
    }
}
