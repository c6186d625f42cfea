//! LAS 1.3 and 1.4 with waveform packets: points of a lidar, each with the stretch of returning light that it was
//! found in. The packets lie in the file itself, or in NAME.wdp beside NAME.las.
//!
//! Points of formats 4, 5, 9 and 10 name their packet: a descriptor (bits of a sample, time between samples, gain and
//! offset in volts), where its samples begin, where in it the point lies, and how far a place on the beam moves with
//! a picosecond. Points with one packet are the returns of one pulse. It is one record; sample i lies at
//! `t0_s + i dt` after the first of its returns.
//!
//! The direction along the beam has no sign that all writers agree on: that of the real file points back to the
//! scanner, as the common reading library has it, while the words of the standard may be read either way. Where pulses
//! have several returns, their places decide; else the direction points back.
//!
//! Refused by name: points without packets, LAZ, compressed packets, samples of other than 8, 16 or 32 bits. Outgoing
//! pulses are not in these files.
//!
//! Source: ASPRS LAS specification 1.3 revision 11 and 1.4 revision 15. One real file could be had, whose packets were
//! cut off: with samples made up behind it, all its 999 points, directions and waveforms equal those that `laspy`
//! reads. The rest is tested on files that the tests build.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use super::beam::{self, Flight, Pulse};
use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record, Scale};

/// The reader.
pub struct Las;

const SIGNATURE: &[u8] = b"LASF";
/// Bytes of the heads of LAS 1.3 and 1.4.
const HEAD_1_3: u64 = 235;
const HEAD_1_4: u64 = 375;
/// Bytes of the head of a variable length record, and of an extended one.
const VARIABLE: u64 = 54;
const EXTENDED: u64 = 60;
/// Bytes of a descriptor of packets, and the records that hold one: a point names one by what it is beyond 99.
const DESCRIPTOR: u64 = 26;
const DESCRIPTORS: Range<u16> = 100..355;
/// Number of the extended record that holds packets.
const PACKETS: u16 = u16::MAX;
/// Points that are in memory at a time.
const PIECE: u64 = 512;
/// Bit of a point format that says that points are compressed.
const COMPRESSED: u8 = 0x80;
/// Bits of the head that say where packets are.
const INTERNAL: u16 = 1 << 1;
const EXTERNAL: u16 = 1 << 2;
const PS: f64 = 1e-12;

impl Reader for Las {
    fn format(&self) -> &'static str {
        "las"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["las"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(SIGNATURE)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let file = File::open(input)?;
        let packets = file.packets(input)?;
        file.records(input, &packets)
    }
}

/// Returns the pulses with their records.
pub(super) fn flight(input: &mut dyn Input) -> Result<Flight, FormatError> {
    let file = File::open(input)?;
    let packets = file.packets(input)?;
    let records = file.records(input, &packets)?;
    let sign = file.sign(input, &packets)?;
    let mut pulses = Vec::with_capacity(records.len());
    for (record, packet) in packets.iter().enumerate() {
        let point = file.point(input, packet.first)?;
        pulses.push(Pulse {
            gps_time_s: point.gps_time_s,
            anchor: point.place,
            velocity_per_s: point.per_ps.map(|per_ps| sign * per_ps / PS),
            outgoing: None,
            returning: vec![record],
        });
    }
    Ok(Flight { records, pulses })
}

/// Where a point format has its GPS time and its packet.
#[derive(Clone, Copy)]
struct Layout {
    gps: usize,
    packet: usize,
}

/// The head of a file and what it describes.
struct File {
    head: Numbers,
    layout: Layout,
    points: Range<u64>,
    stride: u64,
    descriptors: BTreeMap<u8, Descriptor>,
    /// Where packets lie; places in it count from its start.
    waves: Range<u64>,
}

/// How a packet is sampled.
#[derive(Clone, Copy)]
struct Descriptor {
    code_type: CodeType,
    samples: u32,
    dt_s: f64,
    gain: f64,
    offset: f64,
}

/// A point as the file has it.
struct Point {
    descriptor: u8,
    /// Where its packet begins, and how long that is.
    offset: u64,
    bytes: u32,
    /// Of the return, after the first sample.
    location_ps: f64,
    per_ps: [f64; 3],
    place: [f64; 3],
    gps_time_s: f64,
}

/// A packet, with the first and the last point that names it.
#[derive(Clone, Copy)]
struct Packet {
    offset: u64,
    first: u64,
    last: u64,
}

impl File {
    fn open(input: &mut dyn Input) -> Result<Self, FormatError> {
        let head = Numbers::head(input, HEAD_1_3)?;
        let (minor, head_bytes, format) = (head.u8(25), u64::from(head.u16(94)), head.u8(104));
        if format & COMPRESSED != 0 {
            return Err(FormatError::NotRead { what: "a compressed LAS file (LAZ)", fix: "unpack it with `laszip`" });
        }
        let layout = match format {
            4 => Layout { gps: 20, packet: 28 },
            5 => Layout { gps: 20, packet: 34 },
            9 => Layout { gps: 22, packet: 30 },
            10 => Layout { gps: 22, packet: 38 },
            _ => {
                let fix = "export points of format 4, 5, 9 or 10, with their waveforms";
                return Err(FormatError::NotRead { what: "a LAS point cloud without waveform packets", fix });
            }
        };
        if minor < 3 || head_bytes < HEAD_1_3 || minor >= 4 && head_bytes < HEAD_1_4 {
            return Err(
                head.refuse(25, format!("LAS 1.{minor} with a head of {head_bytes} bytes: copy the file again"))
            );
        }
        let more = Numbers::little(input.bytes("the head", HEAD_1_3, head_bytes - HEAD_1_3)?, HEAD_1_3);
        let count = if minor >= 4 { more.u64(12) } else { u64::from(head.u32(107)) };
        let (start, stride) = (u64::from(head.u32(96)), u64::from(head.u16(105)));
        if start < head_bytes || stride < layout.packet as u64 + 29 {
            let problem =
                format!("points of format {format} from byte {start}, of {stride} bytes; copy the file again");
            return Err(head.refuse(96, problem));
        }
        let bytes = count.saturating_mul(stride);
        let end = start.checked_add(bytes).filter(|end| *end <= input.length());
        let end = end.ok_or(FormatError::Truncated {
            what: "the points",
            byte_offset: start,
            needed: bytes,
            length: input.length(),
        })?;
        input.uses(start..end);
        let mut descriptors = BTreeMap::new();
        let mut at = head_bytes;
        for _ in 0..head.u32(100) {
            let record = Numbers::little(input.bytes("a variable length record", at, VARIABLE)?, at);
            let length = u64::from(record.u16(20));
            let payload = input.bytes("a variable length record", at + VARIABLE, length)?;
            let number = record.u16(18);
            if DESCRIPTORS.contains(&number) && record.text(2, 16).as_deref() == Some("LASF_Spec") {
                let fields = Numbers::little(payload, at + VARIABLE);
                descriptors.insert((number - DESCRIPTORS.start + 1) as u8, Descriptor::parse(&fields)?);
            }
            at += VARIABLE + length;
        }
        if at > start {
            return Err(head.refuse(100, format!("records up to byte {at} reach into the points, at byte {start}")));
        }
        // Up to two bytes of padding may stand before the points.
        if start - at <= 2 {
            input.uses(at..start);
        }
        let extended = (minor >= 4).then(|| (more.u64(0), more.u32(8)));
        let waves = waves(input, &head, extended)?;
        Ok(Self { head, layout, points: start..end, stride, descriptors, waves })
    }

    /// The packets in the order of their first points.
    fn packets(&self, input: &mut dyn Input) -> Result<Vec<Packet>, FormatError> {
        let count = (self.points.end - self.points.start) / self.stride;
        let mut packets: Vec<Packet> = Vec::new();
        for first in (0..count).step_by(PIECE as usize) {
            let points = PIECE.min(count - first);
            let piece = input.peek("the points", self.points.start + first * self.stride, points * self.stride)?;
            for (i, bytes) in piece.chunks_exact(self.stride as usize).enumerate() {
                let packet = &bytes[self.layout.packet..];
                if packet[0] == 0 {
                    continue; // no waveform
                }
                let offset = u64::from_le_bytes(packet[1..9].try_into().expect("eight bytes"));
                let point = first + i as u64;
                match packets.last_mut() {
                    // Returns of a pulse mostly follow one another.
                    Some(last) if last.offset == offset => last.last = point,
                    _ => packets.push(Packet { offset, first: point, last: point }),
                }
            }
        }
        packets.sort_unstable_by_key(|packet| (packet.offset, packet.first));
        packets.dedup_by(|later, first| {
            let is_same = later.offset == first.offset;
            if is_same {
                first.last = first.last.max(later.last);
            }
            is_same
        });
        packets.sort_unstable_by_key(|packet| packet.first);
        Ok(packets)
    }

    fn point(&self, input: &mut dyn Input, number: u64) -> Result<Point, FormatError> {
        let at = self.points.start + number * self.stride;
        let entry = Numbers::little(input.peek("a point", at, self.stride)?, at);
        let packet = self.layout.packet;
        let code = |axis: usize| f64::from(entry.i32(4 * axis));
        let finite = |at: usize, name: &str| entry.finite(at, name, entry.f32(at));
        Ok(Point {
            descriptor: entry.u8(packet),
            offset: entry.u64(packet + 1),
            bytes: entry.u32(packet + 9),
            location_ps: finite(packet + 13, "the return's place in its waveform")?,
            per_ps: [
                finite(packet + 17, "the beam's direction")?,
                finite(packet + 21, "the beam's direction")?,
                finite(packet + 25, "the beam's direction")?,
            ],
            place: [0, 1, 2].map(|axis| code(axis) * self.head.f64(131 + 8 * axis) + self.head.f64(155 + 8 * axis)),
            gps_time_s: entry.f64(self.layout.gps),
        })
    }

    fn records(&self, input: &mut dyn Input, packets: &[Packet]) -> Result<Vec<Record>, FormatError> {
        if packets.is_empty() {
            let fix = "export its waveforms with it";
            return Err(FormatError::NotRead { what: "a LAS file none of whose points has a waveform", fix });
        }
        if beam::are_too_many(packets.len() as u64, self.waves.end.max(input.length())) {
            let problem = format!("{} waveforms are more than the file can hold; copy it again", packets.len());
            return Err(self.head.refuse(107, problem));
        }
        let mut heads: BTreeMap<u8, Arc<Head>> = BTreeMap::new();
        let mut records = Vec::with_capacity(packets.len());
        for (number, packet) in packets.iter().enumerate() {
            let point = self.point(input, packet.first)?;
            let place = self.points.start + packet.first * self.stride;
            let refuse = |problem: String| FormatError::Field { byte_offset: place, problem };
            let descriptor = self.descriptors.get(&point.descriptor).ok_or_else(|| {
                refuse(format!("waveform descriptor {} is not in the file; export it again", point.descriptor))
            })?;
            let needed = u64::from(descriptor.samples) * descriptor.code_type.bytes() as u64;
            let start = self.waves.start.checked_add(point.offset).filter(|_| point.offset >= EXTENDED);
            let start = start.ok_or_else(|| refuse(format!("a packet at byte {} is none", point.offset)))?;
            if u64::from(point.bytes) < needed {
                return Err(refuse(format!("a packet of {} bytes, but its samples take {needed}", point.bytes)));
            }
            if start.checked_add(needed).is_none_or(|end| end > self.waves.end) {
                let length = self.waves.end;
                return Err(FormatError::Truncated { what: "a waveform packet", byte_offset: start, needed, length });
            }
            let head = heads.entry(point.descriptor).or_insert_with(|| Arc::new(descriptor.head(&self.head)));
            records.push(Record {
                head: Arc::clone(head),
                segment: (packets.len() > 1).then_some(number as u32),
                t0_s: Some(-point.location_ps * PS),
                trigger_s: None,
                payload: Payload::File {
                    byte_offset: start,
                    stride: descriptor.code_type.bytes() as u64,
                    big_endian: false,
                },
            });
        }
        Ok(records)
    }

    /// Whether directions point along the beam (1) or back (-1): as most of the pulses with several returns say.
    fn sign(&self, input: &mut dyn Input, packets: &[Packet]) -> Result<f64, FormatError> {
        let mut votes = 0_i64;
        for packet in packets.iter().filter(|packet| packet.first != packet.last) {
            let (first, last) = (self.point(input, packet.first)?, self.point(input, packet.last)?);
            let ps = last.location_ps - first.location_ps;
            let along = (0..3).map(|axis| (last.place[axis] - first.place[axis]) * first.per_ps[axis] * ps);
            let along: f64 = along.sum();
            votes += i64::from(along > 0.0) - i64::from(along < 0.0);
        }
        Ok(if votes > 0 { 1.0 } else { -1.0 })
    }
}

impl Descriptor {
    fn parse(fields: &Numbers) -> Result<Self, FormatError> {
        if (fields.bytes.len() as u64) < DESCRIPTOR {
            return Err(FormatError::Field {
                byte_offset: fields.origin,
                problem: format!("a waveform descriptor of {} bytes; export the file again", fields.bytes.len()),
            });
        }
        let (bits, samples, dt_ps) = (fields.u8(0), fields.u32(2), fields.u32(6));
        if fields.u8(1) != 0 {
            let fix = "export them without compression";
            return Err(FormatError::NotRead { what: "a LAS file with compressed waveform packets", fix });
        }
        let code_type = match bits {
            8 => CodeType::U8,
            16 => CodeType::U16,
            32 => CodeType::U32,
            _ => return Err(fields.refuse(0, format!("samples of {bits} bits: 8, 16 and 32 are read"))),
        };
        if samples == 0 || dt_ps == 0 {
            return Err(fields.refuse(2, format!("{samples} samples, {dt_ps} ps apart; export the file again")));
        }
        Ok(Self { code_type, samples, dt_s: f64::from(dt_ps) * PS, gain: fields.f64(10), offset: fields.f64(18) })
    }

    fn head(&self, file: &Numbers) -> Head {
        let Self { gain, offset, .. } = *self;
        let scale = (gain.is_finite() && offset.is_finite() && gain != 0.0).then_some(Scale { gain, offset });
        Head {
            channel: Some("returning".to_owned()),
            unit: Some(if scale.is_some() { "V" } else { "adc" }.to_owned()),
            instrument: file.text(26, 32),
            dt_s: Some(self.dt_s),
            scale,
            header_gain: Some(gain).filter(|gain| gain.is_finite()),
            header_offset: Some(offset).filter(|offset| offset.is_finite()),
            ..Head::new(Las.format(), self.code_type, self.samples as usize)
        }
    }
}

/// Where packets lie, with the extended records of the file counted as used: in LAS 1.4 `extended` says where these
/// begin and how many there are.
fn waves(input: &mut dyn Input, head: &Numbers, extended: Option<(u64, u32)>) -> Result<Range<u64>, FormatError> {
    let (is_internal, is_external) = (head.u16(6) & INTERNAL != 0, head.u16(6) & EXTERNAL != 0);
    let (start, length_of_file) = (head.u64(227), input.length());
    if let Some((mut at, count)) = extended {
        for _ in 0..count {
            let length = extended_record(input, at, length_of_file)?;
            // Packets are counted one by one: bytes between them belong to nothing.
            if at != start || !is_internal {
                input.uses(at..at + EXTENDED + length);
            }
            at += EXTENDED + length;
        }
    }
    if is_external || !is_internal && input.companion().is_some() {
        let waves = input.companion().ok_or_else(|| {
            head.refuse(6, "has no samples: put the file of the same name with ending .wdp next to it")
        })?;
        extended_record(input, waves.start, waves.end)?;
        return Ok(waves);
    }
    if !is_internal || start < HEAD_1_3 {
        return Err(
            head.refuse(227, "its waveform packets are neither in the file nor said to be in a .wdp next to it")
        );
    }
    let length = extended_record(input, start, length_of_file)?;
    let number = Numbers::little(input.peek("the head of the packets", start, EXTENDED)?, start);
    if number.u16(18) != PACKETS {
        return Err(number.refuse(18, "no waveform packets begin here, as the head says; copy the file again"));
    }
    // A length that its writer left at 0 means: up to the end of the file.
    Ok(start..if length == 0 { length_of_file } else { start + EXTENDED + length })
}

/// Length of the extended record whose head begins at `at`, in a file that ends at `end`.
fn extended_record(input: &mut dyn Input, at: u64, end: u64) -> Result<u64, FormatError> {
    let record = Numbers::little(input.bytes("the head of an extended record", at, EXTENDED)?, at);
    let needed = record.u64(20);
    let byte_offset = at + EXTENDED;
    if byte_offset.checked_add(needed).is_none_or(|stop| stop > end) {
        return Err(FormatError::Truncated { what: "an extended record", byte_offset, needed, length: end });
    }
    Ok(needed)
}

#[cfg(test)]
mod tests;
