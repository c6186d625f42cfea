//! What a format reader is, and what can be wrong with a file.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use thiserror::Error;

use crate::waveform::Record;

/// What is wrong with a file. The file's name is added by who opened it.
#[derive(Debug, Error)]
pub enum FormatError {
    /// It cannot be read.
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
    /// Nothing in it.
    #[error("is empty: the capture may have been interrupted")]
    Empty,
    /// No reader knows it.
    #[error(
        "is in no format that is read: LeCroy .trc, LeCroy ASCII .txt, Tektronix .isf, NumPy .npy, or CSV of time and volts"
    )]
    Unknown,
    /// It ends too early.
    #[error(
        "is cut short: {what} needs {needed} bytes from byte {byte_offset}, but the file ends after {length}; copy it from the instrument again"
    )]
    Truncated {
        /// What should be there.
        what: &'static str,
        /// Where it begins.
        byte_offset: u64,
        /// Its length.
        needed: u64,
        /// Length of the file.
        length: u64,
    },
    /// A field of the header makes no sense.
    #[error("byte {byte_offset}: {problem}")]
    Field {
        /// Where.
        byte_offset: u64,
        /// What, and the mend where there is one.
        problem: String,
    },
    /// A line of a text makes no sense.
    #[error("line {line}: {problem}")]
    Line {
        /// Which, from 1.
        line: u64,
        /// What, and the mend where there is one.
        problem: String,
    },
}

impl FormatError {
    /// Where in the file, if it is one place.
    #[must_use]
    pub fn byte_offset(&self) -> Option<u64> {
        match self {
            Self::Truncated { byte_offset, .. } | Self::Field { byte_offset, .. } => Some(*byte_offset),
            _ => None,
        }
    }
}

/// A file, or bytes in memory, of known length.
pub struct Source<F> {
    file: F,
    length: u64,
    extension: String,
}

/// A file as a reader sees it.
pub trait Input {
    /// Length in bytes.
    fn length(&self) -> u64;
    /// The bytes of a stretch, which must lie within the file.
    ///
    /// # Errors
    /// When it does not, or cannot be read.
    fn bytes(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError>;
    /// Everything from the start.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError>;
}

impl<F: Read + Seek> Source<F> {
    /// Of a file; the path gives the extension only.
    ///
    /// # Errors
    /// When its length cannot be found out.
    pub fn new(mut file: F, path: &Path) -> Result<Self, FormatError> {
        let length = file.seek(SeekFrom::End(0))?;
        let extension =
            path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
        Ok(Self { file, length, extension })
    }

    /// Extension of the file's name, in lower case.
    #[must_use]
    pub fn extension(&self) -> String {
        self.extension.clone()
    }

    /// The first bytes, up to `count`.
    pub(super) fn head(&mut self, count: usize) -> Result<Vec<u8>, FormatError> {
        self.bytes("the head", 0, self.length.min(count as u64))
    }

    pub(super) fn seek_to(&mut self, at: SeekFrom) -> Result<(), FormatError> {
        self.file.seek(at)?;
        Ok(())
    }

    /// The file itself.
    pub fn file(&mut self) -> &mut F {
        &mut self.file
    }

    /// The file itself, and nothing else.
    pub fn into_inner(self) -> F {
        self.file
    }
}

impl<F: Read + Seek> Input for Source<F> {
    fn length(&self) -> u64 {
        self.length
    }

    fn bytes(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        if byte_offset.checked_add(count).is_none_or(|end| end > self.length) {
            return Err(FormatError::Truncated { what, byte_offset, needed: count, length: self.length });
        }
        let mut bytes = vec![0; count as usize];
        self.file.seek(SeekFrom::Start(byte_offset))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError> {
        self.file.seek(SeekFrom::Start(0))?;
        Ok(Box::new(&mut self.file))
    }
}

/// One format. A reader validates every length against the file before it allocates, and never panics on what is in a file.
pub trait Reader: Sync {
    /// Name of the format.
    fn format(&self) -> &'static str;
    /// Extensions of file names, lower case, by which it takes files that do not tell by content.
    fn extensions(&self) -> &'static [&'static str];
    /// Whether a file that begins with these bytes is of this format.
    fn recognises(&self, head: &[u8]) -> bool;
    /// The records of a file.
    ///
    /// # Errors
    /// When anything in the file contradicts the format.
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError>;
}
