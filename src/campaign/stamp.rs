//! How a file is recognised without reading it.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;

use serde::{Deserialize, Serialize};

/// Size, times and inode of a file. Content that changes leaves at least one of them different, unless a disk decays:
/// programs can set the time of modification back, but not the time of change, and a file in another's place has
/// another inode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Size.
    pub bytes: u64,
    /// Time of the last modification (`mtime`), nanoseconds since 1970. Programs can set it.
    pub modified_ns: i64,
    /// Time of the last change of content or attributes (`ctime`), nanoseconds since 1970. The system sets it.
    pub changed_ns: i64,
    /// Number of the file in its file system.
    pub inode: u64,
}

impl Stamp {
    /// The stamp in a file's metadata.
    #[must_use]
    pub fn of(metadata: &Metadata) -> Self {
        let nanoseconds = |seconds: i64, rest: i64| seconds.saturating_mul(1_000_000_000).saturating_add(rest);
        Self {
            bytes: metadata.len(),
            modified_ns: nanoseconds(metadata.mtime(), metadata.mtime_nsec()),
            changed_ns: nanoseconds(metadata.ctime(), metadata.ctime_nsec()),
            inode: metadata.ino(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::path::Path;

    use super::*;

    fn stamp(path: &Path) -> Stamp {
        Stamp::of(&fs::metadata(path).unwrap())
    }

    #[test]
    fn a_change_shows_although_size_and_time_of_modification_are_set_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.trc");
        fs::write(&path, "light").unwrap();
        let (before, modified) = (stamp(&path), fs::metadata(&path).unwrap().modified().unwrap());
        assert_eq!(stamp(&path), before);
        std::thread::sleep(std::time::Duration::from_millis(20)); // the clock of the file system is coarse
        fs::write(&path, "LIGHT").unwrap();
        File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
        let after = stamp(&path);
        assert_eq!((after.bytes, after.modified_ns, after.inode), (before.bytes, before.modified_ns, before.inode));
        assert!(after.changed_ns > before.changed_ns);
        // Another file in its place, made before, so that not even its time of change is later.
        let other = folder.path().join("b.trc");
        fs::write(&other, "LIGHT").unwrap();
        fs::rename(&other, &path).unwrap();
        assert_ne!(stamp(&path).inode, after.inode);
    }
}
