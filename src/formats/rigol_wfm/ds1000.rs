//! DS1000B, DS1000C, DS1000D and DS1000E: two headers with the same fields in different places.
//!
//! `volts = V/div / 25 * (zero - position - code)`, with zero = 99 (B) or 125 (C, D, E),
//! `V/div = scale * 1e-6 * probe`, position in codes. Sample i is at offset * 1 ps + (i - depth / 2) / rate. One
//! DS1000B capture with the trigger in the middle was compared with the scope's own CSV: all four channels are equal in
//! every sample and in time. The sign of the offset is as in the DS2000. If the knob was turned after the scope
//! stopped, the offset on the screen differs from that of the measurement. The file does not say which counts, and then
//! there is no time of sample 0.
//!
//! Of DS1000C, D and E, the time of sample 0 is nominal: real DS1000D and DS1000E captures lie 1 to 4 samples off the
//! scope's own CSV.
//!
//! Probe: the DS1000E stores the scale without it, the DS1000D with it, and nothing in the file distinguishes the two.
//! The reader assumes a DS1000E: with a probe other than 1x, volts of a DS1000D come out larger by its factor. An
//! inverted channel has no scale, since it is unknown whether its codes are inverted already. Rolling captures of the
//! DS1000E end in bytes that are no samples; the reader omits them.

use super::{FORMAT, dt_s, factor, field, record, some};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Record, Scale};

/// Where the fields of a header are.
struct Layout {
    channel_heads: usize,
    /// Flags of a channel: switched on; inverted during the measurement.
    on: usize,
    inverted: usize,
    /// Code at 0 V of a channel in the middle of the screen.
    zero: f64,
}

/// Where the fields of a time base are.
struct TimeBase {
    rate: usize,
    offset: usize,
    measured_offset: usize,
}

const B: Layout = Layout { channel_heads: 68, on: 14, inverted: 15, zero: 99.0 };
const B_TIME: TimeBase = TimeBase { rate: 180, offset: 172, measured_offset: 192 };
const B_POINTS: usize = 60;
const B_DATA: u64 = 420;
/// Least depth of its memory.
const B_LEAST_POINTS: u32 = 1 << 12;

const E: Layout = Layout { channel_heads: 36, on: 13, inverted: 14, zero: 125.0 };
const E_TIME: TimeBase = TimeBase { rate: 100, offset: 92, measured_offset: 112 };
const E_POINTS: usize = 28;
const E_DATA: u64 = 276;
/// Fields of the DS1000D and DS1000E only: how far a rolling capture got; depth and time base of the second channel,
/// which apply when each channel has a trigger of its own.
const E_ROLL_STOP: usize = 20;
const E_TRIGGER_MODE: usize = 142;
const ALTERNATING: u8 = 4;
const E_POINTS_2: usize = 232;
const E_TIME_2: TimeBase = TimeBase { rate: 252, offset: 244, measured_offset: 264 };

/// Start of the samples of a DS1000C; sixteen bytes later if the file begins like a DS1000E.
const C_DATA: u64 = 256;
const C_PADDING: u64 = 16;

/// Bytes of a channel in the header.
const CHANNEL_BYTES: usize = 24;
/// Codes per division of the screen.
const CODES_PER_DIVISION: f64 = 25.0;

/// The four channels of a DS1000B, each at its own place even if others are off.
pub(super) fn records_b(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let fields = Numbers::head(input, B_DATA)?;
    let points = fields.u32(B_POINTS);
    // Behind the four channels lies a fifth stretch of their length, whose content is not known.
    let channels = B_DATA + 4 * u64::from(points);
    let has_fifth = points >= B_LEAST_POINTS && input.length() == channels + u64::from(points);
    let fifth = if has_fifth { u64::from(points) } else { 0 };
    input.uses(B_DATA..(channels + fifth).min(input.length()));
    let mut records = Vec::new();
    for number in 0..4 {
        if B.is_on(&fields, number) {
            let mut head = B.head(&fields, number, points)?;
            head.instrument = fields.text(4, 8);
            let t0_s = B_TIME.place(&fields, &mut head, points)?;
            let byte_offset = B_DATA + number as u64 * u64::from(points);
            records.push(record(input, head, t0_s, (byte_offset, 1))?);
        }
    }
    some(records, B.channel_heads + B.on)
}

/// The two channels of the other models; a channel that is off takes no space.
pub(super) fn records_e(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let fields = Numbers::head(input, C_DATA)?;
    let points = fields.u32(E_POINTS);
    let on = (0..2).filter(|number| E.is_on(&fields, *number)).count() as u64;
    let padded = C_DATA + C_PADDING;
    if fields.u8(0) == 0xA1 {
        return two_channels(input, &fields, [points; 2], C_DATA);
    } else if input.length() == padded + on * u64::from(points) {
        input.uses(C_DATA..padded);
        return two_channels(input, &fields, [points; 2], padded);
    }
    let fields = Numbers::head(input, E_DATA)?;
    let points_2 = match fields.u32(E_POINTS_2) {
        0 => points,
        other => other,
    };
    two_channels(input, &fields, [points, points_2], E_DATA)
}

fn two_channels(
    input: &mut dyn Input,
    fields: &Numbers,
    depths: [u32; 2],
    data: u64,
) -> Result<Vec<Record>, FormatError> {
    let is_e = data == E_DATA;
    // The file has two bytes more than the header gives, which are no samples.
    let skipped = match fields.u32(E_ROLL_STOP) {
        stop if is_e && stop > 0 => u64::from(stop) + 2,
        _ => 0,
    };
    let (mut records, mut byte_offset) = (Vec::new(), data);
    for (number, depth) in depths.into_iter().enumerate().filter(|(number, _)| E.is_on(fields, *number)) {
        let valid = u32::try_from(u64::from(depth).saturating_sub(skipped)).unwrap_or(0);
        if valid == 0 {
            let at = if skipped > 0 { E_ROLL_STOP } else { E_POINTS };
            return Err(field(at, format!("CH{} has no samples: {skipped} of {depth} are none", number + 1)));
        }
        let mut head = E.head(fields, number, valid)?;
        head.t0_nominal = true;
        let own_trigger = is_e && number == 1 && fields.u8(E_TRIGGER_MODE) == ALTERNATING;
        let time = if own_trigger { &E_TIME_2 } else { &E_TIME };
        let t0_s = time.place(fields, &mut head, depth)?;
        records.push(record(input, head, t0_s, (byte_offset, 1))?);
        let next = byte_offset + u64::from(depth);
        input.uses(byte_offset..next.min(input.length()));
        byte_offset = next;
    }
    some(records, E.channel_heads + E.on)
}

impl Layout {
    fn is_on(&self, fields: &Numbers, number: usize) -> bool {
        fields.u8(self.channel_heads + number * CHANNEL_BYTES + self.on) != 0
    }

    fn head(&self, fields: &Numbers, number: usize, samples: u32) -> Result<Head, FormatError> {
        let at = self.channel_heads + number * CHANNEL_BYTES;
        let probe = factor(fields, at + 8, "the probe's factor")?;
        let scale = match fields.i32(at + 16) {
            0 => return Err(field(at + 16, "the scale is 0 V/div; save the capture again")),
            scale => 1e-6 * f64::from(scale) * probe,
        };
        let position = f64::from(fields.i16(at + 20));
        let gain = scale / CODES_PER_DIVISION;
        let upright = fields.u8(at + self.inverted) == 0;
        Ok(Head {
            channel: Some(format!("CH{}", number + 1)),
            unit: upright.then(|| "V".to_owned()),
            scale: upright.then_some(Scale { gain: -gain, offset: gain * (self.zero - position) }),
            header_gain: Some(scale),
            header_offset: Some(position),
            ..Head::new(FORMAT, CodeType::U8, samples as usize)
        })
    }
}

impl TimeBase {
    /// Sets the time between samples in the head. Returns the time of sample 0 of a memory of this depth.
    fn place(&self, fields: &Numbers, head: &mut Head, depth: u32) -> Result<Option<f64>, FormatError> {
        let dt_s = dt_s(fields, self.rate, "the sample rate", 1.0)?;
        head.dt_s = Some(dt_s);
        let offset = fields.i64(self.measured_offset);
        let is_unmoved = offset == fields.i64(self.offset);
        Ok(is_unmoved.then(|| 1e-12 * offset as f64 - f64::from(depth) * dt_s / 2.0))
    }
}
