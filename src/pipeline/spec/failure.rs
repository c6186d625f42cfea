//! What is wrong with a pipeline, its files or `--set`.

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::built_in::{BUILT_IN, BuiltIn};
use crate::campaign::suggest;

/// What is wrong with a pipeline file or with `--set`.
#[derive(Debug, Error)]
pub enum SpecError {
    /// The file cannot be read.
    #[error("cannot read pipeline {}{}", path.display(), neighbours(path))]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// No pipeline in the program has this name.
    #[error("{} (`periscope pipelines` lists all; ./{name} is a file)", unknown(name))]
    Unknown {
        /// What stands in the place of a name.
        name: String,
    },
    /// The folder of a campaign stands in the place of a pipeline.
    #[error(
        "{} is a campaign, and a pipeline is expected here; run it with `periscope run --campaign {}`",
        .0.display(), .0.display()
    )]
    Campaign(PathBuf),
    /// Not TOML, or not of this form.
    #[error("{pipeline}: {message}")]
    Syntax {
        /// Pipeline.
        pipeline: String,
        /// What is wrong, and where.
        message: String,
    },
    /// A heading's content is refused.
    #[error("{pipeline}: [{heading}]: {message}")]
    Heading {
        /// Pipeline, or the file of its bases in which the refused key stands.
        pipeline: String,
        /// Heading.
        heading: String,
        /// What is wrong, and how to fix it.
        message: String,
    },
}

fn unknown(name: &str) -> String {
    match BuiltIn::successor(name) {
        Some(successor) => format!("pipeline `{name}` is now part of `{successor}`; write `{successor}`"),
        None => {
            format!("unknown pipeline `{name}`; {}", suggest::hint(name, BUILT_IN.iter().map(|pipeline| pipeline.name)))
        }
    }
}

/// Suggestions for a wrong path: a folder is no pipeline, and another name may be near.
fn neighbours(path: &Path) -> String {
    if path.is_dir() {
        return "; it is a folder, and a pipeline is a file or a name that `periscope pipelines` lists".to_owned();
    }
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let stem = name.trim_end_matches(".toml");
    if let Some(pipeline) = BuiltIn::named(stem) {
        return format!("; the program has a pipeline of this name: write `{}`", pipeline.name);
    }
    if let Some(successor) = BuiltIn::successor(stem) {
        return format!("; pipeline `{stem}` is now part of `{successor}`: write `{successor}`");
    }
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.path().extension().is_some_and(|extension| extension == "toml"))
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    suggest::nearest(name, names.iter().map(String::as_str))
        .map_or(String::new(), |near| format!("; did you mean `{}`?", path.with_file_name(near).display()))
}
