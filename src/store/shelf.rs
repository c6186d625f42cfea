//! The shelf: parts of tables, stored under their lineage, and the views, which show whole tables by name.
//!
//! ```text
//! OUT/onsets -> .shelf/detect-<recipe>/table-<lineage>/onsets        the view, switched in one step when the table is
//! whole OUT/.shelf/detect-<recipe>/stage.json                              what made it: kind, version, parameters,
//! fields, inputs OUT/.shelf/detect-<recipe>/part-<lineage>.onsets.parquet           one table of one part
//! OUT/.shelf/detect-<recipe>/part-<lineage>.json                     written last: the part is whole, with digests
//! OUT/.shelf/detect-<recipe>/table-<lineage>/table.json              the parts of a whole table, in order
//! OUT/.shelf/detect-<recipe>/table-<lineage>/onsets/part-00000.parquet   hard links to the parts
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Digest;
use super::disk as fs;
use super::failure::{At, StoreError};
use super::lock::{self, Hold};
use super::parquet::{self as file, FileRecord, TableWriter};
use super::record;
use super::sweep::{self, Left};

/// The content of a recipe: everything that determines a table except raw files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageId {
    /// Kind of the stage.
    pub kind: String,
    /// Version of the stage.
    pub version: u32,
    /// Parsed parameters.
    pub params: Value,
    /// Fields of campaign.toml that the stage reads.
    pub fields: Value,
    /// Digest of the schemas that it writes.
    pub schemas: Digest,
    /// Kind of CPU that computed it.
    pub arithmetic: String,
    /// Recipes of its inputs, by their names in the stage (`from`, or a name of `with`).
    pub inputs: BTreeMap<String, Digest>,
}

impl StageId {
    /// Digest of all fields.
    #[must_use]
    pub fn recipe(&self) -> Digest {
        /// The fields as a JSON value has them: in the order of their names.
        #[derive(Serialize)]
        struct Canonical<'a> {
            arithmetic: &'a str,
            fields: &'a Value,
            inputs: &'a BTreeMap<String, Digest>,
            kind: &'a str,
            params: &'a Value,
            schemas: &'a Digest,
            version: u32,
        }
        let Self { kind, version, params, fields, schemas, arithmetic, inputs } = self;
        Digest::of_sorted(&Canonical { arithmetic, fields, inputs, kind, params, schemas, version: *version })
    }

    pub(super) fn folder(&self) -> String {
        format!("{}-{}", self.kind, self.recipe().short())
    }
}

/// One complete part: the files of its tables.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartRecord {
    /// Lineage of the part.
    pub lineage: Digest,
    /// Its files by table.
    pub files: BTreeMap<String, FileRecord>,
}

/// One complete table.
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
    /// Held for writing; `None` for reading.
    _lock: Option<lock::Lock>,
    temporary: AtomicU64,
    leftovers: Vec<Left>,
    is_durable: bool,
}

impl Shelf {
    /// Opens a result folder for writing. It creates the folder if necessary, and removes what killed runs left
    /// half-written.
    ///
    /// # Errors
    /// When another run holds it, when it holds foreign files, when its shelf is a link, or when it cannot be written.
    pub fn open(out: &Path) -> Result<Self, StoreError> {
        let mut shelf = Self::take(out, Hold::Alone)?;
        shelf.leftovers = sweep::sweep(&shelf.root())?;
        Ok(shelf)
    }

    /// Opens a result folder to add parts, together with other processes; creates it if necessary. The caller must not
    /// switch views.
    ///
    /// # Errors
    /// When a run holds it alone, when it holds foreign files, or when it cannot be written.
    pub fn join(out: &Path) -> Result<Self, StoreError> {
        Self::take(out, Hold::Together)
    }

    fn take(out: &Path, hold: Hold) -> Result<Self, StoreError> {
        let shelf = out.join(".shelf");
        if fs::is_link(&shelf).at("read", &shelf)? {
            return Err(StoreError::Linked(shelf));
        }
        let is_new = !fs::is_there(&shelf).at("read", &shelf)? && fs::is_there(out).at("read", out)?;
        if is_new && fs::read_dir(out).at("read", out)?.next().is_some() {
            return Err(StoreError::Foreign(out.to_owned()));
        }
        fs::create_dir_all(&shelf).at("create", &shelf)?;
        let lock = lock::take(out, &shelf, hold)?;
        Ok(Self { _lock: Some(lock), ..Self::imagine(out) })
    }

    /// Opens a result folder for reading.
    ///
    /// # Errors
    /// When it is not a result folder.
    pub fn look(out: &Path) -> Result<Self, StoreError> {
        if !fs::is_folder(&out.join(".shelf")).at("read", out)? {
            return Err(StoreError::Absent(out.to_owned()));
        }
        Ok(Self::imagine(out))
    }

    /// A shelf for planning only: it accepts a folder that does not exist yet, and writes nothing.
    #[must_use]
    pub fn imagine(out: &Path) -> Self {
        Self {
            out: out.to_owned(),
            _lock: None,
            temporary: AtomicU64::new(0),
            leftovers: Vec::new(),
            is_durable: false,
        }
    }

    /// The same, if `is_durable` with parts and records that are on the disk before they have their names: a power cut
    /// then loses no finished part.
    #[must_use]
    pub fn durable(self, is_durable: bool) -> Self {
        Self { is_durable, ..self }
    }

    /// The result folder.
    #[must_use]
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// Leftovers of killed runs that could not be removed when the folder was opened.
    #[must_use]
    pub fn leftovers(&self) -> &[Left] {
        &self.leftovers
    }

    /// Folder for notes of sources on raw files.
    #[must_use]
    pub fn notes(&self) -> PathBuf {
        self.root().join("notes")
    }

    pub(super) fn root(&self) -> PathBuf {
        self.out.join(".shelf")
    }

    pub(super) fn temporary(&self, folder: &Path) -> PathBuf {
        folder.join(format!("{}{}-{}", sweep::UNFINISHED, lock::mark(), self.temporary.fetch_add(1, Ordering::Relaxed)))
    }

    /// Records of the parts with these lineages, of those that are complete.
    ///
    /// # Errors
    /// When a record is damaged, or a file cannot be looked at.
    pub fn parts(&self, stage: &StageId, lineages: &[Option<Digest>]) -> Result<Vec<Option<PartRecord>>, StoreError> {
        let folder = self.root().join(stage.folder());
        let part = |lineage: &Option<Digest>| lineage.map_or(Ok(None), |lineage| part(&folder, lineage));
        lineages.iter().map(part).collect()
    }

    /// Starts a part of these tables.
    ///
    /// # Errors
    /// When its files cannot be created.
    pub fn begin(&self, stage: &StageId, tables: &[(String, SchemaRef)]) -> Result<PartWriter<'_>, StoreError> {
        let folder = self.root().join(stage.folder());
        self.describe(&folder, stage)?;
        let mut writers = Vec::new();
        for (table, schema) in tables {
            let path = self.temporary(&folder);
            writers.push((table.clone(), TableWriter::create(&path, schema).at("write", &path)?));
        }
        Ok(PartWriter { shelf: self, stage: stage.clone(), folder, writers })
    }

    /// Records the stage of a folder, if it is not recorded yet.
    pub(super) fn describe(&self, folder: &Path, stage: &StageId) -> Result<(), StoreError> {
        fs::create_dir_all(folder).at("create", folder)?;
        let path = folder.join("stage.json");
        if fs::is_there(&path).at("read", &path)? { Ok(()) } else { self.write_json(&path, stage) }
    }

    pub(super) fn write_json(&self, path: &Path, value: &impl Serialize) -> Result<(), StoreError> {
        let temporary = self.temporary(path.parent().expect("a record lies in a folder"));
        fs::write(&temporary, record::text(value)).at("write", &temporary)?;
        self.place(&temporary, path)
    }

    /// Gives a complete file its name.
    fn place(&self, temporary: &Path, path: &Path) -> Result<(), StoreError> {
        if self.is_durable {
            fs::sync(temporary).at("write", temporary)?;
        }
        fs::rename(temporary, path).at("write", path)
    }

    /// File of one table of one part.
    #[must_use]
    pub fn part_file(&self, stage: &StageId, lineage: &Digest, table: &str) -> PathBuf {
        self.root().join(stage.folder()).join(format!("part-{lineage}.{table}.parquet"))
    }

    /// Batches of one table of one part, of at most `rows` rows each.
    ///
    /// # Errors
    /// When its file differs from its record.
    pub fn read(
        &self,
        stage: &StageId,
        part: &PartRecord,
        table: &str,
        rows: usize,
    ) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<>, StoreError> {
        file::read_recorded(&self.part_file(stage, &part.lineage, table), &part.files[table], rows)
    }

    /// What `each` makes of the row groups of one table of one part, in order: of the batches of one, of at most `rows`
    /// rows each, in the thread that decodes them.
    ///
    /// # Errors
    /// When its file differs from its record.
    pub fn read_groups<T: Send, F: Fn(Vec<RecordBatch>) -> T + Send + Sync>(
        &self,
        stage: &StageId,
        part: &PartRecord,
        table: &str,
        rows: usize,
        each: F,
    ) -> Result<impl Iterator<Item = Result<T, StoreError>> + use<T, F>, StoreError> {
        file::read_groups(&self.part_file(stage, &part.lineage, table), &part.files[table], rows, each)
    }

    /// What reads the same batches, as often as it is called.
    pub fn reader(
        &self,
        stage: &StageId,
        part: &PartRecord,
        table: &str,
        rows: usize,
    ) -> impl Fn() -> Result<PartBatches, StoreError> + Send + Sync + use<> {
        let (path, record) = (self.part_file(stage, &part.lineage, table), part.files[table].clone());
        move || Ok(Box::new(file::read_recorded(&path, &record, rows)?))
    }
}

fn part(folder: &Path, lineage: Digest) -> Result<Option<PartRecord>, StoreError> {
    let Some(record) = record::read::<PartRecord>(&folder.join(format!("part-{lineage}.json")))? else {
        return Ok(None);
    };
    for (table, file) in &record.files {
        let path = folder.join(format!("part-{lineage}.{table}.parquet"));
        let there = fs::if_there(fs::metadata(&path)).at("read", &path)?;
        if there.is_none_or(|metadata| metadata.len() != file.bytes) {
            return Ok(None);
        }
    }
    Ok(Some(record))
}

/// Batches of one table of one part.
pub type PartBatches = Box<dyn Iterator<Item = Result<RecordBatch, StoreError>>>;

/// Writes the tables of one part. Nothing counts before [`PartWriter::commit`].
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

    /// Ends the part under its lineage: it renames the files, then writes the record.
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
            self.shelf.place(&temporary, &self.folder.join(format!("part-{lineage}.{table}.parquet")))?;
            files.insert(table, record);
        }
        let record = PartRecord { lineage, files };
        self.shelf.write_json(&self.folder.join(format!("part-{lineage}.json")), &record)?;
        if self.shelf.is_durable {
            // The names too.
            fs::sync(&self.folder).at("write", &self.folder)?;
        }
        Ok(record)
    }
}

impl Drop for PartWriter<'_> {
    /// Removes uncommitted files. What cannot be removed now goes when the folder is opened next.
    fn drop(&mut self) {
        for (_, writer) in &self.writers {
            let _ = fs::remove_file(writer.path());
        }
    }
}
