//! The lock on a result folder: one run writes at a time, or any number of shards.
//!
//! `OUT/.shelf/lock` is locked by its holder, and says in words who that is. The system lets go of the lock when the process ends, in whatever way: a
//! lock is never left over, and what the file says of an earlier holder means nothing. Shards share it, since each writes only files that are its own, or that
//! have the same bytes whoever writes them; a run, which switches views and sweeps up, holds it alone.

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

/// Bytes of the text of a lock, filled up with blanks: a text that is written over another one leaves nothing of it, also where several write at once.
const TEXT_BYTES: usize = 512;

/// Of this process, by machine, number and start.
static MARK: LazyLock<String> = LazyLock::new(|| {
    let Holder { host, process, .. } = Holder::here();
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Digest::of_bytes(format!("{host} {process} {}", since.as_nanos()).as_bytes()).short()
});

/// A mark that no other process has, on this machine or another: what is half-written has it in its name, so that processes which share a folder
/// never write one file.
#[must_use]
pub fn mark() -> &'static str {
    &MARK
}

/// How a result folder is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Hold {
    /// By one run, which switches views and sweeps up.
    Alone,
    /// Together with others, each of which only adds parts.
    Together,
}

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

/// What stands in a lock: who took it last, and how.
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
        // To close the file is not enough: a child that another thread is about to start has it open too, until it becomes another program. Where unlocking
        // fails, the lock goes with the last of them.
        let _ = self.0.unlock();
    }
}

/// Takes the lock of the shelf of `out`.
pub(super) fn take(out: &Path, shelf: &Path, hold: Hold) -> Result<Lock, StoreError> {
    let path = shelf.join("lock");
    // Not truncated: until the lock is ours, the text is another's.
    let file = File::options().read(true).write(true).create(true).truncate(false).open(&path).at("open", &path)?;
    let taken = match hold {
        Hold::Alone => file.try_lock(),
        Hold::Together => file.try_lock_shared(),
    };
    match taken {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => {
            // A holder that has the lock and has not written its name yet is one without a name.
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
    fn a_second_holder_is_told_the_first_and_the_lock_goes_with_its_holder() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("lock"), "{\"host\": \"of an earlier run, longer than the next name\", \"process\": 1, \"started\": \"2026-03-14T09:15:00Z\"}").unwrap();
        let held = take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
        for hold in [Hold::Alone, Hold::Together] {
            let refused = take(Path::new("results"), folder.path(), hold).unwrap_err().to_string();
            assert!(refused.contains(&format!("process {} on ", std::process::id())), "{refused}");
            assert!(refused.starts_with("another run") && !refused.contains("earlier"), "{refused}");
        }
        // As a child has it that another thread is just starting.
        let of_child = held.0.try_clone().unwrap();
        drop(held);
        take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
        drop(of_child);
    }

    #[test]
    fn shards_share_it_and_a_run_is_told_that_they_do() {
        let folder = tempfile::tempdir().unwrap();
        let held = [0, 1].map(|_| take(Path::new("results"), folder.path(), Hold::Together).unwrap());
        let refused = take(Path::new("results"), folder.path(), Hold::Alone).unwrap_err().to_string();
        assert!(refused.starts_with("shards are being computed into results (the last began as process "), "{refused}");
        drop(held);
        take(Path::new("results"), folder.path(), Hold::Alone).unwrap();
    }
}
