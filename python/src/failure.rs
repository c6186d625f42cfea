//! Errors of the crates as exceptions of `periscope.errors`.

use std::fmt::Display;
use std::path::Path;

use periscope::formats::FormatError as FileError;
use periscope::pipeline::run::RunError as RunFailure;
use periscope::{campaign, geometry, history, pipeline, signal, simulate, store};
use pyo3::PyErr;
use pyo3::exceptions::PyOSError;

pyo3::import_exception!(periscope.errors, CampaignError);
pyo3::import_exception!(periscope.errors, FormatError);
pyo3::import_exception!(periscope.errors, PipelineError);
pyo3::import_exception!(periscope.errors, ResultsError);
pyo3::import_exception!(periscope.errors, RunError);
pyo3::import_exception!(periscope.errors, UndeterminedError);

/// An error with its causes, as the command line prints it.
fn text(error: impl Into<anyhow::Error>) -> String {
    format!("{:#}", error.into())
}

/// What is wrong with a file. What the system refuses is an `OSError` with its number, such as `FileNotFoundError`.
pub fn of_file(path: &Path, error: &FileError) -> PyErr {
    let line = match error {
        FileError::Line { line, .. } => Some(*line),
        _ => None,
    };
    let name = path.display().to_string();
    if let FileError::Io(cause) = error
        && let Some(number) = cause.raw_os_error()
    {
        return PyOSError::new_err((number, cause.to_string(), name));
    }
    FormatError::new_err((format!("{name}: {error}"), name, error.byte_offset(), line))
}

/// A kernel's answer that the measurements do not determine.
fn undetermined(error: impl Display) -> PyErr {
    UndeterminedError::new_err(error.to_string())
}

pub fn of_signal(error: signal::Error) -> PyErr {
    undetermined(error)
}

pub fn of_geometry(error: geometry::Error) -> PyErr {
    undetermined(error)
}

pub fn of_campaign(error: campaign::CampaignError) -> PyErr {
    CampaignError::new_err(text(error))
}

pub fn of_pipeline(error: pipeline::spec::SpecError) -> PyErr {
    PipelineError::new_err(text(error))
}

pub fn of_store(error: store::StoreError) -> PyErr {
    ResultsError::new_err(text(error))
}

pub fn of_history(error: history::HistoryError) -> PyErr {
    ResultsError::new_err(text(error))
}

pub fn of_scene(error: simulate::SceneError) -> PyErr {
    CampaignError::new_err(text(error))
}

pub fn of_simulation(error: simulate::SimulateError) -> PyErr {
    CampaignError::new_err(text(error))
}

/// Why a run ended.
pub fn of_run(error: anyhow::Error) -> PyErr {
    match error.downcast::<RunFailure>() {
        Ok(RunFailure::Store(error)) => of_store(error),
        Ok(error) => RunError::new_err(text(error)),
        Err(error) => RunError::new_err(text(error)),
    }
}
