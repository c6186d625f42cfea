//! What a view shows.
//!
//! A view is a link to a table. In a copy of a result folder (`cp -rL`, an unpacked archive, a synced folder) views
//! have become folders with files of their own. The record of the last run lists every view with its table, so that a
//! copy is read, verified and run on like the original.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use super::disk as fs;
use super::failure::{At, StoreError};
use super::shelf::Shelf;

/// The shelf in a result folder.
pub(super) const SHELF: &str = ".shelf";

impl Shelf {
    /// Folder of the table behind a view, relative to the result folder; `None` if there is no such view.
    ///
    /// # Errors
    /// When a record of a run is damaged.
    pub(super) fn target(&self, view: &str) -> Result<Option<PathBuf>, StoreError> {
        let path = self.out().join(view);
        match fs::read_link(&path) {
            Ok(target) => Ok(Some(target)),
            Err(error) if fs::is_link(&path).at("read", &path)? => Err(error).at("read", &path),
            Err(_) if view != SHELF && fs::is_folder(&path).at("read", &path)? => {
                let runs = self.runs()?;
                let target = runs.iter().rev().find_map(|run| run.views.get(view)).cloned();
                // A record is a file like others: what it says must not lead elsewhere.
                Ok(target.filter(|target| is_table(target)))
            }
            Err(_) => Ok(None),
        }
    }

    /// All views, each with the folder of its table, relative to the result folder.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn targets(&self) -> Result<BTreeMap<String, PathBuf>, StoreError> {
        let mut targets = BTreeMap::new();
        for entry in fs::read_dir(self.out()).at("read", self.out())? {
            let view = entry.at("read", self.out())?.file_name().to_string_lossy().into_owned();
            if let Some(target) = self.target(&view)?.filter(|target| is_table(target)) {
                targets.insert(view, target);
            }
        }
        Ok(targets)
    }
}

/// Whether a link's target is the folder of a table or of a list of rejects, by its words:
/// `.shelf/STAGE/table-LINEAGE/TABLE` or `.shelf/rejects-LINEAGE`.
pub(super) fn is_table(target: &Path) -> bool {
    let name = |part| match part {
        Component::Normal(name) => name.to_str(),
        _ => None,
    };
    let parts: Option<Vec<&str>> = target.components().map(name).collect();
    match parts.as_deref() {
        Some([SHELF, _, whole, _]) => whole.starts_with("table-"),
        Some([SHELF, list]) => list.starts_with("rejects-"),
        _ => false,
    }
}
