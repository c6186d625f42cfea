//! CAEN CoMPASS binary lists (`.BIN`) with waveforms, of DPP firmware.
//!
//! A file begins with a word 0xCAEx, whose last four bits say what an event holds: energy in channels, calibrated
//! energy, short-gate energy, waveform. Then event after event, all little-endian: board, channel, time (ps, 64 bits),
//! the energies, flags, and a code, the number of samples and 16 bit samples of the waveform.
//!
//! Each waveform is a record of channel `ch5`, or `board1/ch5` where there are several boards; segments count the
//! records of a channel, and `trigger_s` is the time of an event after the channel's first one. Events without samples
//! have no record. Energies and flags are not read.
//!
//! The file has no volts, no sample rate and no trigger position: values are the codes; `dt_s` and `t0_s` are `None`.
//! The campaign must give rate, range and pre-trigger, which are in the `settings.xml` of the run. A code other than 1
//! means that CoMPASS saved something else than the input, such as a filtered signal: a remark says so.
//!
//! Lists without waveforms are refused. So are files without the first word (CoMPASS 1, and all but the first file of a
//! run that is saved in files of limited size), since nothing in them says what an event holds: no reader knows them.
//!
//! Source: public readers of the format (`pygama`, `legend-daq2lh5`). No real file could be had: tested on files that
//! the tests build.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::beam;
use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record};

/// The reader.
pub struct CaenCompass;

/// Bytes of the first word.
const START: u64 = 2;
/// What an event holds, as bits of the first word, and the bytes that it takes.
const ENERGIES: [(u8, u64); 3] = [(1, 2), (2, 8), (4, 2)];
const WAVEFORM: u8 = 8;
/// Bytes of an event's head: before the energies, of the flags, of code and number of samples.
const BEFORE_ENERGIES: u64 = 12;
const FLAGS: u64 = 4;
const WAVE_HEAD: u64 = 5;
/// Code of a waveform that is the input.
const INPUT: u8 = 1;
/// Boards and channels are numbered below these.
const BOARDS: u16 = 32;
const CHANNELS: u16 = 64;
/// No board records longer events.
const MAX_SAMPLES: u32 = 100_000_000;

impl Reader for CaenCompass {
    fn format(&self) -> &'static str {
        "caen-compass"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.len() >= 2 && head[0] & 0xF0 == 0xE0 && head[1] == 0xCA
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let holds = input.bytes("the first word", 0, START)?[0];
        if holds & WAVEFORM == 0 {
            let fix = "record with waveforms (Save waves), or make histograms of the times and save them as .npy";
            return Err(FormatError::NotRead { what: "a CoMPASS list of events without waveforms", fix });
        }
        let energies: u64 = ENERGIES.iter().filter(|(bit, _)| holds & bit != 0).map(|(_, bytes)| bytes).sum();
        let list = List { head: BEFORE_ENERGIES + energies + FLAGS + WAVE_HEAD };
        // Counted before any record is kept: a growing vector could take more memory than the file is long.
        let mut channels: BTreeMap<(u16, u16), Channel> = BTreeMap::new();
        let (mut events, mut waveforms, mut other_code) = (0, 0, None);
        let end = list.walk(
            input,
            &mut |input, event| {
                let channel = channels.entry((event.board, event.channel)).or_insert(Channel::first(event));
                if event.samples > 0 {
                    channel.records += 1;
                    waveforms += 1;
                    if event.code != INPUT && other_code.is_none() {
                        other_code = Some((event.at, event.code));
                    }
                }
                events += 1;
                input.uses(event.at..event.data + event.bytes());
            },
            None,
        )?;
        if let Some((at, code)) = other_code {
            let problem = format!(
                "waveforms of code {code}, where 1 is the input: CoMPASS saved another signal; record the input if \
                 times are to be taken from it"
            );
            input.remark(at, problem);
        }
        if waveforms == 0 || beam::are_too_many(waveforms, input.length()) {
            let problem = format!("{waveforms} waveforms in {events} events of {end} bytes; record waveforms again");
            return Err(FormatError::Field { byte_offset: START, problem });
        }
        let several = channels.keys().any(|(board, _)| Some(board) != channels.keys().next().map(|(board, _)| board));
        let mut heads: BTreeMap<(u16, u16, u32), Arc<Head>> = BTreeMap::new();
        let mut records = Vec::with_capacity(waveforms as usize);
        list.walk(
            input,
            &mut |_, event| {
                let key = (event.board, event.channel, event.samples);
                let Some(channel) = channels.get_mut(&(key.0, key.1)).filter(|_| event.samples > 0) else { return };
                let head = heads.entry(key).or_insert_with(|| Arc::new(self.head(event, several)));
                records.push(Record {
                    head: Arc::clone(head),
                    segment: (channel.records > 1).then_some(channel.next),
                    t0_s: None,
                    trigger_s: (channel.records > 1).then(|| event.time_s(channel.first_ps)),
                    payload: Payload::File { byte_offset: event.data, stride: 2, big_endian: false },
                });
                channel.next += 1;
            },
            Some(end),
        )?;
        Ok(records)
    }
}

impl CaenCompass {
    fn head(&self, event: &Event, several_boards: bool) -> Head {
        let Event { board, channel, samples, .. } = event;
        let name = if several_boards { format!("board{board}/ch{channel}") } else { format!("ch{channel}") };
        Head {
            channel: Some(name),
            unit: Some("adc".to_owned()),
            ..Head::new(self.format(), CodeType::U16, *samples as usize)
        }
    }
}

/// A channel of a board.
struct Channel {
    first_ps: u64,
    records: u64,
    /// Number of its next record.
    next: u32,
}

impl Channel {
    fn first(event: &Event) -> Self {
        Self { first_ps: event.time_ps, records: 0, next: 0 }
    }
}

/// An event, and where it and its samples begin.
struct Event {
    at: u64,
    data: u64,
    board: u16,
    channel: u16,
    time_ps: u64,
    code: u8,
    samples: u32,
}

impl Event {
    fn bytes(&self) -> u64 {
        2 * u64::from(self.samples)
    }

    /// Time after another one. Events of a file need not be in order.
    fn time_s(&self, since_ps: u64) -> f64 {
        let after = self.time_ps.abs_diff(since_ps) as f64 * 1e-12;
        if self.time_ps < since_ps { -after } else { after }
    }
}

/// The events of a file.
struct List {
    /// Bytes of an event's head.
    head: u64,
}

impl List {
    /// Passes on every event up to `end`, or up to the end of the file. Returns where the last whole one ends.
    fn walk(
        &self,
        input: &mut dyn Input,
        take: &mut dyn FnMut(&mut dyn Input, &Event),
        end: Option<u64>,
    ) -> Result<u64, FormatError> {
        let (mut at, mut count) = (START, 0);
        while at < end.unwrap_or(input.length()) {
            let event = match self.event(input, at) {
                Err(FormatError::Truncated { .. }) if count > 0 => {
                    input.cut_short(at, "event", count);
                    break;
                }
                event => event?,
            };
            let Some(event) = event else { break };
            at = event.data + event.bytes();
            count += 1;
            take(input, &event);
        }
        Ok(at)
    }

    /// The event at `at`; `None` if zeros follow instead.
    fn event(&self, input: &mut dyn Input, at: u64) -> Result<Option<Event>, FormatError> {
        let head = Numbers::little(input.peek("an event's head", at, self.head)?, at);
        if head.bytes.iter().all(|byte| *byte == 0) {
            return Ok(None);
        }
        let wave = (self.head - WAVE_HEAD) as usize;
        let (board, channel, samples) = (head.u16(0), head.u16(2), head.u32(wave + 1));
        if board >= BOARDS || channel >= CHANNELS {
            let problem =
                format!("channel {channel} of board {board} is none: is the file put together of two? Copy it again");
            return Err(head.refuse(0, problem));
        }
        if samples > MAX_SAMPLES {
            return Err(head.refuse(wave + 1, format!("an event of {samples} samples; copy the file again")));
        }
        let (data, length) = (at + self.head, input.length());
        let needed = self.head + 2 * u64::from(samples);
        if at + needed > length {
            return Err(FormatError::Truncated { what: "an event", byte_offset: at, needed, length });
        }
        Ok(Some(Event { at, data, board, channel, time_ps: head.u64(4), code: head.u8(wave), samples }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal, source};

    /// An event whose energies take so many bytes.
    fn event(energies: usize, board: u16, channel: u16, time_ps: u64, samples: &[u16]) -> Vec<u8> {
        let mut bytes = [board.to_le_bytes(), channel.to_le_bytes()].concat();
        bytes.extend(time_ps.to_le_bytes());
        bytes.extend(vec![7; energies]);
        bytes.extend([0, 0x40, 0, 0, INPUT]);
        bytes.extend((samples.len() as u32).to_le_bytes());
        bytes.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
        bytes
    }

    fn list(holds: u8, events: &[Vec<u8>]) -> Vec<u8> {
        [&[0xE0 | holds, 0xCA], &events.concat()[..]].concat()
    }

    fn three_events(holds: u8, energies: usize) -> Vec<u8> {
        let events = [
            event(energies, 0, 1, 2_000_000, &[100, 101, 16_383]),
            event(energies, 0, 0, 3_000_000, &[9]),
            event(energies, 0, 1, 5_000_000, &[200, 201, 202]),
        ];
        list(holds | WAVEFORM, &events)
    }

    #[test]
    fn waveforms_of_a_channel_are_segments() {
        for (holds, energies) in [(0, 0), (1, 2), (2, 8), (3, 10), (5, 4), (7, 12)] {
            let bytes = three_events(holds, energies);
            assert!(CaenCompass.recognises(&bytes));
            let records = decode(&CaenCompass, &bytes);
            let (record, values) = &records[2];
            assert_eq!((&records[0].1[..], &values[..]), (&[100.0, 101.0, 16_383.0][..], &[200.0, 201.0, 202.0][..]));
            assert_eq!((record.head.channel.as_deref(), record.segment), (Some("ch1"), Some(1)));
            assert!((record.trigger_s.unwrap() - 3e-6).abs() < 1e-18 && record.head.dt_s.is_none());
            assert_eq!((records[1].0.segment, records[1].0.trigger_s), (None, None));
        }
    }

    #[test]
    fn boards_are_named_where_there_are_several() {
        let late = event(2, 1, 63, 5, &[2]);
        let bytes = list(9, &[event(2, 0, 63, 10, &[1]), late, event(2, 1, 63, 1, &[3]), event(2, 0, 5, 1, &[])]);
        let records = decode(&CaenCompass, &bytes);
        let names: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap()).collect();
        assert_eq!(names, ["board0/ch63", "board1/ch63", "board1/ch63"]);
        assert!((records[2].0.trigger_s.unwrap() + 4e-12).abs() < 1e-24);
    }

    #[test]
    fn what_is_unusual_or_wrong_is_reported() {
        let error = refusal(&CaenCompass, &list(5, &[vec![1; 40]]));
        assert!(error.contains("events without waveforms") && error.contains("Save waves"), "{error}");
        assert!(refusal(&CaenCompass, &list(9, &[event(2, 0, 64, 0, &[1])])).contains("byte 2: channel 64"));
        assert!(refusal(&CaenCompass, &list(9, &[event(2, 0, 1, 9, &[])])).contains("0 waveforms in 1 events"));
        let cut = list(9, &[event(2, 0, 1, 0, &[1, 2, 3])]);
        assert!(refusal(&CaenCompass, &cut[..cut.len() - 1]).contains("cut short: an event needs 29 bytes"));
        let mut filtered = three_events(1, 2);
        filtered[2 + 18] = 4;
        let contents = crate::contents(&mut source(&filtered)).unwrap();
        assert!(contents.remarks.len() == 1 && contents.remarks[0].problem.contains("of code 4"));
    }

    #[test]
    fn whole_events_before_a_cut_or_zeros_are_read() {
        let bytes = three_events(1, 2);
        for (changed, is_cut) in [(bytes[..bytes.len() - 1].to_vec(), true), ([&bytes[..], &[0; 50]].concat(), false)] {
            let contents = crate::contents(&mut source(&changed)).unwrap();
            assert_eq!((contents.records.len(), contents.remarks.len()), (if is_cut { 2 } else { 3 }, 1));
            assert_eq!(contents.remarks[0].is_cut, is_cut, "{:?}", contents.remarks);
        }
    }

    #[test]
    fn hostile_files_are_refused_or_decoded_whole() {
        for (holds, energies) in [(1, 2), (7, 12)] {
            cut_everywhere(&CaenCompass, &three_events(holds, energies));
            change_anywhere(&CaenCompass, &three_events(holds, energies), 5000);
        }
    }
}
