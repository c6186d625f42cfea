//! Runs of pipelines, and simulated campaigns.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use periscope::campaign::Campaign;
use periscope::cancel::Cancel;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::recorded::{lineages, recorded};
use periscope::pipeline::run::{self as runner, Outcome, RunError, Settings};
use periscope::pipeline::spec::{BuiltIn, Definition, Reference, Spec};
use periscope::simulate::{self as simulation, Format, Scene};
use periscope::store::runs::RunRecord;
use periscope::store::{Digest, Shelf};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::require;
use crate::failure::{of_campaign, of_pipeline, of_run, of_scene, of_simulation, of_store};
use crate::interrupt::interruptible_run;

/// Runs a pipeline; `periscope.run` calls it.
///
/// Parameters
/// ----------
/// campaigns : list of path
/// out : path
/// pipeline : path, optional
/// settings : list of str
///     Each `TABLE.PARAM=VALUE`.
/// until : str, optional
/// progress : {"auto", "bar", "lines", "none"}
/// listener : callable, optional
///     Gets each event of the progress as a JSON text, in place of standard error.
///
/// Returns
/// -------
/// rejects : int
///     Rejected rows.
/// left_out : list of str
///     What the campaigns have and no table is made from.
#[pyfunction]
pub fn run(
    py: Python<'_>,
    campaigns: Vec<PathBuf>,
    out: PathBuf,
    pipeline: Option<PathBuf>,
    settings: Vec<String>,
    until: Option<String>,
    progress: &str,
    listener: Option<Py<PyAny>>,
) -> PyResult<(u64, Vec<String>)> {
    require(!campaigns.is_empty(), || "there is no campaign to run".to_owned())?;
    let progress = match listener {
        Some(listener) => Progress::to(move |event| pass_on(&listener, &event.to_string())),
        None => Progress::new(style(progress)?),
    };
    let campaigns: Vec<Campaign> =
        campaigns.iter().map(|folder| Campaign::load(folder).map_err(of_campaign)).collect::<PyResult<_>>()?;
    let reference = match pipeline {
        Some(named) => Reference::new(&named, Path::new("")).map_err(of_pipeline)?,
        None => Reference::BuiltIn(BuiltIn::for_campaigns(&campaigns).0),
    };
    let mut definition = Definition::load(&reference).map_err(of_pipeline)?;
    definition.set(&settings).map_err(of_pipeline)?;
    let spec = Spec::new(&definition).map_err(of_pipeline)?;
    let shelf = Shelf::open(&out).map_err(of_store)?;
    let job = Job { spec, reference, settings, campaigns, shelf, until, progress };
    let outcome = interruptible_run(py, |cancel| job.execute(cancel))?.map_err(of_run)?;
    Ok((outcome.rejects, outcome.left_out.iter().map(ToString::to_string).collect()))
}

/// Passes an event of the progress on. An exception is no reason to end the run: Python prints it.
fn pass_on(listener: &Py<PyAny>, event: &str) {
    Python::attach(|py| listener.call1(py, (event,)).map_err(|error| error.write_unraisable(py, None)).ok());
}

/// How to show progress.
fn style(name: &str) -> PyResult<Style> {
    match name {
        "auto" => Ok(Style::auto()),
        "bar" => Ok(Style::Bar),
        "lines" => Ok(Style::Lines),
        "none" => Ok(Style::Silent),
        other => {
            let problem = format!("progress is {other:?}; give \"auto\", \"bar\", \"lines\" or \"none\"");
            Err(PyValueError::new_err(problem))
        }
    }
}

/// What to run, and into which folder.
struct Job {
    spec: Spec,
    reference: Reference,
    settings: Vec<String>,
    campaigns: Vec<Campaign>,
    shelf: Shelf,
    until: Option<String>,
    progress: Progress,
}

impl Job {
    /// Plans and runs. The record of the run is in the result folder from its start on, as the command line leaves it.
    fn execute(&self, cancel: &Cancel) -> Result<Outcome> {
        self.distinct()?;
        let campaigns = self.campaigns.iter().map(|campaign| (campaign.name.as_str(), campaign.root.as_path()));
        let mut record = RunRecord::start(self.reference.absolute()?, &self.settings, campaigns)?;
        recorded(&self.shelf, &mut record, |whole| self.compute(cancel, whole), |_| cancel.is_cancelled())
    }

    /// Rows of campaigns of one name would mix.
    fn distinct(&self) -> Result<()> {
        let mut roots: BTreeMap<&str, &Path> = BTreeMap::new();
        for Campaign { name, root, .. } in &self.campaigns {
            if let Some(other) = roots.insert(name, root) {
                let (a, b) = (other.display(), root.display());
                bail!("campaigns {a} and {b} are both named `{name}`; change `name` in one campaign.toml");
            }
        }
        Ok(())
    }

    /// Collects the lineages of the complete tables in `whole`, even if it fails.
    fn compute(&self, cancel: &Cancel, whole: &mut BTreeMap<String, Digest>) -> Result<Outcome> {
        let settings = Settings { cancel: cancel.clone(), ..Settings::default() };
        let settings = Settings { memory_bytes: settings.memory_bytes.max(settings.least_memory()), ..settings };
        let mut plan =
            Plan::new(&self.spec, &self.campaigns, &self.shelf, self.until.as_deref()).map_err(RunError::Plan)?;
        let outcome = runner::run(&mut plan, &settings, &self.progress);
        whole.extend(lineages(&plan));
        Ok(outcome?)
    }
}

/// Reads campaign.toml and its tables; `periscope.write_campaign` calls it on what it wrote.
///
/// Parameters
/// ----------
/// campaign : path
///
/// Returns
/// -------
/// str
///     Name of the campaign.
#[pyfunction]
pub fn load_campaign(campaign: PathBuf) -> PyResult<String> {
    Campaign::load(&campaign).map(|campaign| campaign.name).map_err(of_campaign)
}

/// Simulates the campaign of a scene: scope files, campaign.toml, and the truth as tables.
///
/// Parameters
/// ----------
/// scene : str or os.PathLike
///     Scene description (TOML); `periscope simulate --help` lists its keys.
/// out : str or os.PathLike
///     Folder for the campaign; must be empty or absent.
/// seed : int
///     Equal seeds give equal files.
/// format : {"trc", "wfm", "bin", "npy", "csv"}
///     Format of the raw files.
///
/// Raises
/// ------
/// CampaignError
///     If the scene contradicts itself, or the folder is in use.
#[pyfunction]
#[pyo3(signature = (scene, out, *, seed=1, format="trc"))]
pub fn simulate(py: Python<'_>, scene: PathBuf, out: PathBuf, seed: u64, format: &str) -> PyResult<()> {
    let format = match format {
        "trc" => Format::Trc,
        "wfm" => Format::Wfm,
        "bin" => Format::Bin,
        "npy" => Format::Npy,
        "csv" => Format::Csv,
        other => return Err(PyValueError::new_err(format!("format is {other:?}; give trc, wfm, bin, npy or csv"))),
    };
    let scene = Scene::load(&scene).map_err(of_scene)?;
    interruptible_run(py, |_| simulation::simulate(&scene, seed, &out, format).map(drop))?.map_err(of_simulation)
}
