//! Data sets of one axis: where their numbers are, and how to unpack them.

use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;

use super::super::inflate::{self, Packing, Unpacker, broken};
use super::super::reader::FormatError;
use super::field;
use super::file::{File, Header, UNDEFINED, message, u16_at, u32_at, u64_at};
use super::value::{Number, axes};
use crate::waveform::{CodeType, Payload, ReadSeek, Unpack};

/// Bytes of numbers that are in memory at a time.
const PIECE_BYTES: usize = 1 << 16;
/// Longest value that is read as a whole.
const VALUE_BYTES: u64 = 1 << 12;
/// Deflate's number among the filters.
const DEFLATE: u16 = 1;

/// Numbers of a data set.
pub(super) struct Dataset {
    pub code_type: CodeType,
    pub samples: usize,
    pub payload: Payload,
}

/// Where the data of an object are.
pub(super) enum Layout<'a> {
    Compact(&'a [u8]),
    Contiguous {
        at: u64,
        bytes: u64,
    },
    /// Elements of a chunk on each axis, and bytes of an element.
    Chunked {
        tree: u64,
        chunk: Vec<u64>,
        element: u64,
    },
}

impl<'a> Layout<'a> {
    pub fn read(header: &'a Header) -> Result<Self, FormatError> {
        let layout = header.need(message::LAYOUT, "data layout")?;
        let lost = || field(header.place, "the data layout is cut short; copy the file again");
        match layout {
            [3, 0, rest @ ..] => {
                let size = rest.get(..2).map(|size| usize::from(u16_at(size, 0))).ok_or_else(lost)?;
                Ok(Self::Compact(rest.get(2..2 + size).ok_or_else(lost)?))
            }
            [3, 1, rest @ ..] if rest.len() >= 16 => {
                Ok(Self::Contiguous { at: u64_at(rest, 0), bytes: u64_at(rest, 8) })
            }
            // The size of an element counts as one more axis.
            [3, 2, axes, rest @ ..] if *axes >= 2 && rest.len() >= 8 + 4 * usize::from(*axes) => {
                let last = usize::from(*axes) - 1;
                let length = |axis: usize| u64::from(u32_at(rest, 8 + 4 * axis));
                let chunk = (0..last).map(length).collect();
                Ok(Self::Chunked { tree: u64_at(rest, 0), chunk, element: length(last) })
            }
            [version, class, ..] => {
                let problem = format!(
                    "a data layout of version {version} and class {class} is not read; \
                     rewrite the file with h5repack --low=0"
                );
                Err(field(header.place, problem))
            }
            _ => Err(lost()),
        }
    }
}

impl Dataset {
    /// Reads where the numbers of an object are.
    pub fn read(file: &mut File, header: &Header) -> Result<Self, FormatError> {
        let refuse = |problem: String| field(header.place, problem);
        let number = Number::parse(header.need(message::DATATYPE, "data type")?);
        let Some((number, code_type)) = number.and_then(|number| Some((number, number.code_type()?))) else {
            return Err(refuse(
                "a data set's type is none of the integers up to 32 bits and IEEE numbers; save it as such".to_owned(),
            ));
        };
        let axes = axes(header.need(message::DATASPACE, "data space")?);
        let samples = match axes.as_deref() {
            Some(&[samples]) if samples > 0 => samples,
            _ => {
                return Err(refuse(format!(
                    "a data set with axes {axes:?} is not read, only one axis with samples on it"
                )));
            }
        };
        let bytes = samples.checked_mul(number.bytes() as u64);
        let (Some(bytes), Ok(samples)) = (bytes, usize::try_from(samples)) else {
            return Err(refuse(format!("{samples} samples of a data set are more than any file has")));
        };
        let payload = match Layout::read(header)? {
            Layout::Compact(_) => {
                return Err(refuse(
                    "samples in an object header are not read; rewrite the file with h5repack".to_owned(),
                ));
            }
            Layout::Contiguous { at, bytes: stored } => {
                if at == UNDEFINED || stored != bytes {
                    return Err(refuse(format!(
                        "a data set needs {bytes} bytes, {stored} were written; save the waveform again"
                    )));
                }
                let byte_offset = file.claim(at, bytes)?;
                Payload::File { byte_offset, stride: number.bytes() as u64, big_endian: number.big_endian }
            }
            Layout::Chunked { tree, chunk, element } => {
                let chunk = match chunk[..] {
                    [chunk] if chunk > 0 && element == number.bytes() as u64 => chunk,
                    _ => {
                        return Err(refuse(format!(
                            "chunks of {chunk:?} elements of {element} bytes do not fit the data type"
                        )));
                    }
                };
                let chunk_bytes = chunk * element;
                let chunks = chunks(file, header, tree, chunk, chunk_bytes)?;
                if chunks.len() as u64 != bytes.div_ceil(chunk_bytes) {
                    let problem = format!(
                        "{} of {} chunks were written; save the waveform again",
                        chunks.len(),
                        bytes.div_ceil(chunk_bytes)
                    );
                    return Err(refuse(problem));
                }
                let swapped = number.big_endian.then_some(code_type);
                Payload::Packed(Arc::new(Chunked { chunks, chunk_bytes, bytes, swapped }))
            }
        };
        Ok(Self { code_type, samples, payload })
    }
}

/// The number in a data set that holds one.
pub(super) fn single(file: &mut File, at: u64, name: &str) -> Result<f64, FormatError> {
    let header = file.header(at)?;
    let number = Number::parse(header.need(message::DATATYPE, "data type")?);
    let one =
        axes(header.need(message::DATASPACE, "data space")?).is_some_and(|axes| axes.iter().all(|&length| length == 1));
    let data = value(file, &header)?;
    let number = number.filter(|_| one).and_then(|number| number.value(&data)).filter(|number| number.is_finite());
    number.ok_or_else(|| field(at, format!("{name} is no single finite number; save the waveform again")))
}

/// The data of a small object.
pub(super) fn value(file: &mut File, header: &Header) -> Result<Vec<u8>, FormatError> {
    match Layout::read(header)? {
        Layout::Compact(data) => Ok(data.to_vec()),
        Layout::Contiguous { at, bytes } if bytes <= VALUE_BYTES => file.bytes("a value", at, bytes),
        _ => Err(field(header.place, "a value is longer than is believed; copy the file again")),
    }
}

/// A range of packed samples.
#[derive(Debug)]
struct Chunk {
    at: u64,
    packed: u32,
    packing: Packing,
}

/// The chunks, which must follow one another without a gap.
fn chunks(
    file: &mut File,
    header: &Header,
    tree: u64,
    chunk: u64,
    chunk_bytes: u64,
) -> Result<Vec<Chunk>, FormatError> {
    let deflated = deflated(header)?;
    if tree == UNDEFINED {
        return Ok(Vec::new());
    }
    let (mut chunks, mut wrong) = (Vec::new(), None);
    // A key holds the bytes of the chunk, skipped filters, and the start of the chunk on each axis.
    file.leaves(tree, 1, 24, &mut |key, at| {
        if u64_at(key, 8) != chunks.len() as u64 * chunk {
            wrong.get_or_insert(u64_at(key, 8));
        }
        let packing = if deflated && u32_at(key, 4) & 1 == 0 { Packing::Zlib } else { Packing::Stored };
        chunks.push(Chunk { at, packed: u32_at(key, 0), packing });
    })?;
    if let Some(wrong) = wrong {
        let problem = format!("the chunk of sample {wrong} does not follow the one before it; save the waveform again");
        return Err(field(tree, problem));
    }
    for Chunk { at, packed, packing } in &mut chunks {
        let packed = u64::from(*packed);
        *at = file.claim(*at, packed)?;
        if !inflate::can_hold(packed, chunk_bytes) || *packing == Packing::Stored && packed != chunk_bytes {
            let problem =
                format!("a chunk of {packed} bytes cannot hold the {chunk_bytes} bytes it should; copy the file again");
            return Err(field(*at, problem));
        }
    }
    Ok(chunks)
}

/// Whether chunks are deflated. Any other filter is refused by its number.
pub(super) fn deflated(header: &Header) -> Result<bool, FormatError> {
    let Some(filters) = header.find(message::FILTERS)? else {
        return Ok(false);
    };
    let first = match filters {
        [_, 0, ..] => return Ok(false),
        [1, 1, _, _, _, _, _, _, id, high, ..] | [2, 1, id, high, ..] => u16::from_le_bytes([*id, *high]),
        _ => u16::MAX,
    };
    if first != DEFLATE {
        let problem = "filters other than deflate alone (shuffle, checksum, SZIP, ...) are not read; \
                       rewrite the file with h5repack -f GZIP=6";
        return Err(field(header.place, problem));
    }
    Ok(true)
}

/// Samples in chunks.
#[derive(Debug)]
struct Chunked {
    chunks: Vec<Chunk>,
    chunk_bytes: u64,
    /// Bytes of all samples; the last chunk may extend beyond them.
    bytes: u64,
    /// Type of the codes, if they are big-endian.
    swapped: Option<CodeType>,
}

impl Unpack for Chunked {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let mut piece = vec![0; PIECE_BYTES.min(usize::try_from(self.chunk_bytes).unwrap_or(PIECE_BYTES))];
        let mut left = self.bytes;
        for chunk in &self.chunks {
            let mut unpacker = Unpacker::new(chunk.packing, chunk.at, u64::from(chunk.packed));
            while unpacker.position() < self.chunk_bytes {
                let rest = self.chunk_bytes - unpacker.position();
                let wanted = piece.len().min(usize::try_from(rest).unwrap_or(PIECE_BYTES));
                if unpacker.read(file, &mut piece[..wanted])? < wanted {
                    return Err(broken(format!(
                        "a chunk unpacks to less than {} bytes; copy the file again",
                        self.chunk_bytes
                    )));
                }
                let own = wanted.min(usize::try_from(left).unwrap_or(wanted));
                left -= own as u64;
                // Check before the last samples are passed on: the receiver stops then, and damage would go unnoticed.
                if left == 0 || unpacker.position() == self.chunk_bytes {
                    self.end(&mut unpacker, file)?;
                }
                let codes = &mut piece[..own];
                if let Some(code_type) = self.swapped {
                    code_type.swap_bytes(codes);
                }
                if take(codes)?.is_break() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

impl Chunked {
    /// Unpacks the rest of a chunk: zlib compares the checksum at its end.
    fn end(&self, unpacker: &mut Unpacker, file: &mut dyn ReadSeek) -> io::Result<()> {
        let mut rest = [0; 1 << 12];
        while unpacker.read(file, &mut rest)? == rest.len() {}
        if unpacker.position() == self.chunk_bytes {
            Ok(())
        } else {
            Err(broken(format!(
                "a chunk unpacks to {} bytes, not {}; copy the file again",
                unpacker.position(),
                self.chunk_bytes
            )))
        }
    }
}
