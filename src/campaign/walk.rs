//! The files of a campaign folder, in order.
//!
//! Hidden files and folders (`.name`), `campaign.toml` and `manifest.json` of the folder itself, and its folder `truth` (what a simulated
//! campaign was made from), are no raw files, nor are result folders within it. Links are followed; a link back to a folder that holds it is not.

use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::load::CAMPAIGN_FILE;
use super::manifest::MANIFEST_FILE;

/// Folder of tables beside a simulated campaign's raw files.
pub const TRUTH: &str = "truth";

/// What a result folder has in it.
const SHELF: &str = ".shelf";

/// A file of a campaign folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Found {
    /// Path, relative to the folder.
    pub path: PathBuf,
    /// When it was last changed; 1970 where the file system has no times.
    pub modified: SystemTime,
}

/// All files below `root`, sorted by path.
///
/// # Errors
/// A folder that cannot be read, with its path.
pub fn files(root: &Path) -> Result<Vec<Found>, (PathBuf, io::Error)> {
    let mut files = Vec::new();
    visit(root, Path::new(""), &mut Vec::new(), &mut files)?;
    files.retain(|Found { path, .. }| {
        path != Path::new(CAMPAIGN_FILE) && path != Path::new(MANIFEST_FILE) && !path.starts_with(TRUTH)
    });
    files.sort();
    Ok(files)
}

/// `above`: the folders on the way here, without links, so that a ring of links ends.
fn visit(
    root: &Path,
    folder: &Path,
    above: &mut Vec<PathBuf>,
    files: &mut Vec<Found>,
) -> Result<(), (PathBuf, io::Error)> {
    let here = root.join(folder);
    let fail = |error| (here.clone(), error);
    let real = here.canonicalize().map_err(fail)?;
    if above.contains(&real) {
        return Ok(());
    }
    above.push(real);
    for entry in here.read_dir().map_err(fail)? {
        let name = entry.map_err(fail)?.file_name();
        if name.as_encoded_bytes().starts_with(b".") {
            continue;
        }
        let path = folder.join(name);
        // A link that leads nowhere, or a file that vanished since, is no file.
        match root.join(&path).metadata() {
            Ok(found) if found.is_dir() && root.join(&path).join(SHELF).is_dir() => {}
            Ok(found) if found.is_dir() => visit(root, &path, above, files)?,
            Ok(found) if found.is_file() => {
                files.push(Found { path, modified: found.modified().unwrap_or(SystemTime::UNIX_EPOCH) });
            }
            _ => {}
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
        let found = files(root).unwrap();
        let expected = ["b.trc", "raw/a.trc", "raw/campaign.toml", "raw/z/1.trc"];
        let paths: Vec<&Path> = found.iter().map(|found| found.path.as_path()).collect();
        assert_eq!(paths, expected.map(Path::new));
        assert_eq!(files(&root.join("none")).unwrap_err().0, root.join("none"));
    }
}
