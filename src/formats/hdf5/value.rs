//! Data types and data spaces of HDF5, and the values of attributes.

use super::super::reader::FormatError;
use super::field;
use super::file::{Header, message, u16_at, u32_at, u64_at};
use crate::waveform::CodeType;

/// Fields of IEEE numbers of 32 and 64 bits: bit offset, precision, exponent (location, size), mantissa (location,
/// size), bias.
const F32: [u8; 12] = [0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0];
const F64: [u8; 12] = [0, 0, 64, 0, 52, 11, 0, 52, 255, 3, 0, 0];

/// A type of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Number {
    float: bool,
    pub signed: bool,
    size: u32,
    pub big_endian: bool,
}

impl Number {
    /// Parses a data type message; for an enumeration, its base type.
    pub fn parse(datatype: &[u8]) -> Option<Self> {
        let datatype = if datatype.first()? & 15 == 8 { datatype.get(8..)? } else { datatype };
        let (head, properties) = datatype.split_at_checked(8)?;
        let size = u32_at(head, 4);
        let (signed, big_endian) = (head[1] & 8 != 0, head[1] & 1 != 0);
        match head[0] & 15 {
            0 if properties.len() >= 4 => {
                let whole = u16_at(properties, 0) == 0 && u32::from(u16_at(properties, 2)) == size.checked_mul(8)?;
                (whole && [1, 2, 4, 8].contains(&size)).then_some(Self { float: false, signed, size, big_endian })
            }
            // Bit 6 with bit 0 is the byte order of the VAX.
            1 if head[1] & 0x40 == 0 => {
                let ieee = size == 4 && properties.starts_with(&F32) || size == 8 && properties.starts_with(&F64);
                ieee.then_some(Self { float: true, signed: true, size, big_endian })
            }
            _ => None,
        }
    }

    /// The type of codes, if records have such a type.
    pub fn code_type(self) -> Option<CodeType> {
        match (self.float, self.signed, self.size) {
            (true, _, 4) => Some(CodeType::F32),
            (true, _, 8) => Some(CodeType::F64),
            (false, true, 1) => Some(CodeType::I8),
            (false, false, 1) => Some(CodeType::U8),
            (false, true, 2) => Some(CodeType::I16),
            (false, false, 2) => Some(CodeType::U16),
            (false, true, 4) => Some(CodeType::I32),
            (false, false, 4) => Some(CodeType::U32),
            _ => None,
        }
    }

    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        self.size as usize
    }

    /// The number at the start of the data.
    pub fn value(self, data: &[u8]) -> Option<f64> {
        let mut bytes = [0; 8];
        let own = &mut bytes[..self.bytes()];
        own.copy_from_slice(data.get(..self.bytes())?);
        if self.big_endian {
            own.reverse();
        }
        if let Some(code_type) = self.code_type() {
            return code_type.decode(own).first().copied();
        }
        Some(if self.signed { i64::from_le_bytes(bytes) as f64 } else { u64::from_le_bytes(bytes) as f64 })
    }
}

/// Lengths of the axes, from a data space message; empty for a single value.
pub(super) fn axes(dataspace: &[u8]) -> Option<Vec<u64>> {
    let (rank, start) = match dataspace {
        [1, rank, ..] => (*rank, 8),
        // Type 2 is the null data space, which holds nothing.
        [2, rank, _, 0 | 1, ..] => (*rank, 4),
        _ => return None,
    };
    let lengths = dataspace.get(start..start + 8 * usize::from(rank))?;
    Some(lengths.chunks_exact(8).map(|length| u64_at(length, 0)).collect())
}

/// An attribute: its data type, and its value.
struct Attribute<'a> {
    name: &'a [u8],
    datatype: &'a [u8],
    value: &'a [u8],
}

impl<'a> Attribute<'a> {
    fn parse(message: &'a [u8]) -> Option<Self> {
        let version = *message.first()?;
        let sizes = message.get(2..8)?;
        // Version 1 pads each field to eight bytes; version 3 has the character set of the name before the name.
        let padded = |size: u16| if version == 1 { usize::from(size).next_multiple_of(8) } else { usize::from(size) };
        let rest = message.get(if version == 3 { 9 } else { 8 }..)?;
        let (name, rest) = rest.split_at_checked(padded(u16_at(sizes, 0)))?;
        let (datatype, rest) = rest.split_at_checked(padded(u16_at(sizes, 2)))?;
        let (dataspace, value) = rest.split_at_checked(padded(u16_at(sizes, 4)))?;
        let single = axes(dataspace)?.iter().all(|&length| length == 1);
        let name = name.split(|byte| *byte == 0).next()?;
        // In versions 2 and 3 the second byte is nonzero if the type is shared.
        ((1..=3).contains(&version) && (version == 1 || message[1] == 0) && single).then_some(Self {
            name,
            datatype,
            value,
        })
    }
}

impl Header {
    fn attribute(&self, name: &str) -> Result<Option<Attribute<'_>>, FormatError> {
        for message in self.all(message::ATTRIBUTE) {
            if let Some(attribute) = Attribute::parse(message?).filter(|attribute| attribute.name == name.as_bytes()) {
                return Ok(Some(attribute));
            }
        }
        Ok(None)
    }

    /// Value of the attribute of this name, if there is one; it must be a number.
    pub fn number(&self, name: &str) -> Result<Option<f64>, FormatError> {
        let Some(Attribute { datatype, value, .. }) = self.attribute(name)? else {
            return Ok(None);
        };
        let number = Number::parse(datatype).and_then(|number| number.value(value)).filter(|number| number.is_finite());
        match number {
            Some(number) => Ok(Some(number)),
            None => Err(field(self.place, format!("attribute {name} is no finite number; save the waveform again"))),
        }
    }

    /// Value of the attribute of this name, if there is one; it must be a text of fixed length.
    pub fn text(&self, name: &str) -> Result<Option<String>, FormatError> {
        let attribute = self.attribute(name)?;
        Ok(attribute.filter(|attribute| attribute.datatype.first().is_some_and(|class| class & 15 == 3)).and_then(
            |Attribute { datatype, value, .. }| fixed_text(value.get(..u32_at(datatype.get(..8)?, 4) as usize)?),
        ))
    }
}

/// A text up to its first zero; `None` if it is empty.
fn fixed_text(bytes: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(bytes.split(|byte| *byte == 0).next()?).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The texts among the members of a compound value, with their names.
pub(super) fn text_members(datatype: &[u8], value: &[u8]) -> Vec<(String, String)> {
    let mut members = Vec::new();
    let mut rest = datatype.get(8..).unwrap_or_default();
    while let Some((name, text, behind)) = text_member(datatype, rest, value) {
        members.extend(text.map(|text| (name, text)));
        rest = behind;
    }
    members
}

/// Name and text of the first member, and the members behind it; `None` at the end, and at a member that is no text.
fn text_member<'a>(datatype: &[u8], members: &'a [u8], value: &[u8]) -> Option<(String, Option<String>, &'a [u8])> {
    // Class 6 is compound. Before its type, a version 1 member has its offset and 28 bytes of axes, a version 2 member
    // only its offset.
    let (version, between) = match datatype.first()? {
        0x16 => (1, 32),
        0x26 => (2, 4),
        0x36 => (3, [1, 2, 3, 4][(u32_at(datatype.get(..8)?, 4).max(1).ilog2() / 8) as usize]),
        _ => return None,
    };
    let name_bytes = members.iter().position(|byte| *byte == 0)?;
    let name = String::from_utf8_lossy(&members[..name_bytes]).into_owned();
    let padded = if version < 3 { (name_bytes + 1).next_multiple_of(8) } else { name_bytes + 1 };
    let (before, behind) = members.get(padded..)?.split_at_checked(between)?;
    let (text, behind) = behind.split_at_checked(8)?;
    let offset = before.iter().take(4).rev().fold(0, |offset, byte| offset << 8 | usize::from(*byte));
    let end = offset.checked_add(u32_at(text, 4) as usize)?;
    (text[0] & 15 == 3 && !name.is_empty()).then(|| (name, value.get(offset..end).and_then(fixed_text), behind))
}
