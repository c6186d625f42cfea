//! Writes FastFrame files for the simulator.

use std::io::{self, Write};

use super::checksum::sum_of_bytes;
use super::{CHECKSUM, CURVE, LAYOUTS, UNCOUNTED, UPDATE};

/// What all frames of a file have in common.
#[derive(Clone, Debug)]
pub struct FrameHead {
    /// Label of the waveform, which names its channel; up to 31 bytes.
    pub label: String,
    /// Volts per code.
    pub gain_v: f64,
    /// Volts at code 0.
    pub offset_v: f64,
    /// Time between samples.
    pub dt_s: f64,
    /// Bits of the converter: 8, or 9 to 16, which fill the upper bits of 16.
    pub bits: u16,
    /// Time zero of the triggers: whole GMT seconds since 1970, and the fraction of a second in [0, 1).
    pub acquired: (i64, f64),
}

/// Writes frames of equal length as one little-endian `WFM#003` file.
///
/// A frame is the time of its trigger (s), the time of its sample 0 (s), and its codes. Codes of an 8 bit converter are
/// stored as bytes and must fit; others are stored as words.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When there is no frame, or their lengths differ. When their times of sample 0 differ by a sample or more: the TT
/// offset is a fraction of a sample. When a code does not fit, or a trigger is not between 1970 and 2038. When the file
/// exceeds 2 GiB, the limit of its header.
pub fn write(out: &mut impl Write, head: &FrameHead, frames: &[(f64, f64, Vec<i16>)]) -> io::Result<()> {
    let samples = frames.first().expect("a file has at least one frame").2.len();
    assert!(frames.iter().all(|(_, _, codes)| codes.len() == samples), "frames of one file have equal lengths");
    let offset_s = frames.iter().map(|(_, t0_s, _)| *t0_s).fold(f64::INFINITY, f64::min);
    let mut updates = frames.iter().map(|(trigger_s, t0_s, _)| update(head, *trigger_s, t0_s - offset_s));
    let curve = curve_object(samples * width(head));
    let mut out = Summed { out, sum: 0 };
    out.put(&file_head(head, frames.len(), samples, offset_s))?;
    updates.next().into_iter().try_for_each(|update| out.put(&update))?;
    out.put(&curve)?;
    updates.try_for_each(|update| out.put(&update))?;
    (1..frames.len()).try_for_each(|_| out.put(&curve))?;
    let mut codes = Vec::with_capacity(samples * width(head));
    for (_, _, frame) in frames {
        codes.clear();
        if head.bits == 8 {
            codes.extend(frame.iter().map(|&code| i8::try_from(code).expect("codes of 8 bits") as u8));
        } else {
            codes.extend(frame.iter().flat_map(|code| code.to_le_bytes()));
        }
        out.put(&codes)?;
    }
    let sum = out.sum;
    out.put(&sum.to_le_bytes())
}

/// Update specification of a frame whose sample 0 is `after_s` after the common offset.
fn update(head: &FrameHead, trigger_s: f64, after_s: f64) -> [u8; UPDATE] {
    let tt_offset = after_s / head.dt_s;
    assert!((0.0..1.0).contains(&tt_offset), "times of sample 0 of one file differ by less than a sample");
    // Whole seconds and fractions are added separately, so that no digit of the fraction is lost.
    let (acquired, fraction_s) = head.acquired;
    let fraction_s = fraction_s + (trigger_s - trigger_s.floor());
    let seconds = acquired + trigger_s.floor() as i64 + fraction_s.floor() as i64;
    let seconds = i32::try_from(seconds).ok().filter(|seconds| *seconds > 0).expect("a time between 1970 and 2038");
    let mut bytes = [0; UPDATE];
    bytes[4..12].copy_from_slice(&tt_offset.to_le_bytes());
    bytes[12..20].copy_from_slice(&(fraction_s - fraction_s.floor()).to_le_bytes());
    bytes[20..].copy_from_slice(&seconds.to_le_bytes());
    bytes
}

/// Curve object of a buffer without extra samples.
fn curve_object(curve_bytes: usize) -> [u8; CURVE] {
    let end = u32::try_from(curve_bytes).expect("a file holds less than 2 GiB");
    let mut bytes = [0; CURVE];
    for at in [18, 22, 26] {
        bytes[at..at + 4].copy_from_slice(&end.to_le_bytes());
    }
    bytes
}

/// A writer that sums the bytes it passes on.
struct Summed<'a, W> {
    out: &'a mut W,
    sum: u64,
}

impl<W: Write> Summed<'_, W> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sum += sum_of_bytes(bytes);
        self.out.write_all(bytes)
    }
}

fn width(head: &FrameHead) -> usize {
    if head.bits == 8 { 1 } else { 2 }
}

/// Everything before the first update specification.
fn file_head(head: &FrameHead, frames: usize, samples: usize, offset_s: f64) -> Vec<u8> {
    let layout = &LAYOUTS[2];
    let (dimension, more) = (layout.explicit, u32::try_from(frames - 1).expect("frames count in 32 bits"));
    let data = layout.end + (frames - 1) * (UPDATE + CURVE);
    let end = data + frames * samples * width(head) + CHECKSUM as usize;
    let length = |bytes: usize| i32::try_from(bytes).expect("a file holds less than 2 GiB");
    let mut bytes = vec![0; layout.update];
    let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
    put(0, b"\x0f\x0f:WFM#003");
    let counted = length(end) - UNCOUNTED as i32;
    put(10, &[counted.to_string().len() as u8]);
    put(11, &counted.to_le_bytes());
    put(15, &[width(head) as u8]);
    put(16, &length(data).to_le_bytes());
    put(40, &head.label.as_bytes()[..head.label.len().min(31)]);
    put(72, &more.to_le_bytes());
    put(78, &u32::from(frames > 1).to_le_bytes());
    for (at, count) in [(82, 1), (110, 1), (114, 1), (118, 1), (122, 2), (142, 1)] {
        put(at, &i32::to_le_bytes(count));
    }
    for at in [146, 150] {
        put(at, &(if frames > 1 { more + 1 } else { 0 }).to_le_bytes());
    }
    put(dimension, &head.gain_v.to_le_bytes());
    put(dimension + 8, &head.offset_v.to_le_bytes());
    put(dimension + 20, b"V");
    put(dimension + 72, &(if head.bits == 8 { 7_i32 } else { 0 }).to_le_bytes());
    if head.bits != 8 {
        // A code has zeros below the bits of the converter.
        let highest = i16::MAX - ((1 << (16 - head.bits)) - 1);
        put(dimension + 92, &highest.to_le_bytes());
        put(dimension + 96, &i16::MIN.to_le_bytes());
    }
    put(layout.implicit, &head.dt_s.to_le_bytes());
    put(layout.implicit + 8, &offset_s.to_le_bytes());
    put(layout.implicit + 16, &length(samples).to_le_bytes());
    put(layout.implicit + 20, b"s");
    put(layout.time_base, &1_u32.to_le_bytes());
    put(layout.time_base + 4, &1_i32.to_le_bytes());
    bytes
}
