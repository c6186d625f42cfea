//! The interface of a format reader, and the errors of a file.

use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

use thiserror::Error;

use crate::accounting::{Ledger, Remark};
use crate::companions::companion;
use crate::description::{Description, Key, Misfit};
use crate::waveform::{ReadSeek, Record};

/// What is wrong with a file. The caller who opened the file adds its name.
#[derive(Debug, Error)]
pub enum FormatError {
    /// The system cannot read it.
    #[error("cannot be read: {0}")]
    Io(io::Error),
    /// It has no bytes.
    #[error("is empty: the capture may have been interrupted")]
    Empty,
    /// No reader recognises it.
    #[error(
        "is in no format that is read; export it from the instrument as CSV, or see docs/formats.md for the formats that are"
    )]
    Unknown,
    /// It is known what it is, and that it is not read.
    #[error("is {what}, which is not read; {fix}")]
    NotRead {
        /// What it is.
        what: &'static str,
        /// What to do.
        fix: &'static str,
    },
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
    /// A field of the header has an impossible value.
    #[error("byte {byte_offset}: {problem}")]
    Field {
        /// Where the field begins.
        byte_offset: u64,
        /// What is wrong, and the fix where there is one.
        problem: String,
    },
    /// What the caller says about it does not fit.
    #[error(transparent)]
    Description(#[from] Misfit),
    /// A line of text cannot be parsed.
    #[error("line {line}: {problem}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// What is wrong, and the fix where there is one.
        problem: String,
    },
}

/// The text already includes the source of the error, so that `source()` must not repeat it.
impl From<io::Error> for FormatError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl FormatError {
    /// Where in the file the problem is, if it is in one place.
    #[must_use]
    pub fn byte_offset(&self) -> Option<u64> {
        match self {
            Self::Truncated { byte_offset, .. } | Self::Field { byte_offset, .. } => Some(*byte_offset),
            _ => None,
        }
    }
}

/// A file followed by the bytes of its companion, if it has one.
pub struct Joined {
    file: File,
    length: u64,
    companion: Option<(File, u64)>,
    position: u64,
}

impl Joined {
    fn open(path: &Path) -> io::Result<Self> {
        let kind = path.metadata()?.file_type();
        if !kind.is_file() && !kind.is_dir() {
            // Opening a pipe would wait for whoever writes into it.
            return Err(io::Error::other("is a pipe or a device; copy what it holds to a file"));
        }
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
    /// Length of the file and its companion.
    total: u64,
    extension: String,
    description: Description,
    ledger: Ledger,
}

/// A file as a format reader sees it.
pub trait Input {
    /// Length in bytes.
    fn length(&self) -> u64;
    /// Where the bytes of its companion begin and end, if it has one: after its own bytes.
    fn companion(&self) -> Option<Range<u64>>;
    /// Returns `count` bytes from `byte_offset` on, for a look at what they may be. The range must be within the file,
    /// or within its companion.
    ///
    /// # Errors
    /// When the range is outside, or cannot be read.
    fn peek(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError>;
    /// Returns `count` bytes from `byte_offset` on, and counts them as used.
    ///
    /// # Errors
    /// As [`Self::peek`].
    fn bytes(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        let bytes = self.peek(what, byte_offset, count)?;
        self.uses(byte_offset..byte_offset + count);
        Ok(bytes)
    }
    /// Counts bytes as used: a part that the reader knows and skips, or samples that are packed. Samples of
    /// [`Payload::File`](crate::waveform::Payload::File) need no word; what is counted nowhere is reported.
    fn uses(&mut self, bytes: Range<u64>);
    /// Notes something about the file that its records do not show.
    fn remark(&mut self, byte_offset: u64, problem: String);
    /// Notes that the file ends within a record from `byte_offset` on, after `whole` others, which are read.
    fn cut_short(&mut self, byte_offset: u64, what: &str, whole: u64);
    /// Reads everything from the start, without the companion; counts nothing as used.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError>;
    /// What the caller says about it.
    fn description(&self) -> &Description;
    /// The file itself, for a library that reads it.
    fn file(&mut self) -> &mut dyn ReadSeek;
}

impl Source<Joined> {
    /// Opens a file on disk, with its companion if that is next to it.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let file = Joined::open(path)?;
        let (length, total) = (file.length, file.total());
        let (extension, description, ledger) = (extension(path), Description::default(), Ledger::default());
        Ok(Self { file, length, total, extension, description, ledger })
    }

    /// Length in bytes, companion included.
    #[must_use]
    pub fn total(&self) -> usize {
        self.total as usize
    }

    /// Loads the whole file into `bytes`, which must be empty.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn load(mut self, mut bytes: Vec<u8>) -> Result<Source<Cursor<Vec<u8>>>, FormatError> {
        self.file.seek(SeekFrom::Start(0))?;
        // One file after the other: `read_to_end` on `Joined` would fill the buffer with zeros before each read.
        self.file.file.read_to_end(&mut bytes)?;
        let length = bytes.len() as u64;
        if let Some((companion, _)) = &mut self.file.companion {
            companion.seek(SeekFrom::Start(0))?;
            companion.read_to_end(&mut bytes)?;
        }
        let total = bytes.len() as u64;
        let Self { extension, description, .. } = self;
        Ok(Source { file: Cursor::new(bytes), length, total, extension, description, ledger: Ledger::default() })
    }
}

/// Extension of a file's name, in lower case.
fn extension(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
}

impl<F: Read + Seek> Source<F> {
    /// A source of bytes. The extension of `path` gives the format where the content does not.
    ///
    /// # Errors
    /// When the length of `file` cannot be determined.
    pub fn new(mut file: F, path: &Path) -> Result<Self, FormatError> {
        let length = file.seek(SeekFrom::End(0))?;
        let (extension, description, ledger) = (extension(path), Description::default(), Ledger::default());
        Ok(Self { file, length, total: length, extension, description, ledger })
    }

    /// A source whose bytes from `length` on belong to the companion.
    ///
    /// # Errors
    /// When the length of `file` cannot be determined.
    pub fn with_companion(file: F, length: u64, path: &Path) -> Result<Self, FormatError> {
        let whole = Self::new(file, path)?;
        Ok(Self { length: length.min(whole.total), ..whole })
    }

    /// The same file with what its caller says about it.
    #[must_use]
    pub fn described(self, description: Description) -> Self {
        Self { description, ..self }
    }

    /// Values of all samples of a record of this file: in the unit of its head, or codes where the file has no scale.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn values(&mut self, record: &Record) -> Result<Vec<f64>, FormatError> {
        let codes = record.read(&mut self.file, 0..record.head.samples)?;
        Ok(record.values(&codes))
    }

    /// Extension of the file's name, in lower case.
    #[must_use]
    pub fn extension(&self) -> &str {
        &self.extension
    }

    /// The first bytes, up to `count`.
    pub(super) fn head(&mut self, count: usize) -> Result<Vec<u8>, FormatError> {
        self.peek("the head", 0, self.length.min(count as u64))
    }

    /// What is to be said about the file of these records, after they were read: bytes that its reader did not use, and
    /// the reader's own remarks.
    pub(super) fn remarks(&mut self, records: &[Record]) -> Vec<Remark> {
        std::mem::take(&mut self.ledger).remarks(records, &[0..self.length, self.length..self.total])
    }

    /// The file alone.
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

    fn peek(&mut self, what: &'static str, byte_offset: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        let length = if byte_offset < self.length { self.length } else { self.total };
        if byte_offset.checked_add(count).is_none_or(|end| end > length) {
            return Err(FormatError::Truncated { what, byte_offset, needed: count, length });
        }
        let mut bytes = vec![0; count as usize];
        self.file.seek(SeekFrom::Start(byte_offset))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn uses(&mut self, bytes: Range<u64>) {
        self.ledger.uses(bytes);
    }

    fn remark(&mut self, byte_offset: u64, problem: String) {
        self.ledger.remark(byte_offset, problem);
    }

    fn cut_short(&mut self, byte_offset: u64, what: &str, whole: u64) {
        self.ledger.uses(byte_offset..self.length);
        self.ledger.cut_short(byte_offset, what, whole);
    }

    fn stream(&mut self) -> Result<Box<dyn Read + '_>, FormatError> {
        self.file.seek(SeekFrom::Start(0))?;
        Ok(Box::new((&mut self.file).take(self.length)))
    }

    fn description(&self) -> &Description {
        &self.description
    }

    fn file(&mut self) -> &mut dyn ReadSeek {
        &mut self.file
    }
}

/// One format. A reader checks every length against the file before it allocates. It never panics, whatever the file
/// holds.
pub trait Reader: Sync {
    /// Name of the format.
    fn format(&self) -> &'static str;
    /// Extensions, in lower case, of files that it accepts when their content does not identify a format.
    fn extensions(&self) -> &'static [&'static str];
    /// Whether a file that begins with these bytes has this format.
    fn recognises(&self, head: &[u8]) -> bool;
    /// Keys of a [`Description`] that it has a use for.
    fn keys(&self) -> &'static [Key] {
        &[]
    }
    /// Returns the records of a file.
    ///
    /// # Errors
    /// When anything in the file contradicts the format.
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError>;
}
