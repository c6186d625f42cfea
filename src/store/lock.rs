//! The lock on a result folder: one run writes at a time, or any number of shards.
//!
//! The holder locks `OUT/.shelf/lock` and writes its name into it. The system releases the lock when the process ends,
//! in whatever way, so that no lock is left over; the text of an earlier holder has no meaning. Shards share the lock:
//! each writes files of its own, or the same bytes as another. A run, which switches views and removes leftovers, holds
//! the lock alone.

use std::fmt;
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::LazyLock;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::Digest;
use super::failure::{At, StoreError};
use super::runs::utc;

/// Bytes of the lock's text, padded with blanks: a text then fully replaces an older one, even if several processes
/// write at once.
const TEXT_BYTES: usize = 512;

/// Hexadecimal digits of a mark.
pub(super) const MARK_DIGITS: usize = 16;

/// Mark of this process: machine, process number and start.
static MARK: LazyLock<String> = LazyLock::new(|| {
    let Holder { host, process, .. } = Holder::here();
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Digest::of_bytes(format!("{host} {process} {}", since.as_nanos()).as_bytes()).short()
});

/// A mark that no other process has, on this machine or another. Names of half-written files contain it, so that
/// processes that share a folder never write the same file.
#[must_use]
pub fn mark() -> &'static str {
    &MARK
}

/// How a process holds a result folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Hold {
    /// Alone: a run, which switches views and removes leftovers.
    Alone,
    /// Together with others that only add parts.
    Together,
}

/// Who holds a result folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Name of the machine.
    pub host: String,
    /// Number of the process on it.
    pub process: u32,
    /// Start of holding (UTC, ISO 8601).
    pub started: String,
}

/// The text of a lock: its latest holder, and how it holds.
#[derive(Debug, Serialize, Deserialize)]
struct Text {
    hold: Hold,
    #[serde(flatten)]
    holder: Holder,
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
        // Closing the file is not enough: a child process that another thread just starts has it open too, until it
        // executes its program. If unlocking fails, the lock ends with the last open handle.
        let _ = self.0.unlock();
    }
}

/// Takes the lock of the shelf of `out`.
pub(super) fn take(out: &Path, shelf: &Path, hold: Hold) -> Result<Lock, StoreError> {
    let path = shelf.join("lock");
    // Not truncated: until we have the lock, the text belongs to another process.
    let file = File::options().read(true).write(true).create(true).truncate(false).open(&path).at("open", &path)?;
    let result = match hold {
        Hold::Alone => file.try_lock(),
        Hold::Together => file.try_lock_shared(),
    };
    match result {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => {
            // A holder may not have written its name yet, so the text may be absent.
            let text: Option<Text> = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
            let (hold, holder) = text.map_or((Hold::Alone, None), |text| (text.hold, Some(text.holder)));
            return Err(StoreError::Busy { out: out.to_owned(), hold, holder });
        }
        Err(fs::TryLockError::Error(source)) => return Err(StoreError::Io { what: "lock", path, source }),
    }
    let name = serde_json::to_string(&Text { hold, holder: Holder::here() }).expect("a name is plain data");
    file.write_all_at(format!("{name:TEXT_BYTES$}").as_bytes(), 0).at("write", &path)?;
    Ok(Lock(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_holder_learns_the_first_and_the_lock_goes_with_its_holder() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("lock"), "{\"host\": \"of an earlier run, longer than the next name\", \"process\": 1, \"started\": \"2026-03-14T09:15:00Z\"}").unwrap();
        let lock = take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
        for hold in [Hold::Alone, Hold::Together] {
            let refused = take(Path::new("results"), folder.path(), hold).unwrap_err().to_string();
            assert!(refused.contains(&format!("process {} on ", std::process::id())), "{refused}");
            assert!(refused.starts_with("another run") && !refused.contains("earlier"), "{refused}");
        }
        // A child process that another thread just starts has such a handle.
        let of_child = lock.0.try_clone().unwrap();
        drop(lock);
        take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
        drop(of_child);
    }

    #[test]
    fn shards_share_it_and_a_run_learns_that_they_do() {
        let folder = tempfile::tempdir().unwrap();
        let lock = [0, 1].map(|_| take(Path::new("results"), folder.path(), Hold::Together).unwrap());
        let refused = take(Path::new("results"), folder.path(), Hold::Alone).unwrap_err().to_string();
        assert!(refused.starts_with("shards are being computed into results (the last began as process "), "{refused}");
        drop(lock);
        take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
    }
}
