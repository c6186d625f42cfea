//! The frames of a file: where their samples are, and when each was triggered.

use super::{CURVE, Header, UPDATE, field};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};
use crate::waveform::CodeType;

/// What differs from frame to frame.
pub(super) struct Frame {
    pub(super) t0_s: f64,
    /// GMT second of its trigger, and the fraction of that second.
    pub(super) trigger: (i32, f64),
    /// Where its samples begin.
    pub(super) byte_offset: u64,
    pub(super) samples: usize,
}

impl Frame {
    /// When it was triggered.
    pub(super) fn acquired_at(&self) -> Option<String> {
        acquired_at(self.trigger)
    }
}

/// Converts GMT seconds since 1970 and a fraction of a second to ISO 8601; `None` where they are not set.
pub(super) fn acquired_at((seconds, fraction): (i32, f64)) -> Option<String> {
    let seconds = u32::try_from(seconds).ok().filter(|&seconds| seconds > 0 && (0.0..1.0).contains(&fraction))?;
    let leap = |year: u32| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let (mut days, mut year, mut month) = (seconds / 86_400, 1970, 0);
    while days >= 365 + u32::from(leap(year)) {
        days -= 365 + u32::from(leap(year));
        year += 1;
    }
    let months = [31, 28 + u32::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    while days >= months[month] {
        days -= months[month];
        month += 1;
    }
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let picoseconds = (fraction * 1e12) as u64;
    Some(format!("{year:04}-{:02}-{:02}T{hour:02}:{minute:02}:{second:02}.{picoseconds:012}Z", month + 1, days + 1))
}

/// Offsets of a curve object: start and end of the samples in its buffer, and the end of the buffer.
#[derive(Clone, Copy)]
struct Curve {
    start: u64,
    stop: u64,
    end: u64,
}

impl Curve {
    fn read(numbers: &Numbers, at: usize, width: u64) -> Result<Self, FormatError> {
        let offset = |at| u64::from(numbers.u32(at));
        let curve = Self { start: offset(at + 14), stop: offset(at + 18), end: offset(at + 26) };
        let Self { start, stop, end } = curve;
        if start >= stop || stop > end || !(stop - start).is_multiple_of(width) {
            let samples = format!("data start offset {start} and postcharge start offset {stop}");
            let problem = format!("{samples} are no samples of {width} bytes in a curve buffer of {end}");
            return Err(numbers.refuse(at + 14, format!("{problem}; save the waveform again")));
        }
        Ok(curve)
    }
}

/// All frames of a file.
pub(super) struct Frames<'a> {
    header: &'a Header,
    /// Update specifications of all frames but the first, then their curve objects.
    tables: Numbers,
    first: Curve,
    code_type: CodeType,
}

impl<'a> Frames<'a> {
    /// Reads the tables of all frames. It first refuses more frames than the file can hold.
    pub(super) fn read(
        input: &mut dyn Input,
        header: &'a Header,
        code_type: CodeType,
    ) -> Result<(Self, u64), FormatError> {
        let (numbers, origin, length) = (&header.numbers, header.layout.end, input.length());
        let more = u64::from(numbers.u32(72));
        let (tables, buffer_offset) = (more * (UPDATE + CURVE) as u64, numbers.i32(16));
        let buffer = u64::try_from(buffer_offset).ok().filter(|&buffer| buffer >= origin as u64).ok_or_else(|| {
            let problem =
                format!("byte offset of the curve buffer = {buffer_offset} lies within the head of {origin} bytes");
            field(16, format!("{problem}; save the waveform again"))
        })?;
        if buffer - (origin as u64) < tables {
            let frames = format!("number of FastFrames minus one = {more}: that many have {tables} bytes of head");
            let problem = format!("{frames}, but the curve buffer begins after {}", buffer - origin as u64);
            return Err(field(72, format!("{problem}; save the waveform again")));
        }
        let first = Curve::read(numbers, header.layout.curve, code_type.bytes() as u64)?;
        if first.end.checked_add(buffer).is_none_or(|end| end > length) {
            let needed = first.end.saturating_mul(more + 1);
            return Err(FormatError::Truncated { what: "the curve buffer", byte_offset: buffer, needed, length });
        }
        let bytes = input.bytes("the frames' update specifications and curve objects", origin as u64, tables)?;
        let tables = Numbers { bytes, origin: origin as u64, big_endian: numbers.big_endian };
        Ok((Self { header, tables, first, code_type }, buffer))
    }

    /// Returns the frames, and where the last one's curve buffer ends. Of a file that ends within a frame, it returns
    /// the whole ones.
    pub(super) fn list(&self, mut buffer: u64, length: u64, dt_s: f64) -> Result<(Vec<Frame>, u64), FormatError> {
        let at = self.header.layout.implicit + 8;
        let offset_s =
            self.header.numbers.finite(at, "offset of the implicit dimension", self.header.numbers.f64(at))?;
        let more = self.tables.bytes.len() / (UPDATE + CURVE);
        let mut frames = Vec::with_capacity(more + 1);
        for i in 0..=more {
            let curve = self.curve(i, more)?;
            if buffer.checked_add(curve.end).is_none_or(|end| end > length) {
                if i > 0 {
                    break;
                }
                let what = "the curve buffer of a frame";
                return Err(FormatError::Truncated { what, byte_offset: buffer, needed: curve.end, length });
            }
            frames.push(self.frame(i, buffer + curve.start, (offset_s, dt_s))?);
            buffer += curve.end;
        }
        Ok((frames, buffer))
    }

    /// How many frames the file should hold.
    pub(super) fn count(&self) -> usize {
        1 + self.tables.bytes.len() / (UPDATE + CURVE)
    }

    /// Curve object of a frame. Instruments leave it zero where it equals that of frame 0.
    fn curve(&self, i: usize, more: usize) -> Result<Curve, FormatError> {
        let Some(before) = i.checked_sub(1) else { return Ok(self.first) };
        let at = more * UPDATE + before * CURVE;
        if self.tables.bytes[at..at + CURVE].iter().all(|&byte| byte == 0) {
            return Ok(self.first);
        }
        let curve = Curve::read(&self.tables, at, self.code_type.bytes() as u64)?;
        if curve.stop - curve.start != self.first.stop - self.first.start {
            let problem = format!("frame {i} has {} bytes of samples", curve.stop - curve.start);
            let first = format!("frame 0 has {}", self.first.stop - self.first.start);
            return Err(self.tables.refuse(at + 14, format!("{problem}, but {first}; save the waveform again")));
        }
        Ok(curve)
    }

    fn frame(&self, i: usize, byte_offset: u64, (offset_s, dt_s): (f64, f64)) -> Result<Frame, FormatError> {
        let (numbers, at) = match i.checked_sub(1) {
            None => (&self.header.numbers, self.header.layout.update),
            Some(before) => (&self.tables, before * UPDATE),
        };
        let tt_offset = numbers.finite(at + 4, "TT offset", numbers.f64(at + 4))?;
        let fraction_s = numbers.finite(at + 12, "fractional second", numbers.f64(at + 12))?;
        let t0_s = offset_s + tt_offset * dt_s;
        if !t0_s.is_finite() {
            let problem = format!("TT offset = {tt_offset} samples of {dt_s} s gives no time");
            return Err(numbers.refuse(at + 4, format!("{problem}; save the waveform again")));
        }
        let samples = (self.first.stop - self.first.start) / self.code_type.bytes() as u64;
        let samples = usize::try_from(samples).map_err(|_| field(self.header.layout.curve, "too many samples"))?;
        Ok(Frame { t0_s, trigger: (numbers.i32(at + 20), fraction_s), byte_offset, samples })
    }
}
