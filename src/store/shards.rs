//! What a result folder holds for those who compute parts of its tables: a job, and a file a shard.
//!
//! ```text
//! OUT/.shelf/shards/job.json     what is to be made, and of which shards
//! OUT/.shelf/shards/<key>.json   one shard: all that who makes it must know
//! ```

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::PathBuf;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::failure::{At, StoreError};
use super::record;
use super::shelf::Shelf;

/// Name of the job among the shards; no key reads so.
const JOB: &str = "job";

impl Shelf {
    fn shard_file(&self, key: &str) -> PathBuf {
        self.root().join("shards").join(format!("{key}.json"))
    }

    /// Writes a job and its shards by key, in the place of those that were there.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write_shards<S: Serialize>(&self, job: &impl Serialize, shards: &[(String, S)]) -> Result<(), StoreError> {
        let folder = self.root().join("shards");
        fs::create_dir_all(&folder).at("create", &folder)?;
        for (key, shard) in shards {
            self.write_json(&self.shard_file(key), shard)?;
        }
        // Whoever reads the job finds its shards.
        self.write_json(&self.shard_file(JOB), job)?;
        let present: BTreeSet<PathBuf> =
            shards.iter().map(|(key, _)| self.shard_file(key)).chain([self.shard_file(JOB)]).collect();
        for entry in fs::read_dir(&folder).at("read", &folder)? {
            let path = entry.at("read", &folder)?.path();
            if path.extension().is_some_and(|ending| ending == "json") && !present.contains(&path) {
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
        let is_key = key.bytes().all(|byte| byte.is_ascii_hexdigit());
        if is_key { record::read(&self.shard_file(key)) } else { Ok(None) }
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
        let folder = self.root().join("shards");
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed.at("remove", &folder),
        }
    }
}
