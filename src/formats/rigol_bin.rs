//! Rigol `.bin`: `RG01` (MSO5000, 7000, 8000) and `RG03` (DHO800, DHO1000; 64 bit sizes). The layout is that of
//! [`super::keysight_bin`].
//!
//! Samples are volts already. The manual calls X Origin the time of the first sample, but the files give it with the
//! opposite sign: sample i is at -(X Origin) + i * X Increment after the trigger. Both fields are f64 with values
//! rounded to f32: at 2.5 MS/s, times are 0.1 ns off after 10 ms. Rigol's waveforms are channels, never segments: their
//! headers have no Time Tag, and all have index 1. What is read and refused is as in [`super::keysight_bin`].
//!
//! Source: Rigol, MSO8000 and DHO1000 User Guides, "Binary Header Format". Tested on real files: both versions, normal
//! waveforms of 2 and 4 channels. Tested only on files that the tests build: peak detect, averages and logic.

use super::keysight_bin::Maker;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::Record;

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
        RIGOL.records(input)
    }
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

    #[test]
    fn spectra_begin_at_their_frequency() {
        let logic = Waveform { buffers: vec![(5, 1, vec![0, 1, 1])], ..Waveform::new("D0", [0.0; 3]) };
        let spectrum = Waveform { units: (6, 5), origin: 1e6, ..Waveform::new("MATH1", [0.0; 3]) };
        let records = read(&RigolBin, &Built::new("RG03", vec![logic, spectrum]).bytes()).unwrap();
        assert_eq!((records[0].0.head.kind, records[0].0.t0_s), (Kind::Digital, Some(2.5e-9)));
        assert_eq!((records[1].0.head.kind, records[1].0.t0_s), (Kind::Spectrum, Some(1e6)));
    }
}
