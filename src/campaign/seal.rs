//! Seals a campaign: records its settings and the content of its raw files, and later checks them against that record.
//!
//! The first seal hashes every raw file. Later ones compare stamps, hash only files where these differ, and refuse
//! changed files by name. New files are reported, and recorded on request, as are changed settings. A missing file
//! keeps its line, since its disk may be elsewhere today.

use std::fmt;
use std::path::PathBuf;

use super::keys::Campaign;
use super::manifest::{FileState, MANIFEST_FILE, Manifest, ManifestError, file_error, hash_file, metadata};
use super::settings::{self, Change};
use super::survey::Survey;
use crate::store::disk;

/// The result of sealing. Paths are relative to the campaign folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SealReport {
    /// Files with the recorded content, whether their time of change is new or not.
    pub unchanged: usize,
    /// Files that are not in the manifest, or were not before this call.
    pub new: Vec<PathBuf>,
    /// Whether the new files were hashed and recorded.
    pub joined: bool,
    /// Files whose stamp was recorded anew, since their content is the same.
    pub refreshed: Vec<PathBuf>,
    /// Changes of the settings that were recorded.
    pub settings: Vec<Change>,
    /// Files in the manifest that do not exist.
    pub gone: Vec<PathBuf>,
}

impl fmt::Display for SealReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let new = if self.joined { "joined   " } else { "new      " };
        for change in &self.settings {
            write!(f, "\nchanged   {change}")?;
        }
        let mut list = |what: &str, files: &[PathBuf]| -> fmt::Result {
            for file in files {
                write!(f, "\n{what} {}", file.display())?;
            }
            Ok(())
        };
        list("touched  ", &self.refreshed)?;
        list("gone     ", &self.gone)?;
        list(new, &self.new)?;
        let advice = if self.joined || self.new.is_empty() { "" } else { "; `--update` lets them join" };
        let (joined, left) = if self.joined { (self.new.len(), 0) } else { (0, self.new.len()) };
        write!(
            f,
            "\nsealed: {} files as recorded, {joined} joined, {left} left out{advice}, {} gone",
            self.unchanged,
            self.gone.len()
        )
    }
}

/// Comparison of a manifest with the files that exist.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Audit {
    /// Files with the recorded content.
    pub unchanged: usize,
    /// Those among them with another stamp.
    pub touched: Vec<PathBuf>,
    /// Files with another content.
    pub changed: Vec<PathBuf>,
    /// Files that do not exist.
    pub gone: Vec<PathBuf>,
}

impl Manifest {
    /// Compares every record with its file: by its stamp, and by content where that differs, or everywhere if `rehash`.
    ///
    /// # Errors
    /// When an existing file cannot be read.
    pub fn audit(&self, campaign: &Campaign, rehash: bool) -> Result<Audit, ManifestError> {
        let mut audit = Audit::default();
        for (path, record) in self.iter() {
            let file = campaign.path_of(path);
            if !disk::is_there(&file).map_err(|source| file_error(&file, source))? {
                audit.gone.push(path.to_owned());
                continue;
            }
            let touched = self.check(&campaign.root, path)? != FileState::Same(record.blake3);
            if (touched || rehash) && hash_file(&file)? != record.blake3 {
                audit.changed.push(path.to_owned());
                continue;
            }
            audit.unchanged += 1;
            if touched {
                audit.touched.push(path.to_owned());
            }
        }
        Ok(audit)
    }
}

/// Seals a campaign, or checks it against its seal. With `update`, new files and changed settings are recorded.
///
/// # Errors
/// When the content of files differs from the record, or without `update` the settings do (the message names all
/// changes, and nothing is stored), or a file cannot be read.
pub fn seal(campaign: &Campaign, survey: &Survey, update: bool) -> Result<SealReport, ManifestError> {
    let root = &campaign.root;
    let sealed = Manifest::load(root)?;
    let is_first = sealed.is_none();
    let join = update || is_first;
    let mut manifest = sealed.unwrap_or_default();
    let audit = manifest.audit(campaign, false)?;
    if !audit.changed.is_empty() {
        return Err(ManifestError::Changed {
            files: audit.changed.iter().map(|file| file.display().to_string()).collect(),
            manifest: root.join(MANIFEST_FILE),
        });
    }
    let mut changes = settings::changes(root, &manifest.settings)?;
    let texts = settings::read(campaign)?;
    if !is_first {
        let unsealed = texts.keys().filter(|file| !manifest.settings.contains_key(*file));
        changes.extend(unsealed.map(|file| Change { file: file.clone(), what: "is not in the seal".to_owned() }));
    }
    if !join && !changes.is_empty() {
        return Err(settings::refused(root, &changes));
    }
    manifest.settings = texts;
    let files = survey.files();
    let new = files.into_iter().filter(|file| manifest.get(file).is_none());
    let new: Vec<PathBuf> = new.map(PathBuf::from).collect();
    for path in &audit.touched {
        if let Some(content) = manifest.get(path).map(|record| record.blake3) {
            manifest.record(path, content, &metadata(&campaign.path_of(path))?);
        }
    }
    for path in new.iter().filter(|_| join) {
        let file = campaign.path_of(path);
        let before = metadata(&file)?;
        manifest.record(path, hash_file(&file)?, &before);
    }
    manifest.save(root)?;
    Ok(SealReport {
        unchanged: audit.unchanged,
        new,
        joined: join,
        refreshed: audit.touched,
        settings: changes,
        gone: audit.gone,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, File};
    use std::path::Path;
    use std::time::{Duration, SystemTime};

    struct Folder(tempfile::TempDir);

    impl Folder {
        fn new(files: &[&str]) -> Self {
            let folder = Self(tempfile::tempdir().unwrap());
            let text = "[campaign]\nname = 'c'\n[sensors.s1]\n[[captures]]\nrole = 'dark'\nfiles = '*.npy'\n";
            folder.write("campaign.toml", text);
            for file in files {
                folder.write(file, file);
            }
            folder
        }

        fn write(&self, file: &str, text: &str) {
            fs::write(self.0.path().join(file), text).unwrap();
        }

        fn touch(&self, file: &str) {
            let file = File::options().write(true).open(self.0.path().join(file)).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(1)).unwrap();
        }

        fn campaign(&self) -> Campaign {
            Campaign::load(self.0.path()).unwrap()
        }

        fn seal(&self, update: bool) -> Result<SealReport, ManifestError> {
            let campaign = self.campaign();
            seal(&campaign, &campaign.survey().unwrap(), update)
        }

        fn manifest(&self) -> Manifest {
            Manifest::load(self.0.path()).unwrap().unwrap()
        }
    }

    fn paths(files: &[&str]) -> Vec<PathBuf> {
        files.iter().map(PathBuf::from).collect()
    }

    #[test]
    fn the_first_seal_takes_all_raw_files_and_a_second_changes_nothing() {
        let folder = Folder::new(&["a.npy", "b.npy", "notes.txt"]);
        let report = folder.seal(false).unwrap();
        assert_eq!(report.new, paths(&["a.npy", "b.npy"]));
        assert!(report.joined);
        let record = *folder.manifest().get(Path::new("a.npy")).unwrap();
        assert_eq!((record.blake3, record.stamp.bytes), (blake3::hash(b"a.npy"), 5));
        let before = folder.manifest();
        let again = folder.seal(true).unwrap();
        assert_eq!((again.unchanged, again.new.len()), (2, 0));
        assert_eq!(folder.manifest(), before);
    }

    #[test]
    fn new_files_join_only_on_request_and_gone_ones_keep_their_line() {
        let folder = Folder::new(&["a.npy", "b.npy"]);
        folder.seal(false).unwrap();
        folder.write("c.npy", "c");
        fs::remove_file(folder.0.path().join("b.npy")).unwrap();
        let report = folder.seal(false).unwrap();
        assert_eq!((report.new, report.joined), (paths(&["c.npy"]), false));
        assert_eq!((report.gone, report.unchanged), (paths(&["b.npy"]), 1));
        assert_eq!(folder.manifest().get(Path::new("c.npy")), None);
        assert!(folder.seal(true).unwrap().joined);
        assert!(folder.manifest().get(Path::new("c.npy")).is_some());
        assert!(folder.manifest().get(Path::new("b.npy")).is_some());
    }

    #[test]
    fn a_touched_file_is_refreshed_and_a_changed_one_refused_by_name() {
        let folder = Folder::new(&["a.npy", "b.npy"]);
        folder.seal(false).unwrap();
        folder.touch("a.npy");
        assert_eq!(folder.seal(false).unwrap().refreshed, paths(&["a.npy"]));
        assert_eq!(folder.seal(false).unwrap().refreshed, paths(&[]));
        let before = folder.manifest();
        folder.write("b.npy", "other");
        folder.write("c.npy", "c");
        let error = folder.seal(true).unwrap_err().to_string();
        assert!(error.starts_with("changed since they were recorded: b.npy; restore"), "{error}");
        assert_eq!(folder.manifest(), before, "nothing is written beside a refusal");
    }

    #[test]
    fn a_change_that_keeps_size_and_time_of_modification_is_seen() {
        let folder = Folder::new(&["a.npy"]);
        folder.touch("a.npy");
        folder.seal(false).unwrap();
        std::thread::sleep(Duration::from_millis(20)); // the clock of the file system is coarse
        folder.write("a.npy", "A.NPY");
        folder.touch("a.npy");
        let audit = |rehash| folder.manifest().audit(&folder.campaign(), rehash).unwrap();
        assert_eq!((audit(false).unchanged, audit(false).changed), (0, paths(&["a.npy"])));
    }

    #[test]
    fn settings_are_sealed_and_a_change_joins_only_on_request() {
        let folder = Folder::new(&["a.npy"]);
        folder.write("rows.csv", "file\nb.npy\n");
        folder.write("b.npy", "b");
        let text = |latency: &str| {
            format!(
                "[campaign]\nname = 'c'\n[sensors.s1]\nlatency_ps = {latency}\n[[captures]]\nrole = 'dark'\ntable = 'rows.csv'\n"
            )
        };
        folder.write("campaign.toml", &text("0.0"));
        assert_eq!(folder.seal(false).unwrap().settings, []);
        assert!(folder.seal(true).unwrap().settings.is_empty());
        folder.write("campaign.toml", &text("1.5"));
        folder.write("rows.csv", "file\na.npy\n");
        let load = || Campaign::load(folder.0.path()).unwrap_err().to_string();
        let sealed = folder.manifest();
        let seal = |update| {
            let campaign = Campaign::read(folder.0.path()).unwrap();
            seal(&campaign, &campaign.survey().unwrap(), update)
        };
        for error in [load(), seal(false).unwrap_err().to_string()] {
            assert!(error.contains("campaign.toml: `sensors.s1.latency_ps` was 0.0 and is 1.5"), "{error}");
            assert!(error.contains("rows.csv: line 2 was `b.npy` and is `a.npy`"), "{error}");
        }
        assert_eq!(folder.manifest(), sealed);
        let changes = seal(true).unwrap().settings;
        assert_eq!(changes.len(), 2, "{changes:?}");
        Campaign::load(folder.0.path()).unwrap();
        fs::remove_file(folder.0.path().join("rows.csv")).unwrap();
        assert!(load().contains("rows.csv: is gone"), "{}", load());
    }
}
