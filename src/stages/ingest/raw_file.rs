//! A raw file with its companion: whole in memory, or read in pieces; hashed as it is read in order.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_buffer::Buffer;

use super::blocks::Blocks;
use super::survey::{Job, Surveyed};
use crate::campaign::tree_hash::{StretchHasher, Subtree};
use crate::campaign::{ManifestError, hash_file};
use crate::formats::companions::companion;
use crate::formats::{self, FormatError, Joined, Remark, Source};
use crate::stages::stage::{Rejection, StageError};
use crate::store::disk;
use crate::tables::traces::Place;
use crate::tables::{Codes, Name};
use crate::waveform::{Payload, Record};

/// Bytes that are read at once where only a part of a record counts; smaller records are read whole, with their
/// neighbours.
const PIECE_BYTES: usize = 1 << 20;

/// A file that was hashed: its name, its digest, and its size and times from before it was read.
pub struct Hashed {
    pub file: PathBuf,
    pub digest: blake3::Hash,
    pub metadata: Metadata,
}

/// A file with a stretch that was hashed: its name, the subtrees of its hash, and its size and times from before it was
/// read.
pub struct HashedStretch {
    pub file: PathBuf,
    pub subtrees: Vec<Subtree>,
    pub metadata: Metadata,
}

/// How a file is read, and which of its bytes are hashed.
#[derive(Clone, Copy)]
pub enum Reading<'a> {
    /// Whole, in memory; all of it is hashed.
    Whole,
    /// In pieces; all of it is hashed.
    Long,
    /// In pieces; these bytes of each file are hashed.
    Stretch(&'a BTreeMap<PathBuf, Range<u64>>),
    /// In pieces; nothing is hashed.
    Unhashed,
}

/// The hash under way, and how far it has come.
enum Hashing {
    Whole(blake3::Hasher, u64),
    Stretch(StretchHasher),
    Nothing,
}

impl Hashing {
    /// Which bytes are still to be hashed.
    fn left(&self, length: u64) -> Range<u64> {
        match self {
            Self::Whole(_, at) => *at..length,
            Self::Stretch(stretch) => stretch.at()..stretch.end(),
            Self::Nothing => length..length,
        }
    }

    /// Takes a stretch of the file; what is not the next to be hashed does not count.
    fn take(&mut self, start: u64, bytes: &[u8]) {
        let (at, end) = (self.left(u64::MAX).start, start + bytes.len() as u64);
        if start > at || end <= at {
            return;
        }
        let new = &bytes[(at - start) as usize..];
        match self {
            Self::Whole(hasher, at) => {
                hasher.update(new);
                *at = end;
            }
            Self::Stretch(stretch) => stretch.update(new),
            Self::Nothing => {}
        }
    }
}

/// Why an item is not used.
#[derive(Clone)]
pub struct Bad {
    pub file: PathBuf,
    pub segment: Option<i32>,
    pub byte_offset: Option<i64>,
    pub reason: String,
    /// The system could not read the file. That says nothing about its content, and may be over at the next try.
    pub is_unreadable: bool,
}

impl Bad {
    /// The rejection of an item for its content.
    ///
    /// # Errors
    /// When the file could not be read: a rejection would count as long as the content is the same.
    pub fn rejection(self, surveyed: &Surveyed<'_>, job: &Job<'_>) -> Result<Rejection, StageError> {
        if self.is_unreadable {
            let path = surveyed.campaigns[job.capture.campaign].path_of(&self.file);
            let (path, reason) = (path.display(), self.reason);
            return Err(StageError::Refused(format!(
                "{path}: cannot be read; check that it exists, and its permissions: {reason}"
            )));
        }
        Ok(Rejection {
            campaign: surveyed.campaigns[job.capture.campaign].name.as_str().into(),
            file: Some(self.file.to_string_lossy().as_ref().into()),
            segment: self.segment,
            byte_offset: self.byte_offset,
            reason: self.reason,
        })
    }
}

/// Whether the system could not read a file; that it ends too early is its content.
fn is_unreadable(error: &FormatError) -> bool {
    matches!(error, FormatError::Io(error) if error.kind() != io::ErrorKind::UnexpectedEof)
}

/// A raw file.
pub struct RawFile {
    pub name: PathBuf,
    /// The same, as the rows have it.
    pub text: Name,
    pub records: Vec<Record>,
    /// The file next to it with its samples, if it has one.
    companion: Option<Name>,
    /// What is to be said about the file, though its records can be used.
    remarks: Vec<Remark>,
    bytes: Bytes,
    blocks: Arc<Blocks>,
    metadata: Metadata,
    /// Of the file alone; nothing where it has a companion: then both are hashed at the end.
    hashing: Hashing,
    /// Files that are not hashed on the way, with size and times from before they were read.
    to_hash: Vec<(PathBuf, PathBuf, Metadata)>,
}

enum Bytes {
    Memory(Buffer),
    Disk(Joined),
}

impl RawFile {
    pub fn open(surveyed: &Surveyed<'_>, job: &Job<'_>, name: &Path, reading: Reading<'_>) -> Result<Self, Bad> {
        let campaign = job.capture.campaign;
        let path_of = |name: &Path| surveyed.campaigns[campaign].path_of(name);
        let io = |error: io::Error| Bad {
            file: name.to_owned(),
            segment: None,
            byte_offset: None,
            reason: error.to_string(),
            is_unreadable: true,
        };
        let format = |error: FormatError| Bad {
            file: name.to_owned(),
            segment: None,
            byte_offset: error.byte_offset().map(|at| at as i64),
            reason: error.to_string(),
            is_unreadable: is_unreadable(&error),
        };
        let path = path_of(name);
        let metadata = disk::metadata(&path).map_err(io)?;
        let companion = companion(name).filter(|file| job.item.exposure.companions.contains(file));
        let mut to_hash = Vec::new();
        if let Some(companion) = companion.as_ref().filter(|_| !matches!(reading, Reading::Unhashed)) {
            for file in [name, companion.as_path()] {
                to_hash.push((file.to_owned(), path_of(file), disk::metadata(path_of(file)).map_err(io)?));
            }
        }
        let hashing = match reading {
            Reading::Stretch(stretches) => {
                let bytes = &stretches[name];
                Hashing::Stretch(StretchHasher::new(bytes.start, bytes.end))
            }
            Reading::Whole | Reading::Long if companion.is_none() => Hashing::Whole(blake3::Hasher::new(), 0),
            Reading::Whole | Reading::Long | Reading::Unhashed => Hashing::Nothing,
        };
        let source = Source::open(&path).map_err(format)?;
        let mut source = source.described(job.item.exposure.keys.description());
        let blocks = Arc::clone(&surveyed.blocks);
        let (bytes, contents) = if matches!(reading, Reading::Whole) {
            let room = blocks.take(source.total());
            let mut source = source.load(room).map_err(format)?;
            let contents = formats::contents(&mut source);
            (Bytes::Memory(blocks.lend(source.into_inner().into_inner())), contents)
        } else {
            let contents = formats::contents(&mut source);
            (Bytes::Disk(source.into_inner()), contents)
        };
        let formats::Contents { records, remarks } = contents.map_err(format)?;
        let text = |name: &Path| -> Name { name.to_string_lossy().as_ref().into() };
        let (companion, text, name) = (companion.as_deref().map(text), text(name), name.to_owned());
        Ok(Self { name, text, records, companion, remarks, bytes, blocks, metadata, hashing, to_hash })
    }

    /// Whether anything is to be said about the file next to its rows.
    pub fn has_remarks(&self) -> bool {
        !self.remarks.is_empty()
    }

    /// Whether the file ends within one of its records.
    pub fn is_cut(&self) -> bool {
        self.remarks.iter().any(|remark| remark.is_cut)
    }

    /// What is to be said about the file next to its rows.
    pub fn remarks(&self) -> impl Iterator<Item = Bad> {
        let bad =
            |remark: &Remark| Bad { byte_offset: Some(remark.byte_offset as i64), ..self.bad(remark.problem.clone()) };
        self.remarks.iter().map(bad)
    }

    /// Something about this file that keeps it from being used.
    pub fn bad(&self, reason: impl Into<String>) -> Bad {
        Bad { file: self.name.clone(), segment: None, byte_offset: None, reason: reason.into(), is_unreadable: false }
    }

    /// Something about one of its records that keeps the file from being used.
    pub fn bad_record(&self, record: usize, reason: impl Into<String>) -> Bad {
        Bad { segment: self.records[record].segment.map(|segment| segment as i32), ..self.bad(reason) }
    }

    /// The bytes of a stretch of the file.
    fn span(&mut self, range: Range<u64>) -> Result<Buffer, Bad> {
        if let Bytes::Memory(memory) = &self.bytes {
            return Ok(memory.slice_with_length(range.start as usize, (range.end - range.start) as usize));
        }
        let left = self.hashing.left(self.metadata.len());
        if !left.is_empty() && range.start > left.start {
            self.hash_to(range.start.min(left.end))?;
        }
        let bytes = self.read(range.clone())?;
        self.hashing.take(range.start, &bytes);
        Ok(bytes)
    }

    fn read(&mut self, range: Range<u64>) -> Result<Buffer, Bad> {
        let Bytes::Disk(file) = &mut self.bytes else { unreachable!("what is in memory is not read again") };
        let count = (range.end - range.start) as usize;
        let mut bytes = self.blocks.take(count);
        bytes.resize(count, 0);
        let read = file.seek(SeekFrom::Start(range.start)).and_then(|_| file.read_exact(&mut bytes));
        match read {
            Ok(()) => Ok(self.blocks.lend(bytes)),
            Err(error) => {
                let (byte_offset, reason) = (Some(range.start as i64), error.to_string());
                Err(Bad { byte_offset, is_unreadable: is_unreadable(&error.into()), ..self.bad(reason) })
            }
        }
    }

    /// Hashes on to a place in the file.
    fn hash_to(&mut self, end: u64) -> Result<(), Bad> {
        loop {
            let at = self.hashing.left(end).start;
            if at >= end {
                return Ok(());
            }
            let bytes = self.read(at..end.min(at + PIECE_BYTES as u64))?;
            self.hashing.take(at, &bytes);
        }
    }

    /// Hashes what is left to be hashed.
    fn hash_rest(&mut self) -> Result<(), Bad> {
        if let Bytes::Memory(memory) = &self.bytes {
            self.hashing.take(0, memory);
            return Ok(());
        }
        let end = self.hashing.left(self.metadata.len()).end;
        self.hash_to(end)
    }

    /// Digests of all that was read.
    pub fn digests(&mut self) -> Result<Vec<Hashed>, Bad> {
        let mut digests = Vec::new();
        for (file, path, metadata) in &self.to_hash {
            let unreadable = |error: ManifestError| Bad { is_unreadable: true, ..self.bad(error.to_string()) };
            let digest = hash_file(path).map_err(unreadable)?;
            digests.push(Hashed { file: file.clone(), digest, metadata: metadata.clone() });
        }
        self.hash_rest()?;
        if let Hashing::Whole(hasher, _) = &self.hashing {
            let metadata = self.metadata.clone();
            digests.push(Hashed { file: self.name.clone(), digest: hasher.finalize(), metadata });
        }
        Ok(digests)
    }

    /// The stretch that was hashed, where the file was read so.
    pub fn stretch(mut self) -> Result<Option<HashedStretch>, Bad> {
        self.hash_rest()?;
        let Hashing::Stretch(hasher) = self.hashing else { return Ok(None) };
        Ok(Some(HashedStretch { file: self.name, subtrees: hasher.finish(), metadata: self.metadata }))
    }

    /// Bytes of the file, and the place where a record begins; about, where it does not lie there in one run.
    pub fn place(&self, record: usize) -> (u64, u64) {
        let length = self.metadata.len();
        let share = u128::from(length) * record as u128 / self.records.len() as u128;
        (length, self.records[record].contiguous().map_or(share as u64, |(at, _)| at))
    }

    /// Companion and offset in it of a place behind the file's own bytes.
    fn in_companion(&self, byte_offset: u64) -> Option<(&Name, u64)> {
        Some((self.companion.as_ref()?, byte_offset.checked_sub(self.metadata.len())?))
    }

    /// File with the codes of a record.
    pub fn file_of_codes(&self, record: usize) -> Name {
        let in_companion = match self.records[record].payload {
            Payload::File { byte_offset, .. } => self.in_companion(byte_offset),
            _ => None,
        };
        in_companion.map_or(&self.text, |(companion, _)| companion).clone()
    }

    /// Where the codes of a record lie in that file from sample `first` on, if they do as plain numbers.
    pub fn place_of_codes(&self, record: usize, first: u64) -> Option<Place> {
        let Payload::File { byte_offset, stride, big_endian } = self.records[record].payload else { return None };
        let offset = self.in_companion(byte_offset).map_or(byte_offset, |(_, offset)| offset) + first * stride;
        Some(Place { offset_bytes: offset as i64, stride_bytes: stride as i64, big_endian })
    }

    /// Codes of records, little-endian; of the samples `[first, last)` of each, where only those count. Records that
    /// lie one behind the other share one read and one block.
    pub fn codes(&mut self, records: &[usize], samples: Option<[u64; 2]>) -> Result<Vec<Codes>, Bad> {
        let mut codes = Vec::with_capacity(records.len());
        let mut start = 0;
        while start < records.len() {
            let end = self.run(records, start);
            let record = &self.records[records[start]];
            let range = match samples {
                Some([first, last]) if first >= last || last > record.head.samples as u64 => {
                    return Err(self.bad_record(records[start], format!(
                        "has {0} samples; samples = [{first}, {last}] in its [[captures]] rule reaches beyond them: end it at {0}, or take it out",
                        record.head.samples
                    )));
                }
                Some([first, last]) => first as usize..last as usize,
                None => 0..record.head.samples,
            };
            if record.contiguous().is_none() || (samples.is_some() && record.code_bytes() > PIECE_BYTES) {
                for &record in &records[start..end] {
                    codes.push(self.apart(record, range.clone())?);
                }
            } else {
                self.together(&records[start..end], range, &mut codes)?;
            }
            start = end;
        }
        Ok(codes)
    }

    /// End of a run of records that lie one behind the other.
    fn run(&self, records: &[usize], start: usize) -> usize {
        let first = &self.records[records[start]];
        let Some((at, _)) = first.contiguous() else {
            return start + 1;
        };
        let length = first.code_bytes() as u64;
        let follows = |i: usize| {
            let record = &self.records[records[i]];
            record.contiguous().map(|(next, _)| next) == Some(at + (i - start) as u64 * length)
                && record.code_bytes() as u64 == length
        };
        (start + 1..records.len()).find(|&i| !follows(i)).unwrap_or(records.len())
    }

    fn together(&mut self, records: &[usize], samples: Range<usize>, codes: &mut Vec<Codes>) -> Result<(), Bad> {
        let record = &self.records[records[0]];
        let (code_type, length) = (record.head.code_type, record.code_bytes());
        let (at, big_endian) = record.contiguous().expect("asked before");
        let mut block = self.span(at..at + (records.len() * length) as u64)?;
        if big_endian {
            let mut bytes = block.to_vec();
            code_type.swap_bytes(&mut bytes);
            block = Buffer::from_vec(bytes);
        }
        let width = code_type.bytes();
        let piece = |i: usize| Codes::new(&block, i * length + samples.start * width, samples.len() * width);
        codes.extend((0..records.len()).map(piece));
        Ok(())
    }

    fn apart(&mut self, number: usize, samples: Range<usize>) -> Result<Codes, Bad> {
        let record = &self.records[number];
        let read = match &mut self.bytes {
            Bytes::Memory(memory) => record.read(&mut Cursor::new(memory.as_slice()), samples),
            Bytes::Disk(file) => record.read(file, samples),
        };
        let bad = |error: io::Error| {
            let reason = error.to_string();
            Bad { is_unreadable: is_unreadable(&error.into()), ..self.bad_record(number, reason) }
        };
        let block = Buffer::from_vec(read.map_err(bad)?);
        Ok(Codes::new(&block, 0, block.len()))
    }
}
