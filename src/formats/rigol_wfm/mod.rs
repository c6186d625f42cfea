//! Rigol .wfm: the saved memory of the scope. Each family has a layout of its own, recognised by content.
//!
//! | family | first bytes | volts | time of sample 0 | tested on |
//! |---|---|---|---|---|
//! | DS1000B | A5 A5 A4 01 | yes | yes | a real file and its CSV |
//! | DS1000C, D, E | A5 or A1, A5 00 00 | yes | nominal | a real DS1000E file; C and D on files built in tests |
//! | DS1000Z, MSO1000Z | 01 FF FF FF | not in the file | not in the file | a real file and its CSV |
//! | DS2000, DS4000 | A5 A5 38 00 | yes | nominal | real files, of the DS2000 with its CSV |
//! | DHO800, DHO1000 | 02 00 00 00 | yes | nominal | a real DHO800 file and its .bin; DHO1000 on files built in tests |
//!
//! Codes stay raw: volts = gain * code + offset; the gain is negative where codes fall with volts. No family stores the
//! sub-sample part of the trigger's time. Records of different triggers therefore scatter by up to a sample against
//! each other; channels of one file do not. `header_gain` is volts per division, `header_offset` the vertical position
//! as stored.
//!
//! The vendor publishes no layouts; these follow RigolWFM's Kaitai descriptions. The file of each family describes
//! where measurements of the same capture contradict them. DS6000 files are refused by name: no file was available to
//! check a layout. Not read: logic channels.

mod dho;
mod ds1000;
mod ds1000z;
mod ds2000;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{Head, Payload, Record};

/// Name of the format.
const FORMAT: &str = "rigol-wfm";
/// Channels of the largest model.
const CHANNELS: usize = 4;

/// The reader.
pub struct RigolWfm;

/// Models that share a layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    Ds1000B,
    /// DS1000C, DS1000D, DS1000E.
    Ds1000E,
    Ds1000Z,
    /// DS2000, DS4000, DS6000, by the model in the header.
    Ds2000,
    Dho,
}

impl Family {
    fn of(head: &[u8]) -> Option<Self> {
        match head {
            [0xA5, 0xA5, 0xA4, 0x01, ..] => Some(Self::Ds1000B),
            [0xA1 | 0xA5, 0xA5, 0, 0, ..] => Some(Self::Ds1000E),
            [0x01, 0xFF, 0xFF, 0xFF, 0xA5 | 0xA6, 0xA5, ..] => Some(Self::Ds1000Z),
            [0xA5, 0xA5, 0x38, 0, ..] => Some(Self::Ds2000),
            [2, 0, 0, 0, ..] if dho::first_block_is_plausible(head) => Some(Self::Dho),
            _ => None,
        }
    }
}

impl Reader for RigolWfm {
    fn format(&self) -> &'static str {
        FORMAT
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["wfm"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        Family::of(head).is_some()
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let head = input.peek("the head", 0, input.length().min(64))?;
        match Family::of(&head) {
            Some(Family::Ds1000B) => ds1000::records_b(input),
            Some(Family::Ds1000E) => ds1000::records_e(input),
            Some(Family::Ds1000Z) => ds1000z::records(input),
            Some(Family::Ds2000) => ds2000::records(input),
            Some(Family::Dho) => dho::records(input),
            None => Err(field(
                0,
                "the first bytes are of no Rigol family that is read (DS1000B/C/D/E/Z, DS2000, DS4000, DHO800, DHO1000); save as CSV on the scope",
            )),
        }
    }
}

fn field(byte_offset: usize, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset: byte_offset as u64, problem: problem.into() }
}

/// A finite number (f32) other than 0.
fn factor(fields: &Numbers, at: usize, name: &str) -> Result<f64, FormatError> {
    match fields.finite(at, name, fields.f32(at))? {
        0.0 => Err(fields.refuse(at, format!("{name} = 0 gives no scale; save the capture again"))),
        value => Ok(value),
    }
}

/// Time between samples, from a sample rate (f32) in units of `unit_hz`.
fn dt_s(fields: &Numbers, at: usize, name: &str, unit_hz: f64) -> Result<f64, FormatError> {
    let dt_s = 1.0 / (fields.finite(at, name, fields.f32(at))? * unit_hz);
    if dt_s > 0.0 && dt_s.is_finite() {
        return Ok(dt_s);
    }
    Err(fields.refuse(at, format!("{name} gives {dt_s} s between samples: the record has no time base")))
}

/// One channel whose codes are in the file, `stride` bytes from one to the next.
fn record(input: &dyn Input, head: Head, t0_s: Option<f64>, place: (u64, u64)) -> Result<Record, FormatError> {
    let (byte_offset, stride) = place;
    within(input, &head, byte_offset, stride)?;
    let payload = Payload::File { byte_offset, stride, big_endian: false };
    Ok(Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload })
}

/// Refuses samples that the file does not have.
fn within(input: &dyn Input, head: &Head, byte_offset: u64, stride: u64) -> Result<(), FormatError> {
    let width = head.code_type.bytes() as u64;
    let before_last = (head.samples as u64).checked_sub(1).and_then(|steps| steps.checked_mul(stride));
    let needed = before_last.and_then(|bytes| bytes.checked_add(width)).ok_or_else(|| {
        field(0, format!("{} samples of {} are no record; save it again", head.samples, channel_of(head)))
    })?;
    if byte_offset.checked_add(needed).is_none_or(|end| end > input.length()) {
        return Err(FormatError::Truncated { what: "the samples", byte_offset, needed, length: input.length() });
    }
    Ok(())
}

fn channel_of(head: &Head) -> &str {
    head.channel.as_deref().unwrap_or("a channel")
}

/// Refuses a file that names no channel.
fn some(records: Vec<Record>, at: usize) -> Result<Vec<Record>, FormatError> {
    if records.is_empty() {
        return Err(field(at, "no channel is switched on: nothing was recorded"));
    }
    Ok(records)
}

/// Unit of a channel, by its number in the header.
fn unit(number: u8) -> Option<String> {
    ["W", "A", "V"].get(usize::from(number)).map(|unit| (*unit).to_owned())
}
