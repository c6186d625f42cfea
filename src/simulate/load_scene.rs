//! Reads a scene file.

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::check_scene::{check, check_setup};
use super::keys::SceneFile;
use super::scene::Scene;
use crate::campaign::Fault;
use crate::campaign::toml_text::{self, TomlError};

/// What is wrong with a scene file.
#[derive(Debug, Error)]
pub enum SceneError {
    /// The file cannot be read.
    #[error("cannot read scene {}", file.display())]
    Read {
        /// File.
        file: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// An impossible value.
    #[error("{}: {fault}", file.display())]
    Setup {
        /// File.
        file: PathBuf,
        /// What is wrong, and how to fix it.
        fault: Fault,
    },
    /// An impossible value.
    #[error("{}: {problem}", file.display())]
    Value {
        /// File.
        file: PathBuf,
        /// What is wrong, and how to fix it.
        problem: String,
    },
}

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is refused.
    pub fn load(file: &Path) -> Result<Self, SceneError> {
        let text = toml_text::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
        Self::parse(file, &text)
    }

    /// Parses the text of a scene file, called `file` in messages.
    ///
    /// # Errors
    /// When anything in it is refused.
    pub fn parse(file: &Path, text: &str) -> Result<Self, SceneError> {
        let keys: SceneFile = toml_text::parse(file, text)?;
        let scene = Self {
            name: keys.campaign.name,
            group_index: keys.campaign.group_index,
            dimensions: keys.campaign.dimensions,
            stations: keys.stations,
            sensors: keys.sensors,
            patches: keys.patches,
            views: keys.views,
            surfaces: keys.surfaces,
            laser: keys.laser,
            optics: keys.optics,
            instrument: keys.instrument,
            captures: keys.captures,
            prior: keys.prior,
            text: text.to_owned(),
        };
        check_setup(&scene).map_err(|fault| SceneError::Setup { file: file.to_owned(), fault })?;
        check(&scene).map_err(|problem| SceneError::Value { file: file.to_owned(), problem })?;
        Ok(scene)
    }
}
