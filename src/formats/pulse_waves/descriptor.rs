//! How the waves of a pulse are sampled: a composition of samplings.

use std::collections::BTreeMap;

use super::super::numbers::Numbers;
use super::super::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head};

/// Records of the file with these numbers are descriptors; a pulse names one by what it is beyond the first.
const FIRST: u32 = 200_000;
const LAST: u32 = 200_255;
/// Bytes of a composition and of a sampling, their descriptions included.
const COMPOSITION: u64 = 92;
const SAMPLING: u64 = 104;
/// What a composition says where no constant time lies between optical centre and anchor.
const NO_CONSTANT: u32 = 0x8FFF_FFFF;

/// Whether light goes out or comes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Outgoing,
    Returning,
}

/// What all pulses of a descriptor have in common.
#[derive(Debug)]
pub(super) struct Composition {
    /// Time of a sampling unit.
    pub unit_s: f64,
    /// Sampling units from the optical centre to the anchor, if that is constant.
    pub anchor_units: Option<f64>,
    /// Bytes of a pulse's waves before its samplings.
    pub extra_bytes: u16,
    pub samplings: Vec<Sampling>,
}

/// Samples of one channel and way.
#[derive(Debug)]
pub(super) struct Sampling {
    /// Position in its composition.
    pub number: usize,
    pub way: Way,
    channel: u8,
    /// Bits of numbers in the waves; 0: the number is the same for all pulses.
    pub duration_bits: u8,
    pub segment_bits: u8,
    pub sample_bits: u8,
    pub segments: u16,
    pub samples: u32,
    scale: f64,
    offset: f64,
    pub code_type: CodeType,
    dt_s: f64,
}

impl Composition {
    /// Time of a segment's first sample after the anchor.
    pub fn start_s(&self, sampling: &Sampling, duration: f64) -> Option<f64> {
        let units = match sampling.way {
            Way::Outgoing => duration - self.anchor_units?,
            Way::Returning => duration,
        };
        Some(units * self.unit_s)
    }
}

impl Sampling {
    /// Sampling units of a number in the waves.
    pub fn duration(&self, number: f64) -> f64 {
        self.scale * number + self.offset
    }

    /// Bytes of a sample.
    pub fn bytes(&self) -> u64 {
        self.code_type.bytes() as u64
    }

    /// The head of its records; `file` is that of the file.
    pub fn head(&self, format: &'static str, samples: usize, composition: &Composition, file: &Numbers) -> Head {
        let way = if self.way == Way::Outgoing { "outgoing" } else { "returning" };
        let channel = if self.channel == 0 { way.to_owned() } else { format!("{way}{}", self.channel) };
        Head {
            channel: Some(channel),
            unit: Some("adc".to_owned()),
            instrument: file.text(40, 64),
            dt_s: Some(if self.dt_s > 0.0 { self.dt_s } else { composition.unit_s }),
            ..Head::new(format, self.code_type, samples)
        }
    }

    fn parse(fields: &Numbers, number: usize) -> Result<Self, FormatError> {
        let bits = |at: usize, all: &[u8]| {
            let bits = fields.u8(at);
            let is_possible = all.contains(&bits);
            is_possible.then_some(bits).ok_or_else(|| fields.refuse(at, format!("{bits} bits: {all:?} are possible")))
        };
        let way = match fields.u8(8) {
            1 => Way::Outgoing,
            2 => Way::Returning,
            other => {
                return Err(
                    fields.refuse(8, format!("sampling of type {other}: 1 (outgoing) and 2 (returning) are read"))
                );
            }
        };
        if fields.u32(36) != 0 {
            let fix = "unpack it with `pulsezip`";
            return Err(FormatError::NotRead { what: "a PulseWaves file with compressed samples", fix });
        }
        let code_type = match fields.u16(28) {
            8 => CodeType::U8,
            16 => CodeType::U16,
            other => return Err(fields.refuse(28, format!("samples of {other} bits: 8 and 16 are read"))),
        };
        Ok(Self {
            number,
            way,
            channel: fields.u8(9),
            duration_bits: bits(11, &[0, 8, 16, 32])?,
            segment_bits: bits(20, &[0, 8, 16])?,
            sample_bits: bits(21, &[0, 8, 16])?,
            segments: fields.u16(22),
            samples: fields.u32(24),
            scale: fields.finite(12, "the scale of durations", fields.f32(12))?,
            offset: fields.finite(16, "the offset of durations", fields.f32(16))?,
            code_type,
            dt_s: fields.finite(32, "the time between samples", fields.f32(32))?.max(0.0) * 1e-9,
        })
    }
}

/// Reads the record of the file whose head begins at `head`, if it is a descriptor; `start` is where what it says
/// begins, and `length` how long that is.
pub(super) fn read(
    input: &mut dyn Input,
    head: u64,
    start: u64,
    length: u64,
    compositions: &mut BTreeMap<u8, Composition>,
) -> Result<(), FormatError> {
    let number = Numbers::little(input.peek("a record's number", head + 16, 4)?, head + 16).u32(0);
    if !(FIRST + 1..=LAST).contains(&number) || length < COMPOSITION {
        return Ok(());
    }
    let fields = Numbers::little(input.peek("a descriptor", start, COMPOSITION)?, start);
    let (size, count) = (u64::from(fields.u32(0)), fields.u16(14));
    let unit_s = fields.f32(16) * 1e-9;
    if !(unit_s > 0.0 && unit_s.is_finite()) {
        return Err(fields.refuse(16, format!("sampling units of {unit_s} s; write the file again")));
    }
    if fields.u32(20) != 0 && fields.u32(24) != 0 {
        let fix = "unpack it with `pulsezip`";
        return Err(FormatError::NotRead { what: "a PulseWaves file with compressed pulses", fix });
    }
    if size < COMPOSITION {
        return Err(fields.refuse(0, format!("a composition of {size} bytes: {COMPOSITION} are the least")));
    }
    let (mut at, end) = (start + size, start + length);
    let mut samplings = Vec::new();
    for number in 0..usize::from(count) {
        if at.checked_add(SAMPLING).is_none_or(|next| next > end) {
            return Err(fields.refuse(14, format!("{count} samplings, but its record ends after {number}")));
        }
        let of_sampling = Numbers::little(input.peek("a sampling", at, SAMPLING)?, at);
        let size = u64::from(of_sampling.u32(0));
        if size < SAMPLING {
            return Err(of_sampling.refuse(0, format!("a sampling of {size} bytes: {SAMPLING} are the least")));
        }
        samplings.push(Sampling::parse(&of_sampling, number)?);
        at += size;
    }
    let anchor = fields.i32(8);
    compositions.insert(
        (number - FIRST) as u8,
        Composition {
            unit_s,
            anchor_units: (anchor as u32 != NO_CONSTANT).then_some(f64::from(anchor)),
            extra_bytes: fields.u16(12),
            samplings,
        },
    );
    Ok(())
}
