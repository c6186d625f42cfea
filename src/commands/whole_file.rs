//! Files that appear whole: written under another name, then renamed, so that a command that is ended leaves no half of
//! one.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};

/// Writes `path` and gives what `write` gives.
///
/// # Errors
/// When the file cannot be written; its path is named.
pub fn write<T>(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> Result<T> {
    let failed = || format!("cannot write {}", path.display());
    // What is no file, such as a pipe or a link, stays what it is.
    if fs::symlink_metadata(path).is_ok_and(|there| !there.is_file()) {
        return File::create(path).map(BufWriter::new).and_then(|file| finished(file, write)).with_context(failed);
    }
    let name = path.file_name().with_context(|| format!("{} names no file", path.display()))?;
    let half = path.with_file_name(format!(".{}.{}", name.display(), std::process::id()));
    let written = File::create(&half).map(BufWriter::new).and_then(|file| {
        let value = finished(file, write)?;
        fs::rename(&half, path)?;
        Ok(value)
    });
    if written.is_err() {
        // The failure to write comes first; of a file that was never created nothing is left.
        let _ = fs::remove_file(&half);
    }
    written.with_context(failed)
}

fn finished<T>(mut file: BufWriter<File>, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> io::Result<T> {
    let value = write(&mut file)?;
    file.flush()?;
    Ok(value)
}
