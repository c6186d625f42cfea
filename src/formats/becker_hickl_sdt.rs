//! Becker & Hickl .sdt: histograms of photons, counted by an SPC module over its time axis.
//!
//! Bin i is at i * dt with dt = tac_r / (tac_g * adc_re): range and gain of the time-to-amplitude converter, and points
//! of its ADC, from the measurement description of the block. The stored axis runs forward in time, although the
//! modules measure from the photon to the next reference pulse. The position of that pulse on the axis depends on
//! cables and delays, so that only differences between channels of one set-up have a meaning.
//!
//! Each curve is a record. A block holds one curve (DECAY), a set of them (PAGE) or an image (a PAGE or IMG block of as
//! many curves as pixels). Channels are named by module and number of the curve, those of FIFO measurements by their
//! routing channel. The curves of an image are the segments of one channel, row by row; `shape` is rows and columns.
//! Counts are u16, u32 or f64. Curves of a compressed block are unpacked one after the other; its CRC-32 is checked
//! where it ends.
//!
//! Other contents (correlation curves, moments, images of other than histograms: FCS, FIDA, FILDA, MCS, MOM) are
//! omitted next to curves, and refused by name where they are alone. Refused as well: curves of FIFO measurements
//! before software 8.3, which share one block, and images of many more pixels than the file has bytes for. Measurement
//! descriptions may be short: those of older software end before the routing channel or the size of an image.
//! `acquired_at` is `None` where day and month of the date are ambiguous.
//!
//! Source: SPC_data_file_structure.h, which comes with the vendor's software. Tested on a real FIFO image of an SPC-160
//! (512 x 512 curves, compressed), all of whose counts and times equal those of `sdtfile`; the rest on files that the
//! tests build, for which it reads the same.

use std::sync::{Arc, Mutex};

use self::packed::{Packed, Part};
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

mod packed;

/// The reader.
pub struct BeckerHicklSdt;

/// Length of the file's header, and of a block's.
const HEADER_BYTES: u64 = 42;
const BLOCK_HEADER_BYTES: u64 = 22;
/// Bytes of a measurement description: the least that have a time base, and those that are read where they are.
const DESCRIPTION_LEAST: u64 = 133;
const DESCRIPTION_BYTES: u64 = 325;
/// `header_valid` of the header, and the sum of its 16 bit words, `chksum` included.
const VALID: u16 = 0x5555;
const SUM: u16 = 0x55AA;
/// The revision from which offsets have 40 bits.
const REVISION_LONG_OFFSETS: u16 = 15;
/// Number of blocks that means that another field holds the number.
const MANY_BLOCKS: u16 = 0x7FFF;
/// Bits of a block's type: origin, content, type of its numbers, compression.
const FIFO_DATA: u16 = 8;
const FIFO_DATA_FROM_FILE: u16 = 9;
const CONTENTS: u16 = 0xF0;
const DECAY: u16 = 0x00;
const PAGE: u16 = 0x10;
const IMAGE: u16 = 0x60;
const NUMBERS: u16 = 0xF00;
const COMPRESSED: u16 = 0x1000;
/// Approximate memory of a record with its own head, in bytes.
const RECORD_BYTES: u64 = 640;
/// Bytes of the counters of an `Arc`.
const COUNTERS: usize = 16;

/// Whether the words of the header have the sum that the instrument's software gives them.
fn is_whole(header: &[u8]) -> bool {
    let words = header.chunks_exact(2).map(|word| u16::from_le_bytes([word[0], word[1]]));
    words.fold(0_u16, u16::wrapping_add) == SUM
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// Little-endian numbers from a range of the file.
struct Fields {
    start: u64,
    bytes: Vec<u8>,
}

impl Fields {
    fn read(input: &mut dyn Input, what: &'static str, start: u64, length: u64) -> Result<Self, FormatError> {
        Ok(Self { start, bytes: input.bytes(what, start, length)? })
    }
    fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        self.bytes[at..at + N].try_into().expect("fields lie within what was read")
    }
    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.array(at))
    }
    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.array(at))
    }
    fn offset(&self, at: usize, name: &str) -> Result<u64, FormatError> {
        let offset = self.u32(at).cast_signed();
        u64::try_from(offset).map_err(|_| self.refuse(at, format!("{name} = {offset} is negative")))
    }
    fn text(&self, at: usize, length: usize) -> Option<String> {
        let bytes = self.bytes[at..at + length].split(|byte| *byte == 0).next().unwrap_or_default();
        Some(String::from_utf8_lossy(bytes).trim().to_owned()).filter(|text| !text.is_empty())
    }
    fn refuse(&self, at: usize, problem: impl Into<String>) -> FormatError {
        field(self.start + at as u64, problem)
    }
}

impl Reader for BeckerHicklSdt {
    fn format(&self) -> &'static str {
        "becker-hickl-sdt"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["sdt"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.get(32..34) == Some(&VALID.to_le_bytes()) && head.get(..HEADER_BYTES as usize).is_some_and(is_whole)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let file = File::read(input)?;
        let (mut records, mut left_out) = (Vec::new(), None);
        let mut at = file.first_block;
        let mut description = None;
        for number in 0..file.blocks {
            let block = Block::read(input, &file, at, &mut description)?;
            match block.contents() {
                Some(other) => left_out = Some(other),
                None => block.curves(input, self.format(), &mut records)?,
            }
            let is_last = number + 1 == file.blocks;
            if !is_last && block.next <= at {
                return Err(field(at + 6, format!("next_block_offs = {} does not lead on", block.next)));
            }
            at = block.next;
        }
        match left_out {
            Some(contents) if records.is_empty() => Err(field(
                file.first_block + 10,
                format!("block_type: the file holds {contents} and no decay curve; export the histograms"),
            )),
            _ => Ok(records),
        }
    }
}

/// The fields of the header.
struct File {
    revision: u16,
    first_block: u64,
    blocks: u64,
    descriptions: u64,
    description_count: u16,
    description_bytes: u64,
}

impl File {
    fn read(input: &mut dyn Input) -> Result<Self, FormatError> {
        let header = Fields::read(input, "the header", 0, HEADER_BYTES)?;
        let valid = header.u16(32);
        if valid != VALID {
            return Err(header.refuse(32, format!("header_valid = {valid:#06x}: the file was not completed")));
        }
        if !is_whole(&header.bytes) {
            let problem = "chksum: the words of the header do not add up to 0x55aa; copy the file again";
            return Err(header.refuse(40, problem));
        }
        let blocks = match header.u16(18) {
            MANY_BLOCKS => u64::from(header.u32(34)),
            count => u64::from(count),
        };
        if blocks == 0 || blocks.saturating_mul(BLOCK_HEADER_BYTES) > input.length() {
            let problem =
                format!("no_of_data_blocks = {blocks} is none, or more than the file can hold; copy it again");
            return Err(header.refuse(18, problem));
        }
        let description_bytes = u64::from(header.u16(30));
        if description_bytes < DESCRIPTION_LEAST {
            let problem = format!("meas_desc_block_length = {description_bytes}: such old files are not read");
            return Err(header.refuse(30, problem));
        }
        let file = Self {
            revision: header.u16(0) & 0xF,
            first_block: header.offset(14, "data_block_offs")?,
            blocks,
            descriptions: header.offset(24, "meas_desc_block_offs")?,
            description_count: header.u16(28),
            description_bytes,
        };
        let descriptions = u64::from(file.description_count) * description_bytes;
        for (start, bytes) in [
            (header.offset(2, "info_offs")?, u64::from(header.u16(6))),
            (header.offset(8, "setup_offs")?, u64::from(header.u16(12))),
            (file.descriptions, descriptions),
        ] {
            input.uses(start..(start + bytes).min(input.length()));
        }
        Ok(file)
    }
}

/// A block: its header and its measurement description.
struct Block {
    header: Fields,
    description: Arc<Fields>,
    kind: u16,
    data: u64,
    next: u64,
    length: u64,
}

impl Block {
    /// `last` is the description of the block before: thousands of blocks have the same.
    fn read(input: &mut dyn Input, file: &File, at: u64, last: &mut Option<Arc<Fields>>) -> Result<Self, FormatError> {
        let header = Fields::read(input, "the header of a data block", at, BLOCK_HEADER_BYTES)?;
        let (data, next) = if file.revision >= REVISION_LONG_OFFSETS {
            let long = |low: usize, high: usize| u64::from(header.u32(low)) | u64::from(header.bytes[high]) << 32;
            (long(2, 0), long(6, 1))
        } else {
            (header.offset(2, "data_offs")?, header.offset(6, "next_block_offs")?)
        };
        let number = header.u16(12);
        if number >= file.description_count {
            let problem = format!("meas_desc_block_no = {number}, of {} descriptions", file.description_count);
            return Err(header.refuse(12, problem));
        }
        let place = file.descriptions + u64::from(number) * file.description_bytes;
        let description = if let Some(same) = last.take().filter(|last| last.start == place) {
            same
        } else {
            let known = file.description_bytes.min(DESCRIPTION_BYTES);
            let mut description = Fields::read(input, "a measurement description", place, known)?;
            // Older software does not have the last fields; zeros say so.
            description.bytes.resize(DESCRIPTION_BYTES as usize, 0);
            Arc::new(description)
        };
        *last = Some(Arc::clone(&description));
        let (kind, length) = (header.u16(10), u64::from(header.u32(18)));
        Ok(Self { header, description, kind, data, next, length })
    }

    /// Its content, if it is not curves.
    fn contents(&self) -> Option<&'static str> {
        match self.kind & CONTENTS {
            DECAY if self.is_fifo() && self.kind & NUMBERS == 0 => Some("curves of software before 8.3"),
            DECAY | PAGE | IMAGE => None,
            0x20 => Some("FCS correlations"),
            0x30 => Some("FIDA histograms"),
            0x40 => Some("FILDA histograms"),
            0x50 | 0x70 => Some("MCS histograms"),
            0x80 | 0xA0 | 0xB0 | 0xC0 => Some("FIFO images of other than histograms"),
            0x90 => Some("moments"),
            _ => Some("contents that are not known"),
        }
    }

    fn is_fifo(&self) -> bool {
        [FIFO_DATA, FIFO_DATA_FROM_FILE].contains(&(self.kind & 0xF))
    }

    fn code_type(&self) -> Result<CodeType, FormatError> {
        match self.kind & NUMBERS {
            0 => Ok(CodeType::U16),
            0x100 => Ok(CodeType::U32),
            0x200 => Ok(CodeType::F64),
            other => Err(self.header.refuse(10, format!("block_type: numbers of type {other:#05x} are not known"))),
        }
    }

    /// Appends its curves, one record each.
    fn curves(
        &self,
        input: &mut dyn Input,
        format: &'static str,
        records: &mut Vec<Record>,
    ) -> Result<(), FormatError> {
        let code_type = self.code_type()?;
        let bins = match self.description.u16(82) {
            0 => 65536,
            bins => u64::from(bins),
        };
        let curve_bytes = bins * code_type.bytes() as u64;
        let curves = self.length / curve_bytes;
        if curves == 0 || !self.length.is_multiple_of(curve_bytes) {
            let problem = format!("block_length = {} is no number of curves of adc_re = {bins} bins", self.length);
            return Err(self.header.refuse(18, problem));
        }
        let image = self.image(curves);
        let most = match image {
            Some(_) => (4 * input.length() + (1 << 19)) / (size_of::<Record>() + size_of::<Part>() + COUNTERS) as u64,
            None => (3 * input.length() + (1 << 19)) / RECORD_BYTES,
        };
        if curves.saturating_add(records.len() as u64) > most.min(u64::from(u32::MAX)) {
            let problem = format!(
                "block_length: an image of {curves} curves needs more memory than its file; sum pixels (spatial \
                 binning) before it is exported"
            );
            return Err(self.header.refuse(18, problem));
        }
        let packed = self.place(input, curve_bytes)?.map(Arc::new);
        let head = self.head(format, code_type, bins as usize)?;
        let of_image = image.map(|shape| Arc::new(Head { shape, channel: Some(self.module()), ..head.clone() }));
        records.reserve_exact(curves as usize);
        for curve in 0..curves as u32 {
            let payload = match &packed {
                Some(block) => Payload::Packed(Arc::new(Part { block: Arc::clone(block), curve })),
                None => Payload::File {
                    byte_offset: self.data + u64::from(curve) * curve_bytes,
                    stride: code_type.bytes() as u64,
                    big_endian: false,
                },
            };
            let own = || Arc::new(Head { channel: Some(self.channel(curve.into())), ..head.clone() });
            let (segment, head) = (of_image.is_some().then_some(curve), of_image.clone().unwrap_or_else(own));
            records.push(Record { head, segment, t0_s: Some(0.0), trigger_s: None, payload });
        }
        Ok(())
    }

    /// Rows and columns, if its curves are the pixels of an image.
    fn image(&self, curves: u64) -> Option<Vec<usize>> {
        let length = |at: usize| u64::from(self.description.u32(at));
        // Columns and rows of the scanner, for each routing channel; then those of a FIFO image.
        let sizes = [(173, 177, 181, 185), (309, 313, 317, 321)];
        let shape = sizes.into_iter().find_map(|(x, y, rx, ry)| {
            let (x, y, routed) = (length(x), length(y), length(rx).max(1).checked_mul(length(ry).max(1))?);
            (x.checked_mul(y)?.checked_mul(routed)? == curves).then_some([routed, y, x])
        })?;
        let is_image = curves > 1 && shape[1] * shape[2] > 1;
        is_image.then(|| shape.iter().map(|length| *length as usize).skip(usize::from(shape[0] == 1)).collect())
    }

    /// Checks that the data is within the file; returns the archive if the data is compressed.
    fn place(&self, input: &mut dyn Input, curve_bytes: u64) -> Result<Option<Packed>, FormatError> {
        let (what, byte_offset, length) = ("a data block", self.data, input.length());
        if self.kind & COMPRESSED == 0 {
            return match self.data.checked_add(self.length) {
                Some(end) if end <= length => Ok(None),
                _ => Err(FormatError::Truncated { what, byte_offset, needed: self.length, length }),
            };
        }
        let end = if self.next > self.data { self.next } else { length };
        if end > length || self.data >= end {
            let needed = end.saturating_sub(self.data);
            return Err(FormatError::Truncated { what, byte_offset, needed, length });
        }
        input.uses(self.data..end);
        let packed = Packed { start: self.data, end, unpacked: self.length, curve_bytes, resumed: Mutex::new(None) };
        if packed.is_possible() {
            return Ok(Some(packed));
        }
        let problem = format!("block_length = {} cannot come from {} packed bytes", self.length, end - self.data);
        Err(self.header.refuse(18, problem))
    }

    fn head(&self, format: &'static str, code_type: CodeType, bins: usize) -> Result<Head, FormatError> {
        let range_s = f64::from(f32::from_le_bytes(self.description.array(64)));
        let gain = self.description.u16(68).cast_signed();
        let dt_s = range_s / (f64::from(gain) * bins as f64);
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            let problem = format!("tac_r = {range_s} s and tac_g = {gain} give no time base; save the file again");
            return Err(self.description.refuse(64, problem));
        }
        Ok(Head {
            kind: Kind::Counts,
            instrument: self.description.text(117, 16),
            unit: Some("counts".to_owned()),
            dt_s: Some(dt_s),
            scale: Some(Scale { gain: 1.0, offset: 0.0 }),
            acquired_at: self.acquired_at(),
            ..Head::new(format, code_type, bins)
        })
    }

    /// The module that counted.
    fn module(&self) -> String {
        format!("M{}", (self.header.u32(14) >> 24 & 3) + 1)
    }

    /// Module and number of a curve, from 1; for FIFO measurements the routing channel, from 0.
    fn channel(&self, curve: u64) -> String {
        let (number, module) = (self.header.u32(14), self.module());
        if self.is_fifo() {
            return format!("{module} routing {}", u64::from(self.description.u16(271)) + curve);
        }
        format!("{module} curve {}", u64::from(number & 0xFF_FFFF) + curve)
    }

    fn acquired_at(&self) -> Option<String> {
        let number = |text: &str| text.parse::<u16>().ok();
        let date = self.description.text(9, 11)?;
        let [a, b, year] = date.splitn(3, '-').filter_map(number).collect::<Vec<_>>().try_into().ok()?;
        let (month, day) = match (a, b) {
            (1..=12, 13..=31) => (a, b),
            (13..=31, 1..=12) => (b, a),
            (1..=12, _) if a == b => (a, b),
            _ => return None,
        };
        let time = self.description.text(0, 9)?;
        let [hour, minute, second] = time.splitn(3, ':').filter_map(number).collect::<Vec<_>>().try_into().ok()?;
        let plausible = (1980..2200).contains(&year) && hour < 24 && minute < 60 && second < 61;
        plausible.then(|| format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}"))
    }
}

#[cfg(test)]
mod tests;
