//! The lock on a result folder: one run writes at a time.
//!
//! `OUT/.shelf/lock` is locked by its holder, and says in words who that is. The system lets go of the lock when the process ends, in whatever way: a
//! lock is never left over, and what the file says of an earlier holder means nothing.

use std::fmt;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::failure::{At, StoreError};
use super::runs::utc;

/// Who holds a result folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Name of the machine.
    pub host: String,
    /// Number of the process on it.
    pub process: u32,
    /// Since when (UTC, ISO 8601).
    pub started: String,
}

impl Holder {
    /// This process, from now on.
    #[must_use]
    pub fn here() -> Self {
        let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
        Self { host, process: std::process::id(), started: utc(SystemTime::now()) }
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "process {} on {}, since {}", self.process, self.host, self.started)
    }
}

/// The lock, held until it is dropped.
#[derive(Debug)]
pub(super) struct Lock(File);

impl Drop for Lock {
    fn drop(&mut self) {
        // To close the file is not enough: a child that another thread is about to start has it open too, until it becomes another program. Where unlocking
        // fails, the lock goes with the last of them.
        let _ = self.0.unlock();
    }
}

/// Takes the lock of the shelf of `out`.
pub(super) fn take(out: &Path, shelf: &Path) -> Result<Lock, StoreError> {
    let path = shelf.join("lock");
    // Not truncated: until the lock is ours, the text is another's.
    let mut file = File::options().read(true).write(true).create(true).truncate(false).open(&path).at("open", &path)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => {
            // A holder that has the lock and has not written its name yet is one without a name.
            let holder = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
            return Err(StoreError::Busy { out: out.to_owned(), holder });
        }
        Err(fs::TryLockError::Error(source)) => return Err(StoreError::Io { what: "lock", path, source }),
    }
    let name = serde_json::to_vec(&Holder::here()).expect("a name is plain data");
    file.set_len(0).and_then(|()| file.write_all(&name)).at("write", &path)?;
    Ok(Lock(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_holder_is_told_the_first_and_the_lock_goes_with_its_holder() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("lock"), "{\"host\": \"of an earlier run, longer than the next name\", \"process\": 1, \"started\": \"2026-03-14T09:15:00Z\"}").unwrap();
        let held = take(Path::new("results"), folder.path()).unwrap();
        let refused = take(Path::new("results"), folder.path()).unwrap_err().to_string();
        assert!(refused.contains(&format!("process {} on ", std::process::id())), "{refused}");
        assert!(refused.contains("--wait") && !refused.contains("earlier"), "{refused}");
        // As a child has it that another thread is just starting.
        let of_child = held.0.try_clone().unwrap();
        drop(held);
        take(Path::new("results"), folder.path()).unwrap();
        drop(of_child);
    }
}
