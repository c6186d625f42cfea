//! A raw file with its companion: whole in memory, or read in pieces; hashed as it is read in order.

use std::fs::Metadata;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use arrow::buffer::Buffer;

use super::survey::{Job, Surveyed};
use crate::campaign::companions::companion;
use crate::campaign::hash_file;
use crate::formats::{self, FormatError, Joined, Source};
use crate::stages::stage::Rejection;
use crate::tables::{Codes, Name};
use crate::waveform::Record;

/// Bytes that are read at once where only a part of a record counts; smaller records are read whole, with their neighbours.
const PIECE_BYTES: usize = 1 << 20;

/// A file that was hashed: its name, its digest, and its size and times from before it was read.
pub struct Hashed {
    pub file: PathBuf,
    pub digest: blake3::Hash,
    pub metadata: Metadata,
}

/// Why an item is set aside.
#[derive(Clone)]
pub struct Bad {
    pub file: PathBuf,
    pub segment: Option<i32>,
    pub byte_offset: Option<i64>,
    pub reason: String,
}

impl Bad {
    pub fn rejection(self, surveyed: &Surveyed<'_>, job: &Job<'_>) -> Rejection {
        Rejection {
            campaign: surveyed.campaigns[job.capture.campaign].name.as_str().into(),
            file: Some(self.file.to_string_lossy().as_ref().into()),
            segment: self.segment,
            byte_offset: self.byte_offset,
            reason: self.reason,
        }
    }
}

/// A raw file.
pub struct RawFile {
    pub name: PathBuf,
    /// The same, as the rows have it.
    pub text: Name,
    pub records: Vec<Record>,
    bytes: Bytes,
    metadata: Metadata,
    /// Of the file alone; none where it has a companion: then both are hashed at the end.
    hasher: Option<blake3::Hasher>,
    hashed: u64,
    /// Files that are not hashed on the way, with size and times from before they were read.
    to_hash: Vec<(PathBuf, PathBuf, Metadata)>,
}

enum Bytes {
    Memory(Buffer),
    Disk(Joined),
}

impl RawFile {
    pub fn open(surveyed: &Surveyed<'_>, job: &Job<'_>, name: &Path, whole: bool) -> Result<Self, Bad> {
        let campaign = job.capture.campaign;
        let path_of = |name: &Path| surveyed.campaigns[campaign].path_of(name);
        let io = |error: io::Error| Bad {
            file: name.to_owned(),
            segment: None,
            byte_offset: None,
            reason: error.to_string(),
        };
        let format = |error: FormatError| Bad {
            file: name.to_owned(),
            segment: None,
            byte_offset: error.byte_offset().map(|at| at as i64),
            reason: error.to_string(),
        };
        let path = path_of(name);
        let metadata = std::fs::metadata(&path).map_err(io)?;
        let companion = companion(name).filter(|file| job.item.exposure.companions.contains(file));
        let mut to_hash = Vec::new();
        if let Some(companion) = &companion {
            for file in [name, companion.as_path()] {
                to_hash.push((file.to_owned(), path_of(file), std::fs::metadata(path_of(file)).map_err(io)?));
            }
        }
        let hasher = companion.is_none().then(blake3::Hasher::new);
        let mut source = Source::open(&path).map_err(format)?;
        let (bytes, records) = if whole {
            let mut source = source.load().map_err(format)?;
            let records = formats::records(&mut source);
            (Bytes::Memory(Buffer::from_vec(source.into_inner().into_inner())), records)
        } else {
            let records = formats::records(&mut source);
            (Bytes::Disk(source.into_inner()), records)
        };
        let records = records.map_err(format)?;
        let text = name.to_string_lossy().as_ref().into();
        Ok(Self { name: name.to_owned(), text, records, bytes, metadata, hasher, hashed: 0, to_hash })
    }

    /// Something about this file that keeps it from being used.
    pub fn bad(&self, reason: impl Into<String>) -> Bad {
        Bad { file: self.name.clone(), segment: None, byte_offset: None, reason: reason.into() }
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
        if self.hasher.is_some() && range.start > self.hashed {
            self.hash_to(range.start)?;
        }
        let bytes = self.read(range.clone())?;
        if let Some(hasher) = self.hasher.as_mut().filter(|_| range.start <= self.hashed && range.end > self.hashed) {
            hasher.update(&bytes[(self.hashed - range.start) as usize..]);
            self.hashed = range.end;
        }
        Ok(bytes)
    }

    fn read(&mut self, range: Range<u64>) -> Result<Buffer, Bad> {
        let Bytes::Disk(file) = &mut self.bytes else { unreachable!("what is in memory is not read again") };
        let mut bytes = vec![0; (range.end - range.start) as usize];
        let read = file.seek(SeekFrom::Start(range.start)).and_then(|_| file.read_exact(&mut bytes));
        match read {
            Ok(()) => Ok(Buffer::from_vec(bytes)),
            Err(error) => Err(Bad { byte_offset: Some(range.start as i64), ..self.bad(error.to_string()) }),
        }
    }

    /// Hashes on to a place in the file.
    fn hash_to(&mut self, end: u64) -> Result<(), Bad> {
        while self.hashed < end {
            let next = end.min(self.hashed + PIECE_BYTES as u64);
            self.span(self.hashed..next)?;
        }
        Ok(())
    }

    /// Digests of all that was read.
    pub fn digests(&mut self) -> Result<Vec<Hashed>, Bad> {
        let mut digests = Vec::new();
        for (file, path, metadata) in &self.to_hash {
            let digest = hash_file(path).map_err(|error| self.bad(error.to_string()))?;
            digests.push(Hashed { file: file.clone(), digest, metadata: metadata.clone() });
        }
        if let (Some(hasher), Bytes::Memory(memory)) = (&mut self.hasher, &self.bytes) {
            hasher.update(&memory[self.hashed as usize..]);
            self.hashed = memory.len() as u64;
        } else if self.hasher.is_some() {
            self.hash_to(self.metadata.len())?;
        }
        if let Some(hasher) = &self.hasher {
            let metadata = self.metadata.clone();
            digests.push(Hashed { file: self.name.clone(), digest: hasher.finalize(), metadata });
        }
        Ok(digests)
    }

    /// Codes of records, little-endian; of the samples `[first, last)` of each, where only those count. Records that lie one behind the other share one
    /// read and one block.
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
        let block = Buffer::from_vec(read.map_err(|error| self.bad_record(number, error.to_string()))?);
        Ok(Codes::new(&block, 0, block.len()))
    }
}
