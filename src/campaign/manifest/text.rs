//! The file of a manifest: JSON with one line per file, easy to read, to compare, and to delete a line. Each line has
//! its own checksum.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use blake3::Hash;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{FileRecord, MANIFEST_FILE, ManifestError, file_error};
use crate::campaign::stamp::Stamp;
use crate::store::disk as fs;

const VERSION: u32 = 3;

/// The JSON of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ManifestFile<F> {
    version: u32,
    pub(super) settings: BTreeMap<String, Text>,
    pub(super) files: F,
}

/// A line of the file, for a text that is kept whole.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Text {
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
pub(super) struct Line {
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
    pub(super) fn record(&self, path: &str) -> Option<FileRecord> {
        let blake3 = Hash::from_hex(&self.blake3).ok()?;
        let &Self { bytes, modified_ns, changed_ns, inode, .. } = self;
        let record = FileRecord { stamp: Stamp { bytes, modified_ns, changed_ns, inode }, blake3 };
        (Self::of(path, &record) == *self).then_some(record)
    }
}

/// The JSON of a manifest, and its path; `None` if there is none.
pub(super) fn read<F: DeserializeOwned>(root: &Path) -> Result<Option<(ManifestFile<F>, PathBuf)>, ManifestError> {
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
pub(super) fn texts(lines: BTreeMap<String, Text>) -> (BTreeMap<String, String>, Vec<String>) {
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

/// The text of a manifest.
pub(super) fn text(
    settings: &BTreeMap<String, String>,
    files: &BTreeMap<String, FileRecord>,
) -> serde_json::Result<String> {
    let settings = settings.iter().map(|(path, text)| line(path, &Text::of(path, text)));
    let files = files.iter().map(|(path, record)| line(path, &Line::of(path, record)));
    let settings = settings.collect::<Result<Vec<_>, _>>()?.join(",\n");
    let files = files.collect::<Result<Vec<_>, _>>()?.join(",\n");
    Ok(format!("{{\n\"version\": {VERSION},\n\"settings\": {{\n{settings}\n}},\n\"files\": {{\n{files}\n}}\n}}\n"))
}

fn line(path: &str, content: &impl Serialize) -> serde_json::Result<String> {
    Ok(format!("{}: {}", serde_json::to_string(path)?, serde_json::to_string(content)?))
}
