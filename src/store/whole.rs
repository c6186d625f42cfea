//! Everything complete on a shelf, with or without a view, for following a table back to its origins.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::Digest;
use super::disk as fs;
use super::failure::{At, StoreError};
use super::record;
use super::shelf::{Shelf, StageId, TableRecord};

/// What the shelf holds of one stage.
#[derive(Clone, Debug)]
pub struct StoredStage {
    /// The stage.
    pub stage: StageId,
    /// Lineages of its complete parts, unordered.
    pub parts: BTreeSet<Digest>,
    /// Its complete tables; none where the table is not kept, several where raw files changed.
    pub tables: Vec<WholeTable>,
}

/// A complete table: its main table and the side tables.
#[derive(Clone, Debug)]
pub struct WholeTable {
    /// Its record.
    pub record: TableRecord,
    /// Folder with a folder of Parquet files for each of its tables.
    pub folder: PathBuf,
}

impl WholeTable {
    /// Names of its tables.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn names(&self) -> Result<Vec<String>, StoreError> {
        Ok(folders(&self.folder)?
            .iter()
            .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
            .collect())
    }

    /// Files of one of its tables, in order.
    ///
    /// # Errors
    /// When there is no such table.
    pub fn files(&self, table: &str) -> Result<Vec<PathBuf>, StoreError> {
        entries(&self.folder.join(table))
    }
}

impl Shelf {
    /// All stages with something complete on the shelf.
    ///
    /// # Errors
    /// When the shelf cannot be read, or a record is damaged.
    pub fn stored(&self) -> Result<Vec<StoredStage>, StoreError> {
        let mut stored = Vec::new();
        for folder in folders(&self.out().join(".shelf"))? {
            let (mut parts, mut tables) = (BTreeSet::new(), Vec::new());
            for path in entries(&folder)? {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let part = name.strip_prefix("part-").and_then(|name| name.strip_suffix(".json"));
                parts.extend(part.and_then(Digest::from_hex));
                if name.starts_with("table-")
                    && let Some(record) = record::read::<TableRecord>(&path.join("table.json"))?
                {
                    tables.push(WholeTable { record, folder: path });
                }
            }
            // A table without parts has no stage.json; its own record names the stage.
            let of_table = tables.first().map(|table| table.record.stage.clone());
            if let Some(stage) = record::read(&folder.join("stage.json"))?.or(of_table) {
                stored.push(StoredStage { stage, parts, tables });
            }
        }
        Ok(stored)
    }
}

/// Entries of a folder, sorted.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let entries = fs::read_dir(folder).at("read", folder)?.map(|entry| Ok(entry.at("read", folder)?.path()));
    let mut entries = entries.collect::<Result<Vec<PathBuf>, StoreError>>()?;
    entries.sort();
    Ok(entries)
}

/// Folders in a folder, sorted.
fn folders(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let is_folder = |path: PathBuf| Ok(fs::is_folder(&path).at("read", &path)?.then_some(path));
    entries(folder)?.into_iter().filter_map(|path| is_folder(path).transpose()).collect()
}
