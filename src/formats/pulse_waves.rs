//! PulseWaves (.pls with .wvs): the pulses of an airborne or terrestrial lidar, each with its outgoing pulse and the
//! light that came back.
//!
//! NAME.pls holds a head, records that describe how waves are sampled, and one entry of at least 48 bytes for each
//! pulse: time, anchor, a target 1000 sampling units along the beam, and where its waves begin in NAME.wvs. Waves are
//! samplings (outgoing or returning, of one channel), each of some segments: stretches of time that were recorded.
//!
//! Each segment is a record of channel `outgoing` or `returning` (`returning1` for channel 1 of several, and so on);
//! segments count all records of a channel. Sample i lies at `t0_s + i dt` after the anchor; times of outgoing pulses,
//! which the file counts from the optical centre, are turned to that. Where the file says that no constant time lies
//! between centre and anchor, they have none. Values are the digitiser's counts.
//!
//! Compressed files (.plz, .wvz) are refused by name, as are samples of other than 8 or 16 bits and files that do not
//! say how many pulses they hold. The maker's software writes the field `compression` of a composition before the
//! index of its scanner, its specification names it after: whichever of them is not zero counts as the index.
//!
//! Source: PulseWaves specification, version 0.3 revision 6. Built from the specification only: no real file could be
//! had.

mod descriptor;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use super::beam::{self, Flight, Pulse};
use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{Head, Payload, Record};
use descriptor::{Composition, Sampling, Way};

/// The reader.
pub struct PulseWaves;

const PULSES: &[u8] = b"PulseWavesPulse\0";
const WAVES: &[u8] = b"PulseWavesWaves\0";
/// Bytes of the two heads, of a pulse, of the head of a variable length record.
const HEAD: u64 = 352;
const WAVES_HEAD: u64 = 60;
const PULSE: u64 = 48;
const VARIABLE: u64 = 96;
/// Sampling units from the anchor to the target.
const TARGET_UNITS: f64 = 1000.0;
/// Pulses that are in memory at a time.
const PIECE: u64 = 512;
/// Number of the appended record that comes first, and ends the list, which is read from its end.
const FIRST_APPENDED: u32 = u32::MAX;

impl Reader for PulseWaves {
    fn format(&self) -> &'static str {
        "pulsewaves"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["pls"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(PULSES)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        File::open(input)?.records(input)
    }
}

/// Returns the pulses with their records.
pub(super) fn flight(input: &mut dyn Input) -> Result<Flight, FormatError> {
    let file = File::open(input)?;
    let records = file.records(input)?;
    let mut pulses: Vec<Pulse> = Vec::new();
    let (mut record, mut last) = (0, None);
    file.walk(input, &mut |shot, segment| {
        if last != Some(shot.number) {
            pulses.push(shot.pulse());
            last = Some(shot.number);
        }
        let pulse = pulses.last_mut().expect("pushed above");
        match segment.sampling.way {
            Way::Outgoing => pulse.outgoing = pulse.outgoing.or(Some(record)),
            Way::Returning => pulse.returning.push(record),
        }
        record += 1;
        Ok(())
    })?;
    let start = |record: usize| records[record].t0_s.unwrap_or_default();
    pulses.retain(|pulse| !pulse.returning.is_empty());
    pulses.iter_mut().for_each(|pulse| pulse.returning.sort_by(|a, b| start(*a).total_cmp(&start(*b))));
    Ok(Flight { records, pulses })
}

/// The head of a file and what it describes.
struct File {
    head: Numbers,
    pulses: Range<u64>,
    stride: u64,
    compositions: BTreeMap<u8, Composition>,
    waves: Range<u64>,
}

/// A pulse as the file has it.
struct Shot<'a> {
    number: u64,
    head: &'a Numbers,
    entry: Numbers,
    composition: &'a Composition,
}

/// A stretch of samples.
struct Segment<'a> {
    sampling: &'a Sampling,
    /// From the anchor (returning) or the optical centre (outgoing), in sampling units.
    duration: f64,
    byte_offset: u64,
    samples: usize,
}

impl File {
    fn open(input: &mut dyn Input) -> Result<Self, FormatError> {
        let waves = input.companion().ok_or_else(|| FormatError::Field {
            byte_offset: 0,
            problem: "has no samples: put the file of the same name with ending .wvs next to it".to_owned(),
        })?;
        let head = Numbers::head(input, HEAD)?;
        let (head_bytes, start, count) = (u64::from(head.u16(174)), head.u64(176), head.u64(184));
        let (format, stride, compression) = (head.u32(192), u64::from(head.u32(200)), head.u32(204));
        if compression != 0 {
            let fix = "unpack it with `pulsezip`";
            return Err(FormatError::NotRead { what: "a compressed PulseWaves file", fix });
        }
        if format != 0 || stride < PULSE {
            let problem =
                format!("pulse format {format} of {stride} bytes: only format 0, of 48 bytes or more, is read");
            return Err(head.refuse(192, problem));
        }
        let bytes = count.checked_mul(stride).filter(|_| count > 0 && i64::try_from(count).is_ok());
        let bytes = bytes.ok_or_else(|| {
            let count = count as i64;
            head.refuse(184, format!("{count} pulses: the file was not closed; write it again with `pulse2pulse`"))
        })?;
        if head_bytes < HEAD || start < head_bytes {
            return Err(head.refuse(174, format!("a head of {head_bytes} bytes before pulses at byte {start}")));
        }
        let end = start.checked_add(bytes).filter(|end| *end <= input.length());
        let end = end.ok_or(FormatError::Truncated {
            what: "the pulses",
            byte_offset: start,
            needed: bytes,
            length: input.length(),
        })?;
        input.uses(HEAD..head_bytes);
        input.uses(start..end);
        let mut compositions = BTreeMap::new();
        let mut at = head_bytes;
        for _ in 0..head.u32(216) {
            let length = variable_length(input, at)?;
            let payload = at + VARIABLE;
            descriptor::read(input, at, payload, length, &mut compositions)?;
            at = payload + length;
        }
        if at > start {
            return Err(head.refuse(216, format!("records up to byte {at} reach into the pulses, at byte {start}")));
        }
        appended(input, end, &mut compositions)?;
        check_waves(input, waves.start)?;
        Ok(Self { head, pulses: start..end, stride, compositions, waves })
    }

    /// Passes on every segment that has samples, with its pulse.
    fn walk(
        &self,
        input: &mut dyn Input,
        take: &mut dyn FnMut(&Shot<'_>, &Segment<'_>) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        let count = (self.pulses.end - self.pulses.start) / self.stride;
        for first in (0..count).step_by(PIECE as usize) {
            let origin = self.pulses.start + first * self.stride;
            let pulses = PIECE.min(count - first);
            let piece = input.peek("the pulses", origin, pulses * self.stride)?;
            for (i, bytes) in piece.chunks_exact(self.stride as usize).enumerate() {
                let at = origin + i as u64 * self.stride;
                let entry = Numbers::little(bytes[..PULSE as usize].to_vec(), at);
                if entry.u64(8) == 0 {
                    continue; // no waves
                }
                let index = entry.u8(44);
                let composition = self.compositions.get(&index).ok_or_else(|| {
                    entry.refuse(44, format!("descriptor {index} is not in the file; write it again"))
                })?;
                let shot = Shot { number: first + i as u64, head: &self.head, entry, composition };
                self.segments(input, &shot, take)?;
            }
        }
        Ok(())
    }

    fn segments(
        &self,
        input: &mut dyn Input,
        shot: &Shot<'_>,
        take: &mut dyn FnMut(&Shot<'_>, &Segment<'_>) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        let offset = shot.entry.u64(8);
        let first = self.waves.start.checked_add(offset).filter(|at| offset >= WAVES_HEAD && *at < self.waves.end);
        let first = first.ok_or_else(|| shot.entry.refuse(8, format!("waves at byte {offset} are not in the .wvs")))?;
        let mut at = first + u64::from(shot.composition.extra_bytes);
        for sampling in &shot.composition.samplings {
            let segments = match sampling.segment_bits {
                0 => u32::from(sampling.segments),
                bits => take_count(input, &mut at, bits)?,
            };
            for _ in 0..segments {
                let duration = match sampling.duration_bits {
                    0 => 0.0,
                    bits => take_duration(input, &mut at, bits)?,
                };
                let samples = match sampling.sample_bits {
                    0 => sampling.samples,
                    bits => take_count(input, &mut at, bits)?,
                };
                let bytes = u64::from(samples) * sampling.bytes();
                if at.checked_add(bytes).is_none_or(|end| end > self.waves.end) {
                    let length = self.waves.end;
                    return Err(FormatError::Truncated { what: "the waves", byte_offset: at, needed: bytes, length });
                }
                if samples > 0 {
                    let duration = sampling.duration(duration);
                    take(shot, &Segment { sampling, duration, byte_offset: at, samples: samples as usize })?;
                }
                at += bytes;
            }
        }
        // Samples are in this range too: a pulse has its waves to itself, as the check on records confirms.
        input.uses(first..at);
        Ok(())
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        // Counted before any record is kept: a growing vector could take more memory than the file is long.
        let (mut count, most) = (0, self.waves.end);
        self.walk(input, &mut |shot, _| {
            count += 1;
            if beam::are_too_many(count, most) {
                let problem = format!("more than {count} segments in {most} bytes; copy both files again");
                return Err(shot.entry.refuse(8, problem));
            }
            Ok(())
        })?;
        let mut records = Vec::with_capacity(count as usize);
        let mut heads: BTreeMap<(u8, usize, usize), Arc<Head>> = BTreeMap::new();
        let mut numbers: BTreeMap<String, u32> = BTreeMap::new();
        self.walk(input, &mut |shot, segment| {
            let Segment { sampling, samples, .. } = *segment;
            let new = || Arc::new(sampling.head(PulseWaves.format(), samples, shot.composition, &self.head));
            let key = (shot.entry.u8(44), sampling.number, samples);
            let head = Arc::clone(heads.entry(key).or_insert_with(new));
            let number = numbers.entry(head.channel.clone().unwrap_or_default()).or_insert(0);
            let t0_s = shot.composition.start_s(sampling, segment.duration);
            let payload =
                Payload::File { byte_offset: segment.byte_offset, stride: sampling.bytes(), big_endian: false };
            records.push(Record { head, segment: Some(*number), t0_s, trigger_s: None, payload });
            *number += 1;
            Ok(())
        })?;
        if records.is_empty() {
            return Err(self.head.refuse(184, "none of the pulses has samples"));
        }
        for record in records.iter_mut().filter(|record| numbers[record.head.channel.as_deref().unwrap_or("")] == 1) {
            record.segment = None;
        }
        Ok(records)
    }
}

impl Shot<'_> {
    fn pulse(&self) -> Pulse {
        let (head, entry) = (self.head, &self.entry);
        let scaled = |axis: usize, code: i32| f64::from(code) * head.f64(256 + 8 * axis) + head.f64(280 + 8 * axis);
        let anchor = [0, 1, 2].map(|axis| scaled(axis, entry.i32(16 + 4 * axis)));
        let target = [0, 1, 2].map(|axis| scaled(axis, entry.i32(28 + 4 * axis)));
        let seconds = TARGET_UNITS * self.composition.unit_s;
        Pulse {
            gps_time_s: entry.i64(0) as f64 * head.f64(224) + head.f64(232),
            anchor,
            velocity_per_s: [0, 1, 2].map(|axis| (target[axis] - anchor[axis]) / seconds),
            outgoing: None,
            returning: Vec::new(),
        }
    }
}

/// A count of 8 or 16 bits in the waves.
fn take_count(input: &mut dyn Input, at: &mut u64, bits: u8) -> Result<u32, FormatError> {
    let bytes = Numbers::little(input.peek("the waves", *at, u64::from(bits / 8))?, *at);
    *at += u64::from(bits / 8);
    Ok(if bits == 8 { bytes.u8(0).into() } else { bytes.u16(0).into() })
}

/// A duration of 8, 16 or 32 bits in the waves, which has a sign.
fn take_duration(input: &mut dyn Input, at: &mut u64, bits: u8) -> Result<f64, FormatError> {
    let bytes = Numbers::little(input.peek("the waves", *at, u64::from(bits / 8))?, *at);
    *at += u64::from(bits / 8);
    Ok(match bits {
        8 => f64::from(bytes.u8(0).cast_signed()),
        16 => f64::from(bytes.i16(0)),
        _ => f64::from(bytes.i32(0)),
    })
}

/// Length of the variable length record whose head begins at `at`; the record is within the file.
fn variable_length(input: &mut dyn Input, at: u64) -> Result<u64, FormatError> {
    let head = Numbers::little(input.bytes("a variable length record", at, VARIABLE)?, at);
    let needed = head.u64(24);
    let (byte_offset, length) = (at + VARIABLE, input.length());
    if byte_offset.checked_add(needed).is_none_or(|end| end > length) {
        return Err(FormatError::Truncated { what: "a variable length record", byte_offset, needed, length });
    }
    input.uses(byte_offset..byte_offset + needed);
    Ok(needed)
}

/// Records behind the pulses: each has its head behind it, so that they are read from the end of the file. If they do
/// not lead back to the pulses, the bytes there are no such records.
fn appended(
    input: &mut dyn Input,
    pulses_end: u64,
    compositions: &mut BTreeMap<u8, Composition>,
) -> Result<(), FormatError> {
    let (mut end, mut places) = (input.length(), Vec::new());
    while end >= pulses_end + VARIABLE {
        let foot = Numbers::little(input.peek("an appended record", end - VARIABLE, VARIABLE)?, end - VARIABLE);
        let length = foot.u64(24);
        let Some(start) = (end - VARIABLE).checked_sub(length).filter(|start| *start >= pulses_end) else { break };
        places.push((end - VARIABLE, start, length));
        end = start;
        if foot.u32(16) == FIRST_APPENDED {
            break;
        }
    }
    if end == pulses_end {
        input.uses(pulses_end..input.length());
        for (foot, start, length) in places {
            descriptor::read(input, foot, start, length, compositions)?;
        }
    }
    Ok(())
}

fn check_waves(input: &mut dyn Input, start: u64) -> Result<(), FormatError> {
    let head = Numbers::little(input.bytes("the head of the .wvs", start, WAVES_HEAD)?, start);
    if !head.bytes.starts_with(WAVES) {
        return Err(head.refuse(0, "the .wvs next to it is no PulseWaves file; copy it again"));
    }
    if head.u32(16) != 0 {
        let fix = "unpack it with `pulsezip`";
        return Err(FormatError::NotRead { what: "a PulseWaves file with compressed waves", fix });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
