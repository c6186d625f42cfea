//! MATLAB's MAT-files of version 5 to 7 (`save -v6`, `-v7`): arrays of real numbers by name. Version 7.3 is HDF5; see
//! `hdf5`.
//!
//! A header of 128 bytes precedes a list of elements. Since version 7, the whole element of a variable is deflated. A
//! variable holds its flags, dimensions, name and numbers; the numbers may have a narrower type than the variable. The
//! first dimension varies fastest, so that the axes appear here in reverse order, as in HDF5 files of version 7.3.
//! Sparse, complex, text, cell and struct variables are skipped. Source: MathWorks, *MAT-File Format*.

use super::array::{self, Array, Arrays};
use super::inflate::{self, Packing, Unpacker};
use super::reader::{FormatError, Input};
use crate::waveform::CodeType;

/// Bytes of the header, and of a tag before data.
const HEAD: u64 = 128;
const TAG: u64 = 8;
/// Types of elements.
const INT8: u32 = 1;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of variables that are arrays of numbers: double to uint64.
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
/// Flag of complex numbers.
const COMPLEX: u8 = 8;
/// Longest name that is accepted, in bytes; a longer one means damage.
const NAME_BYTES: u64 = 1 << 12;

/// Whether a file that begins with these bytes is a MAT-file of version 5 to 7.
#[must_use]
pub fn recognises(head: &[u8]) -> bool {
    head.starts_with(b"MATLAB 5.0") && head.get(124..128).is_some_and(|version| version == [0, 1, b'I', b'M'])
}

/// Returns the arrays whose names `wanted` accepts, and the names of all variables. An array may have `most_bytes`.
///
/// # Errors
/// When the file contradicts the format, or a wanted array is larger.
pub fn arrays(
    input: &mut dyn Input,
    wanted: impl Fn(&str) -> bool,
    most_bytes: u64,
) -> Result<(Arrays, Vec<String>), FormatError> {
    let (mut arrays, mut names) = (Arrays::new(), Vec::new());
    each(input, |input, stream| {
        if let Some((name, array)) = stream.variable(input, &wanted, most_bytes)? {
            arrays.extend(array.map(|array| (name.clone(), array)));
            names.push(name);
        }
        Ok(())
    })?;
    Ok((arrays, names))
}

/// An array of real numbers, and where they are.
#[derive(Debug)]
pub(super) struct Variable {
    pub name: String,
    /// Lengths of its axes, as MATLAB has them: the first is contiguous.
    pub lengths: Vec<u64>,
    pub code_type: CodeType,
    /// Whether they are 64 bit integers, which become floating numbers in memory.
    pub is_long: bool,
    /// Where its first number is in the file; `None`: its variable is compressed.
    pub byte_offset: Option<u64>,
    /// Bytes of its numbers in memory.
    pub bytes: u64,
}

/// Returns all arrays of two and more real numbers, without these.
pub(super) fn variables(input: &mut dyn Input) -> Result<Vec<Variable>, FormatError> {
    let mut variables = Vec::new();
    each(input, |input, stream| {
        variables.extend(stream.layout(input)?);
        Ok(())
    })?;
    Ok(variables)
}

/// Passes on the variables of a file in order, and counts their bytes as used.
fn each(
    input: &mut dyn Input,
    mut take: impl FnMut(&mut dyn Input, &mut Stream) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    input.uses(0..HEAD.min(input.length()));
    let mut at = HEAD;
    while at + TAG <= input.length() {
        let tag = input.bytes("a tag", at, TAG)?;
        let (kind, bytes) = (u32_at(&tag, 0), u64::from(u32_at(&tag, 4)));
        let (start, length) = (at + TAG, input.length());
        if start + bytes > length {
            return Err(FormatError::Truncated { what: "a variable", byte_offset: start, needed: bytes, length });
        }
        let mut stream = match kind {
            COMPRESSED => Stream::packed(input, start, bytes)?,
            MATRIX => Stream { unpacker: Unpacker::new(Packing::Stored, start, bytes), left: bytes, place: start },
            _ => {
                return Err(refuse(
                    at,
                    format!("element of type {kind}, where a variable should be; copy the file again"),
                ));
            }
        };
        take(input, &mut stream)?;
        input.uses(start..start + bytes);
        at = start + bytes;
    }
    Ok(())
}

fn refuse(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// The state of reading one variable.
struct Stream {
    unpacker: Unpacker,
    /// Bytes of the variable that are not read yet.
    left: u64,
    place: u64,
}

/// An element of a variable: its type, its length, and the data that its tag may hold.
struct Element {
    kind: u32,
    bytes: u64,
    /// Data of a small element, which its tag holds.
    small: Option<Vec<u8>>,
}

/// What stands before the numbers of a variable; lengths of its axes as MATLAB has them.
struct Head {
    name: String,
    is_real: bool,
    axes: Vec<u64>,
}

impl Stream {
    fn packed(input: &mut dyn Input, start: u64, packed: u64) -> Result<Self, FormatError> {
        let mut stream = Self { unpacker: Unpacker::new(Packing::Zlib, start, packed), left: TAG, place: start };
        let tag = stream.take(input, TAG)?;
        let (kind, bytes) = (u32_at(&tag, 0), u64::from(u32_at(&tag, 4)));
        if kind != MATRIX || !inflate::can_hold(packed, bytes) {
            return Err(refuse(start, "is no compressed variable that fits its bytes; copy the file again"));
        }
        stream.left = bytes;
        Ok(stream)
    }

    fn take(&mut self, input: &mut dyn Input, count: u64) -> Result<Vec<u8>, FormatError> {
        let cut = || refuse(self.place, "a variable ends before its data; copy the file again");
        self.left = self.left.checked_sub(count).ok_or_else(cut)?;
        let mut bytes = vec![0; count as usize];
        let read = self.unpacker.read(input.file(), &mut bytes)?;
        if read < bytes.len() {
            Err(refuse(self.place, "a variable ends before its data; copy the file again"))
        } else {
            Ok(bytes)
        }
    }

    fn element(&mut self, input: &mut dyn Input) -> Result<Element, FormatError> {
        let tag = self.take(input, TAG)?;
        let first = u32_at(&tag, 0);
        // A small element has its length in the upper half, which is zero in others.
        if first >> 16 == 0 {
            return Ok(Element { kind: first, bytes: u64::from(u32_at(&tag, 4)), small: None });
        }
        let bytes = (first >> 16) as usize;
        let small = tag[4..]
            .get(..bytes)
            .ok_or_else(|| refuse(self.place, "a small element is too long; copy the file again"))?;
        Ok(Element { kind: first & 0xFFFF, bytes: bytes as u64, small: Some(small.to_vec()) })
    }

    fn data(&mut self, input: &mut dyn Input, element: Element) -> Result<Vec<u8>, FormatError> {
        if let Some(small) = element.small {
            return Ok(small);
        }
        let mut data = self.take(input, element.bytes)?;
        let padding = element.bytes.next_multiple_of(8) - element.bytes;
        // Writers may omit the padding of a variable's last element.
        self.take(input, padding.min(self.left))?;
        data.truncate(element.bytes as usize);
        Ok(data)
    }

    fn short(&mut self, input: &mut dyn Input, what: &str) -> Result<Vec<u8>, FormatError> {
        let element = self.element(input)?;
        if element.bytes > NAME_BYTES {
            return Err(refuse(
                self.place,
                format!("{what} of a variable is longer than is believed; copy the file again"),
            ));
        }
        self.data(input, element)
    }

    /// Reads what stands before the numbers of a variable; `None` for one without a name.
    fn head(&mut self, input: &mut dyn Input) -> Result<Option<Head>, FormatError> {
        let flags = self.short(input, "the flags")?;
        let dimensions = self.short(input, "the dimensions")?;
        let name = self.short(input, "the name")?;
        let name = String::from_utf8_lossy(&name).into_owned();
        let (Some(class), Some(flag)) = (flags.first(), flags.get(1)) else {
            return Err(refuse(self.place, "a variable has no flags; copy the file again"));
        };
        let is_real = NUMERIC.contains(class) && flag & COMPLEX == 0;
        let axes = dimensions.chunks_exact(4).map(|length| u64::from(u32_at(length, 0))).collect();
        Ok((!name.is_empty()).then_some(Head { name, is_real, axes }))
    }

    /// Where the numbers of a variable are, if it is an array of two and more real ones.
    fn layout(&mut self, input: &mut dyn Input) -> Result<Option<Variable>, FormatError> {
        let Some(Head { name, is_real: true, axes }) = self.head(input)? else { return Ok(None) };
        let element = self.element(input)?;
        let (width, long) = width(element.kind).ok_or_else(|| self.no_type(&name, element.kind))?;
        if array::bytes_of(&axes, width) != Some(element.bytes) || element.bytes > self.left.max(TAG) {
            return Err(self.no_fit(&name, element.bytes));
        }
        if element.small.is_some() || element.bytes < 2 * width as u64 {
            return Ok(None);
        }
        let byte_offset = self.unpacker.is_stored().then(|| self.place + self.unpacker.position());
        Ok(Some(Variable {
            name,
            lengths: axes,
            code_type: code_type(element.kind),
            is_long: long.is_some(),
            byte_offset,
            bytes: element.bytes,
        }))
    }

    fn no_type(&self, name: &str, kind: u32) -> FormatError {
        refuse(self.place, format!("{name} holds numbers of type {kind}; copy the file again"))
    }

    fn no_fit(&self, name: &str, bytes: u64) -> FormatError {
        let problem = format!("{name} holds {bytes} bytes, not those of its dimensions; copy the file again");
        refuse(self.place, problem)
    }

    /// Returns the name of the variable, and its numbers if it is wanted and has real ones; `None` for one without a
    /// name.
    fn variable(
        &mut self,
        input: &mut dyn Input,
        wanted: &impl Fn(&str) -> bool,
        most_bytes: u64,
    ) -> Result<Option<(String, Option<Array>)>, FormatError> {
        let Some(head) = self.head(input)? else { return Ok(None) };
        let Head { name, is_real, mut axes } = head;
        if !wanted(&name) || !is_real {
            return Ok(Some((name, None)));
        }
        axes.reverse();
        let element = self.element(input)?;
        let (width, long) = width(element.kind).ok_or_else(|| self.no_type(&name, element.kind))?;
        if array::bytes_of(&axes, width) != Some(element.bytes) {
            return Err(self.no_fit(&name, element.bytes));
        }
        array::check_size(&name, element.bytes, most_bytes).map_err(|problem| refuse(self.place, problem))?;
        let kind = element.kind;
        let mut codes = self.data(input, element)?;
        if let Some(signed) = long {
            codes = array::from_long(&codes, signed);
        }
        let array = Array { axes: array::lengths(&axes), code_type: code_type(kind), codes };
        Ok(Some((name, Some(array))))
    }
}

/// Bytes of one number; for 64 bit integers also whether they are signed.
fn width(kind: u32) -> Option<(usize, Option<bool>)> {
    match kind {
        INT8 | 2 => Some((1, None)),
        3 | 4 => Some((2, None)),
        5..=7 => Some((4, None)),
        9 => Some((8, None)),
        12 => Some((8, Some(true))),
        13 => Some((8, Some(false))),
        _ => None,
    }
}

/// Type of codes; 64 bit integers become floating numbers.
fn code_type(kind: u32) -> CodeType {
    match kind {
        INT8 => CodeType::I8,
        2 => CodeType::U8,
        3 => CodeType::I16,
        4 => CodeType::U16,
        5 => CodeType::I32,
        6 => CodeType::U32,
        7 => CodeType::F32,
        _ => CodeType::F64,
    }
}

#[cfg(test)]
pub(super) mod tests;
