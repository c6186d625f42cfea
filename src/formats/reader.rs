//! What a format reader is, and what can be wrong with a file.

use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

use thiserror::Error;

use crate::companions::companion;
use crate::waveform::{ReadSeek, Record};

/// What is wrong with a file. The file's name is added by who opened it.
#[derive(Debug, Error)]
pub enum FormatError {
    /// It cannot be read.
    #[error("cannot be read: {0}")]
    Io(io::Error),
    /// Nothing in it.
    #[error("is empty: the capture may have been interrupted")]
    Empty,
    /// No reader knows it.
    #[error(
        "is in no format that is read; export it from the instrument as CSV, or see docs/formats.md for the formats that are"
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

/// No source of the error is named beside the text, which has it already.
impl From<io::Error> for FormatError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
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

/// A file, and behind its bytes those of its companion where it has one.
pub struct Joined {
    file: File,
    length: u64,
    companion: Option<(File, u64)>,
    position: u64,
}

impl Joined {
    fn open(path: &Path) -> io::Result<Self> {
        let measured = |mut file: File| file.seek(SeekFrom::End(0)).map(|length| (file, length));
        let (file, length) = File::open(path).and_then(measured)?;
        let companion = match companion(path).map(File::open) {
            Some(Err(error)) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            Some(Ok(companion)) => Some(measured(companion)?),
            _ => None,
        };
        Ok(Self { file, length, companion, position: 0 })
    }

    fn total(&self) -> u64 {
        self.length + self.companion.as_ref().map_or(0, |(_, length)| *length)
    }
}

impl Read for Joined {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = match &mut self.companion {
            Some((companion, _)) if self.position >= self.length => companion.read(buffer)?,
            Some((companion, _)) => {
                let here = buffer.len().min((self.length - self.position) as usize);
                companion.seek(SeekFrom::Start(0))?;
                self.file.read(&mut buffer[..here])?
            }
            None => self.file.read(buffer)?,
        };
        self.position += count as u64;
        Ok(count)
    }
}

impl Seek for Joined {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(offset) => self.total().checked_add_signed(offset),
            SeekFrom::Current(offset) => self.position.checked_add_signed(offset),
        };
        self.position = position.ok_or(io::ErrorKind::InvalidInput)?;
        self.file.seek(SeekFrom::Start(self.position.min(self.length)))?;
        if let Some((companion, _)) = &mut self.companion {
            companion.seek(SeekFrom::Start(self.position.saturating_sub(self.length)))?;
        }
        Ok(self.position)
    }
}

/// A file, or bytes in memory, of known length.
pub struct Source<F> {
    file: F,
    /// Length of the file itself.
    length: u64,
    /// The same with its companion.
    total: u64,
    extension: String,
}

/// A file as a reader sees it.
pub trait Input {
    /// Length in bytes.
    fn length(&self) -> u64;
    /// Where the bytes of its companion lie, if it has one: behind its own.
    fn companion(&self) -> Option<Range<u64>>;
    /// The bytes of a stretch, which must lie within the file, or within its companion.
    ///
    /// # Errors
    /// When it does not, or cannot be read.
    fn bytes(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError>;
    /// Everything from the start, without the companion.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError>;
    /// The file itself, for a library that reads it.
    fn file(&mut self) -> &mut dyn ReadSeek;
}

impl Source<Joined> {
    /// Of a file on disk, with its companion if that is beside it.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let file = Joined::open(path)?;
        Ok(Self { length: file.length, total: file.total(), file, extension: extension(path) })
    }

    /// Length in bytes, with that of its companion.
    #[must_use]
    pub fn total(&self) -> usize {
        self.total as usize
    }

    /// The same, whole in memory: in `bytes`, which are empty.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn load(mut self, mut bytes: Vec<u8>) -> Result<Source<Cursor<Vec<u8>>>, FormatError> {
        self.file.seek(SeekFrom::Start(0))?;
        // File by file: what is not asked of a file of the system itself is set to zero before it is read.
        self.file.file.read_to_end(&mut bytes)?;
        let length = bytes.len() as u64;
        if let Some((companion, _)) = &mut self.file.companion {
            companion.seek(SeekFrom::Start(0))?;
            companion.read_to_end(&mut bytes)?;
        }
        let total = bytes.len() as u64;
        Ok(Source { file: Cursor::new(bytes), length, total, extension: self.extension })
    }
}

/// Extension of a file's name, in lower case.
fn extension(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
}

impl<F: Read + Seek> Source<F> {
    /// Of bytes that stand for a file of this name, which gives the extension.
    ///
    /// # Errors
    /// When their number cannot be found out.
    pub fn new(mut file: F, path: &Path) -> Result<Self, FormatError> {
        let length = file.seek(SeekFrom::End(0))?;
        Ok(Self { file, length, total: length, extension: extension(path) })
    }

    /// The same with a companion's bytes, from `length` on.
    ///
    /// # Errors
    /// When the number of bytes cannot be found out.
    pub fn with_companion(file: F, length: u64, path: &Path) -> Result<Self, FormatError> {
        let whole = Self::new(file, path)?;
        Ok(Self { length: length.min(whole.total), ..whole })
    }

    /// Extension of the file's name, in lower case.
    #[must_use]
    pub fn extension(&self) -> &str {
        &self.extension
    }

    /// The first bytes, up to `count`.
    pub(super) fn head(&mut self, count: usize) -> Result<Vec<u8>, FormatError> {
        self.bytes("the head", 0, self.length.min(count as u64))
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

    fn companion(&self) -> Option<Range<u64>> {
        (self.total > self.length).then_some(self.length..self.total)
    }

    fn bytes(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        let length = if byte_offset < self.length { self.length } else { self.total };
        if byte_offset.checked_add(count).is_none_or(|end| end > length) {
            return Err(FormatError::Truncated { what, byte_offset, needed: count, length });
        }
        let mut bytes = vec![0; count as usize];
        self.file.seek(SeekFrom::Start(byte_offset))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError> {
        self.file.seek(SeekFrom::Start(0))?;
        Ok(Box::new((&mut self.file).take(self.length)))
    }

    fn file(&mut self) -> &mut dyn ReadSeek {
        &mut self.file
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
