//! DS2000 and DS4000: headers that differ in a few fields; each channel has its own range of the file.
//!
//! volts = V/div / c * (code - 127) - offset, with c = 25 codes per division (DS2000) or 32 (DS4000). One DS2072A
//! capture was compared with the scope's own CSV, which has the minimum and maximum of each 20 samples. All agree: one
//! channel exactly, the other to half a code, by which the CSV rounds its offset (-85.5 codes here, -85 there). Volts
//! of a DS4000 are not checked against a second source.
//!
//! The file does not give the time of sample 0 to the sample, so `t0_s` is marked as nominal; for times, save CSV. The
//! public reading (the middle of the memory at the horizontal offset) puts that capture 25 samples, 25 ns, before its
//! CSV: all 698 pairs agree at this shift, and at no other. In the CSV the trace crosses the trigger level (a slow
//! edge, 0.2 mV/ns) 8 ns after time 0; in the public reading, 17 ns before it. The scope's own export is more
//! plausible, but no field is known that gives those 25 samples. All channels of a file share their times.
//!
//! A single channel of a DS2000 may use the memory of two (interwoven): even samples are in the first range, odd ones
//! in the second. This was tested only on files that the tests build. DS6000 files are refused by name: no file was
//! available to check the public layout.

use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use super::{CHANNELS, FORMAT, dt_s, factor, field, record, some, unit, within};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Kind, Payload, ReadSeek, Record, Scale, Unpack};

/// Where the fields of a header are.
struct Layout {
    head_bytes: u64,
    acquisition: usize,
    rate: usize,
    /// Horizontal offset of the middle of the memory, i64 in ps.
    horizontal_offset: usize,
    channel_heads: usize,
    /// Where the settings end and the memory begins.
    settings_end: usize,
    first_valid: usize,
    samples: usize,
    codes_per_division: f64,
    /// Whether a channel may use the memory of two, and may store its unit before its inversion.
    is_ds2000: bool,
}

const DS2000: Layout = Layout {
    head_bytes: 0x100,
    acquisition: 0x54,
    rate: 0x60,
    horizontal_offset: 0x70,
    channel_heads: 0x78,
    settings_end: 0xF0,
    first_valid: 0xF8,
    samples: 0xFC,
    codes_per_division: 25.0,
    is_ds2000: true,
};
const DS4000: Layout = Layout {
    head_bytes: 0x110,
    acquisition: 0x58,
    rate: 0x64,
    horizontal_offset: 0x74,
    channel_heads: 0x7C,
    settings_end: 0x100,
    first_valid: 0x108,
    samples: 0x10C,
    codes_per_division: 32.0,
    is_ds2000: false,
};
/// Serial number of the instrument, which begins with its model.
const SERIAL: usize = 4;
const ENABLED: usize = 0x40;
const INTERWOVEN: usize = 0x41;
const OFFSETS: usize = 0x44;
/// Bytes of a channel in the header.
const CHANNEL_BYTES: usize = 28;
/// Most bytes after the valid samples of a channel that is alone.
const SPARE_BYTES: u64 = 1 << 11;
/// Code in the middle of the screen.
const MIDDLE: f64 = 127.0;

/// Returns the records of the channels that are on.
pub(super) fn records(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let serial = Numbers::head(input, 24)?.text(SERIAL, 20).unwrap_or_default();
    let layout = match serial.strip_prefix("MSO").or_else(|| serial.strip_prefix("DS")).and_then(|rest| rest.get(..1)) {
        Some("2") => DS2000,
        Some("4") => DS4000,
        _ => {
            let problem = format!("instrument {serial:?}: of this head only DS2000 and DS4000 are read; save as CSV");
            return Err(field(SERIAL, problem));
        }
    };
    layout.records(input, &serial)
}

impl Layout {
    fn records(&self, input: &mut dyn Input, serial: &str) -> Result<Vec<Record>, FormatError> {
        let fields = Numbers::head(input, self.head_bytes)?;
        let samples = fields.u32(self.samples);
        let is_interwoven = self.is_ds2000 && fields.u8(INTERWOVEN) & 1 == 1;
        self.use_memories(input, &fields, if is_interwoven { samples / 2 } else { samples });
        if is_interwoven {
            return Ok(vec![self.interwoven(input, &fields, serial, samples)?]);
        }
        let mut records = Vec::new();
        for number in (0..CHANNELS).filter(|number| fields.u8(ENABLED) >> number & 1 == 1) {
            let head = self.head(&fields, number, serial, samples)?;
            let t0_s = self.t0_s(&fields, &head);
            records.push(record(input, head, t0_s, (self.stretch(&fields, number)?, 1))?);
        }
        some(records, ENABLED)
    }

    /// Counts the settings and the memory of each channel as used. A memory holds samples before and after the valid
    /// ones; it ends where the next begins. The last is as long as the one before it.
    fn use_memories(&self, input: &mut dyn Input, fields: &Numbers, samples: u32) {
        let starts: Vec<u64> = (0..CHANNELS)
            .map(|number| u64::from(fields.u32(OFFSETS + 4 * number)))
            .filter(|offset| *offset >= self.head_bytes)
            .collect();
        let Some(last) = starts.last() else { return };
        let before = u64::from(fields.u32(self.settings_end));
        let has_settings = (self.head_bytes..=starts[0]).contains(&before);
        let spare = match starts[..] {
            [.., previous, last] if has_settings && last > previous => {
                // The first memory begins where the settings end.
                (last - previous).saturating_sub(starts[0] - before).saturating_sub(u64::from(samples))
            }
            _ if has_settings => SPARE_BYTES,
            _ => 0,
        };
        let end = last + u64::from(fields.u32(self.first_valid)) + u64::from(samples) + spare;
        input.uses(self.head_bytes..end.min(input.length()));
    }

    /// Where the valid samples of a channel begin.
    fn stretch(&self, fields: &Numbers, number: usize) -> Result<u64, FormatError> {
        let at = OFFSETS + 4 * number;
        match fields.u32(at) {
            offset if u64::from(offset) >= self.head_bytes => {
                Ok(u64::from(offset) + u64::from(fields.u32(self.first_valid)))
            }
            offset => Err(field(at, format!("CH{} begins at byte {offset}, within the head", number + 1))),
        }
    }

    fn interwoven(
        &self,
        input: &dyn Input,
        fields: &Numbers,
        serial: &str,
        samples: u32,
    ) -> Result<Record, FormatError> {
        let number = match fields.u8(ENABLED) & 3 {
            1 => 0,
            2 => 1,
            _ => return Err(field(ENABLED, "interwoven memory of other than one channel; save as CSV")),
        };
        if !samples.is_multiple_of(2) {
            return Err(field(self.samples, format!("{samples} samples are not two interwoven halves")));
        }
        let half = Head::new(FORMAT, CodeType::U8, samples as usize / 2);
        let halves = [self.stretch(fields, 0)?, self.stretch(fields, 1)?];
        for byte_offset in halves {
            within(input, &half, byte_offset, 1)?;
        }
        let head = self.head(fields, number, serial, samples)?;
        let payload = Payload::Packed(Arc::new(Interwoven { halves, samples: half.samples }));
        let t0_s = self.t0_s(fields, &head);
        Ok(Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload })
    }

    /// Time of sample 0 if the middle of the memory is at the horizontal offset.
    fn t0_s(&self, fields: &Numbers, head: &Head) -> Option<f64> {
        let middle_s = fields.i64(self.horizontal_offset) as f64 * 1e-12;
        head.dt_s.map(|dt_s| middle_s - head.samples as f64 * dt_s / 2.0)
    }

    fn head(&self, fields: &Numbers, number: usize, serial: &str, samples: u32) -> Result<Head, FormatError> {
        let at = self.channel_heads + number * CHANNEL_BYTES;
        let acquisition = fields.u16(self.acquisition);
        let kind = match acquisition {
            0 | 3 => Kind::Waveform,
            1 => Kind::Average,
            2 => Kind::Envelope,
            _ => {
                let problem = format!("acquisition mode {acquisition} is not known; save as CSV");
                return Err(field(self.acquisition, problem));
            }
        };
        let (scale, offset) =
            (factor(fields, at + 8, "the scale")?, fields.finite(at + 12, "the offset", fields.f32(at + 12))?);
        let flags = [fields.u8(at + 16), fields.u8(at + 17)];
        // Newer DS2000 mark a channel that is on by 8 instead of 1, and swap the two flags.
        let swapped = self.is_ds2000 && fields.u8(at) != 1;
        let [inverted, unit_number] = if swapped { [flags[1], flags[0]] } else { flags };
        let gain = scale / self.codes_per_division;
        Ok(Head {
            kind,
            instrument: Some(serial.to_owned()),
            channel: Some(format!("CH{}", number + 1)),
            unit: unit(unit_number),
            dt_s: Some(dt_s(fields, self.rate, "the sample rate", 1.0)?),
            t0_nominal: true,
            // An inverted channel gets no scale: its codes may or may not be inverted already.
            scale: (inverted == 0).then_some(Scale { gain, offset: -gain * MIDDLE - offset }),
            header_gain: Some(scale),
            header_offset: Some(offset),
            ..Head::new(FORMAT, CodeType::U8, samples as usize)
        })
    }
}

/// Even samples from one range of the file, odd ones from another.
#[derive(Debug)]
struct Interwoven {
    halves: [u64; 2],
    samples: usize,
}

impl Unpack for Interwoven {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        const PIECE: usize = 1 << 16;
        let mut half = vec![0; PIECE.min(self.samples)];
        let mut codes = vec![0; 2 * half.len()];
        for start in (0..self.samples).step_by(PIECE) {
            let count = PIECE.min(self.samples - start);
            for (parity, byte_offset) in self.halves.into_iter().enumerate() {
                file.seek(SeekFrom::Start(byte_offset + start as u64))?;
                file.read_exact(&mut half[..count])?;
                codes.iter_mut().skip(parity).step_by(2).zip(&half[..count]).for_each(|(code, from)| *code = *from);
            }
            if take(&codes[..2 * count])?.is_break() {
                break;
            }
        }
        Ok(())
    }
}
