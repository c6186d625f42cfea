//! Access to the disk, for everything that becomes part of results or decides on them: store, campaign folders, notes.
//!
//! These are the functions of the standard library. A build of the tests has the same with a switch that lets the n-th
//! of them fail below some folder (`faults`), so that every place at which a disk can fail is visited
//! (`pipeline/faulty_disk.rs`).

use std::fs::Metadata;
use std::io::{self, ErrorKind};
use std::path::Path;

#[cfg(test)]
pub(crate) mod faults;

#[cfg(test)]
pub(crate) use faults::disk::{
    Output, canonicalize, copy, create, create_dir_all, hard_link, metadata, open, read, read_dir, read_link,
    read_to_string, remove_dir, remove_dir_all, remove_file, rename, symlink, symlink_metadata, sync, write,
};
#[cfg(not(test))]
pub use plain::{Output, create, open, sync};
#[cfg(not(test))]
pub use std::fs::{
    canonicalize, copy, create_dir_all, hard_link, metadata, read, read_dir, read_link, read_to_string, remove_dir,
    remove_dir_all, remove_file, rename, symlink_metadata, write,
};
#[cfg(not(test))]
pub use std::os::unix::fs::symlink;

/// What there is at a path; `None` if nothing is. That a disk did not say is an error, and not an absence.
///
/// # Errors
/// When it cannot be determined.
pub fn if_there(metadata: io::Result<Metadata>) -> io::Result<Option<Metadata>> {
    match metadata {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        metadata => metadata.map(Some),
    }
}

/// Whether something is there; a link counts for what it leads to.
///
/// # Errors
/// When it cannot be determined.
pub fn is_there(path: &Path) -> io::Result<bool> {
    Ok(if_there(metadata(path))?.is_some())
}

/// Whether a folder is there, or a link to one.
///
/// # Errors
/// When it cannot be determined.
pub fn is_folder(path: &Path) -> io::Result<bool> {
    Ok(if_there(metadata(path))?.is_some_and(|metadata| metadata.is_dir()))
}

/// Whether a link is there.
///
/// # Errors
/// When it cannot be determined.
pub fn is_link(path: &Path) -> io::Result<bool> {
    Ok(if_there(symlink_metadata(path))?.is_some_and(|metadata| metadata.is_symlink()))
}

#[cfg(not(test))]
mod plain {
    use std::fs::File;
    use std::io;
    use std::path::Path;

    /// A file that is written.
    pub type Output = File;

    /// Creates a file, and empties one that exists.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn create(path: &Path) -> io::Result<Output> {
        File::create(path)
    }

    /// Opens a file for reading.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn open(path: &Path) -> io::Result<File> {
        File::open(path)
    }

    /// Waits until a file, or the names in a folder, are on the disk.
    ///
    /// # Errors
    /// When they cannot be brought there.
    pub fn sync(path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }
}
