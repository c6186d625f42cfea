//! The manifest of a campaign folder: stamp and content hash of every raw file that was read or sealed, and in a seal
//! the text of campaign.toml and of the tables that it names.
//!
//! `DIR/manifest.json` has one line per file, sorted, each with its own checksum: you may delete a line, but a damaged
//! one is noticed. Lineages use the hash (BLAKE3). The stamp (size, times, inode) only avoids hashing a file again:
//! where it differs from the record, the content decides.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use blake3::Hash;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};

use super::stamp::Stamp;
use crate::store::disk::{self as fs, Output};
use crate::store::lock;

/// Name of the manifest in a campaign folder.
pub const MANIFEST_FILE: &str = "manifest.json";

const VERSION: u32 = 3;

/// Prefix of half-written manifests; a mark of the writing process follows.
const HALF: &str = ".manifest.json.";

/// Age from which a half-written manifest belongs to a dead process: writing one takes seconds.
const LEFT_BEHIND: Duration = Duration::from_hours(1);

/// Bytes read at a time while hashing.
const BUFFER_BYTES: usize = 1 << 20;

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// A file cannot be read or written.
    #[error("{}: cannot be read or written; check that it exists, its permissions, and that the disk is not full", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is not a manifest.
    #[error("{}: is damaged, or no manifest of this version ({problem}); restore it, or delete it and seal the folder anew", file.display())]
    Format {
        /// The manifest.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Lines of the manifest are damaged.
    #[error(
        "{}: damaged in the lines of {}; restore it, or take these lines out, and the files are hashed anew as they are now",
        file.display(), lines.join(", ")
    )]
    Damaged {
        /// The manifest.
        file: PathBuf,
        /// The files of these lines, as the manifest names them.
        lines: Vec<String>,
    },
    /// The content of files differs from the record.
    #[error(
        "changed since they were recorded: {}; restore them, or, if the change is meant, take their lines out of {} and seal anew",
        files.join(", "), manifest.display()
    )]
    Changed {
        /// The files, relative to the campaign folder.
        files: Vec<String>,
        /// The manifest.
        manifest: PathBuf,
    },
    /// campaign.toml or a table that it names differs from its sealed text.
    #[error(
        "campaign {}: its settings changed since it was sealed: {}; restore them, or, if the change is meant, \
         `periscope seal --update`", root.display(), changes.join("; ")
    )]
    Settings {
        /// The campaign folder.
        root: PathBuf,
        /// The changes: file, and key or line.
        changes: Vec<String>,
    },
}

/// The record of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// The file's stamp when it was hashed.
    #[serde(flatten)]
    pub stamp: Stamp,
    /// Hash of the content.
    #[serde(with = "hexadecimal")]
    pub blake3: Hash,
}

/// Hashes as 64 hexadecimal digits.
pub(super) mod hexadecimal {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(hash: &blake3::Hash, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&hash.to_hex())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<blake3::Hash, D::Error> {
        blake3::Hash::from_hex(String::deserialize(from)?).map_err(D::Error::custom)
    }
}

/// How a file compares with its record, by its stamp alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileState {
    /// As recorded: the file has this content.
    Same(Hash),
    /// The stamp differs from the record: the file must be hashed, and compared with this content.
    Touched {
        /// The content that was recorded.
        recorded: Hash,
    },
    /// Without record.
    New,
}

/// The records of a campaign folder, by path relative to it, with `/` between its parts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    files: BTreeMap<String, FileRecord>,
    /// The sealed text of campaign.toml and of its tables; none in notes of runs.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) settings: BTreeMap<String, String>,
}

/// The JSON of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ManifestFile<F> {
    version: u32,
    settings: BTreeMap<String, Text>,
    files: F,
}

/// A line of the file, for a text that is kept whole.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    text: String,
    /// The first 16 hexadecimal digits of the BLAKE3 hash of path and text.
    check: String,
}

impl Text {
    fn of(path: &str, text: &str) -> Self {
        let check = blake3::hash(format!("{path}\0{text}").as_bytes());
        Self { text: text.to_owned(), check: check.to_hex()[..16].to_owned() }
    }
}

/// A line of the file, for a raw file.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    bytes: u64,
    modified_ns: i64,
    changed_ns: i64,
    inode: u64,
    /// Hexadecimal, lower case.
    blake3: String,
    /// The first 16 hexadecimal digits of the BLAKE3 hash of path and fields.
    check: String,
}

impl Line {
    fn of(path: &str, record: &FileRecord) -> Self {
        let Stamp { bytes, modified_ns, changed_ns, inode } = record.stamp;
        let blake3 = record.blake3.to_hex().to_string();
        let fields = format!("{path}\0{bytes}\0{modified_ns}\0{changed_ns}\0{inode}\0{blake3}");
        let check = blake3::hash(fields.as_bytes()).to_hex()[..16].to_owned();
        Self { bytes, modified_ns, changed_ns, inode, blake3, check }
    }

    /// The record, if the line's checksum is right.
    fn record(&self, path: &str) -> Option<FileRecord> {
        let blake3 = Hash::from_hex(&self.blake3).ok()?;
        let &Self { bytes, modified_ns, changed_ns, inode, .. } = self;
        let record = FileRecord { stamp: Stamp { bytes, modified_ns, changed_ns, inode }, blake3 };
        (Self::of(path, &record) == *self).then_some(record)
    }
}

impl Manifest {
    /// Reads the manifest of a campaign folder; `None` if it has none.
    ///
    /// # Errors
    /// When the manifest cannot be read, or is damaged.
    pub fn load(root: &Path) -> Result<Option<Self>, ManifestError> {
        let Some((read, file)) = read::<BTreeMap<String, Line>>(root)? else {
            return Ok(None);
        };
        let (settings, mut damaged) = texts(read.settings);
        let mut files = BTreeMap::new();
        for (path, line) in read.files {
            match line.record(&path) {
                Some(record) => _ = files.insert(path, record),
                None => damaged.push(path),
            }
        }
        if damaged.is_empty() {
            Ok(Some(Self { files, settings }))
        } else {
            Err(ManifestError::Damaged { file, lines: damaged })
        }
    }

    /// The sealed texts alone, by path; `None` if the campaign folder has no manifest.
    ///
    /// # Errors
    /// When the manifest cannot be read, or these lines are damaged.
    pub fn sealed_texts(root: &Path) -> Result<Option<BTreeMap<String, String>>, ManifestError> {
        let Some((read, file)) = read::<IgnoredAny>(root)? else {
            return Ok(None);
        };
        let (settings, damaged) = texts(read.settings);
        if damaged.is_empty() { Ok(Some(settings)) } else { Err(ManifestError::Damaged { file, lines: damaged }) }
    }

    /// Writes the manifest under another name, then renames it, so that neither a reader nor a crash sees half of it.
    /// Also removes half-written manifests of killed processes.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, root: &Path) -> Result<(), ManifestError> {
        self.write(root, Output::sync_all)
    }

    /// Writes the manifest without waiting for the disk. A power cut may truncate it, which [`Manifest::join`] treats
    /// as absent.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save_without_waiting(&self, root: &Path) -> Result<(), ManifestError> {
        self.write(root, |_| Ok(()))
    }

    fn write(&self, root: &Path, sync: impl FnOnce(&Output) -> io::Result<()>) -> Result<(), ManifestError> {
        let file = root.join(MANIFEST_FILE);
        let half = root.join(format!("{HALF}{}", lock::mark()));
        let write = || -> io::Result<()> {
            let mut out = fs::create(&half)?;
            out.write_all(self.text()?.as_bytes())?;
            sync(&out)?;
            fs::rename(&half, &file)?;
            sweep(root)
        };
        write().map_err(|source| file_error(&file, source))
    }

    /// JSON with one line per file: easy to read, to compare, and to delete a line.
    fn text(&self) -> serde_json::Result<String> {
        let settings = self.settings.iter().map(|(path, text)| line(path, &Text::of(path, text)));
        let files = self.files.iter().map(|(path, record)| line(path, &Line::of(path, record)));
        let settings = settings.collect::<Result<Vec<_>, _>>()?.join(",\n");
        let files = files.collect::<Result<Vec<_>, _>>()?.join(",\n");
        Ok(format!("{{\n\"version\": {VERSION},\n\"settings\": {{\n{settings}\n}},\n\"files\": {{\n{files}\n}}\n}}\n"))
    }

    /// Compares a file with its record by its stamp, without reading its content.
    ///
    /// # Errors
    /// When the file does not exist, or its metadata cannot be read.
    pub fn check(&self, root: &Path, path: &Path) -> Result<FileState, ManifestError> {
        let Some(record) = self.files.get(&key(path)) else {
            return Ok(FileState::New);
        };
        let metadata = metadata(&root.join(path))?;
        Ok(if record.fits(&metadata) {
            FileState::Same(record.blake3)
        } else {
            FileState::Touched { recorded: record.blake3 }
        })
    }

    /// Records a file. Read `metadata` before the content, so that a change in between shows at the next
    /// [`Manifest::check`].
    pub fn record(&mut self, path: &Path, content: Hash, metadata: &Metadata) {
        self.files.insert(key(path), FileRecord::of(content, metadata));
    }

    /// Adds the records of another folder's manifest. A truncated one has none: its files will be hashed again.
    ///
    /// # Errors
    /// When it cannot be read, or is damaged otherwise.
    pub fn join(&mut self, root: &Path) -> Result<(), ManifestError> {
        let is_cut = |bytes: &[u8]| serde_json::from_slice::<IgnoredAny>(bytes).is_err_and(|error| error.is_eof());
        if fs::read(root.join(MANIFEST_FILE)).is_ok_and(|bytes| is_cut(&bytes)) {
            return Ok(());
        }
        self.files.extend(Self::load(root)?.unwrap_or_default().files);
        Ok(())
    }

    /// Adds the records of another manifest.
    pub fn take(&mut self, other: &Self) {
        self.files.extend(other.files.iter().map(|(path, record)| (path.clone(), *record)));
    }

    /// Only the records of these files, as far as they exist.
    #[must_use]
    pub fn of<'a>(&self, files: impl Iterator<Item = &'a Path>) -> Self {
        let record = |file| self.files.get_key_value(&key(file)).map(|(path, record)| (path.clone(), *record));
        Self { files: files.filter_map(record).collect(), settings: BTreeMap::new() }
    }

    /// Drops the records of files that have changed or are gone, for a campaign that is still being captured.
    pub fn forget_changed(&mut self, root: &Path) {
        self.files.retain(|path, record| fs::metadata(root.join(path)).is_ok_and(|metadata| record.fits(&metadata)));
    }

    /// The record of a file.
    #[must_use]
    pub fn get(&self, path: &Path) -> Option<&FileRecord> {
        self.files.get(&key(path))
    }

    /// The sealed texts, by path: campaign.toml, and the tables that it names.
    #[must_use]
    pub fn settings(&self) -> &BTreeMap<String, String> {
        &self.settings
    }

    /// All records, sorted by path.
    pub fn iter(&self) -> impl Iterator<Item = (&Path, &FileRecord)> {
        self.files.iter().map(|(path, record)| (Path::new(path), record))
    }
}

impl FileRecord {
    fn of(content: Hash, metadata: &Metadata) -> Self {
        Self { stamp: Stamp::of(metadata), blake3: content }
    }

    /// Whether the stamp matches the record.
    fn fits(&self, metadata: &Metadata) -> bool {
        self.stamp == Stamp::of(metadata)
    }
}

/// BLAKE3 hash of a file's content, read in pieces of 1 MiB.
///
/// # Errors
/// When it cannot be read.
pub fn hash_file(path: &Path) -> Result<Hash, ManifestError> {
    let hash = || -> io::Result<Hash> {
        let mut file = fs::open(path)?;
        let mut hasher = blake3::Hasher::new();
        let mut buffer = vec![0; BUFFER_BYTES];
        loop {
            match file.read(&mut buffer) {
                Ok(0) => return Ok(hasher.finalize()),
                Ok(read) => hasher.update(&buffer[..read]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
        }
    };
    hash().map_err(|source| file_error(path, source))
}

pub(super) fn metadata(path: &Path) -> Result<Metadata, ManifestError> {
    fs::metadata(path).map_err(|source| file_error(path, source))
}

fn file_error(file: &Path, source: io::Error) -> ManifestError {
    ManifestError::File { file: file.to_owned(), source }
}

/// The JSON of a manifest, and its path; `None` if there is none.
fn read<F: DeserializeOwned>(root: &Path) -> Result<Option<(ManifestFile<F>, PathBuf)>, ManifestError> {
    let file = root.join(MANIFEST_FILE);
    let bytes = match fs::read(&file) {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(None);
        }
        read => read.map_err(|source| file_error(&file, source))?,
    };
    let format = |problem: String| ManifestError::Format { file: file.clone(), problem };
    let read: ManifestFile<F> = serde_json::from_slice(&bytes).map_err(|error| format(error.to_string()))?;
    if read.version != VERSION {
        return Err(format(format!("version {}, not {VERSION}", read.version)));
    }
    Ok(Some((read, file)))
}

/// The texts whose checks are right, and the paths of the others.
fn texts(lines: BTreeMap<String, Text>) -> (BTreeMap<String, String>, Vec<String>) {
    let (mut texts, mut damaged) = (BTreeMap::new(), Vec::new());
    for (path, line) in lines {
        if Text::of(&path, &line.text) == line {
            texts.insert(path, line.text);
        } else {
            damaged.push(path);
        }
    }
    (texts, damaged)
}

/// Removes the half-written manifests of processes that were killed.
fn sweep(root: &Path) -> io::Result<()> {
    for entry in fs::read_dir(root)? {
        let entry = entry?;
        let is_half = entry.file_name().as_encoded_bytes().starts_with(HALF.as_bytes());
        if is_half && entry.metadata()?.modified()?.elapsed().is_ok_and(|age| age > LEFT_BEHIND) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn line(path: &str, content: &impl Serialize) -> serde_json::Result<String> {
    Ok(format!("{}: {}", serde_json::to_string(path)?, serde_json::to_string(content)?))
}

fn key(path: &Path) -> String {
    let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};

    use super::*;

    fn folder_with(text: &str) -> (tempfile::TempDir, Manifest) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.trc");
        fs::write(&file, text).unwrap();
        let mut manifest = Manifest::default();
        let content = hash_file(&file).unwrap();
        manifest.record(Path::new("a.trc"), content, &metadata(&file).unwrap());
        (folder, manifest)
    }

    #[test]
    fn what_went_down_with_the_machine_is_recorded_again_and_what_is_damaged_is_told() {
        let (folder, manifest) = folder_with("light");
        manifest.save_without_waiting(folder.path()).unwrap();
        let text = fs::read_to_string(folder.path().join(MANIFEST_FILE)).unwrap();
        let mut joined = Manifest::default();
        for length in 0..text.trim_end().len() {
            fs::write(folder.path().join(MANIFEST_FILE), &text[..length]).unwrap();
            joined.join(folder.path()).unwrap();
            assert!(Manifest::load(folder.path()).is_err(), "a seal of {length} bytes");
        }
        assert_eq!(joined, Manifest::default());
        fs::write(folder.path().join(MANIFEST_FILE), text.replace("bytes", "bites")).unwrap();
        assert!(joined.join(folder.path()).is_err());
        fs::write(folder.path().join(MANIFEST_FILE), text).unwrap();
        joined.join(folder.path()).unwrap();
        assert_eq!(joined, manifest);
    }

    #[test]
    fn a_manifest_reads_back_and_has_one_file_a_line() {
        let (folder, mut manifest) = folder_with("light");
        let content = blake3::hash(b"light");
        let metadata = metadata(&folder.path().join("a.trc")).unwrap();
        manifest.record(Path::new("raw/\"b\".trc"), content, &metadata);
        assert_eq!(Manifest::load(folder.path()).unwrap(), None);
        manifest.save(folder.path()).unwrap();
        assert_eq!(Manifest::load(folder.path()).unwrap(), Some(manifest));
        let text = fs::read_to_string(folder.path().join(MANIFEST_FILE)).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 10);
        assert!(lines[6].starts_with("\"a.trc\": {\"bytes\":5,\"modified_ns\":"));
        assert!(lines[6].contains(&content.to_hex().to_string()));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing left over");
    }

    #[test]
    fn halves_of_killed_processes_go_and_those_under_way_stay() {
        let folder = tempfile::tempdir().unwrap();
        let half = |process: u32| folder.path().join(format!("{HALF}{process}"));
        fs::write(half(1), "{").unwrap();
        fs::write(half(2), "{").unwrap();
        let long_ago = std::time::SystemTime::now() - 2 * LEFT_BEHIND;
        File::options().write(true).open(half(1)).unwrap().set_modified(long_ago).unwrap();
        Manifest::default().save(folder.path()).unwrap();
        assert!(!half(1).exists() && half(2).exists());
    }

    #[test]
    fn empty_and_broken_manifests() {
        let folder = tempfile::tempdir().unwrap();
        let empty = Manifest::default();
        empty.save(folder.path()).unwrap();
        assert_eq!(Manifest::load(folder.path()).unwrap(), Some(empty));
        for text in ["", "{}", "{\"version\": 2, \"files\": {}}", "{\"version\": 2, \"settings\": {}, \"files\": {}}"] {
            fs::write(folder.path().join(MANIFEST_FILE), text).unwrap();
            let error = Manifest::load(folder.path()).unwrap_err().to_string();
            assert!(error.contains("seal the folder anew"), "{error}");
        }
    }

    #[test]
    fn every_flipped_bit_is_found_and_its_line_named() {
        let (folder, mut manifest) = folder_with("light");
        manifest.settings.insert("campaign.toml".to_owned(), "[campaign]\nname = 'c'\n".to_owned());
        manifest.save(folder.path()).unwrap();
        let file = folder.path().join(MANIFEST_FILE);
        let bytes = fs::read(&file).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&file, &flipped).unwrap();
            let error = Manifest::load(folder.path()).unwrap_err().to_string();
            assert!(error.contains("damaged"), "bit {bit}: {error}");
        }
        let text = String::from_utf8(bytes).unwrap();
        fs::write(&file, text.replace("\"bytes\":5", "\"bytes\":4")).unwrap();
        let error = Manifest::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("damaged in the lines of a.trc; restore it"), "{error}");
    }

    #[test]
    fn the_stamp_tells_that_a_file_was_touched() {
        let (folder, manifest) = folder_with("light");
        let (path, file) = (Path::new("a.trc"), folder.path().join("a.trc"));
        let content = blake3::hash(b"light");
        let state = |path| manifest.check(folder.path(), path).unwrap();
        assert_eq!(state(path), FileState::Same(content));
        assert_eq!(state(Path::new("b.trc")), FileState::New);
        let time = fs::metadata(&file).unwrap().modified().unwrap();
        let set_time = |time| File::options().write(true).open(&file).unwrap().set_modified(time);
        set_time(time + Duration::from_secs(1)).unwrap();
        assert_eq!(state(path), FileState::Touched { recorded: content });
        fs::write(&file, "lights").unwrap();
        set_time(time).unwrap();
        assert_eq!(state(path), FileState::Touched { recorded: content });
        fs::remove_file(&file).unwrap();
        assert!(manifest.check(folder.path(), path).is_err());
    }

    #[test]
    fn hashing_in_pieces_is_hashing_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("big");
        for length in [0, 1, BUFFER_BYTES, 2 * BUFFER_BYTES + 17] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 31 % 251) as u8).collect();
            fs::write(&file, &bytes).unwrap();
            assert_eq!(hash_file(&file).unwrap(), blake3::hash(&bytes));
        }
    }
}
