//! Walks through the waveforms and buffers of a file, in order.

use super::{Maker, date};
use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Kind, Scale};

/// Bytes of the waveform header that are documented; newer ones may be longer.
pub(super) const WAVEFORM: usize = 140;
/// Bytes without the Time Tag and the Segment Index, which default to zero where they are missing.
const WAVEFORM_LEAST: u64 = 128;
/// This many records are always accepted. For more, the file must have at least `RECORD_BYTES` for each: the records
/// must not take more memory than the file, and no real segment is as short.
const RECORDS: u64 = 1000;
/// Least bytes of the file for each record beyond `RECORDS`.
const RECORD_BYTES: u64 = 320;

pub(super) fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// A text field, up to its first zero byte; `None` if it is empty.
fn text(bytes: &[u8]) -> Option<String> {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    let text = String::from_utf8_lossy(&bytes[..end]).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// Where a block of the file begins, and its bytes.
struct Block {
    at: u64,
    bytes: Vec<u8>,
}

impl Block {
    fn read(input: &mut dyn Input, what: &'static str, at: u64, count: u64) -> Result<Self, FormatError> {
        Ok(Self { at, bytes: input.bytes(what, at, count)? })
    }
    fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        self.bytes[at..at + N].try_into().expect("fields lie within their block")
    }
    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.array(at))
    }
    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.array(at))
    }
    fn finite(&self, at: usize, name: &str) -> Result<f64, FormatError> {
        let value = f64::from_le_bytes(self.array(at));
        if value.is_finite() { Ok(value) } else { Err(self.refuse(at, format!("{name} = {value} is no number"))) }
    }
    fn refuse(&self, at: usize, problem: String) -> FormatError {
        field(self.at + at as u64, problem + "; save the file again")
    }
    /// A size that is 64 bits wide in version 03.
    fn size(&self, at: usize, wide: bool) -> u64 {
        if wide { u64::from_le_bytes(self.array(at)) } else { u64::from(self.u32(at)) }
    }
}

/// A buffer of samples: its head, and where the file holds it.
pub(super) struct Trace {
    pub(super) head: Head,
    pub(super) t0_s: Option<f64>,
    pub(super) byte_offset: u64,
    /// Segment Index and Time Tag.
    pub(super) segment: (u32, f64),
}

/// The position in a file while it is read.
pub(super) struct Walk<'a> {
    maker: &'a Maker,
    /// Whether sizes are 64 bits wide.
    wide: bool,
    at: u64,
}

impl<'a> Walk<'a> {
    /// Reads the file header. Returns the walk behind it, the File Size and the Number of Waveforms.
    pub(super) fn start(maker: &'a Maker, input: &mut dyn Input) -> Result<(Self, u64, u32), FormatError> {
        let start = Block::read(input, "the file header", 0, 4)?;
        let wide = match &start.bytes[2..] {
            _ if start.bytes[..2] != maker.cookie => {
                let cookie = String::from_utf8_lossy(&maker.cookie).into_owned();
                let problem = format!("no cookie {cookie}: the head is lost, or the file is of another make");
                return Err(field(0, format!("{problem}; copy it from the instrument again, or export it as CSV")));
            }
            b"01" | b"10" => false,
            b"03" => true,
            version => {
                let version = String::from_utf8_lossy(version).into_owned();
                let problem = format!("version {version:?} is not read, only 01, 03 and 10");
                return Err(field(2, format!("{problem}; export the waveforms as CSV")));
            }
        };
        let bytes = if wide { 16 } else { 12 };
        let header = Block::read(input, "the file header", 0, bytes)?;
        let (file_size, count_at) = (header.size(4, wide), bytes as usize - 4);
        let (count, length) = (header.u32(count_at), input.length());
        let least = u64::from(count).saturating_mul(WAVEFORM_LEAST);
        if count == 0 || least > length {
            let problem = format!("Number of Waveforms = {count} in a file of {length} bytes");
            return Err(header.refuse(count_at, problem));
        }
        Ok((Self { maker, wide, at: bytes }, file_size, count))
    }

    /// Reads all buffers of all waveforms; returns also where the last one ends. Of a file that ends within a
    /// segment it returns the whole ones, and no end.
    pub(super) fn waveforms(
        mut self,
        input: &mut dyn Input,
        count: u32,
    ) -> Result<(Vec<Trace>, Option<u64>), FormatError> {
        let mut traces = Vec::new();
        // Name and index of the previous waveform, and the number of channels so far.
        let (mut before, mut channels) = (None, 0);
        for number in 0..count {
            let at = self.at;
            let (header, buffers) = match self.waveform(input) {
                Err(FormatError::Truncated { .. }) if before.as_ref().is_some_and(|(_, index)| *index > 0) => {
                    input.cut_short(at, "waveform", number.into());
                    return Ok((traces, None));
                }
                read => read?,
            };
            let index = if self.maker.segments { header.u32(136) } else { 0 };
            let label = text(&header.bytes[112..128]);
            if before.as_ref().is_none_or(|(name, last)| *name != label || *last >= index) {
                channels += 1;
            }
            let name = label.clone().unwrap_or_else(|| format!("wf{}", channels - 1));
            before = Some((label, index));
            let tag_s = if self.maker.segments { header.finite(128, "Time Tag")? } else { 0.0 };
            let axis = Axis::read(&header, self.maker, input)?;
            for buffer in buffers {
                let records = traces.len() as u64 + 1;
                if records > RECORDS && records * RECORD_BYTES > input.length() {
                    let problem = format!("{records} waveforms in {} bytes are no recording", input.length());
                    return Err(header.refuse(0, problem));
                }
                let head = buffer.head(&header, self.maker, &axis, &name)?;
                let byte_offset = buffer.byte_offset;
                traces.push(Trace { head, t0_s: Some(axis.origin), byte_offset, segment: (index, tag_s) });
            }
        }
        Ok((traces, Some(self.at)))
    }

    /// Reads a waveform: its header and its buffers.
    fn waveform(&mut self, input: &mut dyn Input) -> Result<(Block, Vec<Buffer>), FormatError> {
        let header = self.header(input)?;
        let count = header.u32(8);
        if count == 0 {
            return Err(header.refuse(8, "Number of Waveform Buffers = 0: nothing was acquired".to_owned()));
        }
        let mut buffers = Vec::new();
        for _ in 0..count {
            buffers.push(self.buffer(input, &header)?);
        }
        Ok((header, buffers))
    }

    fn header(&mut self, input: &mut dyn Input) -> Result<Block, FormatError> {
        let size = Block::read(input, "the waveform header", self.at, 4)?;
        let bytes = u64::from(size.u32(0));
        if bytes < WAVEFORM_LEAST {
            return Err(size.refuse(0, format!("Header Size = {bytes} is less than {WAVEFORM_LEAST}")));
        }
        self.within(input, "the waveform header", bytes)?;
        let mut header = Block::read(input, "the waveform header", self.at, bytes.min(WAVEFORM as u64))?;
        header.bytes.resize(WAVEFORM, 0);
        input.uses(self.at..self.at + bytes);
        self.at += bytes;
        Ok(header)
    }

    fn buffer(&mut self, input: &mut dyn Input, waveform: &Block) -> Result<Buffer, FormatError> {
        let least: u64 = if self.wide { 16 } else { 12 };
        let header = Block::read(input, "the waveform data header", self.at, least)?;
        let (bytes, size) = (u64::from(header.u32(0)), header.size(8, self.wide));
        if bytes < least {
            return Err(header.refuse(0, format!("Waveform Data Header Size = {bytes} is less than {least}")));
        }
        self.within(input, "the waveform data header", bytes)?;
        input.uses(self.at..self.at + bytes);
        self.at += bytes;
        self.within(input, "the waveform buffer", size)?;
        let byte_offset = self.at;
        self.at += size;
        let (what, width) = (header.u16(4), header.u16(6));
        let code_type = match (what, width) {
            (1..=3, 4) => CodeType::F32,
            (5 | 6, 1) => CodeType::U8,
            _ => {
                let problem = format!("Buffer Type {what} of {width} Bytes Per Point holds no samples that are read");
                return Err(header.refuse(4, format!("{problem} (normal, maxima, minima: 4; logic: 1)")));
            }
        };
        let points = waveform.u32(12);
        if points == 0 || u64::from(points) * u64::from(width) != size {
            let problem = format!("Points = {points} of {width} bytes, but Buffer Size = {size}");
            return Err(waveform.refuse(12, problem));
        }
        let samples = usize::try_from(points).map_err(|_| waveform.refuse(12, format!("Points = {points}")))?;
        Ok(Buffer { what, code_type, samples, byte_offset })
    }

    fn within(&self, input: &dyn Input, what: &'static str, needed: u64) -> Result<(), FormatError> {
        let length = input.length();
        if needed > length.saturating_sub(self.at) {
            return Err(FormatError::Truncated { what, byte_offset: self.at, needed, length });
        }
        Ok(())
    }
}

/// The x axis of a waveform.
struct Axis {
    increment: f64,
    origin: f64,
    hertz: bool,
}

impl Axis {
    fn read(header: &Block, maker: &Maker, input: &mut dyn Input) -> Result<Self, FormatError> {
        let (increment, origin) = (header.finite(32, "X Increment")?, header.finite(40, "X Origin")?);
        if increment <= 0.0 {
            return Err(header.refuse(32, format!("X Increment = {increment} is not positive: nothing was acquired")));
        }
        match header.u32(48) {
            unit @ (0 | 2) => {
                if unit == 0 {
                    let problem = "X Units = 0 (unknown): X Increment and X Origin are read as seconds; compare them \
                                   with the instrument's screen";
                    input.remark(header.at + 48, problem.to_owned());
                }
                Ok(Self { increment, origin: maker.origin_sign * origin, hertz: false })
            }
            6 => Ok(Self { increment, origin, hertz: true }),
            unit => {
                let unit = unit_name(unit).unwrap_or("an unknown unit");
                Err(header.refuse(48, format!("X Units: a record over {unit} is neither over seconds nor over Hz")))
            }
        }
    }
}

/// Name of a unit of the X or Y axis.
const fn unit_name(code: u32) -> Option<&'static str> {
    match code {
        0 => Some("?"),
        1 => Some("V"),
        2 => Some("s"),
        4 => Some("A"),
        5 => Some("dB"),
        6 => Some("Hz"),
        _ => None,
    }
}

/// A buffer of a waveform.
struct Buffer {
    /// Buffer Type: 1 normal, 2 maxima, 3 minima, 5 or 6 logic.
    what: u16,
    code_type: CodeType,
    samples: usize,
    byte_offset: u64,
}

impl Buffer {
    fn head(&self, header: &Block, maker: &Maker, axis: &Axis, name: &str) -> Result<Head, FormatError> {
        let kind = match (header.u32(4), self.what) {
            (4 | 5 | 7.., _) => {
                let problem = format!("Waveform Type {} is a histogram or unknown, no record over time", header.u32(4));
                return Err(header.refuse(4, problem));
            }
            (6, _) | (_, 5..) => Kind::Digital,
            _ if axis.hertz => Kind::Spectrum,
            (2, _) | (_, 2..) => Kind::Envelope,
            (3, _) => Kind::Average,
            _ => Kind::Waveform,
        };
        let suffix = match self.what {
            2 => " max",
            3 => " min",
            _ => "",
        };
        let (date, time) = (text(&header.bytes[56..72]), text(&header.bytes[72..88]));
        let frame = text(&header.bytes[88..112]);
        Ok(Head {
            kind,
            instrument: frame.and_then(|frame| frame.split(':').next().map(|model| model.trim().to_owned())),
            channel: Some(format!("{name}{suffix}")),
            unit: unit_name(header.u32(52)).map(str::to_owned),
            dt_s: Some(axis.increment),
            scale: Some(Scale { gain: 1.0, offset: 0.0 }),
            acquired_at: date.zip(time).and_then(|(date, time)| date::acquired_at(&date, &time)),
            ..Head::new(maker.format, self.code_type, self.samples)
        })
    }
}
