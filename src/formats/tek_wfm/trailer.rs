//! The optional trailer after the checksum: keys and values, which instruments of the 4, 5 and 6 Series write.

use super::CHECKSUM;
use crate::numbers::text;
use crate::reader::{FormatError, Input};

/// Mark of a trailer.
const TRAILER: &[u8] = b"tekmeta!";
/// Most bytes of a trailer that are read; real ones have some hundreds.
const TRAILER_BYTES: u64 = 1 << 20;

/// What the trailer says about a record.
#[derive(Default)]
pub(super) struct Trailer {
    pub(super) digital: bool,
    pub(super) iq: bool,
    pub(super) label: Option<String>,
}

impl Trailer {
    /// Looks for a trailer after the checksum.
    pub(super) fn read(input: &mut dyn Input, curves_end: u64, big_endian: bool) -> Result<Self, FormatError> {
        let from = curves_end.saturating_add(CHECKSUM);
        let bytes = input.length().saturating_sub(from).min(TRAILER_BYTES);
        if bytes == 0 {
            return Ok(Self::default());
        }
        let bytes = input.peek("the trailer", from, bytes)?;
        let Some(start) = bytes.windows(TRAILER.len()).position(|window| window == TRAILER) else {
            return Ok(Self::default());
        };
        let mut rest = &bytes[start + TRAILER.len()..];
        let trailer = Self::entries(&mut rest, big_endian).ok_or_else(|| FormatError::Field {
            byte_offset: from + start as u64,
            problem: "the tekmeta! trailer is cut or damaged; copy the file from the instrument again".to_owned(),
        })?;
        input.uses(from + start as u64..from + (bytes.len() - rest.len()) as u64);
        Ok(trailer)
    }

    /// Parses a count, then that many keys and values; a length precedes each text.
    fn entries(bytes: &mut &[u8], big_endian: bool) -> Option<Self> {
        let mut trailer = Self::default();
        let count = number(bytes, big_endian)?;
        for _ in 0..count {
            let key = number(bytes, big_endian)?;
            let key = bytes.split_off(..key)?;
            let value = match bytes.split_off_first()? {
                1 => number(bytes, big_endian)?,
                2 | 4 => 4,
                3 => 8,
                _ => return None,
            };
            let value = bytes.split_off(..value)?;
            match key {
                [b'd', b'0'..=b'9'] => trailer.digital = true,
                b"waveform_label" => trailer.label = text(value),
                _ => trailer.iq |= key.starts_with(b"IQ_"),
            }
        }
        Some(trailer)
    }
}

/// Reads the next u32 of the trailer.
fn number(bytes: &mut &[u8], big_endian: bool) -> Option<usize> {
    let number: [u8; 4] = bytes.split_off(..4)?.try_into().ok()?;
    usize::try_from(if big_endian { u32::from_be_bytes(number) } else { u32::from_le_bytes(number) }).ok()
}
