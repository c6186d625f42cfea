//! LeCroy `.trc`, template `LECROY_2_3`: 8 and 16 bit codes, either byte order, with or without the `#9` block prefix.
//! Both single records and sequences are read; each segment of a sequence has its own sub-sample trigger time.
//!
//! Offsets count from the bytes `WAVEDESC`. Source: LeCroy's remote control manual (the template that the instrument
//! prints on `TMPL?`). The older template LECROY_1_0 has a reader of its own. Other templates are refused by name, and
//! so are RIS and dual arrays. Some firmware leaves SUBARRAY_COUNT at 0 in a sequence: the trigger times count then.

use std::io::Write;
use std::sync::Arc;

use super::numbers::{Numbers, text};
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record, Scale};

/// Length of the wave descriptor.
const DESCRIPTOR: u64 = 346;
/// Bytes that are searched for a descriptor, which may follow a block prefix or the text of a query.
const SEARCH_BYTES: u64 = 1024;
/// Bytes of the trigger times of one segment.
pub(super) const TRIGGER_BYTES: u64 = 16;
/// The descriptor's own name.
const MARK: &[u8] = b"WAVEDESC";

/// The reader.
pub struct LecroyTrc;

impl Reader for LecroyTrc {
    fn format(&self) -> &'static str {
        "lecroy-trc"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["trc"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        position(head)
            .is_some_and(|at| !head[at..].get(16..).is_some_and(|template| template.starts_with(b"LECROY_1_0")))
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let head = input.peek("the head", 0, input.length().min(SEARCH_BYTES))?;
        let start = position(&head)
            .ok_or_else(|| field(0, "no WAVEDESC block: this is no LeCroy waveform, or its head is lost"))?;
        before(input, &head[..start]);
        Descriptor::read(input, start as u64)?.records(input, self.format())
    }
}

pub(super) fn position(head: &[u8]) -> Option<usize> {
    head.windows(MARK.len()).take(SEARCH_BYTES as usize).position(|window| window == MARK)
}

/// Counts what stands before the descriptor, if it is the head of a block (`#9...`) or the text of a query.
pub(super) fn before(input: &mut dyn Input, head: &[u8]) {
    if head.iter().all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) {
        input.uses(0..head.len() as u64);
    }
}

/// Counts the end of the line after a block, which transfers over SCPI leave.
pub(super) fn line_end(input: &mut dyn Input, end: u64) -> Result<(), FormatError> {
    let left = input.length().saturating_sub(end);
    if (1..=2).contains(&left) && input.peek("the end", end, left)?.iter().all(|byte| b"\r\n".contains(byte)) {
        input.uses(end..end + left);
    }
    Ok(())
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// The wave descriptor, with its byte order.
struct Descriptor(Numbers);

impl Descriptor {
    fn read(input: &mut dyn Input, start: u64) -> Result<Self, FormatError> {
        let bytes = input.bytes("the wave descriptor", start, DESCRIPTOR)?;
        let template = text(&bytes[16..32]).unwrap_or_default();
        if template != "LECROY_2_3" {
            return Err(field(
                start + 16,
                format!("template {template:?} is not read, only LECROY_2_3; export the trace again in that form"),
            ));
        }
        // COMM_ORDER gives its own byte order: 1 is little-endian, 0 big-endian.
        let big_endian = match [bytes[34], bytes[35]] {
            [1, 0] => false,
            [0, 0] => true,
            [a, b] => {
                return Err(field(
                    start + 34,
                    format!("byte order {a:#04x} {b:#04x} is neither little nor big endian"),
                ));
            }
        };
        Ok(Self(Numbers { bytes, origin: start, big_endian }))
    }

    fn count(&self, at: usize, name: &str) -> Result<u64, FormatError> {
        let count = self.0.i32(at);
        u64::try_from(count).map_err(|_| self.0.refuse(at, format!("{name} = {count} is negative")))
    }

    /// Lengths in bytes of the blocks of the file, in their order.
    fn blocks(&self) -> Result<[u64; 7], FormatError> {
        let mut blocks = [0; 7];
        let names = [
            "WAVE_DESCRIPTOR",
            "USER_TEXT",
            "RES_DESC1",
            "TRIGTIME_ARRAY",
            "RIS_TIME_ARRAY",
            "RES_ARRAY1",
            "WAVE_ARRAY_1",
        ];
        for (i, name) in names.iter().enumerate() {
            blocks[i] = self.count(36 + 4 * i, name)?;
        }
        if blocks[0] < DESCRIPTOR {
            return Err(self.0.refuse(
                36,
                format!("WAVE_DESCRIPTOR = {} is less than the {DESCRIPTOR} bytes that it has", blocks[0]),
            ));
        }
        if blocks[4] > 0 {
            return Err(self.0.refuse(
                52,
                "RIS_TIME_ARRAY: samples interleaved from several triggers are not read; record in real time",
            ));
        }
        if self.count(64, "WAVE_ARRAY_2")? > 0 {
            return Err(self.0.refuse(64, "a second data array (complex or extrema) is no plain voltage over time"));
        }
        Ok(blocks)
    }

    fn records(&self, input: &mut dyn Input, format: &'static str) -> Result<Vec<Record>, FormatError> {
        let code_type = match self.0.i16(32) {
            0 => CodeType::I8,
            1 => CodeType::I16,
            other => {
                return Err(self.0.refuse(32, format!("COMM_TYPE {other} is neither 8 nor 16 bit")));
            }
        };
        let blocks = self.blocks()?;
        let data = self.0.origin + blocks[..6].iter().sum::<u64>();
        let count = self.count(116, "WAVE_ARRAY_COUNT")?;
        let segments = self.segments(input, blocks, count)?;
        if count * code_type.bytes() as u64 != blocks[6] {
            return Err(self.0.refuse(
                116,
                format!("WAVE_ARRAY_COUNT = {count} does not fit the {} bytes of WAVE_ARRAY_1", blocks[6]),
            ));
        }
        if count == 0 || !count.is_multiple_of(segments) {
            return Err(self.0.refuse(
                144,
                format!("{count} points are no whole number of samples for each of {segments} segments"),
            ));
        }
        let segment_bytes = blocks[6] / segments;
        let whole = input.length().saturating_sub(data) / segment_bytes;
        if whole < segments && segments > 1 && whole > 0 {
            input.cut_short(data + whole * segment_bytes, "segment", whole);
        } else if whole < segments {
            return Err(FormatError::Truncated {
                what: "WAVE_ARRAY_1",
                byte_offset: data,
                needed: blocks[6],
                length: input.length(),
            });
        }
        input.uses(self.0.origin..data);
        line_end(input, data + blocks[6])?;
        let head = Arc::new(self.head(code_type, (count / segments) as usize, format)?);
        let triggers = self.triggers(input, blocks, segments)?;
        let record = |(i, (trigger_s, t0_s)): (usize, (Option<f64>, f64))| Record {
            head: Arc::clone(&head),
            segment: (segments > 1).then_some(i as u32),
            t0_s: Some(t0_s),
            trigger_s,
            payload: Payload::File {
                byte_offset: data + i as u64 * segment_bytes,
                stride: code_type.bytes() as u64,
                big_endian: self.0.big_endian,
            },
        };
        Ok(triggers.into_iter().take(whole as usize).enumerate().map(record).collect())
    }

    /// The number of segments: `SUBARRAY_COUNT`, or, where that is 0, one for each trigger time.
    fn segments(&self, input: &mut dyn Input, blocks: [u64; 7], count: u64) -> Result<u64, FormatError> {
        let segments = self.count(144, "SUBARRAY_COUNT")?;
        let times = blocks[3] / TRIGGER_BYTES;
        if segments > 0 || times < 2 || !blocks[3].is_multiple_of(TRIGGER_BYTES) || !count.is_multiple_of(times) {
            return Ok(segments.max(1));
        }
        let problem = format!(
            "SUBARRAY_COUNT = 0, but there are {times} trigger times: read as {times} segments of {} samples",
            count / times
        );
        input.remark(self.0.origin + 144, problem);
        Ok(times)
    }

    fn head(&self, code_type: CodeType, samples: usize, format: &'static str) -> Result<Head, FormatError> {
        let gain = self.0.finite(156, "VERTICAL_GAIN", self.0.f32(156))?;
        let offset = self.0.finite(160, "VERTICAL_OFFSET", self.0.f32(160))?;
        let dt_s = self.0.finite(176, "HORIZ_INTERVAL", self.0.f32(176))?;
        if dt_s <= 0.0 {
            return Err(self
                .0
                .refuse(176, format!("HORIZ_INTERVAL = {dt_s} is not positive: the record has no time base")));
        }
        if let Some(unit) = self.0.text(244, 48).filter(|unit| !unit.eq_ignore_ascii_case("s")) {
            return Err(self.0.refuse(
                244,
                format!("samples over {unit:?} are no voltage over time; save the trace that was recorded"),
            ));
        }
        let source = self.0.i16(344);
        Ok(Head {
            instrument: self.0.text(76, 16),
            channel: (0..4).contains(&source).then(|| format!("C{}", source + 1)),
            unit: self.0.text(196, 48),
            dt_s: Some(dt_s),
            scale: Some(Scale { gain, offset: -offset }),
            header_gain: Some(gain),
            header_offset: Some(offset),
            rails: self.rails(code_type),
            acquired_at: acquired_at(&self.0, 296),
            ..Head::new(format, code_type, samples)
        })
    }

    /// Lowest and highest code. The converter fills the upper bits of a code, so that the highest code has zeros in the
    /// lower bits.
    fn rails(&self, code_type: CodeType) -> Option<(f64, f64)> {
        let (low, high) = code_type.limits()?;
        let bits = i32::from(self.0.i16(172));
        let spare = code_type.bytes() as i32 * 8 - bits;
        if (1..=8).contains(&spare) && bits >= 8 {
            Some((low, high + 1.0 - f64::from(1 << spare)))
        } else {
            Some((low, high))
        }
    }

    /// For each segment the time of its trigger after the first trigger, and the time of sample 0.
    fn triggers(
        &self,
        input: &mut dyn Input,
        blocks: [u64; 7],
        segments: u64,
    ) -> Result<Vec<(Option<f64>, f64)>, FormatError> {
        if segments == 1 {
            return Ok(vec![(None, self.0.finite(180, "HORIZ_OFFSET", self.0.f64(180))?)]);
        }
        if blocks[3] != 16 * segments {
            return Err(self.0.refuse(
                48,
                format!("TRIGTIME_ARRAY has {} bytes, but {segments} segments need {}", blocks[3], 16 * segments),
            ));
        }
        trigger_times(&self.0, input, self.0.origin + blocks[..3].iter().sum::<u64>(), segments)
    }
}

/// The time of the first trigger: f64 seconds, then minute, hour, day, month in a byte each, and an i16 year.
pub(super) fn acquired_at(numbers: &Numbers, at: usize) -> Option<String> {
    let seconds = numbers.f64(at);
    let [minute, hour, day, month] = [8, 9, 10, 11].map(|after| numbers.u8(at + after));
    let year = numbers.i16(at + 12);
    let plausible = (0.0..61.0).contains(&seconds)
        && minute < 60
        && hour < 24
        && (1..=31).contains(&day)
        && (1..=12).contains(&month)
        && year > 1980;
    plausible.then(|| format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{seconds:012.9}"))
}

/// The array of trigger times: for each segment the time of its trigger after the first one, and the time of its sample
/// 0.
pub(super) fn trigger_times(
    descriptor: &Numbers,
    input: &mut dyn Input,
    origin: u64,
    segments: u64,
) -> Result<Vec<(Option<f64>, f64)>, FormatError> {
    let bytes = input.bytes("TRIGTIME_ARRAY", origin, TRIGGER_BYTES * segments)?;
    let times = Numbers { bytes, origin, big_endian: descriptor.big_endian };
    let mut triggers = Vec::with_capacity(segments as usize);
    for i in 0..segments as usize {
        let at = TRIGGER_BYTES as usize * i;
        let (trigger_s, t0_s) = (times.f64(at), times.f64(at + 8));
        if !(trigger_s.is_finite() && t0_s.is_finite()) {
            return Err(times.refuse(at, format!("trigger time of segment {i} is no number")));
        }
        triggers.push((Some(trigger_s), t0_s));
    }
    Ok(triggers)
}

/// What all segments of a sequence file have in common.
#[derive(Clone, Debug)]
pub struct SequenceHead {
    /// Name of the instrument, up to 15 bytes.
    pub instrument: String,
    /// Channel, from 0.
    pub channel: i16,
    /// Volts per code.
    pub gain_v: f32,
    /// Offset in volts: volts = gain * code - offset.
    pub offset_v: f32,
    /// Time between samples; the format holds it as f32.
    pub dt_s: f32,
    /// Bits of the converter: 8, or 9 to 16 (stored as 16).
    pub bits: u16,
    /// When the first segment was acquired.
    pub acquired: Acquired,
}

/// Wall-clock time of a trigger, in the zone of the instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "names say it")]
pub struct Acquired {
    pub year: i16,
    pub month: u8,
    pub day: u8,
    pub hour: u8,
    pub minute: u8,
    pub second: f64,
}

/// Writes a sequence as one little-endian file. All segments have equal length.
///
/// A segment is the time of its trigger after the first one (s), the time of its sample 0 (s), and its codes. Codes of
/// an 8 bit converter are stored as bytes and must fit; others are stored as words.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When there is no segment, their lengths differ, or a code does not fit. Also when the file exceeds 2 GiB, the limit
/// of its header.
pub fn write_sequence(
    out: &mut impl Write,
    head: &SequenceHead,
    segments: &[(f64, f64, Vec<i16>)],
) -> std::io::Result<()> {
    let samples = segments.first().expect("a file has at least one segment").2.len();
    assert!(segments.iter().all(|(_, _, codes)| codes.len() == samples), "segments of one file have equal lengths");
    let wide = head.bits > 8;
    let width = if wide { 2 } else { 1 };
    let length = |bytes: usize| i32::try_from(bytes).expect("a file holds less than 2 GiB");
    let sequence = segments.len() > 1;
    let (triggers, data) = (if sequence { 16 * segments.len() } else { 0 }, segments.len() * samples * width);
    let mut bytes = vec![0; DESCRIPTOR as usize];
    let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
    put(0, MARK);
    put(16, b"LECROY_2_3");
    put(32, &i16::from(wide).to_le_bytes());
    put(34, &1_i16.to_le_bytes());
    put(36, &(DESCRIPTOR as i32).to_le_bytes());
    put(48, &length(triggers).to_le_bytes());
    put(60, &length(data).to_le_bytes());
    put(76, &head.instrument.as_bytes()[..head.instrument.len().min(15)]);
    put(116, &length(segments.len() * samples).to_le_bytes());
    put(120, &length(samples).to_le_bytes());
    put(128, &length(segments.len() * samples - 1).to_le_bytes());
    put(144, &length(segments.len()).to_le_bytes());
    put(156, &head.gain_v.to_le_bytes());
    put(160, &head.offset_v.to_le_bytes());
    put(172, &head.bits.to_le_bytes());
    put(176, &head.dt_s.to_le_bytes());
    put(180, &segments[0].1.to_le_bytes());
    put(196, b"V");
    put(244, b"S");
    let Acquired { year, month, day, hour, minute, second } = head.acquired;
    put(296, &second.to_le_bytes());
    put(304, &[minute, hour, day, month]);
    put(308, &year.to_le_bytes());
    put(344, &head.channel.to_le_bytes());
    let total = bytes.len() + triggers + data;
    write!(out, "#9{total:09}")?;
    out.write_all(&bytes)?;
    if sequence {
        for (trigger_s, t0_s, _) in segments {
            out.write_all(&trigger_s.to_le_bytes())?;
            out.write_all(&t0_s.to_le_bytes())?;
        }
    }
    let mut codes = Vec::with_capacity(samples * width);
    for (_, _, segment) in segments {
        codes.clear();
        if wide {
            codes.extend(segment.iter().flat_map(|code| code.to_le_bytes()));
        } else {
            codes.extend(segment.iter().map(|&code| i8::try_from(code).expect("codes of 8 bits") as u8));
        }
        out.write_all(&codes)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hostile::{source, surplus_is_reported};

    /// Segments of 40 codes.
    fn sequence(segments: usize) -> Vec<u8> {
        let head = SequenceHead {
            instrument: "LECROYSIM".to_owned(),
            channel: 1,
            gain_v: 0.25,
            offset_v: -0.5,
            dt_s: 5e-11,
            bits: 8,
            acquired: Acquired { year: 2026, month: 3, day: 4, hour: 5, minute: 6, second: 7.25 },
        };
        let segment = |i: usize| (1e-3 * i as f64, -1e-9 * i as f64, vec![i as i16; 40]);
        let mut bytes = Vec::new();
        write_sequence(&mut bytes, &head, &(0..segments).map(segment).collect::<Vec<_>>()).unwrap();
        bytes
    }

    #[test]
    fn bytes_that_no_block_counts_are_reported() {
        surplus_is_reported(&LecroyTrc, &sequence(1));
        surplus_is_reported(&LecroyTrc, &sequence(4));
    }

    #[test]
    fn whole_segments_before_a_cut_are_read() {
        let bytes = sequence(4);
        let contents = crate::contents(&mut source(&bytes[..bytes.len() - 50])).unwrap();
        assert_eq!((contents.records.len(), contents.remarks.len()), (2, 1));
        assert!(contents.remarks[0].problem.contains("within segment 2"), "{:?}", contents.remarks);
        assert!(crate::contents(&mut source(&sequence(1)[..380])).unwrap_err().to_string().contains("cut short"));
    }

    /// Some firmware does not count the segments of a sequence: there is one for each trigger time.
    #[test]
    fn segments_that_are_not_counted_are_those_of_the_trigger_times() {
        let mut bytes = sequence(4);
        let at = 11 + 144;
        bytes[at..at + 4].fill(0);
        let contents = crate::contents(&mut source(&bytes)).unwrap();
        assert_eq!((contents.records.len(), contents.remarks.len()), (4, 1));
        assert_eq!((contents.records[3].head.samples, contents.records[3].t0_s), (40, Some(-1e-9 * 3.0)));
        assert_eq!(contents.remarks[0].byte_offset, at as u64);
    }
}
