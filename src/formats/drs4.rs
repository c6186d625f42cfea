//! Events of a DRS4 evaluation board (`.dat`, as DRSOsc saves them since 2014: `DRS2`).
//!
//! A file begins with the widths of the 1024 sampling cells of each channel that was saved, for every board. Each event
//! has a date, the middle of the range of voltages, for each board the cell in which sampling stopped, and for each
//! channel a scaler and 1024 codes of 16 bits, the first one of the cell after the stop.
//!
//! # Time
//!
//! Cells differ in width by a third and more, and a record has one time between samples. The reader therefore
//! interpolates the codes to equal steps: a cubic through the two samples on either side, limited to the range of the
//! converter. The step is the mean width of a cell of the board's first channel. All channels of a board sample cell 0
//! at the same moment. Sample i of every channel of an event lies i steps after sample 0 of the first channel, so that
//! times of channels can be compared. Samples beyond a channel's own ends repeat its first or last code.
//!
//! The file does not say where in the record the trigger is: `t0_s` is `None`, and so is `trigger_s`, since the events
//! have only the time of a computer. volts = code / 65536 + middle - 0.5. Scalers are not read. Each channel of an
//! event is a record; segments count events.
//!
//! Refused: records of 2048 cells, whose widths the file does not hold, files of before 2014 (`TIME`), and those of
//! WaveDREAM boards (`DRS8`).
//!
//! Source: Paul Scherrer Institute, the example `read_binary` of the DRS4 software, as laboratories use it. No real
//! file could be had: tested on files that the tests build.

mod cells;

use std::collections::BTreeMap;
use std::sync::Arc;

use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record, Scale};
use cells::{CELLS, Cells, Channel};

/// The reader.
pub struct Drs4;

const START: &[u8] = b"DRS2TIME";
const EVENT: &[u8] = b"EHDR";
const BOARD: &[u8] = b"B#";
const STOP: &[u8] = b"T#";
/// Bytes of a tag with its number, of an event's head, of a channel's tag and scaler.
const TAG: u64 = 4;
const EVENT_HEAD: u64 = 24;
const CHANNEL_HEAD: u64 = 8;
/// Bytes of a channel's codes, and of its cells' widths.
const CODES: u64 = 2 * CELLS as u64;
const WIDTHS: u64 = 4 * CELLS as u64;
/// Codes per volt.
const CODES_PER_V: f64 = 65_536.0;

impl Reader for Drs4 {
    fn format(&self) -> &'static str {
        "drs4"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(START)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let file = File::open(input)?;
        let count = file.count(input)?;
        let channels: usize = file.boards.iter().map(|board| board.channels.len()).sum();
        let mut records = Vec::with_capacity(count as usize * channels);
        let mut heads: BTreeMap<(usize, usize, i16), Arc<Head>> = BTreeMap::new();
        for number in 0..count {
            let at = file.events + number * file.event_bytes;
            let event = Numbers::little(input.bytes("an event", at, EVENT_HEAD)?, at);
            let middle_mv = event.i16(22);
            let mut at = at + EVENT_HEAD;
            for (b, board) in file.boards.iter().enumerate() {
                let stop = Numbers::little(input.bytes("a board's head", at, 2 * TAG)?, at).u16(6);
                at += 2 * TAG;
                for (c, channel) in board.channels.iter().enumerate() {
                    let new = || Arc::new(file.head(board, channel, &event, middle_mv));
                    let head = heads.entry((b, c, middle_mv)).or_insert_with(new);
                    let codes = at + CHANNEL_HEAD;
                    input.uses(at..codes + CODES);
                    let (first, own) = (Arc::clone(&board.channels[0].1), Arc::clone(&channel.1));
                    records.push(Record {
                        head: Arc::clone(head),
                        segment: (count > 1).then_some(number as u32),
                        t0_s: None,
                        trigger_s: None,
                        payload: Payload::Packed(Arc::new(Cells { at: codes, stop: stop.into(), own, first })),
                    });
                    at = codes + CODES;
                }
            }
        }
        Ok(records)
    }
}

/// A board: its serial number, and the tags and cells of its channels.
struct Board {
    serial: u16,
    channels: Vec<([u8; 4], Arc<Channel>)>,
}

/// What every event of a file has.
struct File {
    boards: Vec<Board>,
    /// Where the first event begins.
    events: u64,
    event_bytes: u64,
}

impl File {
    fn open(input: &mut dyn Input) -> Result<Self, FormatError> {
        let mut at = START.len() as u64;
        input.bytes("the head", 0, at)?;
        let mut boards: Vec<Board> = Vec::new();
        loop {
            let tag = input.peek("the widths of the cells", at, TAG)?;
            if tag == EVENT {
                break;
            }
            input.uses(at..at + TAG);
            if tag.starts_with(BOARD) {
                boards.push(Board { serial: u16::from_le_bytes([tag[2], tag[3]]), channels: Vec::new() });
                at += TAG;
                continue;
            }
            let (Some(board), Some(name)) = (boards.last_mut(), channel_tag(&tag)) else {
                return Err(field(at, "a board, a channel or an event should begin here; copy the file again"));
            };
            let widths = input.bytes("the widths of the cells", at + TAG, WIDTHS)?;
            let channel = Channel::new(&widths).map_err(|problem| field(at + TAG, &problem))?;
            board.channels.push((name, Arc::new(channel)));
            at += TAG + WIDTHS;
        }
        let bytes = |board: &Board| 2 * TAG + board.channels.len() as u64 * (CHANNEL_HEAD + CODES);
        let event_bytes = EVENT_HEAD + boards.iter().map(bytes).sum::<u64>();
        if boards.iter().all(|board| board.channels.is_empty()) {
            return Err(field(at, "no channel has widths of its cells; calibrate the board's times, and save again"));
        }
        Ok(Self { boards, events: at, event_bytes })
    }

    /// Number of whole events, each of which has the boards and channels of the file.
    fn count(&self, input: &mut dyn Input) -> Result<u64, FormatError> {
        let mut count = 0;
        loop {
            let at = self.events + count * self.event_bytes;
            let left = input.length() - at;
            if left < TAG {
                return Ok(count); // what is left is reported
            }
            let tag = input.peek("an event", at, TAG)?;
            if tag == [0; TAG as usize] && count > 0 {
                return Ok(count);
            }
            if tag != EVENT {
                return Err(field(at, "an event (EHDR) should begin here; copy the file again"));
            }
            if left < self.event_bytes {
                if count == 0 {
                    let (needed, length) = (self.event_bytes, input.length());
                    return Err(FormatError::Truncated { what: "an event", byte_offset: at, needed, length });
                }
                input.cut_short(at, "event", count);
                return Ok(count);
            }
            self.check(input, at + EVENT_HEAD)?;
            count += 1;
        }
    }

    /// Checks the tags of an event behind its head.
    fn check(&self, input: &mut dyn Input, mut at: u64) -> Result<(), FormatError> {
        for board in &self.boards {
            let head = Numbers::little(input.peek("a board's head", at, 2 * TAG)?, at);
            if !head.bytes.starts_with(BOARD) || head.u16(2) != board.serial || head.bytes[4..6] != *STOP {
                return Err(head.refuse(0, format!("board {} should begin here; copy the file again", board.serial)));
            }
            if usize::from(head.u16(6)) >= CELLS {
                return Err(head.refuse(6, format!("sampling stopped in cell {} of {CELLS}", head.u16(6))));
            }
            at += 2 * TAG;
            for (name, _) in &board.channels {
                if input.peek("a channel", at, TAG)? != name {
                    let name = String::from_utf8_lossy(name);
                    return Err(field(at, &format!("channel {name} should begin here; copy the file again")));
                }
                at += CHANNEL_HEAD + CODES;
            }
        }
        Ok(())
    }

    fn head(&self, board: &Board, channel: &([u8; 4], Arc<Channel>), event: &Numbers, middle_mv: i16) -> Head {
        let number = channel.0[3] - b'0';
        let name = match self.boards.len() {
            1 => format!("CH{number}"),
            _ => format!("board{}/CH{number}", board.serial),
        };
        let offset = f64::from(middle_mv) / 1000.0 - 0.5;
        Head {
            instrument: Some(format!("DRS4 evaluation board {}", board.serial)),
            channel: Some(name),
            unit: Some("V".to_owned()),
            dt_s: Some(board.channels[0].1.mean_s()),
            scale: Some(Scale { gain: 1.0 / CODES_PER_V, offset }),
            header_offset: Some(f64::from(middle_mv) / 1000.0),
            rails: CodeType::U16.limits(),
            acquired_at: date(event),
            ..Head::new(Drs4.format(), CodeType::F32, CELLS)
        }
    }
}

/// The tag of a channel, if it is one: `C001` to `C009`.
fn channel_tag(tag: &[u8]) -> Option<[u8; 4]> {
    let tag: [u8; 4] = tag.try_into().ok()?;
    (tag.starts_with(b"C00") && (b'1'..=b'9').contains(&tag[3])).then_some(tag)
}

/// Time of an event by the clock of its computer, in ISO 8601.
fn date(event: &Numbers) -> Option<String> {
    let [year, month, day, hour, minute, second, ms] = [8, 10, 12, 14, 16, 18, 20].map(|at| event.u16(at));
    let is_date = (2000..10_000).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let is_time = hour < 24 && minute < 60 && second < 61 && ms < 1000;
    (is_date && is_time).then(|| format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}"))
}

fn field(byte_offset: u64, problem: &str) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.to_owned() }
}

#[cfg(test)]
mod tests;
