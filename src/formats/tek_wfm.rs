//! Tektronix `.wfm`: `WFM#001`, `WFM#002` and `WFM#003`, either byte order, single records and FastFrame.
//!
//! volts = scale * code + offset of explicit dimension 1. Sample i of a frame is at offset + (TT offset + i) * scale of
//! implicit dimension 1 after the trigger; each frame has its own TT offset, a fraction of a sample. The samples are
//! those from the data start to the postcharge start of a frame's curve. The instrument keeps further samples around
//! them for interpolation, which are not part of the record. A frame whose curve object is all zeros uses that of frame
//! 0. Codes are 8, 16 or 32 bit integers or floats; 64 bit integers are refused, since an f64 cannot hold them.
//!
//! The sum of all bytes follows the curves and is verified. Some files then have a `tekmeta!` trailer, which identifies
//! digital lines and I/Q records (I and Q alternate). A summary frame is the last one, named average or envelope.
//! Waveform databases, pixel maps, histograms and XY records are pictures, not samples in order of time, and are
//! refused by name. The curve object's own checksum and display settings are not read.
//!
//! Source: Tektronix, Performance Oscilloscope Reference Waveform File Format, 077-0220. Tested on real files:
//! `WFM#003` in little-endian order, single, FastFrame and digital. Tested only on files that the tests build: versions
//! 1 and 2, big-endian order, floats, summary frames, envelopes, spectra, I/Q.

mod checksum;
mod encode;
mod frames;
#[cfg(test)]
mod tests;
mod trailer;

use std::sync::Arc;

use checksum::verify;
pub use encode::{FrameHead, write};
use frames::{Frame, Frames};
use trailer::Trailer;

use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

/// The reader.
pub struct TekWfm;

/// Where the blocks of a header begin, which depends on the version.
struct Layout {
    version: u8,
    /// Explicit dimension 1: volts.
    explicit: usize,
    /// Implicit dimension 1: time.
    implicit: usize,
    /// Time base 1.
    time_base: usize,
    /// Update specification of frame 0.
    update: usize,
    /// Curve object of frame 0.
    curve: usize,
    /// End of the header.
    end: usize,
}

/// Version 2 added the summary frame (2 bytes at 154), version 3 wider point densities.
const LAYOUTS: [Layout; 3] = [
    Layout { version: 1, explicit: 166, implicit: 478, time_base: 742, update: 766, curve: 790, end: 820 },
    Layout { version: 2, explicit: 168, implicit: 480, time_base: 744, update: 768, curve: 792, end: 822 },
    Layout { version: 3, explicit: 168, implicit: 488, time_base: 760, update: 784, curve: 808, end: 838 },
];
/// Length of an update specification.
const UPDATE: usize = 24;
/// Length of a curve object.
const CURVE: usize = 30;
/// Length of the checksum.
const CHECKSUM: u64 = 8;
/// Bytes at the start that the byte count does not include.
const UNCOUNTED: u32 = 15;

impl Reader for TekWfm {
    fn format(&self) -> &'static str {
        "tek-wfm"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["wfm"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        mark(head).is_some()
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let header = Header::read(input)?;
        let (code_type, dt_s) = (header.code_type()?, header.dt_s()?);
        let (frames, count, end) = {
            let (frames, buffer) = Frames::read(input, &header, code_type)?;
            let count = frames.count();
            let (frames, end) = frames.list(buffer, input.length(), dt_s)?;
            // Before and after the samples of a frame are those of its interpolation.
            input.uses(buffer..end);
            (frames, count, end)
        };
        if frames.len() < count {
            input.cut_short(end, "frame", frames.len() as u64);
            let problem = "the checksum at the end of the file is lost: the frames before are not verified";
            input.remark(end, problem.to_owned());
            let head = Head { dt_s: Some(dt_s), ..header.head(code_type, &Trailer::default(), &frames[0])? };
            return header.records(head, &frames, count);
        }
        let trailer = Trailer::read(input, end, header.numbers.big_endian)?;
        let head = Head { dt_s: Some(dt_s), ..header.head(code_type, &trailer, &frames[0])? };
        verify(&header.numbers, input, end)?;
        header.records(head, &frames, count)
    }
}

/// Where the `WFM#` of a version begins. Instruments write a colon before it; files without a colon are accepted too.
fn mark(head: &[u8]) -> Option<usize> {
    [2, 3].into_iter().find(|&at| head.get(at..at + 4) == Some(b"WFM#"))
}

fn field(byte_offset: usize, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset: byte_offset as u64, problem: problem.into() }
}

/// The header, and where its fields are.
struct Header {
    numbers: Numbers,
    layout: &'static Layout,
}

impl Header {
    fn read(input: &mut dyn Input) -> Result<Self, FormatError> {
        let start = input.peek("the head", 0, 16.min(input.length()))?;
        let at =
            mark(&start).ok_or_else(|| field(2, "no WFM# mark: this is no Tektronix waveform, or its head is lost"))?;
        let number = start.get(at + 4..at + 7).and_then(|digits| std::str::from_utf8(digits).ok());
        let version = number.and_then(|digits| digits.parse().ok());
        let layout = LAYOUTS.iter().find(|layout| Some(layout.version) == version).ok_or_else(|| {
            let version = String::from_utf8_lossy(&start[at..(at + 7).min(start.len())]).into_owned();
            field(at, format!("version {version:?} is not read, only WFM#001 to WFM#003; export the waveform as CSV"))
        })?;
        let big_endian = match start[..2] {
            [0x0f, 0x0f] => false,
            [0xf0, 0xf0] => true,
            _ => {
                let mark = format!("{:#04x} {:#04x}", start[0], start[1]);
                let problem = format!("byte order mark {mark} is neither 0x0f 0x0f nor 0xf0 0xf0");
                return Err(field(0, format!("{problem}; copy the file from the instrument again")));
            }
        };
        let bytes = input.bytes("the head", 0, layout.end as u64)?;
        Ok(Self { numbers: Numbers { bytes, origin: 0, big_endian }, layout })
    }

    fn code_type(&self) -> Result<CodeType, FormatError> {
        let (at, version) = (self.layout.explicit + 72, self.layout.version);
        let code_type = match (self.numbers.i32(at), version) {
            (0, _) => CodeType::I16,
            (1, _) => CodeType::I32,
            (2, _) => CodeType::U32,
            (4, _) => CodeType::F32,
            (5, _) => CodeType::F64,
            (6, 3) => CodeType::U8,
            (7, 3) => CodeType::I8,
            (3, _) => {
                return Err(field(at, "format UINT64: codes of 64 bits are not read; export the waveform as CSV"));
            }
            (format, _) => {
                let problem = format!("format {format} of the explicit dimension is none of WFM#{version:03}");
                return Err(field(at, format!("{problem}; save the waveform again")));
            }
        };
        let (header_width, width) = (self.numbers.bytes[15], code_type.bytes());
        if usize::from(header_width) != width {
            let problem =
                format!("number of bytes per point = {header_width}, but a code of {} has {width}", code_type.name());
            return Err(field(15, format!("{problem}; save the waveform again")));
        }
        Ok(code_type)
    }

    fn dt_s(&self) -> Result<f64, FormatError> {
        let at = self.layout.implicit;
        let dt_s = self.numbers.finite(at, "scale of the implicit dimension", self.numbers.f64(at))?;
        if dt_s <= 0.0 {
            let problem = format!("scale of the implicit dimension = {dt_s} is not positive: there is no time base");
            return Err(field(at, format!("{problem}; save the waveform again")));
        }
        Ok(dt_s)
    }

    fn kind(&self, trailer: &Trailer) -> Result<Kind, FormatError> {
        let refuse = |at, what: String| {
            let advice = "is no plain record over time; save the channel as a waveform";
            Err(field(at, format!("{what} {advice}")))
        };
        for (at, name) in [(114, "implicit"), (118, "explicit")] {
            let count = self.numbers.u32(at);
            if count != 1 {
                return refuse(at, format!("{name} dimension count = {count} (XY, waveform database or pixel map)"));
            }
        }
        let (data_type, storage_at) = (self.numbers.i32(122), self.layout.explicit + 76);
        let storage = self.numbers.i32(storage_at);
        if data_type == 6 || trailer.digital {
            return Ok(Kind::Digital);
        }
        if data_type != 2 {
            return refuse(122, format!("data type {data_type} (a scalar, a pixel map or a waveform database)"));
        }
        if trailer.iq {
            return Ok(Kind::Iq);
        }
        if !(0..=1).contains(&storage) {
            return refuse(storage_at, format!("storage type {storage} (a histogram or a pixel map)"));
        }
        let unit_at = self.layout.implicit + 20;
        let unit = self.numbers.text(unit_at, 20);
        let spectral = (1..=2).contains(&self.numbers.i32(self.layout.time_base + 8));
        match unit.as_deref() {
            Some("Hz") => Ok(Kind::Spectrum),
            _ if spectral => Ok(Kind::Spectrum),
            None | Some("s" | "S") if storage == 1 => Ok(Kind::Envelope),
            None | Some("s" | "S") => Ok(Kind::Waveform),
            Some(unit) => refuse(unit_at, format!("a record over {unit:?}")),
        }
    }

    fn head(&self, code_type: CodeType, trailer: &Trailer, first: &Frame) -> Result<Head, FormatError> {
        let at = self.layout.explicit;
        let gain = self.numbers.finite(at, "scale of the explicit dimension", self.numbers.f64(at))?;
        let offset = self.numbers.finite(at + 8, "offset of the explicit dimension", self.numbers.f64(at + 8))?;
        if gain == 0.0 {
            return Err(field(at, "scale of the explicit dimension = 0 gives no volts; save the waveform again"));
        }
        let kind = self.kind(trailer)?;
        let unit = self.numbers.text(at + 20, 20);
        let logic = (kind == Kind::Digital).then(|| "logic".to_owned());
        Ok(Head {
            kind,
            channel: self.numbers.text(40, 32).or_else(|| trailer.label.clone()),
            unit: unit.or(logic),
            scale: Some(Scale { gain, offset }),
            header_gain: Some(gain),
            header_offset: Some(offset),
            rails: if kind == Kind::Digital { None } else { self.rails(code_type) },
            acquired_at: first.acquired_at(),
            ..Head::new(TekWfm.format(), code_type, first.samples)
        })
    }

    /// Lowest and highest code. For 8 bit converters they are those of the type; for others the header gives them,
    /// though most instruments leave zero there.
    fn rails(&self, code_type: CodeType) -> Option<(f64, f64)> {
        let (high, low) = (self.layout.explicit + 92, self.layout.explicit + 96);
        match code_type {
            CodeType::I8 | CodeType::U8 => code_type.limits(),
            CodeType::I16 => {
                let (low, high) = (self.numbers.i16(low), self.numbers.i16(high));
                (low < high).then(|| (f64::from(low), f64::from(high)))
            }
            _ => None,
        }
    }

    fn records(&self, head: Head, frames: &[Frame], count: usize) -> Result<Vec<Record>, FormatError> {
        let several = count > 1;
        let summary = match self.layout.version {
            1 => 0,
            _ if several => self.numbers.u16(154),
            _ => 0,
        };
        let stride = head.code_type.bytes() as u64;
        let summary = match summary {
            0 => None,
            1 => Some(Arc::new(Head { kind: Kind::Average, ..head.clone() })),
            2 => Some(Arc::new(Head { kind: Kind::Envelope, ..head.clone() })),
            other => return Err(field(154, format!("summary frame type {other} is none; save the waveform again"))),
        };
        let (head, last, first_s) = (Arc::new(head), count - 1, frames[0].trigger);
        let record = |(i, frame): (usize, &Frame)| {
            let summary = summary.as_ref().filter(|_| i == last);
            let stamped = several && summary.is_none() && first_s.0 > 0 && frame.trigger.0 > 0;
            Record {
                head: Arc::clone(summary.unwrap_or(&head)),
                segment: several.then_some(i as u32),
                t0_s: Some(frame.t0_s),
                // Seconds and fractions are subtracted separately: an f64 cannot hold the picoseconds of a date.
                trigger_s: stamped
                    .then(|| f64::from(frame.trigger.0) - f64::from(first_s.0) + (frame.trigger.1 - first_s.1)),
                payload: Payload::File { byte_offset: frame.byte_offset, stride, big_endian: self.numbers.big_endian },
            }
        };
        Ok(frames.iter().enumerate().map(record).collect())
    }
}
