//! Writes `AG10` files for the simulator.

use std::io::{self, Write};

use super::walk::WAVEFORM;

/// Length of the file header.
const FILE: usize = 12;
/// Length of a waveform data header.
const BUFFER: usize = 12;

/// What all segments of a file have in common.
#[derive(Clone, Debug)]
pub struct VoltsHead {
    /// Model and serial number of the instrument, `MODEL:SERIAL`; up to 23 bytes.
    pub instrument: String,
    /// Channel, up to 15 bytes.
    pub label: String,
    /// Time between samples.
    pub dt_s: f64,
}

/// Writes segments of equal length as one `AG10` file.
///
/// A segment is the time of its trigger after the first one (s), the time of its sample 0 (s), and its volts. A single
/// one gets no Time Tag and no Segment Index, as in unsegmented files.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When there is no segment, their lengths differ, or the file exceeds 2 GiB, the limit of its header.
pub fn write(out: &mut impl Write, head: &VoltsHead, segments: &[(f64, f64, Vec<f32>)]) -> io::Result<()> {
    let samples = segments.first().expect("a file has at least one segment").2.len();
    assert!(segments.iter().all(|(_, _, volts)| volts.len() == samples), "segments of one file have equal lengths");
    let total = FILE + segments.len() * (WAVEFORM + BUFFER + 4 * samples);
    let length = |bytes: usize| i32::try_from(bytes).expect("a file holds less than 2 GiB").to_le_bytes();
    out.write_all(b"AG10")?;
    out.write_all(&length(total))?;
    out.write_all(&length(segments.len()))?;
    let mut bytes = Vec::with_capacity(WAVEFORM + BUFFER + 4 * samples);
    for (i, (trigger_s, t0_s, volts)) in segments.iter().enumerate() {
        let (tag_s, index) = if segments.len() > 1 { (*trigger_s, i + 1) } else { (0.0, 0) };
        bytes.clear();
        bytes.resize(WAVEFORM + BUFFER, 0);
        let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
        put(0, &length(WAVEFORM));
        for (at, number) in [(4, 1_u32), (8, 1), (16, 1), (48, 2), (52, 1)] {
            put(at, &number.to_le_bytes());
        }
        put(12, &length(samples));
        put(20, &((head.dt_s * samples as f64) as f32).to_le_bytes());
        put(24, &t0_s.to_le_bytes());
        put(32, &head.dt_s.to_le_bytes());
        put(40, &t0_s.to_le_bytes());
        put(88, &head.instrument.as_bytes()[..head.instrument.len().min(23)]);
        put(112, &head.label.as_bytes()[..head.label.len().min(15)]);
        put(128, &tag_s.to_le_bytes());
        put(136, &length(index));
        put(WAVEFORM, &length(BUFFER));
        put(WAVEFORM + 4, &1_u16.to_le_bytes());
        put(WAVEFORM + 6, &4_u16.to_le_bytes());
        put(WAVEFORM + 8, &length(4 * samples));
        bytes.extend(volts.iter().flat_map(|volts| volts.to_le_bytes()));
        out.write_all(&bytes)?;
    }
    Ok(())
}
