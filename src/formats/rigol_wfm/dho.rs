//! DHO800 and DHO1000: small blocks of settings, each packed by zlib, then u16 codes, interleaved channel by channel.
//!
//! volts = k * (code - 32768) + centre. DHO800: k = n / 7.5e12, centre = -m * 1e-9; DHO1000: k = n / 7.5e11, centre =
//! -m * 1e-8; n and m are in the channel's block. dt = ticks * 0.8 ns (DHO800) or 10 ns (DHO1000). One DHO824 capture
//! was compared with its .bin, which has volts. All samples agree to within the .bin's rounding of the centre to a
//! whole code (1.4 uV of 300 mV), and dt is equal.
//!
//! No field is known that gives the position of the trigger in the memory. In that capture it is in the middle, by its
//! .bin (half of the samples precede it). The same holds for any capture with the trigger at 50 % and no delay.
//! Therefore `t0_s` is marked as nominal. All channels share their times. The .bin has the time of sample 0: save that
//! if times matter.

use std::io::Read;

use flate2::read::ZlibDecoder;

use super::{CHANNELS, FORMAT, field, record, some};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Record, Scale};

const HEAD_BYTES: u64 = 24;
const BLOCK_HEAD_BYTES: u64 = 12;
/// Bytes of a channel's block that are read: whether it is on (byte 0), n as i64 at 1, m as i64 at 38.
const CHANNEL_BYTES: u64 = 46;
/// Type of a channel's block.
const DHO800_CHANNEL: u16 = 5;
const DHO1000_CHANNEL: u16 = 9;
/// Bytes of the header of the codes.
const DATA_HEAD_BYTES: u64 = 40;
const CODE_BYTES: u64 = 2;
/// Code in the middle of the screen.
const MIDDLE: f64 = 32768.0;
/// Bytes of padding that are read at a time.
const PIECE_BYTES: u64 = 1 << 12;

/// Whether the first block of settings is plausible: files of other makes begin with the same four bytes.
pub(super) fn first_block_is_plausible(head: &[u8]) -> bool {
    let Some(block) = head.get(24..37) else { return false };
    let [id, _, unpacked, packed, length, reserved] =
        [0, 2, 4, 6, 8, 10].map(|at| u16::from_le_bytes([block[at], block[at + 1]]));
    let zlib = block[12] == 0x78;
    id > 0 && reserved == 0 && packed > 0 && packed <= length && (packed == unpacked || packed < unpacked && zlib)
}

/// A channel's block.
struct Channel {
    number: usize,
    is_on: bool,
    is_dho800: bool,
    gain: f64,
    centre: f64,
}

impl Channel {
    fn head(&self, samples: usize, ticks: u32) -> Head {
        let tick_s = if self.is_dho800 { 8e-10 } else { 1e-8 };
        Head {
            channel: Some(format!("CH{}", self.number)),
            unit: Some("V".to_owned()),
            dt_s: Some(f64::from(ticks) * tick_s),
            t0_nominal: true,
            scale: Some(Scale { gain: self.gain, offset: self.centre - self.gain * MIDDLE }),
            header_gain: Some(self.gain),
            header_offset: Some(self.centre),
            ..Head::new(FORMAT, CodeType::U16, samples)
        }
    }
}

/// Returns the records of the channels that are on.
pub(super) fn records(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let (mut channels, end) = blocks(input)?;
    let data = Data::find(input, end)?;
    input.uses(end..data.start + DATA_HEAD_BYTES);
    // Older files do not mark channels as on; there, every channel with a block is on.
    if channels.iter().filter(|channel| channel.is_on).count() == data.channels {
        channels.retain(|channel| channel.is_on);
    }
    if channels.len() != data.channels {
        let problem = format!("{} channels have samples, but {} settings; save as .bin", data.channels, channels.len());
        return Err(field(data.start as usize, problem));
    }
    channels.sort_by_key(|channel| channel.number);
    let stride = data.channels as u64 * CODE_BYTES;
    let mut records = Vec::new();
    for (lane, channel) in channels.iter().enumerate() {
        let byte_offset = data.start + DATA_HEAD_BYTES + lane as u64 * CODE_BYTES;
        let head = channel.head(data.samples, data.ticks);
        let t0_s = head.dt_s.map(|dt_s| -(data.samples as f64) * dt_s / 2.0);
        records.push(record(input, head, t0_s, (byte_offset, stride))?);
    }
    some(records, data.start as usize)
}

/// Returns the channels' blocks, and where the blocks end.
fn blocks(input: &mut dyn Input) -> Result<(Vec<Channel>, u64), FormatError> {
    let mut channels: Vec<Channel> = Vec::new();
    input.uses(0..HEAD_BYTES);
    let mut at = HEAD_BYTES;
    loop {
        let head = Numbers::little(input.bytes("a block of settings", at, BLOCK_HEAD_BYTES)?, 0);
        let [id, kind, unpacked, packed, length] = [0, 2, 4, 6, 8].map(|at| head.u16(at));
        if packed == 0 && length == 0 {
            return Ok((channels, at));
        }
        if packed > length {
            let problem = format!("a block of {length} bytes cannot hold {packed}; copy the file again");
            return Err(field(at as usize + 6, problem));
        }
        let content = at + BLOCK_HEAD_BYTES;
        let number = usize::from(id);
        if (1..=CHANNELS).contains(&number) && [DHO800_CHANNEL, DHO1000_CHANNEL].contains(&kind) {
            if channels.iter().any(|channel| channel.number == number) {
                return Err(field(at as usize, format!("CH{number} has two blocks of settings; save as .bin")));
            }
            let bytes = input.bytes("a channel's settings", content, u64::from(packed))?;
            channels.push(channel(&bytes, packed < unpacked, (number, kind), content)?);
        }
        input.uses(content..(content + u64::from(length)).min(input.length()));
        at = content + u64::from(length);
    }
}

fn channel(bytes: &[u8], packed: bool, block: (usize, u16), at: u64) -> Result<Channel, FormatError> {
    let mut content = Vec::new();
    let read = if packed {
        ZlibDecoder::new(bytes).take(CHANNEL_BYTES).read_to_end(&mut content)
    } else {
        bytes.take(CHANNEL_BYTES).read_to_end(&mut content)
    };
    let (number, kind) = block;
    if read.is_err() || content.len() as u64 != CHANNEL_BYTES {
        let problem = format!("the settings of CH{number} cannot be unpacked; copy the file from the instrument again");
        return Err(field(at as usize, problem));
    }
    let content = Numbers::little(content, 0);
    let is_dho800 = kind == DHO800_CHANNEL;
    let (numerator, centre) = (content.i64(1) as f64, content.i64(38) as f64);
    if numerator == 0.0 {
        return Err(field(at as usize, format!("the scale of CH{number} is 0; save the capture again")));
    }
    Ok(Channel {
        number,
        is_on: content.u8(0) == 1,
        is_dho800,
        gain: numerator / if is_dho800 { 7.5e12 } else { 7.5e11 },
        centre: -centre / if is_dho800 { 1e9 } else { 1e8 },
    })
}

/// The header of the codes.
struct Data {
    start: u64,
    channels: usize,
    samples: usize,
    ticks: u32,
}

impl Data {
    /// Finds the header after the padding of zeros. Its own first bytes may be zeros too, so every possible start is
    /// tried.
    fn find(input: &mut dyn Input, blocks_end: u64) -> Result<Self, FormatError> {
        let nonzero = first_nonzero(input, blocks_end)?;
        let starts = (0..8).filter_map(|zeros| nonzero.checked_sub(zeros)).filter(|start| *start >= blocks_end);
        let mut candidate: Option<Self> = None;
        for start in starts {
            if input.length().saturating_sub(start) < DATA_HEAD_BYTES {
                continue;
            }
            if let Some(data) =
                Self::read(&Numbers::little(input.peek("the head of the samples", start, DATA_HEAD_BYTES)?, 0), start)
            {
                if data.end() == Some(input.length()) {
                    return Ok(data);
                }
                candidate = candidate.or(Some(data));
            }
        }
        candidate.ok_or_else(|| {
            field(nonzero as usize, "here should be the number of samples; the file may be cut short: copy it again")
        })
    }

    fn read(fields: &Numbers, start: u64) -> Option<Self> {
        let (total, ticks) = (fields.i64(0), fields.u32(16));
        let (samples, again) = (fields.u32(24), fields.u32(28));
        if total <= 0 || samples == 0 || samples != again || ticks == 0 {
            return None;
        }
        // A DHO1000 counts about 64 samples more than it stores, hence the rounding.
        let channels = (total as u64).checked_add(u64::from(samples) / 2)? / u64::from(samples);
        let channels = usize::try_from(channels).ok().filter(|channels| (1..=CHANNELS).contains(channels))?;
        Some(Self { start, channels, samples: samples as usize, ticks })
    }

    fn end(&self) -> Option<u64> {
        let bytes = (self.samples as u64).checked_mul(self.channels as u64)?.checked_mul(CODE_BYTES)?;
        self.start.checked_add(DATA_HEAD_BYTES)?.checked_add(bytes)
    }
}

fn first_nonzero(input: &mut dyn Input, from: u64) -> Result<u64, FormatError> {
    let mut at = from;
    while at < input.length() {
        let piece = input.peek("padding", at, PIECE_BYTES.min(input.length() - at))?;
        if let Some(position) = piece.iter().position(|byte| *byte != 0) {
            return Ok(at + position as u64);
        }
        at += piece.len() as u64;
    }
    Err(FormatError::Truncated {
        what: "the head of the samples",
        byte_offset: from,
        needed: DATA_HEAD_BYTES,
        length: at,
    })
}
