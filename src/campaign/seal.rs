//! Sealing a campaign: recording the content of its raw files, and holding it to what was recorded.
//!
//! The first seal hashes every raw file. Later ones look at sizes and times, hash only what these make doubtful, and refuse changed files by name.
//! New files are reported and join on request; a file that is gone keeps its line, as its disk may be elsewhere today.

use std::path::PathBuf;

use super::keys::Campaign;
use super::manifest::{FileState, MANIFEST_FILE, Manifest, ManifestError, hash_file, metadata};
use super::survey::Survey;

/// What sealing found and did. Paths are relative to the campaign folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SealReport {
    /// Files whose record stood, be their time of change new or not.
    pub unchanged: usize,
    /// Files that are not in the manifest, or were not before this call.
    pub new: Vec<PathBuf>,
    /// Whether the new files were hashed and recorded.
    pub joined: bool,
    /// Files of which size and time of change were recorded anew, as their content is the same.
    pub refreshed: Vec<PathBuf>,
    /// Files in the manifest that are not there.
    pub gone: Vec<PathBuf>,
}

/// Records of a manifest against the files that are there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Audit {
    /// Files with the content that was recorded.
    pub unchanged: usize,
    /// Those among them whose time of change is another.
    pub touched: Vec<PathBuf>,
    /// Files with another content.
    pub changed: Vec<PathBuf>,
    /// Files that are not there.
    pub gone: Vec<PathBuf>,
}

impl Manifest {
    /// Compares every record with its file: by size and time of change, and by content where these differ, or everywhere if `rehash`.
    ///
    /// # Errors
    /// When a file that is there cannot be read.
    pub fn audit(&self, campaign: &Campaign, rehash: bool) -> Result<Audit, ManifestError> {
        let mut audit = Audit::default();
        for (path, record) in self.iter() {
            let file = campaign.path_of(path);
            if !file.exists() {
                audit.gone.push(path.to_owned());
                continue;
            }
            let touched = self.check(&campaign.root, path)? != FileState::Known(record.blake3);
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

/// Seals a campaign, or holds a sealed one to its seal. `update`: files that came since join.
///
/// # Errors
/// When a file has another content than was recorded (all such files are named, and nothing is written), or cannot be read.
pub fn seal(campaign: &Campaign, survey: &Survey, update: bool) -> Result<SealReport, ManifestError> {
    let root = &campaign.root;
    let sealed = Manifest::load(root)?;
    let join = update || sealed.is_none();
    let mut manifest = sealed.unwrap_or_default();
    let audit = manifest.audit(campaign, false)?;
    if !audit.changed.is_empty() {
        return Err(ManifestError::Changed {
            files: audit.changed.iter().map(|file| file.display().to_string()).collect(),
            manifest: root.join(MANIFEST_FILE),
        });
    }
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
        gone: audit.gone,
    })
}
