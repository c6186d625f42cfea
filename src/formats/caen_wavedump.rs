//! CAEN WaveDump binary output: one event after another, each a header of six little-endian words and its 16 bit codes.
//!
//! Words of the header: bytes of the event, header included; board; pattern; channel; event counter; trigger time tag
//! (WaveDump user manual UM2091). One file is one channel, every event is a segment of it, and segments differ in
//! length.
//!
//! The file has no volts, no sample rate and no trigger position: values are the codes; `dt_s`, `t0_s` and `trigger_s`
//! are `None`. The campaign must give rate, range and post-trigger, which are in the `WaveDumpConfig.txt` of the run.
//! The trigger time tag is not read: it wraps, and its tick depends on the board.
//!
//! Boards of the 742 family write floats in place of codes, after WaveDump's corrections of their cells. The values of
//! the first event decide which of both a file holds. Channels of a 742 are numbered within a group of eight, and its
//! trigger input is channel 8; the name of the file says which group it is.
//!
//! Refused where they are recognised: 8 bit boards (721, 731: one byte per code), by codes beyond 14 bits in the
//! first event; files without headers (record with `OUTPUT_FILE_HEADER YES`). Text (`OUTPUT_FILE_FORMAT ASCII`) is for
//! the CSV reader, which gets all `.dat` files that are not recognised. Events of unequal length and floats were tested
//! on files that the tests build; all else on real files of a DT5751.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record};

/// The reader.
pub struct CaenWavedump;

/// Bytes of an event's header.
const HEAD: u64 = 24;
/// Boards are numbered by five bits (GEO), channels up to 64 (740).
const BOARDS: u32 = 32;
const CHANNELS: u32 = 64;
/// Bytes of the longest event that is accepted: no board records more than 100 million samples per channel.
const MAX_EVENT: u32 = 200_000_000;
/// Events after which the counter of a board begins anew.
const COUNTER_WRAPS: u32 = 1 << 24;
/// Largest code of any board with 16 bit codes.
const MAX_CODE: u16 = (1 << 14) - 1;
/// Smallest and largest code that a 742 writes as a float, besides 0: its converter has 12 bits.
const FLOATS: (f32, f32) = (1e-6, 8192.0);
/// How far from their baseline most codes of 8 bits lie.
const NEAR: u8 = 8;
/// Bytes of the first event that are searched for codes beyond `MAX_CODE`.
const LOOKED_AT: u64 = 1 << 16;

impl Reader for CaenWavedump {
    fn format(&self) -> &'static str {
        "caen-wavedump"
    }
    fn extensions(&self) -> &'static [&'static str] {
        // The content identifies its .dat files; any other .dat file is text.
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        let Some(first) = Event::parse(head).filter(|event| event.problem(None).is_none()) else {
            return false;
        };
        match head.get(first.bytes as usize..).and_then(Event::parse) {
            Some(second) => second.problem(Some(first)).is_none(),
            None => true,
        }
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let (mut first, mut last) = (None, None);
        let (mut count, mut code_type) = (0_usize, CodeType::U16);
        // Counted before any record is kept: a growing vector could take more memory than the file is long.
        let mut at = 0;
        let end = loop {
            if at == input.length() {
                break at;
            }
            let event = match Event::read(input, at, first) {
                Err(FormatError::Truncated { .. }) if count > 0 => {
                    input.cut_short(at, "event", count as u64);
                    break at;
                }
                event => event?,
            };
            if first.is_none() {
                code_type = codes(input, event)?;
            }
            first.get_or_insert(event);
            if !u64::from(event.bytes).is_multiple_of(code_type.bytes() as u64) {
                let problem =
                    format!("an event of {} bytes does not hold whole floats; copy the file again", event.bytes);
                return Err(field(at, problem));
            }
            if last.is_some_and(|last| event.repeats(last)) {
                let problem = format!(
                    "event counter {} comes after a later one: is the file put together of two?",
                    event.counter
                );
                input.remark(at + 16, problem);
            }
            last = Some(event.counter);
            at += u64::from(event.bytes);
            count += 1;
        };
        let mut heads = BTreeMap::new();
        let mut records = Vec::with_capacity(count);
        at = 0;
        while at < end {
            let event = Event::read(input, at, first)?;
            let head = heads.entry(event.bytes).or_insert_with(|| Arc::new(self.head(event, code_type)));
            let segment = u32::try_from(records.len()).map_err(|_| field(at, "has more events than are counted"))?;
            records.push(Record {
                head: Arc::clone(head),
                segment: (count > 1).then_some(segment),
                t0_s: None,
                trigger_s: None,
                payload: Payload::File { byte_offset: at + HEAD, stride: code_type.bytes() as u64, big_endian: false },
            });
            at += u64::from(event.bytes);
        }
        Ok(records)
    }
}

impl CaenWavedump {
    fn head(&self, event: Event, code_type: CodeType) -> Head {
        Head {
            channel: Some(format!("ch{}", event.channel)),
            unit: Some("adc".to_owned()),
            ..Head::new(self.format(), code_type, (event.bytes as usize - HEAD as usize) / code_type.bytes())
        }
    }
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// The fields of an event's header that the reader uses.
#[derive(Clone, Copy)]
struct Event {
    bytes: u32,
    board: u32,
    channel: u32,
    counter: u32,
}

impl Event {
    fn parse(head: &[u8]) -> Option<Self> {
        let word =
            |i: usize| head.get(4 * i..4 * i + 4).map(|word| u32::from_le_bytes(word.try_into().expect("four bytes")));
        // Reading the last word ensures that the header is complete.
        word(5)?;
        Some(Self { bytes: word(0)?, board: word(1)?, channel: word(3)?, counter: word(4)? })
    }

    /// Whether its counter does not go on from that of the event before it. A counter that wraps falls far.
    fn repeats(self, last: u32) -> bool {
        self.counter <= last && last - self.counter < COUNTER_WRAPS / 2
    }

    /// What is wrong with the event: where in the header, and how.
    fn problem(self, first: Option<Self>) -> Option<(u64, String)> {
        let Self { bytes, board, channel, .. } = self;
        if !(26..=MAX_EVENT).contains(&bytes) || bytes % 2 == 1 {
            let problem = format!(
                "event size {bytes} is none of an event of 16 bit codes with its head of 24 bytes; record with \
                 OUTPUT_FILE_HEADER YES on a board of 10 to 14 bits, or copy the file from its disk again"
            );
            return Some((0, problem));
        }
        let (boards, channels) = first.map_or((BOARDS, CHANNELS), |first| (first.board, first.channel));
        if first.map_or(board >= boards, |_| board != boards) {
            return Some((4, format!("board ID {board} is none, or not that of the first event; copy the file again")));
        }
        if first.map_or(channel >= channels, |_| channel != channels) {
            return Some((
                12,
                format!("channel {channel} is none, or not that of the first event; copy the file again"),
            ));
        }
        None
    }

    fn read(input: &mut dyn Input, at: u64, first: Option<Self>) -> Result<Self, FormatError> {
        let length = input.length();
        let bytes = input.peek("an event's head", at, HEAD)?;
        let event = Self::parse(&bytes).expect("24 bytes are a head");
        if let Some((offset, problem)) = event.problem(first) {
            return Err(field(at + offset, problem));
        }
        let needed = u64::from(event.bytes);
        if at.checked_add(needed).is_none_or(|end| end > length) {
            return Err(FormatError::Truncated { what: "an event", byte_offset: at, needed, length });
        }
        input.uses(at..at + needed);
        Ok(event)
    }
}

/// The type of a file's codes by its first event: 16 bit integers, or the floats of a 742.
fn codes(input: &mut dyn Input, event: Event) -> Result<CodeType, FormatError> {
    let codes = input.peek("the first event", HEAD, (u64::from(event.bytes) - HEAD).min(LOOKED_AT))?;
    let beyond = codes.chunks_exact(2).position(|code| u16::from_le_bytes([code[0], code[1]]) > MAX_CODE);
    match beyond {
        None => Ok(CodeType::U16),
        Some(_) if are_floats(&codes) => Ok(CodeType::F32),
        Some(i) => Err(field(
            HEAD + 2 * i as u64,
            "a code has more than 14 bits: an 8 bit board (721, 731), whose files are not read; convert the run \
             to .npy",
        )),
    }
}

/// Whether bytes are codes as floats. Those of an 8 bit board may look like it, but lie near their baseline.
fn are_floats(bytes: &[u8]) -> bool {
    let is_code = |code: &[u8; 4]| {
        let code = f32::from_le_bytes(*code).abs();
        code == 0.0 || (FLOATS.0..=FLOATS.1).contains(&code)
    };
    let mut sorted = bytes.to_vec();
    sorted.sort_unstable();
    let middle = sorted[sorted.len() / 2];
    let near = bytes.iter().filter(|byte| byte.abs_diff(middle) <= NEAR).count();
    bytes.len().is_multiple_of(4) && bytes.as_chunks().0.iter().all(is_code) && 4 * near < 3 * bytes.len()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::path::Path;

    use super::super::hostile;
    use super::*;
    use crate::Source;

    fn event(board: u32, channel: u32, counter: u32, codes: &[u16]) -> Vec<u8> {
        let words = [24 + 2 * codes.len() as u32, board, 0x0006_0000, channel, counter, 0x0030_AF85];
        let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        bytes.extend(codes.iter().flat_map(|code| code.to_le_bytes()));
        bytes
    }

    fn two_events() -> Vec<u8> {
        [event(31, 5, 0, &[1, 2, 3]), event(31, 5, 1, &[4, 5, 16383, 7])].concat()
    }

    fn error(bytes: Vec<u8>) -> String {
        let mut source = Source::new(Cursor::new(bytes), Path::new("wave5.dat")).unwrap();
        CaenWavedump.records(&mut source).unwrap_err().to_string()
    }

    #[test]
    fn events_of_any_length_are_segments() {
        let bytes = two_events();
        assert!(CaenWavedump.recognises(&bytes));
        let mut source = Source::new(Cursor::new(bytes), Path::new("wave5.dat")).unwrap();
        let records = CaenWavedump.records(&mut source).unwrap();
        let values = |i: usize, source: &mut Source<_>| {
            let record: &Record = &records[i];
            let codes = record.read(source.file(), 0..record.head.samples).unwrap();
            record.values(&codes)
        };
        assert_eq!(values(0, &mut source), [1.0, 2.0, 3.0]);
        assert_eq!(values(1, &mut source), [4.0, 5.0, 16383.0, 7.0]);
        assert_eq!(records[1].segment, Some(1));
        assert_eq!(records[1].head.channel.as_deref(), Some("ch5"));
        assert!(records[1].t0_s.is_none() && records[1].head.dt_s.is_none() && records[1].head.scale.is_none());
    }

    #[test]
    fn a_single_event_is_no_segment_and_equal_events_share_a_head() {
        let mut source = Source::new(Cursor::new(event(0, 0, 0, &[9])), Path::new("wave0.dat")).unwrap();
        assert_eq!(CaenWavedump.records(&mut source).unwrap()[0].segment, None);
        let bytes = [event(0, 0, 0, &[9]), event(0, 0, 1, &[8])].concat();
        let records =
            CaenWavedump.records(&mut Source::new(Cursor::new(bytes), Path::new("wave0.dat")).unwrap()).unwrap();
        assert!(Arc::ptr_eq(&records[0].head, &records[1].head));
    }

    /// The event of a 742: samples as floats.
    fn floats(counter: u32, samples: &[f32]) -> Vec<u8> {
        let halves: Vec<u16> = samples
            .iter()
            .flat_map(|sample| {
                let bits = sample.to_bits();
                [bits as u16, (bits >> 16) as u16]
            })
            .collect();
        event(31, 8, counter, &halves)
    }

    #[test]
    fn floats_of_a_742_differ_from_codes_of_8_bits() {
        let bytes = [floats(0, &[2048.25, 2047.5, 1.0, -3.5]), floats(1, &[0.0, 5.0, 4000.0])].concat();
        assert!(CaenWavedump.recognises(&bytes));
        let records = hostile::decode(&CaenWavedump, &bytes);
        assert_eq!(
            (&records[0].1[..], &records[1].1[..]),
            (&[2048.25, 2047.5, 1.0, -3.5][..], &[0.0, 5.0, 4000.0][..])
        );
        let head = &records[1].0.head;
        assert_eq!((head.code_type, head.channel.as_deref()), (CodeType::F32, Some("ch8")));
        hostile::cut_everywhere(&CaenWavedump, &bytes);
        hostile::change_anywhere(&CaenWavedump, &bytes, 3000);
        // Codes of 8 bits around 69 are floats of some 3000, and far too much alike.
        assert!(error(event(0, 1, 0, &[0x4545, 0x4544, 0x4645, 0x4545])).contains("8 bit board"));
        assert!(error([bytes.clone(), event(31, 8, 2, &[1])].concat()).contains("does not hold whole floats"));
    }

    #[test]
    fn other_files_are_not_taken() {
        for head in [b"1.0,2.0\n3.0,4.0\n5.0,6.0\n7.0,8.0\n".as_slice(), &[0; 64], &[255; 64], b"\x1a\0\0\0"] {
            assert!(!CaenWavedump.recognises(head));
        }
        let mut lost = two_events();
        lost.remove(30);
        assert!(!CaenWavedump.recognises(&lost));
    }

    #[test]
    fn what_is_wrong_is_said() {
        let two = two_events();
        assert!(error(two[..20].to_vec()).contains("an event's head needs 24 bytes from byte 0"));
        assert!(error(two[..29].to_vec()).contains("cut short: an event needs 30 bytes"));
        assert!(error([event(0, 1, 0, &[1]), event(0, 2, 1, &[1])].concat()).contains("byte 38: channel 2"));
        assert!(error([event(0, 1, 0, &[1]), event(3, 1, 1, &[1])].concat()).contains("board ID 3"));
        assert!(error(event(0, 1, 0, &[])).contains("event size 24"));
        assert!(error(event(0, 1, 0, &[100, 0x8081])).contains("byte 26: a code has more than 14 bits"));
        let mut odd = event(0, 1, 0, &[1, 1]);
        odd[0] -= 1;
        assert!(error(odd).contains("event size 27"));
    }

    /// An interrupted run ends anywhere: the whole events are read, and the rest is reported once.
    #[test]
    fn whole_events_before_a_cut_are_read() {
        let two = two_events();
        for length in [31, 50, two.len() - 1] {
            let mut source = Source::new(Cursor::new(two[..length].to_vec()), Path::new("wave5.dat")).unwrap();
            let contents = crate::contents(&mut source).unwrap();
            assert_eq!((contents.records.len(), contents.remarks.len()), (1, 1));
            assert!(contents.remarks[0].problem.contains("within event 1"), "{:?}", contents.remarks);
            assert_eq!(contents.remarks[0].byte_offset, 30);
        }
    }

    #[test]
    fn hostile_files_are_refused_or_decoded_whole() {
        hostile::cut_everywhere(&CaenWavedump, &two_events());
        hostile::change_anywhere(&CaenWavedump, &two_events(), 5000);
    }
}
