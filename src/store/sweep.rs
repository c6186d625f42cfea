//! Removes what killed runs left behind: unfinished files have names that say so.

use std::fs;
use std::path::Path;

use super::failure::{At, StoreError};

/// Removes half-written files and folders below `folder`: those named `tmp-...`, and hidden ones. Only the holder of
/// the lock may call it.
pub(super) fn sweep(folder: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(folder).at("read", folder)? {
        let entry = entry.at("read", folder)?;
        let (name, path) = (entry.file_name(), entry.path());
        let name = name.as_encoded_bytes();
        let is_folder = entry.file_type().at("read", &path)?.is_dir();
        if name.starts_with(b"tmp-") || name.starts_with(b".") {
            if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) }.at("remove", &path)?;
        } else if is_folder && !name.starts_with(b"table-") {
            // A table is complete before it gets its name, so nothing inside it is half-written.
            sweep(&path)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_half_written_goes_wherever_it_lies_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let at = |path: &str| folder.path().join(path);
        let stay = ["lock", "detect-1/part-2.json", "detect-1/table-3/table.json", "notes/day/manifest.json"];
        let go = ["tmp-0/table.json", "detect-1/tmp-4", "notes/day/.manifest.json.4711", "tmp-7/onsets/part-0.parquet"];
        for path in stay.iter().chain(&go) {
            fs::create_dir_all(at(path).parent().unwrap()).unwrap();
            fs::write(at(path), "x").unwrap();
        }
        std::os::unix::fs::symlink("nowhere", at("tmp-view-onsets")).unwrap();
        sweep(folder.path()).unwrap();
        assert!(stay.iter().all(|path| at(path).exists()));
        assert!(go.iter().all(|path| !at(path).exists()) && !at("tmp-0").exists());
        assert!(fs::symlink_metadata(at("tmp-view-onsets")).is_err());
    }
}
