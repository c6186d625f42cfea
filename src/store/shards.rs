//! What a result folder holds for those who compute parts of its tables: a job, and a file a shard.
//!
//! ```text
//! OUT/.shelf/shards/job.json                  what is to be made, and of which shards
//! OUT/.shelf/shards/<key>.json                one shard: all that who makes it must know
//! OUT/.shelf/shards/<key>.cut.json            the same of a piece of a part: which of its records
//! OUT/.shelf/shards/<key>.subtotals.parquet   what a piece adds up to
//! OUT/.shelf/shards/<key>.made.json           written last: the piece is made, with digests
//! ```

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::PathBuf;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::failure::{At, StoreError};
use super::parquet::{self, FileRecord, TableWriter};
use super::record;
use super::shelf::Shelf;

/// Folder of all of it on the shelf.
pub(super) const SHARDS: &str = "shards";
/// Name of the job among the shards; no key reads so.
const JOB: &str = "job";
/// Rows of subtotals that are read at a time: each has the sums of a phase.
const SUBTOTAL_ROWS: usize = 16;
/// Ending of the record of a piece that is made.
const MADE: &str = "made.json";

/// What a piece of a part has left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PieceRecord {
    /// The file of its subtotals.
    pub subtotals: FileRecord,
    /// What reading it gave, as its source alone understands it.
    pub learnt: Value,
    /// Why the part must be computed whole, if so.
    pub indivisible: Option<String>,
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

    /// Writes a job, its shards and its pieces of parts by key, in the place of those that were there. Pieces of these keys that are made stay.
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
        // Whoever reads the job finds its shards.
        self.write_json(&self.shard_file(JOB), job)?;
        let keys = shards.iter().map(|(key, _)| key.as_ref()).chain(cuts.iter().map(|(key, _)| key.as_ref()));
        let keys: BTreeSet<&str> = keys.chain([JOB]).collect();
        for entry in fs::read_dir(&folder).at("read", &folder)? {
            let path = entry.at("read", &folder)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // What is half-written has no ending.
            if name.split_once('.').is_some_and(|(key, _)| !keys.contains(key)) {
                // Another plan may have removed it.
                match fs::remove_file(&path) {
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    removed => removed.at("remove", &path)?,
                }
            }
        }
        Ok(())
    }

    /// The shard of a key, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn shard<S: DeserializeOwned>(&self, key: &str) -> Result<Option<S>, StoreError> {
        if is_key(key) { record::read(&self.shard_file(key)) } else { Ok(None) }
    }

    /// The piece of a part of a key, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn cut<C: DeserializeOwned>(&self, key: &str) -> Result<Option<C>, StoreError> {
        if is_key(key) { record::read(&self.file_of(key, "cut.json")) } else { Ok(None) }
    }

    /// Leaves what a piece adds up to, under a temporary name first; its record is written last.
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

    /// What a piece has left, if it is made.
    ///
    /// # Errors
    /// When its record is damaged.
    pub fn piece(&self, key: &str) -> Result<Option<PieceRecord>, StoreError> {
        let record: Option<PieceRecord> = record::read(&self.file_of(key, MADE))?;
        let size = fs::metadata(self.file_of(key, "subtotals.parquet")).map(|found| found.len()).ok();
        Ok(record.filter(|record| size == Some(record.subtotals.bytes)))
    }

    /// The subtotals of a piece, in batches of some rows.
    ///
    /// # Errors
    /// When the file is not as it was written.
    pub fn subtotals(
        &self,
        key: &str,
        record: &PieceRecord,
    ) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<>, StoreError> {
        parquet::read_recorded(&self.file_of(key, "subtotals.parquet"), &record.subtotals, SUBTOTAL_ROWS)
    }

    /// Files of pieces that are made: record and subtotals of each.
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

    /// The job whose shards these are, if there is one.
    ///
    /// # Errors
    /// When its file is damaged or cannot be read.
    pub fn job<J: DeserializeOwned>(&self) -> Result<Option<J>, StoreError> {
        record::read(&self.shard_file(JOB))
    }

    /// Removes job and shards.
    ///
    /// # Errors
    /// When they cannot be removed.
    pub fn remove_shards(&self) -> Result<(), StoreError> {
        let folder = self.root().join(SHARDS);
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed.at("remove", &folder),
        }
    }
}
