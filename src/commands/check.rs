//! `periscope check`: checks a campaign, even while it is still being captured.
//!
//! A built-in pipeline measures every capture through the ordinary runtime. With `--out` its tables stay, and the next
//! check reads only new files; otherwise they go to a temporary folder, which is removed. The results are data
//! ([`report`]), printed as text ([`text`]) or as JSON.

pub mod coverage;
mod quality;
pub mod report;
mod text;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use periscope::campaign::keys::{Exclude, Match};
use periscope::campaign::{Campaign, Manifest, Survey};
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self as runner, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use periscope::tables::{Calibration, Reject, Row};

use super::SOME_REJECTED;
use report::Report;

/// The built-in pipeline. Traces are not kept: they are as large as the campaign.
const PIPELINE: &str = r#"
[calibration_traces]
stage = "ingest"
params = { roles = ["response"] }
keep = false
[calibration]
stage = "calibrate"
from = "calibration_traces"
[traces]
stage = "ingest"
params = { roles = ["scene", "response", "fiducial", "dark", "blocked"] }
keep = false
[profiles]
stage = "average"
from = "traces"
with = { calibration = "calibration" }
[measurements]
stage = "measure"
from = "profiles"
with = { calibration = "calibration" }
[checks]
stage = "characterize"
from = "measurements"
"#;

/// Arguments of `check`.
#[derive(Args)]
pub struct Check {
    /// Campaign folder
    #[arg(long, value_name = "DIR")]
    campaign: PathBuf,
    /// Folder for the measurements, so that the next check reads only new files
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

/// The command.
pub fn check(args: &Check) -> Result<ExitCode> {
    let campaign = Campaign::load(&args.campaign)?;
    let survey = campaign.survey().with_context(|| format!("campaign {}", args.campaign.display()))?;
    let out = OutFolder::of(args.out.as_deref());
    let report = look(&campaign, &survey, &out.path)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", text::text(&report));
    }
    Ok(if report.mend.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(SOME_REJECTED) })
}

/// The folder for tables. A temporary one is removed at the end, even if the check fails.
struct OutFolder {
    path: PathBuf,
    temporary: bool,
}

impl OutFolder {
    fn of(out: Option<&Path>) -> Self {
        let temporary = || std::env::temp_dir().join(format!("periscope-check-{}", std::process::id()));
        Self { path: out.map_or_else(temporary, Path::to_owned), temporary: out.is_none() }
    }
}

impl Drop for OutFolder {
    fn drop(&mut self) {
        if self.temporary {
            // Nothing depends on the result: the system removes what remains.
            let _ = std::fs::remove_dir_all(&self.path);
        }
    }
}

/// Surveys, measures, and gathers the results.
fn look(campaign: &Campaign, survey: &Survey, out: &Path) -> Result<Report> {
    let shelf = Shelf::open(out)?;
    forget_changed(campaign, &shelf)?;
    let calibrating = run(campaign, &shelf, Some("calibration"))?;
    let calibrated: Vec<Calibration> = rows(&shelf, "calibration")?;
    let left_out = coverage::without_template(survey, &calibrated);
    let mut measured = campaign.clone();
    measured.exclude.extend(left_out.iter().map(|sensor| Exclude {
        matches: Match { sensor: Some(sensor.clone()), ..Match::default() },
        reason: "its reference channel is not calibrated".to_owned(),
    }));
    let mut rejects = run(&measured, &shelf, None)?;
    rejects.extend(calibrating);
    let mut report = Report { campaign: campaign.name.clone(), ..Report::default() };
    let measurements = rows(&shelf, "measurements")?;
    coverage::fill(&mut report, campaign, survey, &measurements, &left_out);
    quality::fill(&mut report, &measurements, rows(&shelf, "checks")?, rejects);
    Ok(report)
}

/// Drops records of files that have changed, so that a file that was still being written counts as new.
pub fn forget_changed(campaign: &Campaign, shelf: &Shelf) -> Result<()> {
    let notes = shelf.notes().join(&campaign.name);
    if let Some(mut manifest) = Manifest::load(&notes)? {
        manifest.forget_changed(&campaign.root);
        manifest.save(&notes)?;
    }
    Ok(())
}

/// Runs the pipeline; returns rejected files, and why.
fn run(campaign: &Campaign, shelf: &Shelf, until: Option<&str>) -> Result<BTreeSet<(Option<String>, String)>> {
    let spec = Spec::parse("check", PIPELINE, &[])?;
    let campaigns = [campaign.clone()];
    let mut plan = Plan::new(&spec, &campaigns, shelf, until)?;
    let settings = Settings::default();
    let memory_bytes = settings.memory_bytes.max(settings.least_memory());
    runner::run(&mut plan, &Settings { memory_bytes, ..settings }, &Progress::new(Style::auto()))?;
    let reject = |row: Reject| (row.file.map(|file| file.to_string()), row.reason.to_string());
    let rejects = shelf.batches("rejects")?.iter().map(Reject::rows).collect::<Result<Vec<_>, _>>()?;
    Ok(rejects.into_iter().flatten().map(reject).collect())
}

/// Rows of a table; none if it could not be made since nothing was captured.
fn rows<R: Row>(shelf: &Shelf, view: &str) -> Result<Vec<R>> {
    if shelf.view(view)?.is_none() {
        return Ok(Vec::new());
    }
    let batches = shelf.batches(view)?;
    let rows = batches.iter().map(R::rows).collect::<Result<Vec<_>, _>>()?;
    Ok(rows.into_iter().flatten().collect())
}
