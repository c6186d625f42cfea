//! Scope files to records: one file a format, behind one trait. The format is found by content first, then by extension.

pub mod csv;
pub mod lecroy_ascii;
pub mod lecroy_trc;
pub mod npy;
pub mod reader;
pub mod tek_isf;

use std::io::SeekFrom;
use std::path::Path;

pub use reader::{FormatError, Reader, Source};

use crate::waveform::Record;

/// The formats, those that know themselves by their first bytes before those that take any text.
pub const READERS: [&dyn Reader; 5] =
    [&lecroy_trc::LecroyTrc, &npy::Npy, &tek_isf::TekIsf, &lecroy_ascii::LecroyAscii, &csv::Csv];

/// Bytes at the start of a file by which its format is found.
const HEAD_BYTES: usize = 2048;

/// Opens a file.
///
/// # Errors
/// When it cannot be read.
pub fn open(path: &Path) -> Result<Source<std::fs::File>, FormatError> {
    Source::new(std::fs::File::open(path)?, path)
}

/// The records of a file; reads headers, and samples only where they are text.
///
/// # Errors
/// When no reader knows the file, or its reader refuses it.
pub fn records<F: std::io::Read + std::io::Seek>(source: &mut Source<F>) -> Result<Vec<Record>, FormatError> {
    let head = source.head(HEAD_BYTES)?;
    if head.is_empty() {
        return Err(FormatError::Empty);
    }
    let reader = READERS.into_iter().find(|reader| reader.recognises(&head));
    let extension = source.extension();
    let reader =
        reader.or_else(|| READERS.into_iter().find(|reader| reader.extensions().contains(&extension.as_str())));
    let reader = reader.ok_or(FormatError::Unknown)?;
    source.seek_to(SeekFrom::Start(0))?;
    reader.records(source)
}
