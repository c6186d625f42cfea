//! What a result folder holds for the workers that compute parts of its tables: a job, and a file for each shard.
//!
//! ```text
//! OUT/.shelf/shards/job.json                  what to compute, and its shards
//! OUT/.shelf/shards/<key>.json                one shard: everything that its worker needs
//! OUT/.shelf/shards/<key>.cut.json            the same for a piece of a part, with its range of records
//! OUT/.shelf/shards/<key>.subtotals.parquet   the subtotals of a piece
//! OUT/.shelf/shards/<key>.made.json           written last: the piece is complete, with digests
//! OUT/.shelf/shards/gathered.json             what is left when all is gathered: the keys, and how it ended
//! ```

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::disk as fs;
use super::failure::{At, StoreError};
use super::parquet::{self, FileRecord, TableWriter};
use super::record;
use super::shelf::Shelf;

/// Folder of these files on the shelf.
pub(super) const SHARDS: &str = "shards";
/// Name of the job's file; no key has this form.
const JOB: &str = "job";
/// Name of the record of a gathered job; no key has this form either.
const GATHERED: &str = "gathered";
/// Rows of subtotals that are read at once: each has the sums of a phase.
const SUBTOTAL_ROWS: usize = 16;
/// Ending of the record of a finished piece.
const MADE: &str = "made.json";

/// The results of a piece of a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PieceRecord {
    /// The file of its subtotals.
    pub subtotals: FileRecord,
    /// What reading it gave; only its source can interpret this.
    pub learnt: Value,
    /// Why the part must be computed whole, if it must.
    pub indivisible: Option<String>,
}

/// What remains of a job whose results were gathered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gathered {
    /// Keys of its shards and pieces.
    pub keys: BTreeSet<String>,
    /// Whether something was left out or rejected, or a result is empty.
    pub is_incomplete: bool,
}

fn is_key(key: &str) -> bool {
    key.bytes().all(|byte| byte.is_ascii_hexdigit())
}

impl Shelf {
    fn shard_file(&self, key: &str) -> PathBuf {
        self.root().join(SHARDS).join(format!("{key}.json"))
    }

    fn file_of(&self, key: &str, ending: &str) -> PathBuf {
        self.root().join(SHARDS).join(format!("{key}.{ending}"))
    }

    /// Writes a job, its shards and its pieces of parts by key, and replaces earlier ones. Finished pieces of these
    /// keys stay.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write_shards<K: AsRef<str>>(
        &self,
        job: &impl Serialize,
        shards: &[(K, impl Serialize)],
        cuts: &[(K, impl Serialize)],
    ) -> Result<(), StoreError> {
        let folder = self.root().join(SHARDS);
        fs::create_dir_all(&folder).at("create", &folder)?;
        for (key, shard) in shards {
            self.write_json(&self.shard_file(key.as_ref()), shard)?;
        }
        for (key, cut) in cuts {
            self.write_json(&self.file_of(key.as_ref(), "cut.json"), cut)?;
        }
        // Written last: a reader of the job must find its shards.
        self.write_json(&self.shard_file(JOB), job)?;
        let keys = shards.iter().map(|(key, _)| key.as_ref()).chain(cuts.iter().map(|(key, _)| key.as_ref()));
        let keys: BTreeSet<&str> = keys.chain([JOB]).collect();
        for entry in fs::read_dir(&folder).at("read", &folder)? {
            let path = entry.at("read", &folder)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // Half-written files have no such ending.
            if name.split_once('.').is_some_and(|(key, _)| !keys.contains(key)) {
                // Another process may have removed it already.
                match fs::remove_file(&path) {
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    removed => removed.at("remove", &path)?,
                }
            }
        }
        Ok(())
    }

    /// Reads the shard of a key, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn shard<S: DeserializeOwned>(&self, key: &str) -> Result<Option<S>, StoreError> {
        if is_key(key) { record::read(&self.shard_file(key)) } else { Ok(None) }
    }

    /// Reads the piece of a key, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn cut<C: DeserializeOwned>(&self, key: &str) -> Result<Option<C>, StoreError> {
        if is_key(key) { record::read(&self.file_of(key, "cut.json")) } else { Ok(None) }
    }

    /// Writes the subtotals of a piece, first under a temporary name; its record is written last.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_piece(
        &self,
        key: &str,
        schema: &SchemaRef,
        subtotals: &[RecordBatch],
        learnt: Value,
        indivisible: Option<String>,
    ) -> Result<PieceRecord, StoreError> {
        let path = self.file_of(key, "subtotals.parquet");
        let temporary = self.temporary(&self.root().join(SHARDS));
        let write = || {
            let mut writer = TableWriter::create(&temporary, schema)?;
            subtotals.iter().try_for_each(|batch| writer.write(batch))?;
            writer.finish(&[("periscope.shard", key.to_owned())])
        };
        let record = PieceRecord { subtotals: write().at("write", &temporary)?, learnt, indivisible };
        fs::rename(&temporary, &path).at("write", &path)?;
        self.write_json(&self.file_of(key, MADE), &record)?;
        Ok(record)
    }

    /// Reads the results of a piece, if it is finished.
    ///
    /// # Errors
    /// When its record is damaged, or its subtotals cannot be looked at.
    pub fn piece(&self, key: &str) -> Result<Option<PieceRecord>, StoreError> {
        let record: Option<PieceRecord> = record::read(&self.file_of(key, MADE))?;
        let path = self.file_of(key, "subtotals.parquet");
        let bytes = fs::if_there(fs::metadata(&path)).at("read", &path)?.map(|metadata| metadata.len());
        Ok(record.filter(|record| bytes == Some(record.subtotals.bytes)))
    }

    /// Reads the subtotals of a piece, in batches of some rows.
    ///
    /// # Errors
    /// When the file differs from its record.
    pub fn subtotals(
        &self,
        key: &str,
        record: &PieceRecord,
    ) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<>, StoreError> {
        parquet::read_recorded(&self.file_of(key, "subtotals.parquet"), &record.subtotals, SUBTOTAL_ROWS)
    }

    /// Files of finished pieces: record and subtotals of each.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub(super) fn pieces(&self) -> Result<Vec<(PathBuf, PathBuf)>, StoreError> {
        let folder = self.root().join(SHARDS);
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.at("read", &folder)?,
        };
        let mut pieces = Vec::new();
        for entry in entries {
            let path = entry.at("read", &folder)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if let Some((key, MADE)) = name.split_once('.') {
                pieces.push((path, self.file_of(key, "subtotals.parquet")));
            }
        }
        pieces.sort();
        Ok(pieces)
    }

    /// Reads the job of these shards, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn job<J: DeserializeOwned>(&self) -> Result<Option<J>, StoreError> {
        record::read(&self.shard_file(JOB))
    }

    /// Replaces job and shards by the record that they were gathered.
    ///
    /// # Errors
    /// When it cannot be written, or they cannot be removed.
    pub fn end_shards(&self, gathered: &Gathered) -> Result<(), StoreError> {
        let record = self.shard_file(GATHERED);
        self.write_json(&record, gathered)?;
        let folder = self.root().join(SHARDS);
        // The job goes first: without it, what is left of its shards counts for nothing.
        let mut paths = vec![self.shard_file(JOB)];
        for entry in fs::read_dir(&folder).at("read", &folder)? {
            paths.push(entry.at("read", &folder)?.path());
        }
        for path in paths.iter().filter(|path| **path != record) {
            match fs::remove_file(path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                removed => removed.at("remove", path)?,
            }
        }
        Ok(())
    }

    /// The record of the last job, if its results were gathered.
    ///
    /// # Errors
    /// When it is damaged or cannot be read.
    pub fn gathered(&self) -> Result<Option<Gathered>, StoreError> {
        record::read(&self.shard_file(GATHERED))
    }
}
