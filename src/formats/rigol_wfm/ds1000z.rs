//! DS1000Z and MSO1000Z: channels interleaved byte by byte.
//!
//! The file gives neither volts nor the time of sample 0, so `scale` and `t0_s` are `None`; for both, save CSV. Codes
//! rise with volts. All channels of a file share their times.
//!
//! One DS1054Z capture (firmware 00.04.04.SP3, two channels, 1 V/div) was compared with the scope's own CSV, which has
//! the same samples. There a code is 0.0440 V of one channel and 0.0435 V of the other. 0 V is at code 104.6 and 117.2,
//! and the CSV begins 38 samples after the first of the file. The public reading is a code of volts/div / 20, with the
//! middle of the memory at the trigger's delay. It gives 0.050 V, values off by up to 0.4 V, and 128 samples: 3.6 us
//! too early. The CSV is right: its triggering edge is at time 0, within a sample. No field of the header gives its
//! numbers.
//!
//! Lanes: with two channels on, the first one has the odd bytes; with three or four, four bytes are CH4, CH3, CH2, CH1.
//! Records with logic channels are refused by name: how they share the memory is unknown. `dt_s` is 1 / (sample rate in
//! GHz, an f32, * 1e9).

use super::{CHANNELS, FORMAT, dt_s, field, record, some};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Kind, Record};

const HEAD_BYTES: u64 = 0x118;
const MODEL: usize = 8;
const STRUCTURE_SIZE: usize = 0x54;
const ENABLED: usize = 0x58;
const LOGIC: usize = 0x6C;
const ACQUISITION: usize = 0x70;
const DEPTH: usize = 0x74;
const RATE_GHZ: usize = 0x78;
const CHANNEL_HEADS: usize = 0x7C;
const CHANNEL_BYTES: usize = 28;
const HORIZONTAL_SIZE: usize = 0x100;
const HORIZONTAL_OFFSET: usize = 0x104;

/// Returns the records of the channels that are on.
pub(super) fn records(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let fields = Numbers::head(input, HEAD_BYTES)?;
    if fields.u16(STRUCTURE_SIZE) != 0xD8 {
        let size = fields.u16(STRUCTURE_SIZE);
        return Err(field(STRUCTURE_SIZE, format!("a head of {size} bytes is not of a DS1000Z; save as CSV")));
    }
    if fields.u32(LOGIC) != 0 {
        return Err(field(LOGIC, "logic channels are in the record, in a way that is not known; switch them off"));
    }
    let on: Vec<usize> = (0..CHANNELS).filter(|number| fields.u8(ENABLED) >> number & 1 == 1).collect();
    let stride = match on.len() {
        3 => 4,
        count => count.max(1) as u32,
    };
    let depth = fields.u32(DEPTH);
    if depth == 0 || !depth.is_multiple_of(stride) {
        return Err(field(DEPTH, format!("{depth} bytes are no whole number of samples of {} channels", on.len())));
    }
    let data = u64::from(fields.u32(HORIZONTAL_SIZE)) + u64::from(fields.u32(HORIZONTAL_OFFSET));
    if data < HEAD_BYTES {
        return Err(field(HORIZONTAL_OFFSET, format!("samples from byte {data} would lie in the head")));
    }
    // Settings that are not read lie before the samples.
    input.uses(0..data.min(input.length()));
    let mut records = Vec::new();
    for (position, number) in on.iter().enumerate() {
        let lane = match stride {
            4 => CHANNELS - 1 - number,
            _ => on.len() - 1 - position,
        };
        let head = head(&fields, *number, depth / stride)?;
        records.push(record(input, head, None, (data + lane as u64, u64::from(stride)))?);
    }
    some(records, ENABLED)
}

fn head(fields: &Numbers, number: usize, samples: u32) -> Result<Head, FormatError> {
    let at = CHANNEL_HEADS + number * CHANNEL_BYTES;
    let acquisition = fields.u8(ACQUISITION);
    Ok(Head {
        kind: match acquisition {
            0 | 3 => Kind::Waveform,
            1 => Kind::Envelope,
            2 => Kind::Average,
            _ => return Err(field(ACQUISITION, format!("acquisition mode {acquisition} is not known; save as CSV"))),
        },
        instrument: fields.text(MODEL, 20),
        channel: Some(format!("CH{}", number + 1)),
        dt_s: Some(dt_s(fields, RATE_GHZ, "the sample rate", 1e9)?),
        header_gain: Some(fields.finite(at + 8, "the scale", fields.f32(at + 8))?),
        header_offset: Some(fields.finite(at + 12, "the shift", fields.f32(at + 12))?),
        ..Head::new(FORMAT, CodeType::U8, samples as usize)
    })
}
