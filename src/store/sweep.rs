//! Removes what killed runs left behind on a shelf.
//!
//! Deleting is the one thing that cannot be taken back. So a name must be one that this program makes for unfinished
//! files, in a folder where it makes them; links are never followed; and an unfinished folder must hold nothing but
//! tables and records. All else stays as it is.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};

use super::disk as fs;
use super::failure::{At, StoreError};
use super::lock::MARK_DIGITS;

/// Prefix of unfinished files and folders of the shelf; the mark of the writing process and a number follow.
pub(super) const UNFINISHED: &str = "tmp-";
/// Prefix of a link that is about to become a view; the view's name follows.
pub(super) const VIEW: &str = "tmp-view-";
/// Prefix of unfinished notes on raw files; the mark of the writing process follows.
const NOTE: &str = ".manifest.json.";

/// A leftover that could not be removed.
#[derive(Debug)]
pub struct Left {
    /// File or folder.
    pub path: PathBuf,
    /// Why it is still there.
    pub why: io::Error,
}

/// Removes unfinished files and folders of a shelf, and returns those that could not be removed: they do no harm. Only
/// the holder of the lock may call it.
///
/// # Errors
/// When the shelf itself cannot be read.
pub(super) fn sweep(shelf: &Path) -> Result<Vec<Left>, StoreError> {
    let mut left = Vec::new();
    for entry in fs::read_dir(shelf).at("read", shelf)? {
        let entry = entry.at("read", shelf)?;
        let (name, path) = (entry.file_name(), entry.path());
        let kind = entry.file_type().at("read", &path)?;
        if is_unfinished(&name) || is_view(&name) && kind.is_symlink() {
            remove(&path, &mut left);
        } else if kind.is_dir() && name == "notes" {
            within(&path, &mut left, |campaign, left| within_files(campaign, left, is_note));
        } else if kind.is_dir() && (name == "runs" || name == "shards" || is_stage(&name)) {
            within_files(&path, &mut left, is_unfinished);
        }
    }
    Ok(left)
}

/// Calls `each` for the folders in a folder, links excepted.
fn within(folder: &Path, left: &mut Vec<Left>, each: impl Fn(&Path, &mut Vec<Left>)) {
    match fs::read_dir(folder) {
        Ok(entries) => {
            let folders = entries.flatten().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
            folders.for_each(|entry| each(&entry.path(), left));
        }
        Err(why) => left.push(Left { path: folder.to_owned(), why }),
    }
}

/// Removes what has such a name from a folder.
fn within_files(folder: &Path, left: &mut Vec<Left>, is_leftover: impl Fn(&OsStr) -> bool) {
    match fs::read_dir(folder) {
        Ok(entries) => {
            let leftovers = entries.flatten().filter(|entry| is_leftover(&entry.file_name()));
            leftovers.for_each(|entry| remove(&entry.path(), left));
        }
        Err(why) => left.push(Left { path: folder.to_owned(), why }),
    }
}

/// `tmp-MARK-NUMBER`.
pub(super) fn is_unfinished(name: &OsStr) -> bool {
    let parts = || name.to_str()?.strip_prefix(UNFINISHED)?.split_once('-');
    parts().is_some_and(|(mark, number)| is_mark(mark) && is_number(number))
}

/// `tmp-view-NAME`.
fn is_view(name: &OsStr) -> bool {
    name.to_str().and_then(|name| name.strip_prefix(VIEW)).is_some_and(|view| !view.is_empty())
}

/// `.manifest.json.MARK`.
fn is_note(name: &OsStr) -> bool {
    name.to_str().and_then(|name| name.strip_prefix(NOTE)).is_some_and(is_mark)
}

/// `KIND-MARK`: the folder of a stage.
fn is_stage(name: &OsStr) -> bool {
    let recipe = || Some(name.to_str()?.rsplit_once('-')?.1);
    recipe().is_some_and(is_mark)
}

fn is_mark(text: &str) -> bool {
    text.len() == MARK_DIGITS && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Removes a file, a link, or an unfinished folder of tables.
fn remove(path: &Path, left: &mut Vec<Left>) {
    let result = fs::symlink_metadata(path)
        .and_then(|found| if found.is_dir() { remove_tables(path) } else { fs::remove_file(path) });
    if let Err(why) = result {
        left.push(Left { path: path.to_owned(), why });
    }
}

/// Removes a folder that holds only tables (`.parquet`), records (`.json`) and folders of these.
fn remove_tables(folder: &Path) -> io::Result<()> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    let mut next = 0;
    while next < folders.len() {
        for entry in fs::read_dir(&folders[next])? {
            let (path, kind) = entry.and_then(|entry| Ok((entry.path(), entry.file_type()?)))?;
            let ours = path.extension().is_some_and(|extension| extension == "parquet" || extension == "json");
            match (kind.is_dir(), kind.is_file() && (ours || is_unfinished(path.file_name().unwrap_or_default()))) {
                (true, _) => folders.push(path),
                (_, true) => files.push(path),
                _ => return Err(io::Error::other(format!("{} in it is no table", path.display()))),
            }
        }
        next += 1;
    }
    files.iter().try_for_each(fs::remove_file)?;
    folders.iter().rev().try_for_each(fs::remove_dir)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::os::unix::fs::symlink;

    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use std::fs;

    use super::*;

    fn write(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "x").unwrap();
    }

    #[test]
    fn what_is_half_written_goes_wherever_it_lies_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let at = |path: &str| folder.path().join(path);
        let stay = [
            "lock",
            "detect-0123456789abcdef/part-2.json",
            "detect-0123456789abcdef/table-3/table.json",
            "notes/day/manifest.json",
        ];
        let go = [
            "tmp-0123456789abcdef-0/table.json",
            "detect-0123456789abcdef/tmp-0123456789abcdef-4",
            "notes/day/.manifest.json.0123456789abcdef",
            "shards/tmp-0123456789abcdef-12",
            "runs/tmp-0123456789abcdef-3",
            "tmp-0123456789abcdef-7/onsets/part-0.parquet",
        ];
        stay.iter().chain(&go).for_each(|path| write(&at(path)));
        symlink("nowhere", at("tmp-view-onsets")).unwrap();
        assert_eq!(sweep(folder.path()).unwrap().len(), 0);
        assert!(stay.iter().all(|path| at(path).exists()));
        assert!(go.iter().all(|path| !at(path).exists()) && !at("tmp-0123456789abcdef-0").exists());
        assert!(fs::symlink_metadata(at("tmp-view-onsets")).is_err());
    }

    #[test]
    fn a_leftover_with_foreign_files_is_reported_and_left() {
        let folder = tempfile::tempdir().unwrap();
        let half = folder.path().join("tmp-0123456789abcdef-0");
        write(&half.join("onsets/part-00000.parquet"));
        write(&half.join("thesis.tex"));
        let left = sweep(folder.path()).unwrap();
        assert_eq!(left.len(), 1);
        assert!(left[0].why.to_string().contains("thesis.tex"), "{}", left[0].why);
        assert!(half.join("onsets/part-00000.parquet").exists());
    }

    /// All files and links below a folder, with their content.
    fn content(folder: &Path) -> BTreeMap<PathBuf, String> {
        let mut all = BTreeMap::new();
        for entry in fs::read_dir(folder).unwrap() {
            let (path, kind) = entry.map(|entry| (entry.path(), entry.file_type().unwrap())).unwrap();
            if kind.is_dir() {
                all.insert(path.clone(), "folder".to_owned());
                all.extend(content(&path));
            } else if kind.is_symlink() {
                all.insert(path.clone(), fs::read_link(&path).unwrap().display().to_string());
            } else {
                all.insert(path.clone(), fs::read_to_string(&path).unwrap());
            }
        }
        all
    }

    /// 1,000 shelves with hidden files, names that resemble those of leftovers, nested repositories, and links to a
    /// home folder: nothing of these changes.
    #[test]
    fn nothing_foreign_is_removed_from_any_shelf() {
        const FOREIGN: [&str; 14] = [
            ".bashrc",
            ".git/HEAD",
            ".ssh/id_ed25519",
            "tmp-notes",
            "tmp-view-plots/a.png",
            "tmp-0123456789abcdef",
            "tmp-0123456789ABCDEF-1",
            "tmp-0123456789abcdef-x",
            "tmp-view-report",
            "notes/.manifest.json.0123456789abcdef.bak/a",
            "notes/day/.manifest.json.4711",
            "notes/day/tmp-0123456789abcdef-0",
            "repository/.git/tmp-0123456789abcdef-0",
            "detect-0123456789abcdef/.hidden",
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(29);
        for _ in 0..1000 {
            let folder = tempfile::tempdir().unwrap();
            let (home, shelf) = (folder.path().join("home"), folder.path().join("shelf"));
            for path in FOREIGN {
                write(&home.join(path));
                write(&home.join("detect-0123456789abcdef/tmp-0123456789abcdef-0"));
                if rng.random_bool(0.5) {
                    write(&shelf.join(path));
                }
            }
            fs::create_dir_all(&shelf).unwrap();
            // Links by which a sweep could leave the shelf, each with a name that it visits.
            for name in ["notes", "runs", "shards", "detect-aaaaaaaaaaaaaaaa", "notes/link"] {
                let parent_is_there = shelf.join(name).parent().is_some_and(Path::is_dir);
                if parent_is_there && !shelf.join(name).exists() && rng.random_bool(0.5) {
                    symlink(&home, shelf.join(name)).unwrap();
                }
            }
            let before = content(folder.path());
            let leftover = shelf.join("tmp-fedcba9876543210-5");
            write(&leftover);
            sweep(&shelf).unwrap();
            assert!(!leftover.exists());
            assert_eq!(content(folder.path()), before);
        }
    }
}
