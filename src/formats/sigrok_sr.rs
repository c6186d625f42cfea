//! sigrok session files `.sr` (PulseView): a zip file of `version` 2, the INI file `metadata`, and the samples in
//! chunks.
//!
//! value = the code itself (32 bit floats, little-endian); sample i of a channel is i / samplerate after the first. The
//! file gives no unit and no trigger position: `unit` and `t0_s` are `None`. Section `[device 1]` names the channels as
//! `analog<number>=<name>`. Their samples are the members `analog-1-<number>-<chunk>`, with chunks counted from 1: 10
//! comes after 9. Source: sigrok wiki, "File format:Sigrok/v2".
//!
//! Not read: logic levels (`logic-1-<chunk>`), which are omitted next to analog channels and refused by name where they
//! are alone; version 1, which has no analog channels. Tested on real files; several chunks and stored members only on
//! files that the tests build.

use std::collections::BTreeSet;
use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use super::zip_file::{self, Member};
use crate::waveform::{CodeType, Head, Payload, ReadSeek, Record, Unpack};

/// The reader.
pub struct SigrokSr;

/// Longest `metadata` that is read.
const METADATA_BYTES: u64 = 1 << 16;

impl Reader for SigrokSr {
    fn format(&self) -> &'static str {
        "sigrok-sr"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["sr"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        zip_file::first_name(head).is_some_and(|name| [b"version".as_slice(), b"metadata"].contains(&name))
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let members = zip_file::members(input)?;
        let (at, version) = text(input, &members, "version")?;
        if version.trim() != "2" {
            let problem =
                format!("version {:?} is not read, only 2; save the session again with PulseView", version.trim());
            return Err(field(at, problem));
        }
        let (at, metadata) = text(input, &members, "metadata")?;
        let device = Device::read(&metadata).map_err(|problem| field(at, problem))?;
        // Sorted by number: in the file they are in alphabetical order, or in none.
        let mut chunks: Vec<(u32, u32, &Member)> = members.iter().filter_map(chunk).collect();
        chunks.sort_unstable_by_key(|&(channel, number, _)| (channel, number));
        if chunks.is_empty() && members.iter().any(|member| member.name.starts_with("logic-1")) {
            return Err(field(
                at,
                "holds logic levels only: digital channels cannot be timed to fractions of a sample",
            ));
        }
        if let Some((channel, _, stray)) = chunks.iter().find(|chunk| !device.numbers.contains(&chunk.0)) {
            let problem = format!("{:?} is of channel analog{channel}, which the metadata does not name", stray.name);
            return Err(field(stray.byte_offset, problem));
        }
        let record = |(number, name): &(u32, String)| {
            let start = chunks.partition_point(|chunk| chunk.0 < *number);
            let end = chunks.partition_point(|chunk| chunk.0 <= *number);
            let own = Chunks::new(name, &chunks[start..end]).map_err(|problem| field(at, problem))?;
            let head = Head {
                channel: Some(name.clone()),
                dt_s: Some(1.0 / device.rate_hz),
                ..Head::new(self.format(), CodeType::F32, own.samples)
            };
            let payload = Payload::Packed(Arc::new(own));
            Ok(Record { head: Arc::new(head), segment: None, t0_s: None, trigger_s: None, payload })
        };
        device.channels.iter().map(record).collect()
    }
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// Where a text member begins, and its text.
fn text(input: &mut dyn Input, members: &[Member], name: &str) -> Result<(u64, String), FormatError> {
    let Some(member) = members.iter().find(|member| member.name == name) else {
        return Err(field(0, format!("the zip file has no member {name:?}: it is no session of sigrok")));
    };
    let at = member.byte_offset;
    if member.length > METADATA_BYTES {
        return Err(field(at, format!("{name} has {} bytes, which is no text of sigrok", member.length)));
    }
    let bytes = member.start(input.file(), METADATA_BYTES).map_err(|error| field(at, format!("{name}: {error}")))?;
    Ok((at, String::from_utf8_lossy(&bytes).into_owned()))
}

/// Channel and number of a chunk, if the member is one: `analog-1-<channel>-<number>`.
fn chunk(member: &Member) -> Option<(u32, u32, &Member)> {
    let (channel, number) = member.name.strip_prefix("analog-1-")?.split_once('-')?;
    Some((channel.parse().ok()?, number.parse().ok()?, member))
}

/// The device, as the metadata describe it.
#[derive(Debug, PartialEq)]
struct Device {
    rate_hz: f64,
    /// Number and name of the analog channels, in the order of the metadata.
    channels: Vec<(u32, String)>,
    /// Their numbers, to look them up.
    numbers: BTreeSet<u32>,
}

impl Device {
    fn read(metadata: &str) -> Result<Self, String> {
        let mut rate_hz = None;
        let mut channels: Vec<(u32, String)> = Vec::new();
        let mut numbers = BTreeSet::new();
        let mut section = "";
        for line in metadata.split(['\n', '\r']).map(str::trim) {
            if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
                section = name;
            }
            let Some((key, value)) = line.split_once('=').filter(|_| section == "device 1" && !line.starts_with('#'))
            else {
                continue;
            };
            let (key, value) = (key.trim(), value.trim());
            if key == "samplerate" {
                rate_hz =
                    Some(hertz(value).ok_or_else(|| format!("samplerate = {value:?} in metadata is no rate in Hz"))?);
            }
            if let Some(number) = key.strip_prefix("analog").and_then(|number| number.parse().ok()) {
                if !numbers.insert(number) {
                    return Err(format!("metadata names channel analog{number} twice; save the session again"));
                }
                channels.push((number, value.to_owned()));
            }
        }
        let rate_hz = rate_hz.ok_or("metadata has no samplerate in section [device 1]; save the session again")?;
        Ok(Self { rate_hz, channels, numbers })
    }
}

/// Parses a rate like `50 MHz`. It appends the power of ten to the text, so that the number is rounded only once.
fn hertz(text: &str) -> Option<f64> {
    let number = text.trim_end_matches(|letter: char| letter.is_ascii_alphabetic() || letter == ' ');
    let power = match text[number.len()..].trim_start() {
        "" | "Hz" => 0,
        "kHz" => 3,
        "MHz" => 6,
        "GHz" => 9,
        _ => return None,
    };
    let plain = number.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    let rate_hz: f64 = format!("{number}e{power}").parse().ok()?;
    (plain && rate_hz > 0.0 && (1.0 / rate_hz).is_finite() && rate_hz.is_finite()).then_some(rate_hz)
}

/// The samples of one channel.
#[derive(Debug)]
struct Chunks {
    chunks: Vec<Member>,
    samples: usize,
}

impl Chunks {
    fn new(name: &str, chunks: &[(u32, u32, &Member)]) -> Result<Self, String> {
        if chunks.is_empty() {
            return Err(format!(
                "channel {name:?} has no samples: the acquisition may have been interrupted; record it again"
            ));
        }
        let mut bytes = 0_u64;
        for (i, (channel, number, member)) in chunks.iter().enumerate() {
            if u64::from(*number) != i as u64 + 1 {
                return Err(format!("chunk {} of channel {name:?} (analog-1-{channel}-{}) is missing", i + 1, i + 1));
            }
            if member.length == 0 || member.length % 4 != 0 {
                return Err(format!("{:?} has {} bytes, no whole number of samples", member.name, member.length));
            }
            bytes = bytes.saturating_add(member.length);
        }
        let samples =
            usize::try_from(bytes / 4).map_err(|_| format!("channel {name:?} is too long for this machine"))?;
        Ok(Self { chunks: chunks.iter().map(|&(_, _, member)| member.clone()).collect(), samples })
    }
}

impl Unpack for Chunks {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        for chunk in &self.chunks {
            if chunk.unpack(&mut chunk.unpacker(), file, chunk.length, &mut |piece| take(piece))?.is_break() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::path::Path;

    use super::super::hostile;
    use super::super::zip_file::tests::{Local, zip};
    use super::*;
    use crate::Source;

    const METADATA: &str = "[global]\r\nsigrok version=0.6\r\n# analog1=none\r\n[device 1]\r\n\
        samplerate = 12 MHz\r\ntotal analog=2\r\n\
        probe1=D0\r\nanalog9=A0\r\nanalog10=A1\r\n[device 2]\r\nsamplerate=1 Hz\r\n";

    fn samples(from: u16, count: u16) -> Vec<u8> {
        (from..from + count).flat_map(|i| f32::from(i).to_le_bytes()).collect()
    }

    /// Eleven chunks of channel A0 in the order of their names as text, one of A1.
    fn file(version: &str, metadata: &str, deflate: bool) -> Vec<u8> {
        let numbers = [1, 10, 11, 2, 3, 4, 5, 6, 7, 8, 9];
        let chunks = numbers.map(|i: u16| (format!("analog-1-9-{i}"), samples(2 * (i - 1), 2)));
        let one = samples(100, 3);
        let mut members = vec![("version", version.as_bytes()), ("metadata", metadata.as_bytes())];
        members.extend(chunks.iter().map(|(name, samples)| (name.as_str(), samples.as_slice())));
        members.extend([("analog-1-10-1", one.as_slice()), ("logic-1-1", b"logic")]);
        zip(&members, deflate, Local::Lengths)
    }

    fn records(bytes: &[u8]) -> Result<Vec<Record>, String> {
        let mut source = Source::new(Cursor::new(bytes), Path::new("a.sr")).unwrap();
        SigrokSr.records(&mut source).map_err(|error| error.to_string())
    }

    #[test]
    fn chunks_are_joined_by_their_numbers() {
        for deflate in [false, true] {
            let bytes = file("2", METADATA, deflate);
            assert!(SigrokSr.recognises(&bytes));
            let records = records(&bytes).unwrap();
            let values = |i: usize| {
                let record: &Record = &records[i];
                record.values(&record.read(&mut Cursor::new(&bytes), 0..record.head.samples).unwrap())
            };
            assert!(values(0).into_iter().eq((0..22).map(f64::from)));
            assert_eq!(values(1), [100.0, 101.0, 102.0]);
            let head = &records[0].head;
            assert_eq!((head.channel.as_deref(), head.unit.as_deref()), (Some("A0"), None));
            assert_eq!((head.dt_s, records[0].t0_s), (Some(1.0 / 12e6), None));
        }
    }

    #[test]
    fn rates_have_units() {
        for (text, rate_hz) in [("1000", 1e3), ("1 Hz", 1.0), ("200kHz", 2e5), ("0.1 MHz", 1e5), ("1.25 GHz", 1.25e9)] {
            assert_eq!(hertz(text), Some(rate_hz), "{text}");
        }
        for text in ["", "MHz", "0 Hz", "-1 Hz", "1 THz", "1e3 Hz", "nan", "inf Hz", "1.2.3 Hz"] {
            assert_eq!(hertz(text), None, "{text}");
        }
    }

    #[test]
    fn what_is_wrong_is_said() {
        assert!(records(&file("1", METADATA, false)).unwrap_err().contains("version \"1\""));
        for (from, to, says) in [
            ("samplerate = 12", "samplerate = twelve", "\"twelve MHz\""),
            ("samplerate = 12 MHz", "", "no samplerate"),
            ("analog10=A1", "", "which the metadata does not name"),
            ("analog10=A1", "analog10=A1\nanalog12=A3", "\"A3\" has no samples"),
            ("analog10=A1", "analog10=A1\nanalog9=B", "analog9 twice"),
        ] {
            let error = records(&file("2", &METADATA.replace(from, to), true)).unwrap_err();
            assert!(error.contains(says), "{error}");
        }
        let error = |members: &[(&str, &[u8])]| {
            let all = [[("version", b"2".as_slice()), ("metadata", METADATA.as_bytes())].as_slice(), members].concat();
            records(&zip(&all, false, Local::Lengths)).unwrap_err()
        };
        assert!(error(&[("logic-1-1", b"101")]).contains("logic levels only"));
        assert!(error(&[]).contains("\"A0\" has no samples"));
        assert!(error(&[("analog-1-9-1", &[0; 4]), ("analog-1-9-3", &[0; 4])]).contains("chunk 2 of channel \"A0\""));
        assert!(error(&[("analog-1-9-1", &[0; 5])]).contains("5 bytes"));
        assert!(
            records(&zip(&[("version", b"2")], false, Local::Lengths)).unwrap_err().contains("no member \"metadata\"")
        );
    }

    #[test]
    fn hostile_files_are_refused_or_decoded_whole() {
        for deflate in [false, true] {
            hostile::cut_everywhere(&SigrokSr, &file("2", METADATA, deflate));
            hostile::change_anywhere(&SigrokSr, &file("2", METADATA, deflate), 3000);
        }
    }
}
