//! LeCroy traces of the template LECROY_1_0 (.000), which the 7200A of the 1990s wrote: one descriptor of 320 bytes,
//! then trigger times, then codes.
//!
//! volts = VERTICAL_GAIN * code - VERTICAL_OFFSET; sample i is at HORIZ_OFFSET + i * HORIZ_INTERVAL after the trigger.
//! In a sequence, TRIGTIME gives each segment its own offset. Source: the template that the instrument prints.
//!
//! ACQ_VERT_OFFSET is not the offset: it is in divisions of the screen, 2.5 where VERTICAL_OFFSET is 0.125 V at 50 mV
//! per division. One public reader uses it, which puts a real 7200A trace that was triggered at 13 mV between -2.42 and
//! -2.33 V. The template's formula puts the trace between -46 and 43 mV.
//!
//! Not read: a second data array; records interleaved from several triggers; sequences with uncorrected trigger times.
//! Sequences, big-endian files and 8 bit codes were tested only on files that the tests build.

use std::sync::Arc;

use super::lecroy_trc::{TRIGGER_BYTES, acquired_at, before, line_end, position, trigger_times};
use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

/// Length of the wave descriptor.
const DESCRIPTOR: u64 = 320;
/// Bytes that are searched for a descriptor, which may follow a block prefix or the text of a query.
const SEARCH_BYTES: u64 = 1024;
/// Name of the template, 16 bytes after the start of the descriptor.
const TEMPLATE: &[u8] = b"LECROY_1_0";
/// Memory of a segment in bytes: a record, and its times.
const SEGMENT_BYTES: u64 = size_of::<Record>() as u64 + 24;

/// The reader.
pub struct Lecroy10;

/// Where the descriptor of this template begins, if the file has one.
fn descriptor(head: &[u8]) -> Option<usize> {
    position(head).filter(|start| head[*start..].get(16..).is_some_and(|name| name.starts_with(TEMPLATE)))
}

impl Reader for Lecroy10 {
    fn format(&self) -> &'static str {
        "lecroy-1.0"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["000", "001", "002", "003", "004", "005", "006", "007", "008", "009"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        descriptor(head).is_some()
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let head = input.peek("the head", 0, input.length().min(SEARCH_BYTES + DESCRIPTOR))?;
        let start = descriptor(&head).ok_or_else(|| FormatError::Field {
            byte_offset: 0,
            problem: "no WAVEDESC block of the template LECROY_1_0: this is no trace of a 7200A, or its head is lost"
                .into(),
        })?;
        before(input, &head[..start]);
        Descriptor::read(input, start as u64)?.records(input, self.format())
    }
}

/// The wave descriptor, with its byte order.
struct Descriptor(Numbers);

/// Lengths of the blocks after the descriptor.
struct Blocks {
    trigger_times: u64,
    triggers: u64,
    data: u64,
    length: u64,
}

impl Descriptor {
    fn read(input: &mut dyn Input, start: u64) -> Result<Self, FormatError> {
        let bytes = input.bytes("the wave descriptor", start, DESCRIPTOR)?;
        let big_endian = match [bytes[34], bytes[35]] {
            [1, 0] => false,
            [0, 0] => true,
            [a, b] => {
                let problem = format!("COMM_ORDER {a:#04x} {b:#04x} is neither little nor big endian");
                return Err(FormatError::Field { byte_offset: start + 34, problem });
            }
        };
        Ok(Self(Numbers { bytes, origin: start, big_endian }))
    }

    fn f32(&self, at: usize, name: &str) -> Result<f64, FormatError> {
        self.0.finite(at, name, self.0.f32(at))
    }
    fn count(&self, at: usize, name: &str) -> Result<u64, FormatError> {
        let count = self.0.i32(at);
        u64::try_from(count).map_err(|_| self.0.refuse(at, format!("{name} = {count} is negative")))
    }
    fn records(&self, input: &mut dyn Input, format: &'static str) -> Result<Vec<Record>, FormatError> {
        let code_type = match self.0.i16(32) {
            0 => CodeType::I8,
            1 => CodeType::I16,
            other => return Err(self.0.refuse(32, format!("COMM_TYPE {other} is neither byte nor word"))),
        };
        let blocks = self.blocks(input)?;
        let (count, segments) = (self.count(92, "WAVE_ARRAY_COUNT")?, self.count(108, "SUBARRAY_COUNT")?.max(1));
        let width = code_type.bytes() as u64;
        if count * width != blocks.length {
            let problem =
                format!("WAVE_ARRAY_COUNT = {count} does not fit the {} bytes of WAVE_ARRAY_1", blocks.length);
            return Err(self.0.refuse(92, problem));
        }
        if count == 0 || !count.is_multiple_of(segments) {
            let problem = format!("SUBARRAY_COUNT = {segments} does not divide {count} points");
            return Err(self.0.refuse(108, problem));
        }
        if segments * SEGMENT_BYTES > 3 * input.length() + (1 << 19) {
            let problem = format!("SUBARRAY_COUNT = {segments} is more segments than {count} points make sense for");
            return Err(self.0.refuse(108, problem));
        }
        input.uses(self.0.origin..blocks.data);
        line_end(input, blocks.data + blocks.length)?;
        let head = Arc::new(self.head(code_type, (count / segments) as usize, format)?);
        let record = |(i, (trigger_s, t0_s)): (usize, (Option<f64>, f64))| Record {
            head: Arc::clone(&head),
            segment: (segments > 1).then_some(i as u32),
            t0_s: Some(t0_s),
            trigger_s,
            payload: Payload::File {
                byte_offset: blocks.data + i as u64 * (blocks.length / segments),
                stride: width,
                big_endian: self.0.big_endian,
            },
        };
        Ok(self.triggers(input, &blocks, segments)?.into_iter().enumerate().map(record).collect())
    }

    fn blocks(&self, input: &dyn Input) -> Result<Blocks, FormatError> {
        let descriptor = self.count(36, "WAVE_DESCRIPTOR")?;
        if descriptor < DESCRIPTOR {
            let problem = format!("WAVE_DESCRIPTOR = {descriptor} is less than the {DESCRIPTOR} bytes that it has");
            return Err(self.0.refuse(36, problem));
        }
        let text = self.count(40, "USER_TEXT")?;
        let (triggers, length) = (self.count(44, "TRIGTIME_ARRAY")?, self.count(48, "WAVE_ARRAY_1")?);
        if self.count(52, "WAVE_ARRAY_2")? > 0 {
            return Err(self.0.refuse(52, "a second data array (complex or extrema) is no plain voltage over time"));
        }
        let trigger_times = self.0.origin + descriptor + text;
        let data = trigger_times + triggers;
        if data + length > input.length() {
            let (what, length) = ("WAVE_ARRAY_1", input.length());
            return Err(FormatError::Truncated { what, byte_offset: data, needed: self.count(48, what)?, length });
        }
        Ok(Blocks { trigger_times, triggers, data, length })
    }

    fn head(&self, code_type: CodeType, samples: usize, format: &'static str) -> Result<Head, FormatError> {
        let (gain, offset) = (self.f32(120, "VERTICAL_GAIN")?, self.f32(124, "VERTICAL_OFFSET")?);
        let dt_s = self.f32(134, "HORIZ_INTERVAL")?;
        if dt_s <= 0.0 {
            let problem = format!("HORIZ_INTERVAL = {dt_s} is not positive: the record has no time base");
            return Err(self.0.refuse(134, problem));
        }
        if gain == 0.0 {
            return Err(self.0.refuse(120, "VERTICAL_GAIN = 0 gives no scale; save the trace again"));
        }
        let (low, high) = (f64::from(self.0.i16(130)), f64::from(self.0.i16(128)));
        let kind = self.kind()?;
        let is_raw = kind == Kind::Waveform && low < high;
        Ok(Head {
            kind,
            instrument: self.0.text(56, 16),
            channel: self.channel(),
            unit: self.0.text(154, 48),
            dt_s: Some(dt_s),
            scale: Some(Scale { gain, offset: -offset }),
            header_gain: Some(gain),
            header_offset: Some(offset),
            // MIN_VALUE and MAX_VALUE are in words; 8 bit codes are their upper half.
            rails: is_raw.then(|| match code_type {
                CodeType::I8 => ((low / 256.0).floor(), (high / 256.0).floor()),
                _ => (low, high),
            }),
            acquired_at: acquired_at(&self.0, 250),
            ..Head::new(format, code_type, samples)
        })
    }

    fn kind(&self) -> Result<Kind, FormatError> {
        let record_type = self.0.i16(270);
        match (record_type, self.0.text(202, 48).unwrap_or_default().as_str()) {
            (1 | 8, _) => Err(self.0.refuse(
                270,
                "RECORD_TYPE: samples interleaved from several triggers are not read; record in real time",
            )),
            (12, _) => Err(self.0.refuse(270, "RECORD_TYPE: the trigger times of this sequence are not corrected")),
            (_, "Hz" | "HZ") => Ok(Kind::Spectrum),
            (6, _) => Ok(Kind::Envelope),
            (_, "" | "s" | "S") => {
                let cumulative = self.0.i16(272) == 8 || self.count(116, "SWEEPS_PER_ACQ")? > 1;
                Ok(if cumulative { Kind::Average } else { Kind::Waveform })
            }
            (_, unit) => Err(self.0.refuse(
                202,
                format!("samples over {unit:?} are no voltage over time; save the trace that was recorded"),
            )),
        }
    }

    /// The channel: plug-in and channel number, since each of up to six plug-ins numbers its own.
    fn channel(&self) -> Option<String> {
        let (plug_in, channel) = (self.0.i16(294), self.0.i16(296));
        let letter = usize::try_from(plug_in).ok().and_then(|plug_in| "CABCDEF".chars().nth(plug_in))?;
        (1..=4).contains(&channel).then(|| format!("{letter}{channel}"))
    }

    /// For each segment the time of its trigger after the first trigger, and the time of sample 0.
    fn triggers(
        &self,
        input: &mut dyn Input,
        blocks: &Blocks,
        segments: u64,
    ) -> Result<Vec<(Option<f64>, f64)>, FormatError> {
        if segments == 1 {
            return Ok(vec![(None, self.0.finite(138, "HORIZ_OFFSET", self.0.f64(138))?)]);
        }
        if segments.checked_mul(TRIGGER_BYTES) != Some(blocks.triggers) {
            let problem = format!("TRIGTIME_ARRAY = {} bytes are no {segments} segments' times", blocks.triggers);
            return Err(self.0.refuse(44, problem));
        }
        trigger_times(&self.0, input, blocks.trigger_times, segments)
    }
}

#[cfg(test)]
mod tests;
