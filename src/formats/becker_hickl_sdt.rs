//! Becker & Hickl .sdt: histograms of photons, counted by an SPC module over its time axis.
//!
//! Bin i is at i * dt with dt = tac_r / (tac_g * adc_re): range and gain of the time-to-amplitude converter, and points
//! of its ADC, from the measurement description of the block. The stored axis runs forward in time, although the
//! modules measure from the photon to the next reference pulse. The position of that pulse on the axis depends on
//! cables and delays, so that only differences between channels of one set-up have a meaning.
//!
//! Each curve is a record. A block holds one curve (DECAY) or a set of them (PAGE). Channels are named by module and
//! number of the curve, those of FIFO measurements by their routing channel. Counts are u16, u32 or f64. Each read
//! unpacks compressed blocks and checks their CRC-32 where they have one.
//!
//! Other contents (correlation curves, images, moments: FCS, FIDA, FILDA, MCS, IMG, MOM) are omitted next to curves,
//! and refused by name where they are alone. Refused as well: curves of FIFO measurements before software 8.3, which
//! share one block. Events (.spc) are not read. `acquired_at` is `None` where day and month of the date are ambiguous.
//!
//! Source: SPC_data_file_structure.h, which comes with the vendor's software. Tested on files that the tests build, for
//! which `sdtfile` reads the same counts and times.

use std::sync::Arc;

use self::packed::Packed;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

mod packed;

/// The reader.
pub struct BeckerHicklSdt;

/// Length of the file's header, and of a block's.
const HEADER_BYTES: u64 = 42;
const BLOCK_HEADER_BYTES: u64 = 22;
/// Bytes of a measurement description that are read.
const DESCRIPTION_BYTES: u64 = 309;
/// `header_valid` and `chksum` of the header.
const VALID: u16 = 0x5555;
const CHECKSUM: u16 = 0x55AA;
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
const NUMBERS: u16 = 0xF00;
const COMPRESSED: u16 = 0x1000;
/// Approximate memory of a record with its head, in bytes.
const RECORD_BYTES: u64 = 640;

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
        head.get(32..34) == Some(&VALID.to_le_bytes()) && head.get(40..42) == Some(&CHECKSUM.to_le_bytes())
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let file = File::read(input)?;
        let (mut records, mut left_out) = (Vec::new(), None);
        let mut at = file.first_block;
        for number in 0..file.blocks {
            let block = Block::read(input, &file, at)?;
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
        let (valid, checksum) = (header.u16(32), header.u16(40));
        if valid != VALID || checksum != CHECKSUM {
            let problem = format!("header_valid = {valid:#06x}, chksum = {checksum:#06x}: the file was not completed");
            return Err(header.refuse(32, problem));
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
        if description_bytes < DESCRIPTION_BYTES {
            let problem = format!("meas_desc_block_length = {description_bytes}: such old files are not read");
            return Err(header.refuse(30, problem));
        }
        Ok(Self {
            revision: header.u16(0) & 0xF,
            first_block: header.offset(14, "data_block_offs")?,
            blocks,
            descriptions: header.offset(24, "meas_desc_block_offs")?,
            description_count: header.u16(28),
            description_bytes,
        })
    }
}

/// A block: its header and its measurement description.
struct Block {
    header: Fields,
    description: Fields,
    kind: u16,
    data: u64,
    next: u64,
    length: u64,
}

impl Block {
    fn read(input: &mut dyn Input, file: &File, at: u64) -> Result<Self, FormatError> {
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
        let description = Fields::read(input, "a measurement description", place, DESCRIPTION_BYTES)?;
        let (kind, length) = (header.u16(10), u64::from(header.u32(18)));
        Ok(Self { header, description, kind, data, next, length })
    }

    /// Its content, if it is not curves.
    fn contents(&self) -> Option<&'static str> {
        match self.kind & CONTENTS {
            DECAY if self.is_fifo() && self.kind & NUMBERS == 0 => Some("curves of software before 8.3"),
            DECAY | PAGE => None,
            0x20 => Some("FCS correlations"),
            0x30 => Some("FIDA histograms"),
            0x40 => Some("FILDA histograms"),
            0x50 | 0x70 => Some("MCS histograms"),
            0x60 | 0x80 | 0xA0 => Some("FIFO images"),
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
    fn curves(&self, input: &dyn Input, format: &'static str, records: &mut Vec<Record>) -> Result<(), FormatError> {
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
        let room = (3 * input.length() + (1 << 19)) / RECORD_BYTES;
        if curves.saturating_add(records.len() as u64) > room {
            let problem = format!("block_length: {curves} curves are an image; sum its pixels before it is exported");
            return Err(self.header.refuse(18, problem));
        }
        let packed = self.place(input)?;
        let head = self.head(format, code_type, bins as usize)?;
        records.reserve_exact(curves as usize);
        for curve in 0..curves {
            let payload = match packed {
                Some(packed) => Payload::Packed(Arc::new(packed.part(curve * curve_bytes, curve_bytes, code_type))),
                None => Payload::File {
                    byte_offset: self.data + curve * curve_bytes,
                    stride: code_type.bytes() as u64,
                    big_endian: false,
                },
            };
            let head = Arc::new(Head { channel: Some(self.channel(curve)), ..head.clone() });
            records.push(Record { head, segment: None, t0_s: Some(0.0), trigger_s: None, payload });
        }
        Ok(())
    }

    /// Checks that the data is within the file; returns the archive if the data is compressed.
    fn place(&self, input: &dyn Input) -> Result<Option<Packed>, FormatError> {
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
        let packed = Packed { start: self.data, end, unpacked: self.length };
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

    /// Module and number of a curve, from 1; for FIFO measurements the routing channel, from 0.
    fn channel(&self, curve: u64) -> String {
        let number = self.header.u32(14);
        let module = (number >> 24 & 3) + 1;
        if self.is_fifo() {
            return format!("M{module} routing {}", u64::from(self.description.u16(271)) + curve);
        }
        format!("M{module} curve {}", u64::from(number & 0xFF_FFFF) + curve)
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
