//! How a user names a pipeline: by a name of those in the program, or by a file.

use std::io;
use std::path::{Path, PathBuf};

use super::built_in::BuiltIn;
use super::failure::SpecError;
use crate::campaign::toml_text;

/// Which pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reference {
    /// One in the program.
    BuiltIn(&'static BuiltIn),
    /// A file.
    File(PathBuf),
}

impl Reference {
    /// Text that ends in `.toml` or holds a separator of folders is a file, all else a name. Relative files are seen
    /// from `folder`.
    ///
    /// # Errors
    /// When the program has no pipeline of that name.
    pub fn new(text: &Path, folder: &Path) -> Result<Self, SpecError> {
        let name = text.to_string_lossy();
        if let Some(pipeline) = BuiltIn::named(&name) {
            return Ok(Self::BuiltIn(pipeline));
        }
        if folder.join(text).join("campaign.toml").is_file() {
            return Err(SpecError::Campaign(text.to_owned()));
        }
        if name.ends_with(".toml") || name.contains(std::path::is_separator) {
            return Ok(Self::File(folder.join(text)));
        }
        Err(SpecError::Unknown { name: name.into_owned() })
    }

    /// Its name in messages.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::BuiltIn(pipeline) => pipeline.name.to_owned(),
            Self::File(path) => path.display().to_string(),
        }
    }

    /// Its text.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn text(&self) -> Result<String, SpecError> {
        match self {
            Self::BuiltIn(pipeline) => Ok(pipeline.text.to_owned()),
            Self::File(path) => toml_text::read(path).map_err(|source| SpecError::Read { path: path.clone(), source }),
        }
    }

    /// The folder from which it names other files.
    pub(super) fn folder(&self) -> &Path {
        match self {
            Self::BuiltIn(_) => Path::new(""),
            Self::File(path) => path.parent().unwrap_or(Path::new("")),
        }
    }

    /// Whether both name one pipeline.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::File(a), Self::File(b)) => {
                a == b || a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
            }
            (a, b) => a == b,
        }
    }

    /// The same wherever the program runs: a name, or an absolute path.
    ///
    /// # Errors
    /// When the current folder is gone.
    pub fn absolute(&self) -> io::Result<PathBuf> {
        match self {
            Self::BuiltIn(pipeline) => Ok(PathBuf::from(pipeline.name)),
            Self::File(path) => std::path::absolute(path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_files_differ() {
        let here = |text: &str| Reference::new(Path::new(text), Path::new(""));
        assert_eq!(here("mirror").unwrap().name(), "mirror");
        assert_eq!(here("mirror.toml").unwrap(), Reference::File("mirror.toml".into()));
        assert_eq!(here("./mirror").unwrap(), Reference::File("./mirror".into()));
        assert_eq!(here("mine/p").unwrap(), Reference::File("mine/p".into()));
        assert_eq!(here("mirror/").unwrap(), Reference::File("mirror/".into()));
        let error = here("mirorr").unwrap_err().to_string();
        assert!(error.contains("did you mean `mirror`?") && error.contains("./mirorr"), "{error}");
        let error = here("visible").unwrap_err().to_string();
        assert!(error.contains("`visible` is now part of `scene`"), "{error}");
        let there = Reference::new(Path::new("base.toml"), Path::new("/lab")).unwrap();
        assert_eq!((there.name(), there.folder()), ("/lab/base.toml".to_owned(), Path::new("/lab")));
    }
}
