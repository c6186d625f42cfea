//! Siglent `.bin`, saved by an oscilloscope: versions 1 to 4 of the maker's binary format.
//!
//! A header of 2048 bytes (4096 in version 4) says which traces follow: the channels that are on, one after the other,
//! then math traces (versions 3 and 4), then logic channels. Values in it have a power of 1000 and a unit. Version 1
//! has no number of its own: its first word says whether channel 1 is on.
//!
//! volts = ((code - middle) * volts per division / codes per division - offset) * probe. The middle is 128 or 32768;
//! versions 1 and 2 have 25 codes per division, version 2 with 16 bits does not say how many: its values are codes.
//! Version 1 does not hold the probe: its volts are those at the scope's input. Real files of version 4 contradict the
//! maker's description, which adds the offset and leaves the probe out. Math traces (`F1` to `F4`) have no probe.
//!
//! The header does not say at which part of the screen the trigger is, and has the horizontal settings at the time of
//! saving: `t0_s` takes the middle of the screen plus the delay, and is marked as nominal. A zoomed trace has the delay
//! of its window. There is neither a date nor a model in the file.
//!
//! Logic channels are skipped with a remark. Saved segments are files of their own, without their trigger times.
//! Versions 5 and 6 and the files of the old SDS1000X and SDS2000X are not read.
//!
//! Source: Siglent, *How to Extract Data from the Binary File*, and what owners measured on an SDS814X HD. Tested on
//! real files of version 4: 16 bit channels, math, zoom, amperes. Versions 1 to 3, 8 bit, big-endian codes and several
//! channels in a file were tested on files that the tests build.

use std::sync::Arc;

use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

/// The reader.
pub struct SiglentBin;

/// Channels of a bank, and math traces.
const BANK: usize = 4;
/// Logic channels.
const LOGIC: usize = 16;
/// Codes per division of an 8 bit converter.
const CODES_PER_DIVISION: f64 = 25.0;
/// Power of 1000 that stands for no prefix, and the largest one.
const NO_PREFIX: i32 = 8;
const LARGEST_PREFIX: u32 = 16;
/// Bytes of the header up to version 3, and in version 4 at least.
const HEAD: u64 = 0x800;
const HEAD_4: u64 = 0x1000;
const HEAD_MAX: u64 = 1 << 16;
/// Bytes from which the format is recognised.
const RECOGNISED: usize = 0x290;

/// Where the fields of a version are.
#[derive(Clone, Copy)]
struct Layout {
    version: u32,
    /// Bytes of a value with its power and unit.
    value: usize,
    on: usize,
    per_division: usize,
    offset: usize,
    logic: usize,
    delay: usize,
    samples: usize,
    rate: usize,
    logic_samples: usize,
    /// How far fields from the probes on lie behind those of version 3, if there are any.
    later: Option<usize>,
}

const VERSION_1: Layout = Layout {
    version: 1,
    value: 16,
    on: 0x00,
    per_division: 0x10,
    offset: 0x50,
    logic: 0x90,
    delay: 0xE4,
    samples: 0xF4,
    rate: 0xF8,
    logic_samples: 0x108,
    later: None,
};

/// Versions 2 to 4: the last one has the place of the data in addition, at byte 4.
const fn later(version: u32) -> Layout {
    let shift = if version == 4 { 4 } else { 0 };
    Layout {
        version,
        value: 40,
        on: 0x04 + shift,
        per_division: 0x14 + shift,
        offset: 0xB4 + shift,
        logic: 0x154 + shift,
        delay: 0x1C0 + shift,
        samples: 0x1E8 + shift,
        rate: 0x1EC + shift,
        logic_samples: 0x214 + shift,
        later: Some(shift),
    }
}

/// Fields of versions 2 (probes, width) and 3 (all), before they are shifted.
const PROBE: usize = 0x240;
const WIDTH: usize = 0x260;
const ORDER: usize = 0x261;
const CODES: usize = 0x26C;
const MATH_ON: usize = 0x27C;
const MATH_PER_DIVISION: usize = 0x28C;
const MATH_OFFSET: usize = 0x32C;
const MATH_SAMPLES: usize = 0x3CC;
const MATH_STEP: usize = 0x3DC;
const MATH_CODES: usize = 0x3FC;
/// Fields of version 4: channels 5 to 8, and the zoomed window.
const ON_5: usize = 0x404;
const PER_DIVISION_5: usize = 0x414;
const OFFSET_5: usize = 0x4B4;
const PROBE_5: usize = 0x554;
const CODES_5: usize = 0x574;
const ZOOM: usize = 0xAF4;
const ZOOM_DELAY: usize = 0xB20;

impl Reader for SiglentBin {
    fn format(&self) -> &'static str {
        "siglent-bin"
    }
    fn extensions(&self) -> &'static [&'static str] {
        // Files of other makers end in .bin as well.
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        Layout::of(head).is_some()
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let start = input.peek("the header", 0, input.length().min(RECOGNISED as u64))?;
        let layout = Layout::of(&start).ok_or_else(|| FormatError::Field {
            byte_offset: 0,
            problem: "no header of a Siglent waveform of version 1 to 4; save the file again".to_owned(),
        })?;
        let data = if layout.version == 4 { u64::from(Numbers::little(start, 0).u32(4)) } else { HEAD };
        let head = Header { layout, numbers: Numbers::head(input, data)? };
        let traces = head.traces()?;
        let width = head.code_type().bytes() as u64;
        let mut records = Vec::with_capacity(traces.len());
        let mut at = data;
        for trace in &traces {
            let needed = u64::from(trace.samples) * width;
            if at + needed > input.length() {
                if records.is_empty() {
                    let length = input.length();
                    return Err(FormatError::Truncated { what: "a trace", byte_offset: at, needed, length });
                }
                input.cut_short(at, "trace", records.len() as u64);
                return Ok(records);
            }
            records.push(head.record(trace, at)?);
            at += needed;
        }
        head.skip_logic(input, at);
        if records.is_empty() {
            let problem = "no channel and no math trace is on; save a waveform of an analog channel";
            return Err(head.numbers.refuse(layout.on, problem));
        }
        Ok(records)
    }
}

impl Layout {
    /// The version of a file that begins with these bytes.
    fn of(head: &[u8]) -> Option<Self> {
        let numbers = Numbers::little(head.get(..RECOGNISED)?.to_vec(), 0);
        let layout = match numbers.u32(0) {
            version @ 2..=4 => later(version),
            _ => VERSION_1,
        };
        layout.fits(&numbers).then_some(layout)
    }

    /// Whether the fields that say little by themselves are what they must be.
    fn fits(&self, head: &Numbers) -> bool {
        let is_flag = |at: usize| head.u32(at) <= 1;
        let value = self.value;
        let values = (0..BANK).flat_map(|i| [self.per_division + i * value, self.offset + i * value]);
        let times = [self.delay - value, self.delay];
        let is_value = |at: usize| head.u32(at + 8) <= LARGEST_PREFIX && head.f64(at).is_finite();
        let rate = head.f64(self.rate);
        let later = self.later.is_none_or(|shift| {
            let order = if self.version > 2 { head.u8(ORDER + shift) } else { 0 };
            head.u8(WIDTH + shift) <= 1 && order <= 1
        });
        let data = u64::from(head.u32(4));
        (0..BANK).all(|i| is_flag(self.on + 4 * i))
            && is_flag(self.logic)
            && values.chain(times).all(is_value)
            && head.u32(self.rate + 8) <= LARGEST_PREFIX
            && rate.is_finite()
            && rate > 0.0
            && later
            && (self.version != 4 || (HEAD_4..=HEAD_MAX).contains(&data))
    }
}

/// One trace of a file.
struct Trace {
    name: String,
    samples: u32,
    step_s: f64,
    /// Where its value per division and its offset are.
    per_division: usize,
    offset: usize,
    /// Where its codes per division are, if the header has them.
    codes: Option<usize>,
    probe: f64,
}

struct Header {
    layout: Layout,
    numbers: Numbers,
}

impl Header {
    fn later(&self, at: usize) -> Option<usize> {
        self.layout.later.map(|shift| at + shift)
    }

    fn code_type(&self) -> CodeType {
        let is_wide = self.later(WIDTH).is_some_and(|at| self.numbers.u8(at) == 1);
        if is_wide { CodeType::U16 } else { CodeType::U8 }
    }

    /// A value with its power of 1000.
    fn value(&self, at: usize) -> f64 {
        let power = 3 * (self.numbers.u32(at + 8).min(LARGEST_PREFIX).cast_signed() - NO_PREFIX);
        // Dividing by a power of ten is exact, multiplying by its inverse is not.
        let number = self.numbers.f64(at);
        if power < 0 { number / 10_f64.powi(-power) } else { number * 10_f64.powi(power) }
    }

    /// The traces that are on, in the order of their codes.
    fn traces(&self) -> Result<Vec<Trace>, FormatError> {
        let (head, layout) = (&self.numbers, &self.layout);
        let samples = head.u32(layout.samples);
        let step_s = 1.0 / self.value(layout.rate);
        let channel = |i: usize, [on, per_division, offset]: [usize; 3], probe, codes: Option<usize>| {
            (head.u32(on + 4 * (i % BANK)) == 1).then(|| Trace {
                name: format!("C{}", i + 1),
                samples,
                step_s,
                per_division: per_division + layout.value * (i % BANK),
                offset: offset + layout.value * (i % BANK),
                codes: codes.map(|at| at + 4 * (i % BANK)),
                probe,
            })
        };
        let probe = |at: usize, i: usize| head.f64(at + 8 * (i % BANK));
        let codes = self.later(CODES).filter(|_| layout.version > 2);
        let first = [layout.on, layout.per_division, layout.offset];
        let mut traces: Vec<Trace> = (0..BANK)
            .filter_map(|i| channel(i, first, self.later(PROBE).map_or(1.0, |at| probe(at, i)), codes))
            .collect();
        if layout.version == 4 {
            let second = [ON_5, PER_DIVISION_5, OFFSET_5];
            traces.extend((BANK..2 * BANK).filter_map(|i| channel(i, second, probe(PROBE_5, i), Some(CODES_5))));
        }
        if let Some(shift) = layout.later.filter(|_| layout.version > 2) {
            let on = (0..BANK).filter(|i| head.u32(MATH_ON + shift + 4 * i) == 1);
            traces.extend(on.map(|i| Trace {
                name: format!("F{}", i + 1),
                samples: head.u32(MATH_SAMPLES + shift + 4 * i),
                step_s: head.f64(MATH_STEP + shift + 8 * i),
                per_division: MATH_PER_DIVISION + shift + layout.value * i,
                offset: MATH_OFFSET + shift + layout.value * i,
                codes: Some(MATH_CODES + shift),
                probe: 1.0,
            }));
        }
        for trace in &traces {
            if trace.samples == 0 || !(trace.step_s > 0.0 && trace.step_s.is_finite()) {
                let problem = format!(
                    "{} has {} samples, {} s apart: that is no trace; save the file again",
                    trace.name, trace.samples, trace.step_s
                );
                return Err(head.refuse(layout.samples, problem));
            }
        }
        Ok(traces)
    }

    fn record(&self, trace: &Trace, byte_offset: u64) -> Result<Record, FormatError> {
        let code_type = self.code_type();
        let (unit, kind) = self.unit(trace.per_division);
        let big_endian = self.layout.version > 2 && self.later(ORDER).is_some_and(|at| self.numbers.u8(at) == 1);
        let delay_s = match self.layout.version {
            4 if self.numbers.u32(ZOOM) == 1 => self.value(ZOOM_DELAY),
            _ => self.value(self.layout.delay),
        };
        let t0_s = self.numbers.finite(
            self.layout.delay,
            "the delay",
            delay_s - f64::from(trace.samples) * trace.step_s / 2.0,
        )?;
        let head = Head {
            kind,
            channel: Some(trace.name.clone()),
            unit: unit.map(str::to_owned),
            dt_s: Some(trace.step_s),
            t0_nominal: true,
            scale: self.scale(trace)?,
            header_gain: Some(self.value(trace.per_division)),
            header_offset: Some(self.value(trace.offset)),
            rails: code_type.limits().filter(|_| code_type == CodeType::U8),
            ..Head::new(SiglentBin.format(), code_type, trace.samples as usize)
        };
        let payload = Payload::File { byte_offset, stride: code_type.bytes() as u64, big_endian };
        Ok(Record { head: Arc::new(head), segment: None, t0_s: Some(t0_s), trigger_s: None, payload })
    }

    /// Units of a code and of the middle, or `None` where the file does not say how many codes are a division.
    fn scale(&self, trace: &Trace) -> Result<Option<Scale>, FormatError> {
        let (codes, middle) = match (trace.codes, self.code_type()) {
            (Some(at), CodeType::U16) => (f64::from(self.numbers.i32(at)), 32_768.0),
            (Some(at), _) => (f64::from(self.numbers.i32(at)), 128.0),
            (None, CodeType::U16) => return Ok(None),
            (None, _) => (CODES_PER_DIVISION, 128.0),
        };
        let gain = self.value(trace.per_division) / codes * trace.probe;
        let offset = -middle * gain - self.value(trace.offset) * trace.probe;
        if gain == 0.0 || !gain.is_finite() || !offset.is_finite() {
            let problem = format!(
                "{} at {} per division, {codes} codes and a probe of {}: that is no scale; save the file again",
                trace.name,
                self.value(trace.per_division),
                trace.probe
            );
            return Err(self.numbers.refuse(trace.per_division, problem));
        }
        Ok(Some(Scale { gain, offset }))
    }

    /// The unit of a value, and what a trace in it is.
    fn unit(&self, at: usize) -> (Option<&'static str>, Kind) {
        let word = |i: usize| self.numbers.i32(at + 12 + 4 * i);
        if self.layout.version == 1 {
            let unit = [Some("V"), Some("A")].get(word(0) as usize).copied().flatten();
            return (unit, Kind::Waveform);
        }
        // Powers of V, A and s as fractions.
        let powers = [1, 3, 5].map(|i| (word(i), word(i + 1)));
        match word(0) {
            0 if powers == [(1, 1), (0, 1), (0, 1)] => (Some("V"), Kind::Waveform),
            0 if powers == [(0, 1), (1, 1), (0, 1)] => (Some("A"), Kind::Waveform),
            4 | 5 => (Some("V"), Kind::Waveform),
            1..=3 | 6 => (None, Kind::Spectrum),
            _ => (None, Kind::Waveform),
        }
    }

    /// Counts the logic channels at `at` as used, as far as they are there.
    fn skip_logic(&self, input: &mut dyn Input, at: u64) {
        let logic = self.layout.logic;
        let flags = (0..LOGIC).filter(|i| self.numbers.u32(logic + 4 + 4 * i) == 1).count() as u64;
        if self.numbers.u32(logic) != 1 || flags == 0 {
            return;
        }
        let bytes = flags * u64::from(self.numbers.u32(self.layout.logic_samples)).div_ceil(8);
        input.uses(at..(at + bytes).min(input.length()));
        input.remark(at, format!("{flags} logic channels are skipped; save them as CSV if they are needed"));
    }
}

#[cfg(test)]
mod tests;
