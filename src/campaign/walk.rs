//! The files of a campaign folder, in order.
//!
//! Some files are not raw: hidden files and folders (`.name`), `campaign.toml` and `manifest.json` of the folder
//! itself, its folder `truth` (the ground truth of a simulated campaign), and result folders inside it. Links are
//! followed, unless they lead back to a folder above.

use std::io;
use std::path::{Path, PathBuf};

use super::keys::CAMPAIGN_FILE;
use super::manifest::MANIFEST_FILE;
use super::stamp::Stamp;
use crate::store::disk;

/// Folder of ground-truth tables of a simulated campaign.
pub const TRUTH: &str = "truth";

/// Entry that marks a result folder.
const SHELF: &str = ".shelf";

/// A file of a campaign folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawFile {
    /// Path, relative to the folder.
    pub path: PathBuf,
    /// How it is recognised again.
    pub stamp: Stamp,
}

/// All files below `root`, sorted by path.
///
/// # Errors
/// A folder that cannot be read, with its path.
pub fn files(root: &Path) -> Result<Vec<RawFile>, (PathBuf, io::Error)> {
    let mut files = Vec::new();
    visit(root, Path::new(""), &mut Vec::new(), &mut files)?;
    files.retain(|RawFile { path, .. }| {
        path != Path::new(CAMPAIGN_FILE) && path != Path::new(MANIFEST_FILE) && !path.starts_with(TRUTH)
    });
    files.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(files)
}

/// `above`: the folders on the way here, with links resolved, so that a circle of links ends.
fn visit(
    root: &Path,
    folder: &Path,
    above: &mut Vec<PathBuf>,
    files: &mut Vec<RawFile>,
) -> Result<(), (PathBuf, io::Error)> {
    let here = root.join(folder);
    let fail = |error| (here.clone(), error);
    let real = disk::canonicalize(&here).map_err(fail)?;
    if above.contains(&real) {
        return Ok(());
    }
    above.push(real);
    for entry in disk::read_dir(&here).map_err(fail)? {
        let name = entry.map_err(fail)?.file_name();
        if name.as_encoded_bytes().starts_with(b".") {
            continue;
        }
        let path = folder.join(name);
        let whole = root.join(&path);
        let fail = |error| (whole.clone(), error);
        // A link without target, or a file that has just vanished, does not count.
        let Some(metadata) = disk::if_there(disk::metadata(&whole)).map_err(fail)? else { continue };
        if metadata.is_file() {
            files.push(RawFile { path, stamp: Stamp::of(&metadata) });
        } else if metadata.is_dir() && !disk::is_folder(&whole.join(SHELF)).map_err(fail)? {
            visit(root, &path, above, files)?;
        }
    }
    above.pop();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn files_come_sorted_without_hidden_ones_and_rings_end() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        for file in ["b.trc", "raw/z/1.trc", "raw/a.trc", ".git/x", "raw/.part", "raw/campaign.toml"] {
            fs::create_dir_all(root.join(file).parent().unwrap()).unwrap();
            fs::write(root.join(file), "x").unwrap();
        }
        fs::create_dir_all(root.join("results/.shelf")).unwrap();
        fs::write(root.join("results/part.parquet"), "x").unwrap();
        fs::write(root.join(CAMPAIGN_FILE), "").unwrap();
        fs::write(root.join(MANIFEST_FILE), "").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(root, root.join("raw/ring")).unwrap();
        let raw_files = files(root).unwrap();
        let expected = ["b.trc", "raw/a.trc", "raw/campaign.toml", "raw/z/1.trc"];
        let paths: Vec<&Path> = raw_files.iter().map(|file| file.path.as_path()).collect();
        assert_eq!(paths, expected.map(Path::new));
        assert_eq!(files(&root.join("none")).unwrap_err().0, root.join("none"));
    }
}
