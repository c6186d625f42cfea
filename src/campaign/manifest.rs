//! The manifest of a campaign folder: stamp and content hash of every raw file that was read or sealed, and in a seal
//! the text of campaign.toml and of the tables that it names.
//!
//! `DIR/manifest.json` has one line per file, sorted, each with its own checksum: you may delete a line, but a damaged
//! one is noticed. Lineages use the hash (BLAKE3). The stamp (size, times, inode) only avoids hashing a file again:
//! where it differs from the record, the content decides.

mod text;

use std::collections::BTreeMap;
use std::fs::{DirEntry, Metadata};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use blake3::Hash;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::stamp::Stamp;
use crate::store::disk::{self as fs, Output};
use crate::store::lock;
use text::Line;

/// Name of the manifest in a campaign folder.
pub const MANIFEST_FILE: &str = "manifest.json";

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

impl Manifest {
    /// Reads the manifest of a campaign folder; `None` if it has none.
    ///
    /// # Errors
    /// When the manifest cannot be read, or is damaged.
    pub fn load(root: &Path) -> Result<Option<Self>, ManifestError> {
        let Some((read, file)) = text::read::<BTreeMap<String, Line>>(root)? else {
            return Ok(None);
        };
        let (settings, mut damaged) = text::texts(read.settings);
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
        let Some((read, file)) = text::read::<IgnoredAny>(root)? else {
            return Ok(None);
        };
        let (settings, damaged) = text::texts(read.settings);
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
            out.write_all(text::text(&self.settings, &self.files)?.as_bytes())?;
            sync(&out)?;
            fs::rename(&half, &file)?;
            sweep(root)
        };
        write().map_err(|source| file_error(&file, source))
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

pub(super) fn file_error(file: &Path, source: io::Error) -> ManifestError {
    ManifestError::File { file: file.to_owned(), source }
}

/// Removes the half-written manifests of processes that were killed.
fn sweep(root: &Path) -> io::Result<()> {
    for entry in fs::read_dir(root)? {
        let entry = entry?;
        let is_half = entry.file_name().as_encoded_bytes().starts_with(HALF.as_bytes());
        if is_half {
            remove_if_left_behind(&entry).or_else(gone)?;
        }
    }
    Ok(())
}

fn remove_if_left_behind(half: &DirEntry) -> io::Result<()> {
    let is_old = half.metadata()?.modified()?.elapsed().is_ok_and(|age| age > LEFT_BEHIND);
    if is_old { fs::remove_file(half.path()) } else { Ok(()) }
}

/// A file may go while its folder is listed: its writer gives it its name, or another process removes it.
fn gone(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}

fn key(path: &Path) -> String {
    let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
    parts.join("/")
}

#[cfg(test)]
mod tests;
