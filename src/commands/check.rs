//! `periscope check`: checks a campaign, even while it is still being captured.
//!
//! A built-in pipeline measures every capture through the ordinary runtime. With `--out` its tables stay, and the next
//! check reads only new files; otherwise they go to a temporary folder, which is removed. The results are data
//! ([`report`]), printed as text ([`text`]), as JSON or as rows ([`rows`]).

pub mod coverage;
mod flight;
mod quality;
pub mod report;
mod rows;
mod text;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use periscope::campaign::keys::{Exclude, Match};
use periscope::campaign::left_out::left_out;
use periscope::campaign::{Campaign, Manifest, Role, Survey};
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::rejects;
use periscope::pipeline::responses::{self, MissingResponse};
use periscope::pipeline::run::{self as runner, Settings};
use periscope::pipeline::spec::{Definition, Reference, Spec, Step};
use periscope::stages::Node;
use periscope::store::Shelf;
use periscope::store::finite::NotJson;
use periscope::tables::{Calibration, Echo, Measurement, Reject, Row};

use super::SOME_REJECTED;
use super::output::{Format, Output, json, print, print_text};
use super::run::{or_declared, reference};
use report::Report;

/// The built-in pipeline. Traces are not kept: they are as large as the campaign. Captures of the scene are averaged by
/// the parameters of the pipeline that will run ([`rules`]).
const PIPELINE: &str = r#"
[calibration_traces]
stage = "ingest"
params = { roles = ["response"] }
keep = false
[calibration]
stage = "calibrate"
from = "calibration_traces"
[session_traces]
stage = "ingest"
params = { roles = ["response", "fiducial", "dark", "blocked"] }
keep = false
[session_profiles]
stage = "average"
from = "session_traces"
with = { calibration = "calibration" }
[session_measurements]
stage = "measure"
from = "session_profiles"
with = { calibration = "calibration" }
[checks]
stage = "characterize"
from = "session_measurements"
[traces]
stage = "ingest"
params = { roles = ["scene"] }
keep = false
[profiles]
stage = "average"
from = "traces"
with = { calibration = "calibration" }
[measurements]
stage = "measure"
from = "profiles"
with = { calibration = "calibration" }
"#;

/// Arguments of `check`.
#[derive(Args)]
pub struct Check {
    /// Campaign folder
    #[arg(long, value_name = "DIR")]
    campaign: PathBuf,
    /// Pipeline that will run, a name or a file: captures of the scene are rejected by its rules [default: as of `run`]
    #[arg(long, value_name = "PIPELINE", value_parser = reference())]
    pipeline: Option<Reference>,
    /// Folder for the measurements, so that the next check reads only new files
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn check(args: &Check) -> Result<ExitCode> {
    let campaign = Campaign::load(&args.campaign)?;
    let survey = campaign.survey().with_context(|| format!("campaign {}", args.campaign.display()))?;
    let out = OutFolder::of(args.out.as_deref());
    let reference = or_declared(args.pipeline.as_ref(), std::slice::from_ref(&campaign));
    let spec = Spec::new(&Definition::load(&reference)?)?;
    let look = if campaign.is_of_lidar() { look_at_flight } else { look };
    let report = look(&campaign, &survey, &spec, &out.path)?;
    match args.output.format {
        Format::Table => print_text(&text::text(&report))?,
        Format::Json => print(json(&report)?)?,
        Format::Csv => rows::rows(&report).print(Format::Csv)?,
    }
    Ok(if report.fix.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(SOME_REJECTED) })
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

/// The response that the pipeline needs and no file shows: `run` would refuse the campaign.
fn missing_response(spec: &Spec, campaign: &Campaign, shelf: &Shelf) -> Result<Option<MissingResponse>> {
    let plan = Plan::new(spec, std::slice::from_ref(campaign), shelf, None)?;
    Ok(responses::require(&plan).err())
}

/// Surveys, measures, and gathers the results. `spec` is the pipeline that will run.
fn look(campaign: &Campaign, survey: &Survey, spec: &Spec, out: &Path) -> Result<Report> {
    let shelf = Shelf::open(out)?;
    forget_changed(campaign, &shelf)?;
    let missing = missing_response(spec, campaign, &shelf)?;
    let pipeline = Spec::parse("check", PIPELINE, &rules(spec)?)?;
    let calibrating = run(campaign, &shelf, &pipeline, Some("calibration"))?;
    let calibrated: Vec<Calibration> = table(&shelf, "calibration")?;
    let uncalibrated = coverage::without_template(survey, &calibrated);
    let mut measured = campaign.clone();
    measured.exclude.extend(uncalibrated.iter().map(|sensor| Exclude {
        matches: Match { sensor: Some(sensor.clone()), ..Match::default() },
        reason: "its reference channel is not calibrated".to_owned(),
    }));
    let mut rejects = run(&measured, &shelf, &pipeline, None)?;
    let calibrating: Vec<Reject> = calibrating.into_iter().filter(|reject| !rejects.contains(reject)).collect();
    rejects.extend(calibrating);
    let mut measurements = table(&shelf, "measurements")?;
    measurements.extend(table(&shelf, "session_measurements")?);
    let mut report = report_of_captures(campaign, survey, &measurements, &uncalibrated)?;
    quality::fill(&mut report, &measurements, table(&shelf, "checks")?, &rejects);
    report.fix.extend(missing.map(|missing| missing.words()));
    Ok(report)
}

/// What was captured, and what is missing.
fn report_of_captures(
    campaign: &Campaign,
    survey: &Survey,
    measurements: &[Measurement],
    uncalibrated: &BTreeSet<String>,
) -> Result<Report> {
    let mut report = Report { campaign: campaign.name.clone(), ..Report::default() };
    let left_out = left_out(&campaign.root, survey, Manifest::load(&campaign.root)?.as_ref());
    coverage::fill(&mut report, campaign, survey, measurements, &left_out, uncalibrated);
    Ok(report)
}

/// The same for a lidar.
fn look_at_flight(campaign: &Campaign, survey: &Survey, spec: &Spec, out: &Path) -> Result<Report> {
    let shelf = Shelf::open(out)?;
    forget_changed(campaign, &shelf)?;
    let decompose = spec.steps.iter().find(|step| step.node.kind() == "decompose");
    let params = decompose.map_or(Ok(Vec::new()), |step| settings_of(step, "echoes"))?;
    let rejects = run(campaign, &shelf, &Spec::parse("check", flight::PIPELINE, &params)?, None)?;
    let mut report = report_of_captures(campaign, survey, &[], &BTreeSet::new())?;
    quality::fill(&mut report, &[], Vec::new(), &rejects);
    flight::fill(&mut report, &table::<Echo>(&shelf, "echoes")?);
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

/// How a pipeline averages captures of the scene, as settings of [`PIPELINE`]: so `check` rejects what `run` rejects.
fn rules(spec: &Spec) -> Result<Vec<String>> {
    let reads_scene = |step: &Step| {
        let from = step.from.as_deref().and_then(|from| spec.table(from));
        let Some(Node::Source(source)) = from.map(|(source, _)| &spec.steps[source].node) else { return Ok(false) };
        let roles = source.params()?["roles"].clone();
        Ok::<_, NotJson>(roles.as_array().is_some_and(|roles| roles.iter().any(|role| role == Role::Scene.name())))
    };
    for step in spec.steps.iter().filter(|step| step.node.kind() == "average") {
        if reads_scene(step)? {
            return settings_of(step, "profiles");
        }
    }
    Ok(Vec::new())
}

/// Parameters of a stage as settings of the stage under another heading.
fn settings_of(step: &Step, heading: &str) -> Result<Vec<String>> {
    let Node::Operator(operator) = &step.node else { return Ok(Vec::new()) };
    let params = operator.params()?;
    let given = params.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    Ok(given.map(|(key, value)| format!("{heading}.{key}={value}")).collect())
}

/// Runs a pipeline; returns what was rejected, each once.
fn run(campaign: &Campaign, shelf: &Shelf, pipeline: &Spec, until: Option<&str>) -> Result<Vec<Reject>> {
    let campaigns = [campaign.clone()];
    let mut plan = Plan::new(pipeline, &campaigns, shelf, until)?;
    let settings = Settings::default();
    let memory_bytes = settings.memory_bytes.max(settings.least_memory());
    runner::run(&mut plan, &Settings { memory_bytes, ..settings }, &Progress::new(Style::auto()))?;
    let mut rejects: Vec<Reject> = Vec::new();
    for reject in rejects::rows(shelf)? {
        // A file may be read for several tables.
        if !rejects.iter().any(|other| (&other.file, &other.reason) == (&reject.file, &reject.reason)) {
            rejects.push(reject);
        }
    }
    Ok(rejects)
}

/// Rows of a table; none if it could not be made since nothing was captured.
fn table<R: Row>(shelf: &Shelf, view: &str) -> Result<Vec<R>> {
    if shelf.view(view)?.is_none() {
        return Ok(Vec::new());
    }
    let batches = shelf.batches(view)?;
    let rows = batches.iter().map(R::rows).collect::<Result<Vec<_>, _>>()?;
    Ok(rows.into_iter().flatten().collect())
}
