//! What is on record of a campaign's raw files: its seal, if it has one, and what earlier runs into this result folder
//! noted.
//!
//! ```text
//! OUT/.shelf/notes/<campaign>/manifest.json               what runs have noted
//! OUT/.shelf/notes/<campaign>/part-<name>/manifest.json   a slip: what one part taught, not yet gathered
//! ```
//!
//! A killed run loses no part that it has finished. Processes that read other parts at the same time write separate
//! files. No run waits until its notes are on the disk, which takes longer than a part: a machine that goes down may
//! lose them, and files are hashed again.

use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde_json::json;

use super::survey::Capture;
use crate::campaign::{Campaign, FileState, Manifest, ManifestError};
use crate::store::Digest;
use crate::store::disk as fs;

/// How the folders of slips begin.
const SLIP: &str = "part-";

/// What is on record of a campaign's raw files.
pub struct Record {
    pub seal: Option<Manifest>,
    /// Folder of the notes.
    notes: PathBuf,
    noted: Mutex<Noted>,
}

/// Notes: those that were written down, and new ones that are not yet.
struct Noted {
    manifest: Manifest,
    new: Vec<(PathBuf, blake3::Hash, Metadata)>,
}

impl Record {
    /// All that is on record; `notes` is the folder of the notes of all campaigns.
    pub fn load(campaign: &Campaign, notes: &Path) -> Result<Self, ManifestError> {
        let notes = notes.join(&campaign.name);
        let mut manifest = Manifest::default();
        manifest.join(&notes)?;
        slips(&notes)?.iter().try_for_each(|slip| manifest.join(slip))?;
        Ok(Self::of(Manifest::load(&campaign.root)?, notes, manifest))
    }

    /// What was on record of these parts when another process gave them away, and what was noted of them since.
    pub fn of_parts<'a>(
        campaign: &Campaign,
        notes: &Path,
        seal: Option<Manifest>,
        mut noted: Manifest,
        parts: impl Iterator<Item = &'a [Capture]>,
    ) -> Result<Self, ManifestError> {
        let notes = notes.join(&campaign.name);
        for part in parts {
            noted.join(&notes.join(slip(part)))?;
        }
        Ok(Self::of(seal, notes, noted))
    }

    fn of(seal: Option<Manifest>, notes: PathBuf, manifest: Manifest) -> Self {
        Self { seal, notes, noted: Mutex::new(Noted { manifest, new: Vec::new() }) }
    }

    fn noted(&self) -> MutexGuard<'_, Noted> {
        self.noted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was noted of these files.
    pub fn noted_of<'a>(&self, files: impl Iterator<Item = &'a Path>) -> Manifest {
        self.noted().manifest.of(files)
    }

    /// The first of the noted files, where it is not there any more, and how many these are.
    ///
    /// # Errors
    /// When the disk cannot be asked.
    pub fn first_gone(&self, root: &Path) -> io::Result<Option<(PathBuf, usize)>> {
        let noted = self.noted();
        let Some((file, _)) = noted.manifest.iter().next() else { return Ok(None) };
        let count = noted.manifest.iter().count();
        Ok((!fs::is_there(&root.join(file))?).then(|| (file.to_owned(), count)))
    }

    /// The content that is on record.
    pub fn content(&self, file: &Path) -> Option<blake3::Hash> {
        let sealed = self.seal.as_ref().and_then(|seal| seal.get(file)).map(|record| record.blake3);
        sealed.or_else(|| self.noted().manifest.get(file).map(|record| record.blake3))
    }

    /// The seal decides where there is one.
    pub fn check(&self, root: &Path, file: &Path) -> Result<FileState, ManifestError> {
        let sealed = self.seal.as_ref().map_or(Ok(FileState::New), |seal| seal.check(root, file))?;
        let noted = self.noted().manifest.check(root, file)?;
        Ok(match (sealed, noted) {
            (FileState::New, noted) => noted,
            // A file whose time stamp alone changed was hashed again by an earlier run, which noted it.
            (FileState::Touched { recorded }, FileState::Same(hash)) if hash == recorded => noted,
            (sealed, _) => sealed,
        })
    }

    /// Notes the digest of a file that was read; `metadata` was taken before.
    pub fn note(&self, file: &Path, digest: blake3::Hash, metadata: &Metadata) {
        let mut noted = self.noted();
        noted.manifest.record(file, digest, metadata);
        noted.new.push((file.to_owned(), digest, metadata.clone()));
    }

    /// Writes down what was learnt since the last time, on the slip of the part that was read.
    pub fn save_slip(&self, part: &[Capture]) -> Result<(), ManifestError> {
        let new = std::mem::take(&mut self.noted().new);
        if new.is_empty() {
            return Ok(());
        }
        let folder = self.notes.join(slip(part));
        let mut manifest = Manifest::default();
        new.iter().for_each(|(file, digest, metadata)| manifest.record(file, *digest, metadata));
        create(&folder)?;
        manifest.save_without_waiting(&folder)
    }

    /// Gathers in one file what was learnt and all slips. These include slips of other sources of the run, of shards,
    /// and of an earlier run that was killed.
    pub fn save(&self) -> Result<(), ManifestError> {
        let new = std::mem::take(&mut self.noted().new);
        let slips = slips(&self.notes)?;
        if new.is_empty() && slips.is_empty() {
            return Ok(());
        }
        let mut manifest = Manifest::default();
        manifest.join(&self.notes)?;
        slips.iter().try_for_each(|slip| manifest.join(slip))?;
        new.iter().for_each(|(file, digest, metadata)| manifest.record(file, *digest, metadata));
        create(&self.notes)?;
        manifest.save_without_waiting(&self.notes)?;
        slips.iter().try_for_each(|slip| fs::remove_dir_all(slip).map_err(|source| at(slip, source)))
    }
}

/// Name of the slip of a part: by its first capture, which no other part has.
fn slip(part: &[Capture]) -> String {
    let Capture { role, run, sensor, lit, seen, items, .. } = &part[0];
    let file = items.first().map(|item| &item.exposure.file);
    format!("{SLIP}{}", Digest::of(&json!([role, run, sensor, lit, seen, file])).short())
}

/// The slips in a folder of notes.
fn slips(notes: &Path) -> Result<Vec<PathBuf>, ManifestError> {
    let entries = match fs::read_dir(notes) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(|source| at(notes, source))?,
    };
    let path = |entry: io::Result<std::fs::DirEntry>| Ok(entry.map_err(|source| at(notes, source))?.path());
    let mut slips = entries.map(path).collect::<Result<Vec<_>, ManifestError>>()?;
    slips.retain(|path| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(SLIP.as_bytes())));
    Ok(slips)
}

fn create(folder: &Path) -> Result<(), ManifestError> {
    fs::create_dir_all(folder).map_err(|source| at(folder, source))
}

fn at(file: &Path, source: io::Error) -> ManifestError {
    ManifestError::File { file: file.to_owned(), source }
}
