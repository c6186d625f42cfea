//! The shelf: parts of tables under the lineage that made them, and the views that show whole tables by name.
//!
//! ```text
//! OUT/onsets -> .shelf/detect-<recipe>/table-<lineage>/onsets        the view, switched in one step when the table is whole
//! OUT/.shelf/detect-<recipe>/stage.json                              what made it: kind, version, parameters, fields, inputs
//! OUT/.shelf/detect-<recipe>/part-<lineage>.onsets.parquet           one table of one part
//! OUT/.shelf/detect-<recipe>/part-<lineage>.json                     written last: the part is whole, with digests
//! OUT/.shelf/detect-<recipe>/table-<lineage>/table.json              the parts of a whole table, in order
//! OUT/.shelf/detect-<recipe>/table-<lineage>/onsets/part-00000.parquet   hard links to the parts
//! ```

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use arrow::datatypes::SchemaRef;
use arrow::record_batch::RecordBatch;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Digest;
use super::failure::{At, StoreError};
use super::lock;
use super::parquet::{self as file, FileRecord, TableWriter};
use super::record;
use super::sweep;
use crate::tables::{Reject, Row};

/// Name of a [`RejectsRecord`].
pub(super) const REJECTS_RECORD: &str = "rejects.json";

/// The files of the view `rejects`, which are of many stages.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct RejectsRecord {
    /// Files by name.
    pub files: BTreeMap<String, FileRecord>,
}

/// What makes a table, raw files apart: its recipe's content.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageId {
    /// Kind of the stage.
    pub kind: String,
    /// Version of the stage.
    pub version: u32,
    /// Parameters, as parsed.
    pub params: Value,
    /// Fields of campaign.toml that the stage reads.
    pub fields: Value,
    /// Digest of the schemas that it writes.
    pub schemas: Digest,
    /// On which kind of CPU it was computed.
    pub arithmetic: String,
    /// Recipes of its inputs, by the name under which it knows them (`from`, or a name of `with`).
    pub inputs: BTreeMap<String, Digest>,
}

impl StageId {
    /// Digest of all of it.
    #[must_use]
    pub fn recipe(&self) -> Digest {
        Digest::of(&serde_json::to_value(self).expect("a stage id is plain data"))
    }

    pub(super) fn folder(&self) -> String {
        format!("{}-{}", self.kind, self.recipe().short())
    }
}

/// One whole part: the files of its tables.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartRecord {
    /// Lineage of the part.
    pub lineage: Digest,
    /// Its files by table.
    pub files: BTreeMap<String, FileRecord>,
}

/// One whole table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableRecord {
    /// Lineage of the table: its parts' lineages, in order.
    pub lineage: Digest,
    /// What made it.
    pub stage: StageId,
    /// Its parts, in order.
    pub parts: Vec<PartRecord>,
}

impl TableRecord {
    /// Lineage of a table of these parts.
    pub fn lineage_of<'a>(parts: impl IntoIterator<Item = &'a Digest>) -> Digest {
        Digest::join("table", parts)
    }

    /// Rows of one of its tables (main or side), all parts together.
    #[must_use]
    pub fn rows(&self, table: &str) -> u64 {
        self.parts.iter().filter_map(|part| part.files.get(table)).map(|file| file.rows).sum()
    }

    /// Bytes of one of its tables on disk.
    #[must_use]
    pub fn bytes(&self, table: &str) -> u64 {
        self.parts.iter().filter_map(|part| part.files.get(table)).map(|file| file.bytes).sum()
    }
}

/// A result folder's store.
pub struct Shelf {
    out: PathBuf,
    /// Held while the folder is written; `None` for reading.
    _lock: Option<File>,
    temporary: AtomicU64,
}

impl Shelf {
    /// Opens a result folder for writing: makes it if need be, and sweeps up what a killed run left half-written.
    ///
    /// # Errors
    /// When another run holds it, when it holds foreign files, or when it cannot be written.
    pub fn open(out: &Path) -> Result<Self, StoreError> {
        let shelf = out.join(".shelf");
        let foreign = !shelf.exists() && out.exists() && fs::read_dir(out).at("read", out)?.next().is_some();
        if foreign {
            return Err(StoreError::Foreign(out.to_owned()));
        }
        fs::create_dir_all(&shelf).at("create", &shelf)?;
        let lock = lock::take(out, &shelf)?;
        let shelf = Self { out: out.to_owned(), _lock: Some(lock), temporary: AtomicU64::new(0) };
        sweep::sweep(&shelf.root())?;
        Ok(shelf)
    }

    /// Opens a result folder for reading.
    ///
    /// # Errors
    /// When it is not a result folder.
    pub fn look(out: &Path) -> Result<Self, StoreError> {
        if !out.join(".shelf").is_dir() {
            return Err(StoreError::Foreign(out.to_owned()));
        }
        Ok(Self { out: out.to_owned(), _lock: None, temporary: AtomicU64::new(0) })
    }

    /// A shelf for planning only: works on a folder that does not exist yet, and writes nothing.
    #[must_use]
    pub fn imagine(out: &Path) -> Self {
        Self { out: out.to_owned(), _lock: None, temporary: AtomicU64::new(0) }
    }

    /// The result folder.
    #[must_use]
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// Folder where sources may note down what they learnt of raw files.
    #[must_use]
    pub fn notes(&self) -> PathBuf {
        self.root().join("notes")
    }

    pub(super) fn root(&self) -> PathBuf {
        self.out.join(".shelf")
    }

    fn temporary(&self, folder: &Path) -> PathBuf {
        folder.join(format!("tmp-{}", self.temporary.fetch_add(1, Ordering::Relaxed)))
    }

    /// Record of a part, if it is whole.
    ///
    /// # Errors
    /// When its record is damaged.
    pub fn part(&self, stage: &StageId, lineage: &Digest) -> Result<Option<PartRecord>, StoreError> {
        let folder = self.root().join(stage.folder());
        let Some(record) = record::read::<PartRecord>(&folder.join(format!("part-{lineage}.json")))? else {
            return Ok(None);
        };
        let present = |(table, file): (&String, &FileRecord)| {
            fs::metadata(folder.join(format!("part-{lineage}.{table}.parquet")))
                .is_ok_and(|found| found.len() == file.bytes)
        };
        Ok(record.files.iter().all(present).then_some(record))
    }

    /// Starts a part of these tables.
    ///
    /// # Errors
    /// When its files cannot be created.
    pub fn begin(&self, stage: &StageId, tables: &[(String, SchemaRef)]) -> Result<PartWriter<'_>, StoreError> {
        let folder = self.root().join(stage.folder());
        self.describe(stage)?;
        let mut writers = Vec::new();
        for (table, schema) in tables {
            let path = self.temporary(&folder);
            writers.push((table.clone(), TableWriter::create(&path, schema).at("write", &path)?));
        }
        Ok(PartWriter { shelf: self, stage: stage.clone(), folder, writers })
    }

    /// Writes down what makes the tables of a folder, if that does not stand there.
    fn describe(&self, stage: &StageId) -> Result<(), StoreError> {
        let folder = self.root().join(stage.folder());
        fs::create_dir_all(&folder).at("create", &folder)?;
        let path = folder.join("stage.json");
        if path.exists() { Ok(()) } else { self.write_json(&path, stage) }
    }

    pub(super) fn write_json(&self, path: &Path, value: &impl Serialize) -> Result<(), StoreError> {
        let temporary = self.temporary(path.parent().expect("a record lies in a folder"));
        fs::write(&temporary, record::text(value)).at("write", &temporary)?;
        fs::rename(&temporary, path).at("write", path)
    }

    /// Makes a whole table of parts, and shows each of its tables under its view name.
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
        let folder = self.root().join(stage.folder());
        let whole = folder.join(format!("table-{lineage}"));
        self.describe(stage)?;
        let part = |part: &PartRecord, table: &str| folder.join(format!("part-{}.{table}.parquet", part.lineage));
        let linked = |i: usize, table: &str| {
            let shown = whole.join(table).join(format!("part-{i:05}.parquet"));
            shows(&shown, &part(&record.parts[i], table))
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
            let target = PathBuf::from(".shelf").join(stage.folder()).join(format!("table-{lineage}")).join(table);
            self.show(view, &target)?;
        }
        Ok(record)
    }

    /// Shows the rejects of all these tables as one view, `OUT/rejects`, a file a part and heading; gives their number of rows.
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
        let named: Vec<Digest> =
            files.iter().map(|(heading, .., part)| Digest::join(heading, [&part.lineage])).collect();
        let name = format!("{table}-{}", TableRecord::lineage_of(&named).short());
        let rows = files.iter().map(|(.., part)| part.files[table].rows).sum();
        let whole = self.root().join(&name);
        let linked = |(heading, stage, i, part): &(&str, &StageId, usize, &PartRecord)| {
            shows(&whole.join(format!("{heading}-{i:05}.parquet")), &self.part_file(stage, &part.lineage, table))
        };
        if whole.exists() && files.iter().all(linked) {
            self.show(table, &PathBuf::from(".shelf").join(name))?;
            return Ok(rows);
        }
        let temporary = self.temporary(&self.root());
        fs::create_dir_all(&temporary).at("create", &temporary)?;
        // An empty file keeps the view readable, with its schema, when nothing was set aside.
        let none = temporary.join("none.parquet");
        let empty =
            TableWriter::create(&none, &Reject::schema()).and_then(|writer| writer.finish(&[])).at("write", &none)?;
        let mut shown = RejectsRecord { files: BTreeMap::from([("none.parquet".to_owned(), empty)]) };
        for (heading, stage, i, part) in &files {
            let source = self.part_file(stage, &part.lineage, table);
            let name = format!("{heading}-{i:05}.parquet");
            let target = temporary.join(&name);
            fs::hard_link(&source, &target).or_else(|_| fs::copy(&source, &target).map(drop)).at("link", &target)?;
            shown.files.insert(name, part.files[table].clone());
        }
        self.write_json(&temporary.join(REJECTS_RECORD), &shown)?;
        self.replace(&temporary, &whole)?;
        self.show(table, &PathBuf::from(".shelf").join(name))?;
        Ok(rows)
    }

    /// Puts a whole folder where perhaps another is that is not as its record says. Readers miss it for two renames, not for as long as its files take to remove.
    fn replace(&self, temporary: &Path, whole: &Path) -> Result<(), StoreError> {
        if whole.exists() {
            let aside = self.temporary(&self.root());
            fs::rename(whole, &aside).at("replace", whole)?;
            fs::rename(temporary, whole).at("write", whole)?;
            return fs::remove_dir_all(&aside).at("remove", &aside);
        }
        fs::rename(temporary, whole).at("write", whole)
    }

    /// Points the view `OUT/<view>` at `target` (relative to OUT) in one step.
    fn show(&self, view: &str, target: &Path) -> Result<(), StoreError> {
        let link = self.out.join(view);
        match fs::read_link(&link) {
            Ok(present) if present == target => return Ok(()),
            Err(_) if link.exists() => return Err(StoreError::InTheWay(link)),
            _ => {}
        }
        let temporary = self.out.join(format!(".shelf/tmp-view-{view}"));
        let _ = fs::remove_file(&temporary);
        // The link is made in the shelf and moved out, so its target is written as seen from OUT.
        std::os::unix::fs::symlink(target, &temporary).at("link", &temporary)?;
        fs::rename(&temporary, &link).at("link", &link)
    }

    /// The views and the tables behind them, by name.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn tables(&self) -> Result<Vec<(String, TableRecord)>, StoreError> {
        let mut tables = Vec::new();
        for entry in fs::read_dir(&self.out).at("read", &self.out)?.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if let Some(record) = self.view(&name)? {
                tables.push((name, record));
            }
        }
        tables.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(tables)
    }

    /// Record of the table behind a view.
    ///
    /// # Errors
    /// When its record is damaged.
    pub fn view(&self, view: &str) -> Result<Option<TableRecord>, StoreError> {
        let Ok(target) = fs::read_link(self.out.join(view)) else {
            return Ok(None);
        };
        let Some(whole) = target.parent() else {
            return Ok(None);
        };
        record::read(&self.out.join(whole).join("table.json"))
    }

    /// Name of the table (main or side) that a view shows.
    #[must_use]
    pub fn table_of(&self, view: &str) -> Option<String> {
        let target = fs::read_link(self.out.join(view)).ok()?;
        Some(target.file_name()?.to_string_lossy().into_owned())
    }

    /// When the table behind a view became whole.
    #[must_use]
    pub fn made(&self, view: &str) -> Option<std::time::SystemTime> {
        let target = fs::read_link(self.out.join(view)).ok()?;
        fs::metadata(self.out.join(target.parent()?).join("table.json")).ok()?.modified().ok()
    }

    /// Files of a view, in order: of the table that it shows now, also when a run switches the view before they are read.
    ///
    /// # Errors
    /// When there is no such view.
    pub fn files(&self, view: &str) -> Result<Vec<PathBuf>, StoreError> {
        Ok(self.recorded(view)?.into_iter().map(|(path, _)| path).collect())
    }

    /// Files of a view, in order, with what is on record of each.
    ///
    /// # Errors
    /// When there is no such view, or its record is damaged.
    pub fn recorded(&self, view: &str) -> Result<Vec<(PathBuf, FileRecord)>, StoreError> {
        let missing = || StoreError::NoTable { out: self.out.clone(), heading: view.to_owned() };
        // Of the table as it is now, also where the view is switched meanwhile.
        let folder = fs::canonicalize(self.out.join(view)).map_err(|_| missing())?;
        if let Some(rejects) = record::read::<RejectsRecord>(&folder.join(REJECTS_RECORD))? {
            return Ok(rejects.files.into_iter().map(|(name, file)| (folder.join(name), file)).collect());
        }
        let table = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let record = record::read::<TableRecord>(&folder.with_file_name("table.json"))?.ok_or_else(missing)?;
        let parts = record.parts.into_iter().enumerate();
        let file = |(i, mut part): (usize, PartRecord)| {
            part.files
                .remove(&table)
                .map(|file| (folder.join(format!("part-{i:05}.parquet")), file))
                .ok_or_else(missing)
        };
        parts.map(file).collect()
    }

    /// File of one table of one part.
    #[must_use]
    pub fn part_file(&self, stage: &StageId, lineage: &Digest, table: &str) -> PathBuf {
        self.root().join(stage.folder()).join(format!("part-{lineage}.{table}.parquet"))
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

    /// Batches of one table of one part, of at most `rows` rows each.
    ///
    /// # Errors
    /// When its file is not as it was written.
    pub fn read(
        &self,
        stage: &StageId,
        part: &PartRecord,
        table: &str,
        rows: usize,
    ) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<>, StoreError> {
        file::read_recorded(&self.part_file(stage, &part.lineage, table), &part.files[table], rows)
    }
}

/// What is on record of a file that a view shows; `None` for files elsewhere.
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

/// Whether a file of a view shows its part: linked to it, or, where there are no links, copied from it. A part that was made anew is younger.
fn shows(view: &Path, part: &Path) -> bool {
    let (Ok(view), Ok(part)) = (fs::metadata(view), fs::metadata(part)) else {
        return false;
    };
    let not_older = view.modified().ok().zip(part.modified().ok()).is_some_and(|(view, part)| view >= part);
    view.len() == part.len() && not_older
}

/// Writes the tables of one part; nothing of it counts before [`PartWriter::commit`].
pub struct PartWriter<'a> {
    shelf: &'a Shelf,
    stage: StageId,
    folder: PathBuf,
    writers: Vec<(String, TableWriter)>,
}

impl PartWriter<'_> {
    /// Appends rows to the `table`-th table of the part.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, table: usize, batch: &RecordBatch) -> Result<(), StoreError> {
        let writer = &mut self.writers[table].1;
        let path = writer.path().to_owned();
        writer.write(batch).at("write", &path)
    }

    /// Ends the part under its lineage: files are moved to their names, and its record is written last.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn commit(mut self, lineage: Digest) -> Result<PartRecord, StoreError> {
        let footer = [
            ("periscope.lineage", lineage.to_string()),
            ("periscope.stage", serde_json::to_string(&self.stage).expect("a stage id is plain data")),
        ];
        let mut files = BTreeMap::new();
        for (table, writer) in std::mem::take(&mut self.writers) {
            let temporary = writer.path().to_owned();
            let record = writer.finish(&footer).at("write", &temporary)?;
            let path = self.folder.join(format!("part-{lineage}.{table}.parquet"));
            fs::rename(&temporary, &path).at("write", &path)?;
            files.insert(table, record);
        }
        let record = PartRecord { lineage, files };
        self.shelf.write_json(&self.folder.join(format!("part-{lineage}.json")), &record)?;
        Ok(record)
    }
}

impl Drop for PartWriter<'_> {
    /// What was not committed goes; what cannot be removed now is swept away when the folder is opened next.
    fn drop(&mut self) {
        for (_, writer) in &self.writers {
            let _ = fs::remove_file(writer.path());
        }
    }
}
