//! One side of a comparison: a result folder, or a folder of tables such as the truth of a simulated campaign.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use crate::store::{Digest, FileRecord, Shelf, StoreError};
use crate::tables::{Reject, Row};

/// A side's tables.
pub struct Side {
    /// Its folder, as the user gave it.
    pub folder: PathBuf,
    /// In the order of the dataflow if there is one, else by name.
    pub tables: Vec<SideTable>,
    /// Their ancestry; `None` for a folder of tables.
    pub history: Option<(Shelf, Ancestry)>,
}

/// One table of a side.
pub struct SideTable {
    /// Its name: that of the view, or of the folder.
    pub view: String,
    /// Its kind, as in `periscope schema`.
    pub kind: String,
    /// Its node in the ancestry of a result folder; `None` for others, and for `rejects`.
    pub node: Option<Table>,
    /// Its files in order, with their records.
    pub files: Vec<(PathBuf, Option<FileRecord>)>,
}

impl Side {
    /// Opens a result folder, a folder of tables, or a campaign folder that contains its truth.
    ///
    /// # Errors
    /// When it is none of these, or cannot be read.
    pub fn open(folder: &Path) -> Result<Self, HistoryError> {
        if folder.join(".shelf").is_dir() {
            return Self::of_results(folder);
        }
        if !folder.exists() {
            return Err(StoreError::Absent(folder.to_owned()).into());
        }
        let truth = folder.join("truth");
        let tables = Self::of_tables(if truth.is_dir() { &truth } else { folder })?;
        if tables.is_empty() {
            return Err(HistoryError::Refused(format!(
                "{} holds no tables: give a result folder of `periscope run`, or the `truth` of a simulated campaign",
                folder.display()
            )));
        }
        Ok(Self { folder: folder.to_owned(), tables, history: None })
    }

    fn of_results(folder: &Path) -> Result<Self, HistoryError> {
        let shelf = Shelf::look(folder)?;
        let ancestry = Ancestry::of(&shelf)?;
        let mut tables = Vec::new();
        for (view, table) in ancestry.views() {
            let parts = ancestry.record(&table).map(|record| record.parts.as_slice()).unwrap_or_default();
            let records = parts.iter().map(|part| part.files.get(&table.name).cloned());
            let files = ancestry.files(&table)?.into_iter().zip(records).collect();
            tables.push(SideTable { view, kind: table.name.clone(), node: Some(table), files });
        }
        let rejects = Reject::TABLE.to_owned();
        if folder.join(&rejects).is_dir() {
            let files = shelf.files(&rejects)?.into_iter().map(|file| (file, None)).collect();
            tables.push(SideTable { view: rejects.clone(), kind: rejects, node: None, files });
        }
        Ok(Self { folder: folder.to_owned(), tables, history: Some((shelf, ancestry)) })
    }

    /// Tables that are in folders of their names.
    fn of_tables(folder: &Path) -> Result<Vec<SideTable>, HistoryError> {
        let refused =
            |error: std::io::Error| HistoryError::Refused(format!("cannot read {}: {error}", folder.display()));
        let mut folders: BTreeMap<String, Vec<(PathBuf, Option<FileRecord>)>> = BTreeMap::new();
        for entry in fs::read_dir(folder).map_err(refused)?.flatten().filter(|entry| entry.path().is_dir()) {
            let mut files: Vec<PathBuf> =
                fs::read_dir(entry.path()).map_err(refused)?.flatten().map(|entry| entry.path()).collect();
            files.retain(|file| file.extension().is_some_and(|extension| extension == "parquet"));
            files.sort();
            if !files.is_empty() {
                let name = entry.file_name().to_string_lossy().into_owned();
                folders.insert(name, files.into_iter().map(|file| (file, None)).collect());
            }
        }
        let table = |(view, files): (String, Vec<(PathBuf, Option<FileRecord>)>)| SideTable {
            kind: view.clone(),
            view,
            node: None,
            files,
        };
        Ok(folders.into_iter().map(table).collect())
    }

    /// The table of this name.
    pub fn table(&self, view: &str) -> Option<&SideTable> {
        self.tables.iter().find(|table| table.view == view)
    }

    /// Lineage of a table.
    pub fn lineage(&self, table: &SideTable) -> Option<Digest> {
        let (_, ancestry) = self.history.as_ref()?;
        ancestry.record(table.node.as_ref()?).map(|record| record.lineage)
    }
}
