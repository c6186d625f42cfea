//! Rigol `.bin`: `RG01` (MSO5000, 7000, 8000) and `RG03` (DHO800, DHO1000; 64 bit sizes). The layout is that of
//! [`super::keysight_bin`].
//!
//! Samples are volts already. The manual calls X Origin the time of the first sample, but the files give it with the
//! opposite sign: sample i is at -(X Origin) + i * X Increment after the trigger. Both fields are f64 with values
//! rounded to f32: at 2.5 MS/s, times are 0.1 ns off after 10 ms. Rigol's waveforms are channels, never segments: their
//! headers have no Time Tag, and all have index 1. What is read and refused is as in [`super::keysight_bin`].
//!
//! Some firmware of the MSO5000 writes codes of 8 bits, one channel behind the other, each under a header that is the
//! same in every file and calls them 1000 floats of 1 ps. Such files are read as codes without scale and time base.
//! Their layout is known from reports of owners; no such file was at hand.
//!
//! Source: Rigol, MSO8000 and DHO1000 User Guides, "Binary Header Format". Tested on real files: both versions, normal
//! waveforms of 2 and 4 channels. Tested only on files that the tests build: peak detect, averages and logic.

use std::sync::Arc;

use super::keysight_bin::Maker;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record};

/// The reader.
pub struct RigolBin;

/// Rigol's files.
const RIGOL: Maker = Maker { format: "rigol-bin", cookie: *b"RG", origin_sign: -1.0, segments: false };

impl Reader for RigolBin {
    fn format(&self) -> &'static str {
        RIGOL.format
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["bin"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        RIGOL.recognises(head)
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let start = input.peek("the file header", 0, input.length().min(RAW_START.len() as u64))?;
        if start == RAW_START {
            return raw_blocks(input);
        }
        RIGOL.records(input)
    }
}

/// How each channel of some MSO5000 begins: `RG01`, a File Size of 4168, one waveform with a header of 144 bytes. The
/// numbers are the same in every file, whatever was recorded.
const RAW_START: &[u8] = b"RG01\x48\x10\0\0\x01\0\0\0\x90\0\0\0";
/// Bytes before the codes of a channel: headers of the file, the waveform and its data.
const RAW_HEAD: u64 = 12 + 144 + 12;
/// Bytes that are searched at a time for the next channel.
const PIECE_BYTES: u64 = 1 << 16;
/// Most channels of a scope.
const CHANNELS: usize = 4;

/// Channels one behind the other, each codes of 8 bits in a block that calls itself 1000 floats of 1 ps. The file has
/// no scale, no time base and no number of samples: a channel ends where the next begins.
fn raw_blocks(input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
    let mut starts = vec![0];
    let (mut at, length) = (RAW_HEAD, input.length());
    while at + RAW_START.len() as u64 <= length && starts.len() <= CHANNELS {
        let bytes = input.peek("the samples", at, PIECE_BYTES.min(length - at))?;
        let found = bytes.windows(RAW_START.len()).position(|window| window == RAW_START);
        match found {
            Some(position) => {
                starts.push(at + position as u64);
                at += position as u64 + RAW_HEAD;
            }
            // A mark may lie across the border of two pieces.
            None => at += (bytes.len() - RAW_START.len() + 1) as u64,
        }
    }
    let problem = "an MSO5000 that saves codes of 8 bits under a header of fixed numbers: the file has no volts, no time \
                   base and no number of samples; give dt_ps, t0_ps, gain_v and offset_v in its [[captures]] rule";
    input.remark(0, problem.to_owned());
    let ends = starts.iter().skip(1).copied().chain([length]);
    let mut records = Vec::new();
    for (number, (start, end)) in starts.iter().zip(ends).enumerate() {
        let data = start + RAW_HEAD;
        if data >= end || number == CHANNELS {
            let problem =
                format!("channel {number} has no samples, or is one of more than {CHANNELS}; save the file again");
            return Err(FormatError::Field { byte_offset: *start, problem });
        }
        input.uses(*start..data);
        let samples = usize::try_from(end - data).map_err(|_| FormatError::Field {
            byte_offset: data,
            problem: "is too large for this machine".to_owned(),
        })?;
        let head = Head {
            channel: Some(format!("CH{}", number + 1)),
            rails: CodeType::U8.limits(),
            ..Head::new(RIGOL.format, CodeType::U8, samples)
        };
        let payload = Payload::File { byte_offset: data, stride: 1, big_endian: false };
        records.push(Record { head: Arc::new(head), segment: None, t0_s: None, trigger_s: None, payload });
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hostile::{cut_everywhere, damage, read};
    use crate::keysight_bin::tests::{Built, Waveform};
    use crate::waveform::Kind;

    #[test]
    fn waveforms_are_channels_and_the_origin_has_the_other_sign() {
        for cookie in ["RG01", "RG03"] {
            // The 12 bytes after the label do not hold a time.
            let waveform = |label, index| Waveform::new(label, [1.0, 2.0, 3.0]).segment(index, f64::NAN);
            let built =
                Built::new(cookie, vec![waveform("", 1), waveform("", 2), waveform("CH3", 1), waveform("CH3", 2)]);
            let records = read(&RigolBin, &built.bytes()).unwrap();
            let channels: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap()).collect();
            assert_eq!(channels, ["wf0", "wf1", "CH3", "CH3"]);
            for (record, volts) in &records {
                assert_eq!((record.t0_s, record.segment, record.trigger_s), (Some(2.5e-9), None, None));
                assert_eq!((record.head.format, &volts[..]), ("rigol-bin", &[1.0, 2.0, 3.0][..]));
            }
            cut_everywhere(&RigolBin, &built.bytes());
            assert!(damage(&RigolBin, &built.bytes(), 3000, |_| {}) > 0, "some edits are harmless");
        }
    }

    #[test]
    fn a_file_size_that_is_too_small_is_forgiven_when_the_waveforms_fill_the_file() {
        let mut bytes = Built::new("RG01", vec![Waveform::new("CH1", [0.0; 3]); 2]).bytes();
        bytes[4..8].copy_from_slice(&100_u32.to_le_bytes());
        assert_eq!(read(&RigolBin, &bytes).unwrap().len(), 2);
        bytes[4..8].copy_from_slice(&1000_u32.to_le_bytes());
        assert!(read(&RigolBin, &bytes).unwrap_err().contains("cut short"));
    }

    /// Of such files only the bytes behind the headers mean anything: codes, of as many channels as there are headers.
    #[test]
    fn codes_under_a_header_of_fixed_numbers_are_codes() {
        let mut bytes = Vec::new();
        for channel in 0..2_u8 {
            bytes.extend(RAW_START);
            bytes.resize(bytes.len() + RAW_HEAD as usize - RAW_START.len(), 0);
            // More than a piece, so that the second header lies across two.
            bytes.extend((0..PIECE_BYTES - 8).map(|i| (i % 200) as u8 + channel));
        }
        let contents = crate::contents(&mut crate::hostile::source(&bytes)).unwrap();
        assert_eq!((contents.records.len(), contents.remarks.len()), (2, 1), "{:?}", contents.remarks);
        let records = read(&RigolBin, &bytes).unwrap();
        assert_eq!((records[1].1.len(), records[1].1[0], records[1].1[199]), (65_528, 1.0, 200.0));
        let head = &records[0].0.head;
        assert_eq!((head.dt_s, head.unit.as_deref(), head.scale), (None, None, None));
        assert!(damage(&RigolBin, &bytes[..400], 3000, |_| {}) > 0);
    }

    #[test]
    fn spectra_begin_at_their_frequency() {
        let logic = Waveform { buffers: vec![(5, 1, vec![0, 1, 1])], ..Waveform::new("D0", [0.0; 3]) };
        let spectrum = Waveform { units: (6, 5), origin: 1e6, ..Waveform::new("MATH1", [0.0; 3]) };
        let records = read(&RigolBin, &Built::new("RG03", vec![logic, spectrum]).bytes()).unwrap();
        assert_eq!((records[0].0.head.kind, records[0].0.t0_s), (Kind::Digital, Some(2.5e-9)));
        assert_eq!((records[1].0.head.kind, records[1].0.t0_s), (Kind::Spectrum, Some(1e6)));
    }
}
