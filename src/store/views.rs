//! The views: complete tables under the names of their headings. Each is a link to a table that never changes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use serde::{Deserialize, Serialize};

use super::disk as fs;
use super::failure::{At, StoreError};
use super::parquet::{self as file, FileRecord, TableWriter};
use super::shelf::{PartRecord, Shelf, StageId, TableRecord};
use super::{Digest, damage, record, sweep};
use crate::tables::{Reject, Row};

/// Name of a [`RejectsRecord`].
pub(super) const REJECTS_RECORD: &str = "rejects.json";

/// The files of the view `rejects`, which come from many stages.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RejectsRecord {
    /// Files by name.
    pub files: BTreeMap<String, FileRecord>,
}

impl Shelf {
    /// Makes a complete table of parts, and shows each of its tables under its view name.
    ///
    /// `views` pairs the name of a table within the parts with the name of the view.
    ///
    /// # Errors
    /// When the views cannot be written, or something else has their name.
    pub fn publish(
        &self,
        stage: &StageId,
        parts: Vec<PartRecord>,
        views: &[(String, String)],
    ) -> Result<TableRecord, StoreError> {
        let lineage = TableRecord::lineage_of(parts.iter().map(|part| &part.lineage));
        let record = TableRecord { lineage, stage: stage.clone(), parts };
        let name = stage.folder();
        let folder = self.root().join(&name);
        let whole = folder.join(format!("table-{lineage}"));
        self.describe(&folder, stage)?;
        let part = |part: &PartRecord, table: &str| folder.join(format!("part-{}.{table}.parquet", part.lineage));
        let linked = |i: usize, table: &str| {
            let view_file = whole.join(table).join(format!("part-{i:05}.parquet"));
            shows(&view_file, &part(&record.parts[i], table))
        };
        let stands = record::read::<TableRecord>(&whole.join("table.json"))?.as_ref() == Some(&record)
            && views.iter().all(|(table, _)| (0..record.parts.len()).all(|i| linked(i, table)));
        if !stands {
            let temporary = self.temporary(&folder);
            for (table, _) in views {
                let tables = temporary.join(table);
                fs::create_dir_all(&tables).at("create", &tables)?;
                for (i, source) in record.parts.iter().map(|record| part(record, table)).enumerate() {
                    let target = tables.join(format!("part-{i:05}.parquet"));
                    fs::hard_link(&source, &target)
                        .or_else(|_| fs::copy(&source, &target).map(drop))
                        .at("link", &target)?;
                }
            }
            self.write_json(&temporary.join("table.json"), &record)?;
            self.replace(&temporary, &whole)?;
        }
        for (table, view) in views {
            let target = PathBuf::from(".shelf").join(&name).join(format!("table-{lineage}")).join(table);
            self.show(view, &target)?;
        }
        Ok(record)
    }

    /// Shows the rejects of all these tables as one view, `OUT/rejects`, with one file per part and heading. Returns
    /// their number of rows.
    ///
    /// # Errors
    /// When the view cannot be written.
    pub fn publish_rejects(&self, tables: &[(&str, &StageId, &[Option<PartRecord>])]) -> Result<u64, StoreError> {
        let table = Reject::TABLE;
        let files: Vec<_> = tables
            .iter()
            .flat_map(|(heading, stage, parts)| {
                parts.iter().flatten().enumerate().map(move |(i, part)| (*heading, *stage, i, part))
            })
            .filter(|(.., part)| part.files.get(table).is_some_and(|file| file.rows > 0))
            .collect();
        let lineages: Vec<Digest> =
            files.iter().map(|(heading, .., part)| Digest::join(heading, [&part.lineage])).collect();
        let name = format!("{table}-{}", TableRecord::lineage_of(&lineages).short());
        let rows = files.iter().map(|(.., part)| part.files[table].rows).sum();
        let whole = self.root().join(&name);
        let linked = |(heading, stage, i, part): &(&str, &StageId, usize, &PartRecord)| {
            shows(&whole.join(format!("{heading}-{i:05}.parquet")), &self.part_file(stage, &part.lineage, table))
        };
        if fs::is_there(&whole).at("read", &whole)? && files.iter().all(linked) {
            self.show(table, &PathBuf::from(".shelf").join(name))?;
            return Ok(rows);
        }
        let temporary = self.temporary(&self.root());
        fs::create_dir_all(&temporary).at("create", &temporary)?;
        // Without rejects, an empty file keeps the view readable, with its schema.
        let none = temporary.join("none.parquet");
        let empty =
            TableWriter::create(&none, &Reject::schema()).and_then(|writer| writer.finish(&[])).at("write", &none)?;
        let mut record = RejectsRecord { files: BTreeMap::from([("none.parquet".to_owned(), empty)]) };
        for (heading, stage, i, part) in &files {
            let source = self.part_file(stage, &part.lineage, table);
            let name = format!("{heading}-{i:05}.parquet");
            let target = temporary.join(&name);
            fs::hard_link(&source, &target).or_else(|_| fs::copy(&source, &target).map(drop)).at("link", &target)?;
            record.files.insert(name, part.files[table].clone());
        }
        self.write_json(&temporary.join(REJECTS_RECORD), &record)?;
        self.replace(&temporary, &whole)?;
        self.show(table, &PathBuf::from(".shelf").join(name))?;
        Ok(rows)
    }

    /// Replaces a folder that differs from its record. Readers miss it during two renames, not during the removal of
    /// its files.
    fn replace(&self, temporary: &Path, whole: &Path) -> Result<(), StoreError> {
        if fs::is_there(whole).at("read", whole)? {
            let aside = self.temporary(&self.root());
            fs::rename(whole, &aside).at("replace", whole)?;
            fs::rename(temporary, whole).at("write", whole)?;
            return fs::remove_dir_all(&aside).at("remove", &aside);
        }
        fs::rename(temporary, whole).at("write", whole)
    }

    /// Points the view `OUT/<view>` at `target` (relative to OUT) in one step. A folder that copies a table gives way
    /// to the link.
    fn show(&self, view: &str, target: &Path) -> Result<(), StoreError> {
        let link = self.out().join(view);
        let is_copy = match fs::read_link(&link) {
            Ok(present) if present == target => return Ok(()),
            Err(_) if self.is_copy(view, &link)? => true,
            Err(_) if fs::is_there(&link).at("read", &link)? => return Err(StoreError::InTheWay(link)),
            Ok(_) | Err(_) => false,
        };
        let temporary = self.root().join(format!("{}{view}", sweep::VIEW));
        // It may be left from a run that was killed.
        let _ = fs::remove_file(&temporary);
        // The link is made in the shelf and then moved, so its target is relative to OUT.
        fs::symlink(target, &temporary).at("link", &temporary)?;
        if is_copy {
            let aside = self.temporary(&self.root());
            fs::rename(&link, &aside).at("replace", &link)?;
            fs::rename(&temporary, &link).at("link", &link)?;
            return fs::remove_dir_all(&aside).at("remove", &aside);
        }
        fs::rename(&temporary, &link).at("link", &link)
    }

    /// Whether a folder in the place of a view holds just what its table has, byte for byte.
    fn is_copy(&self, view: &str, folder: &Path) -> Result<bool, StoreError> {
        let Some(target) = self.target(view)? else {
            return Ok(false);
        };
        let Some(files) = self.files_of(&target)? else {
            return Ok(false);
        };
        let mut files: BTreeMap<String, FileRecord> = files.into_iter().collect();
        for entry in fs::read_dir(folder).at("read", folder)? {
            let entry = entry.at("read", folder)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let is_whole = match files.remove(&name) {
                Some(file) => damage::find(&entry.path(), &file)?.is_none(),
                None => name == REJECTS_RECORD,
            };
            if !is_whole {
                return Ok(false);
            }
        }
        Ok(files.is_empty())
    }

    /// Names of the files of the table in a folder (relative to OUT), in order, each with its record; `None` if there
    /// is no such table.
    ///
    /// # Errors
    /// When its record is damaged.
    pub(super) fn files_of(&self, target: &Path) -> Result<Option<Vec<(String, FileRecord)>>, StoreError> {
        let folder = self.out().join(target);
        if let Some(rejects) = record::read::<RejectsRecord>(&folder.join(REJECTS_RECORD))? {
            return Ok(Some(rejects.files.into_iter().collect()));
        }
        let table = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(record) = record::read::<TableRecord>(&folder.with_file_name("table.json"))? else {
            return Ok(None);
        };
        let parts = record.parts.into_iter().enumerate();
        Ok(parts.map(|(i, mut part)| Some((format!("part-{i:05}.parquet"), part.files.remove(&table)?))).collect())
    }

    /// The views and the tables behind them, by name.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn tables(&self) -> Result<Vec<(String, TableRecord)>, StoreError> {
        let mut tables = Vec::new();
        for entry in fs::read_dir(self.out()).at("read", self.out())? {
            let name = entry.at("read", self.out())?.file_name().to_string_lossy().into_owned();
            if let Some(record) = self.view(&name)? {
                tables.push((name, record));
            }
        }
        tables.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(tables)
    }

    /// Names of all views, `rejects` among them.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn names(&self) -> Result<Vec<String>, StoreError> {
        let mut names: Vec<String> = self.tables()?.into_iter().map(|(view, _)| view).collect();
        let rejects = self.out().join(Reject::TABLE);
        names.extend(fs::is_folder(&rejects).at("read", &rejects)?.then(|| Reject::TABLE.to_owned()));
        Ok(names)
    }

    /// Record of the table behind a view.
    ///
    /// # Errors
    /// When its record is damaged.
    pub fn view(&self, view: &str) -> Result<Option<TableRecord>, StoreError> {
        let Some(target) = self.target(view)? else {
            return Ok(None);
        };
        let Some(whole) = target.parent() else {
            return Ok(None);
        };
        record::read(&self.out().join(whole).join("table.json"))
    }

    /// Name of the table (main or side) that a view shows; `None` if there is no such view.
    ///
    /// # Errors
    /// When a record of a run is damaged, or the disk does not say.
    pub fn table_of(&self, view: &str) -> Result<Option<String>, StoreError> {
        let name = |target: PathBuf| Some(target.file_name()?.to_string_lossy().into_owned());
        Ok(self.target(view)?.and_then(name))
    }

    /// Time at which the table behind a view was completed; `None` if there is no such view.
    ///
    /// # Errors
    /// When a record of a run is damaged, or the disk does not say.
    pub fn made(&self, view: &str) -> Result<Option<std::time::SystemTime>, StoreError> {
        let Some(target) = self.target(view)? else { return Ok(None) };
        let record = self.out().join(target).with_file_name("table.json");
        let record_is = fs::if_there(fs::metadata(&record)).at("read", &record)?;
        record_is.map(|metadata| metadata.modified().at("read", &record)).transpose()
    }

    /// Files of a view, in order. They belong to the present table even if a run switches the view before they are
    /// read.
    ///
    /// # Errors
    /// When there is no such view.
    pub fn files(&self, view: &str) -> Result<Vec<PathBuf>, StoreError> {
        Ok(self.recorded(view)?.into_iter().map(|(path, _)| path).collect())
    }

    /// Files of a view, in order, each with its record.
    ///
    /// # Errors
    /// When there is no such view, or its record is damaged.
    pub fn recorded(&self, view: &str) -> Result<Vec<(PathBuf, FileRecord)>, StoreError> {
        let missing = || StoreError::NoTable { out: self.out().to_owned(), heading: view.to_owned() };
        // Resolve the link first, in case a run switches the view meanwhile.
        let target = self.target(view)?.ok_or_else(missing)?;
        let folder = self.out().join(&target);
        if !fs::is_folder(&folder).at("read", &folder)? {
            return Err(missing());
        }
        let folder = fs::canonicalize(&folder).at("read", &folder)?;
        let files = self.files_of(&target)?.ok_or_else(missing)?;
        Ok(files.into_iter().map(|(name, file)| (folder.join(name), file)).collect())
    }

    /// All batches of a view.
    ///
    /// # Errors
    /// When there is no such view, or a file cannot be read.
    pub fn batches(&self, view: &str) -> Result<Vec<RecordBatch>, StoreError> {
        let mut batches = Vec::new();
        for (path, record) in self.recorded(view)? {
            for batch in file::read_recorded(&path, &record, 1024)? {
                batches.push(batch?);
            }
        }
        Ok(batches)
    }
}

/// The record of a file that a view shows; `None` for other files.
///
/// # Errors
/// When the record is damaged.
pub(super) fn on_record(path: &Path) -> Result<Option<FileRecord>, StoreError> {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
        return Ok(None);
    };
    let (folder, name) = (fs::canonicalize(folder).at("find", folder)?, name.to_string_lossy());
    if let Some(mut rejects) = record::read::<RejectsRecord>(&folder.join(REJECTS_RECORD))? {
        return Ok(rejects.files.remove(name.as_ref()));
    }
    let table: Option<TableRecord> = record::read(&folder.with_file_name("table.json"))?;
    let part = || name.strip_prefix("part-")?.strip_suffix(".parquet")?.parse::<usize>().ok();
    let file = |mut record: TableRecord| {
        let part = record.parts.get_mut(part()?)?;
        part.files.remove(folder.file_name()?.to_string_lossy().as_ref())
    };
    Ok(table.and_then(file))
}

/// Whether a file of a view shows its part: as a hard link, or as a copy where links are impossible. A part that was
/// made anew is younger.
fn shows(view: &Path, part: &Path) -> bool {
    let (Ok(view), Ok(part)) = (fs::metadata(view), fs::metadata(part)) else {
        return false;
    };
    let not_older = view.modified().ok().zip(part.modified().ok()).is_some_and(|(view, part)| view >= part);
    view.len() == part.len() && not_older
}
