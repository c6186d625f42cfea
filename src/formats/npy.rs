//! NumPy `.npy`: integer and floating arrays. The last axis counts samples, unless the caller names the axes. Where the
//! samples of a record lie apart, as in the Fortran order that MATLAB and R write, they are read one by one.
//!
//! The file has no scale and no time base. Structured and complex types are refused. Source: NumPy
//! Enhancement Proposal 1; the header is a Python dictionary of three keys.

use std::io::{self, Write};

use super::array;
use super::description::Key;
use super::grid::Grid;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Record};

/// The reader.
pub struct Npy;

/// Longest header that is read: the dictionary of a plain array has about a hundred bytes.
pub(super) const HEADER_BYTES: u64 = 1 << 12;

impl Reader for Npy {
    fn format(&self) -> &'static str {
        "npy"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["npy"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(b"\x93NUMPY")
    }
    fn keys(&self) -> &'static [Key] {
        &[Key::Axes]
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let bytes = input.peek("the header", 0, input.length().min(HEADER_BYTES))?;
        let Some(array) = Array::read(&bytes, input.length(), input.description().axes.as_deref())? else {
            return Err(refuse("a single number is no waveform"));
        };
        array.grid.limit(input.length(), 0, size_of::<Record>())?;
        input.uses(0..array.data);
        let payload = |i: u64| array.grid.payload(i, array.data, array.code_type, array.big_endian);
        Ok(array.grid.list(array.grid.head(self.format(), array.code_type), payload))
    }
}

fn refuse(problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset: 0, problem: problem.into() }
}

/// An array, as its header describes it.
pub(super) struct Array {
    pub code_type: CodeType,
    pub big_endian: bool,
    /// Where its numbers begin.
    pub data: u64,
    /// Where its records lie among them.
    pub grid: Grid,
}

impl Array {
    /// Parses the first bytes of an array of `length` bytes, header included; `None` for a single number. Its axes may
    /// have names.
    pub fn read(bytes: &[u8], length: u64, names: Option<&[String]>) -> Result<Option<Self>, FormatError> {
        let (text, data) = header_text(bytes).map_err(refuse)?;
        let Header { descr, fortran_order, shape } = Header::parse(text).map_err(refuse)?;
        if shape.is_empty() {
            return Ok(None);
        }
        let (code_type, big_endian) = code_type(descr).ok_or_else(|| {
            refuse(format!("numbers of type {descr} are not read; save them as i1, i2, i4, u1, u2, u4, f4 or f8"))
        })?;
        let count = shape.iter().try_fold(1_u64, |product, &length| product.checked_mul(length));
        let needed = count.and_then(|count| count.checked_mul(code_type.bytes() as u64));
        let available = length.saturating_sub(data);
        match needed {
            Some(0) => return Err(refuse(format!("shape {shape:?} holds no sample"))),
            Some(needed) if needed <= available => {}
            _ => {
                let problem = format!(
                    "shape {shape:?} does not fit the {available} bytes that follow the header; copy the file again"
                );
                return Err(FormatError::Field { byte_offset: data, problem });
            }
        }
        let grid = Grid::new(&shape, fortran_order, names)?;
        Ok(Some(Self { code_type, big_endian, data, grid }))
    }

    /// Bytes of its numbers.
    pub fn bytes(&self) -> u64 {
        self.grid.records() * self.record_bytes()
    }

    /// Bytes of one record.
    pub fn record_bytes(&self) -> u64 {
        self.grid.samples() * self.code_type.bytes() as u64
    }
}

/// A whole array with all of its axes, from the bytes of its file: also single numbers, and integers of 64 bits without
/// a sign or with, which become floating numbers.
///
/// # Errors
/// When the bytes contradict the format, or are no numbers.
pub(super) fn whole(bytes: &[u8]) -> Result<array::Array, FormatError> {
    let (text, data) = header_text(bytes).map_err(refuse)?;
    let Header { descr, fortran_order, shape } = Header::parse(text).map_err(refuse)?;
    let (order, name) = descr.split_at_checked(1).unwrap_or(("", descr));
    let width = match name {
        "i8" | "u8" => 8,
        _ => code_type(descr).map_or(0, |(code_type, _)| code_type.bytes()),
    };
    if width == 0 {
        return Err(refuse(format!("numbers of type {descr} are not read; save them as integers or floating numbers")));
    }
    let mut codes = bytes[data as usize..].to_vec();
    if array::bytes_of(&shape, width) != Some(codes.len() as u64) {
        let problem = format!("shape {shape:?} does not fit the {} bytes that follow the header", codes.len());
        return Err(FormatError::Field { byte_offset: data, problem });
    }
    if order == ">" {
        codes.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    }
    let axes = array::lengths(&shape);
    if fortran_order {
        codes = last_axis_fastest(&codes, &axes, width);
    }
    let (code_type, codes) = match (name, code_type(descr)) {
        (_, Some((code_type, _))) => (code_type, codes),
        (_, None) => (CodeType::F64, array::from_long(&codes, name == "i8")),
    };
    Ok(array::Array { axes, code_type, codes })
}

/// Numbers whose first axis is the fastest, with the last one as the fastest.
fn last_axis_fastest(codes: &[u8], axes: &[usize], width: usize) -> Vec<u8> {
    let mut ordered = Vec::with_capacity(codes.len());
    let mut place = vec![0; axes.len()];
    for _ in 0..codes.len() / width {
        let at = place.iter().zip(axes).rev().fold(0, |at, (place, length)| at * length + place);
        ordered.extend_from_slice(&codes[at * width..(at + 1) * width]);
        for (place, length) in place.iter_mut().zip(axes).rev() {
            *place += 1;
            if *place < *length {
                break;
            }
            *place = 0;
        }
    }
    ordered
}

/// Returns the text of the header, and where the numbers begin.
fn header_text(bytes: &[u8]) -> Result<(&[u8], u64), String> {
    let (length, text) = match bytes {
        [_, _, _, _, _, _, 1, _, a, b, text @ ..] => (u32::from(u16::from_le_bytes([*a, *b])), text),
        [_, _, _, _, _, _, 2 | 3, _, a, b, c, d, text @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]), text),
        _ => return Err("header: neither version 1, 2 nor 3, or cut short; save the array again".to_owned()),
    };
    let before = (bytes.len() - text.len()) as u64;
    let text = text.get(..length as usize).ok_or_else(|| {
        format!("the header claims {length} bytes, of which {} are there; copy the file again", text.len())
    })?;
    Ok((text, before + u64::from(length)))
}

/// The three entries of the header's dictionary.
#[derive(Debug, PartialEq)]
struct Header<'a> {
    descr: &'a str,
    fortran_order: bool,
    shape: Vec<u64>,
}

impl<'a> Header<'a> {
    fn parse(text: &'a [u8]) -> Result<Self, String> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        let mut scanner = Scanner(text);
        scanner.expect(b'{')?;
        while !scanner.eat(b'}') {
            let key = scanner.quoted()?;
            scanner.expect(b':')?;
            match key {
                "descr" if scanner.peek() == Some(b'[') => {
                    return Err("structured types are not read; save the numbers as a plain array".to_owned());
                }
                "descr" => descr = Some(scanner.quoted()?),
                "fortran_order" => {
                    fortran_order = Some(match scanner.word() {
                        b"True" => true,
                        b"False" => false,
                        _ => return Err("header: fortran_order is neither True nor False".to_owned()),
                    });
                }
                "shape" => shape = Some(scanner.numbers()?),
                _ => return Err(format!("header: there is no key `{key}` in such files")),
            }
            if !scanner.eat(b',') && scanner.peek() != Some(b'}') {
                return Err(scanner.problem("a comma or the end of the dictionary"));
            }
        }
        if scanner.peek().is_some_and(|byte| byte != 0) {
            return Err(scanner.problem("nothing more"));
        }
        match (descr, fortran_order, shape) {
            (Some(descr), Some(fortran_order), Some(shape)) => Ok(Self { descr, fortran_order, shape }),
            _ => Err("header: not all of descr, fortran_order and shape are given".to_owned()),
        }
    }
}

/// The unread rest of a header.
struct Scanner<'a>(&'a [u8]);

impl<'a> Scanner<'a> {
    fn peek(&mut self) -> Option<u8> {
        self.0 = self.0.trim_ascii_start();
        self.0.first().copied()
    }

    fn eat(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.0 = &self.0[usize::from(is_next)..];
        is_next
    }

    fn expect(&mut self, byte: u8) -> Result<(), String> {
        if self.eat(byte) { Ok(()) } else { Err(self.problem(&format!("`{}`", byte as char))) }
    }

    fn problem(&self, expected: &str) -> String {
        let rest = String::from_utf8_lossy(&self.0[..self.0.len().min(16)]);
        format!("header: expected {expected}, found `{}`; save the array again", rest.escape_debug())
    }

    /// Letters, digits and underscores.
    fn word(&mut self) -> &'a [u8] {
        self.peek();
        let end = self.0.iter().position(|byte| !byte.is_ascii_alphanumeric() && *byte != b'_');
        let (word, rest) = self.0.split_at(end.unwrap_or(self.0.len()));
        self.0 = rest;
        word
    }

    /// Text between quotes. The keys and types of a header have no escapes.
    fn quoted(&mut self) -> Result<&'a str, String> {
        let quote = self.peek().filter(|byte| b"'\"".contains(byte)).ok_or_else(|| self.problem("a text in quotes"))?;
        let length =
            self.0[1..].iter().position(|byte| *byte == quote).ok_or_else(|| self.problem("an end of quotes"))?;
        let text = std::str::from_utf8(&self.0[1..=length]).map_err(|_| self.problem("a text of letters"))?;
        self.0 = &self.0[length + 2..];
        Ok(text)
    }

    /// Whole numbers between brackets; Python 2 wrote an L after long ones.
    fn numbers(&mut self) -> Result<Vec<u64>, String> {
        self.expect(b'(')?;
        let mut numbers = Vec::new();
        while !self.eat(b')') {
            let digits = self.word();
            let digits = digits.strip_suffix(b"L").unwrap_or(digits);
            let number = std::str::from_utf8(digits).ok().and_then(|digits| digits.parse().ok());
            numbers.push(number.ok_or_else(|| self.problem("the length of an axis before"))?);
            if !self.eat(b',') && self.peek() != Some(b')') {
                return Err(self.problem("a comma or the end of the shape"));
            }
        }
        Ok(numbers)
    }
}

fn code_type(descr: &str) -> Option<(CodeType, bool)> {
    let (order, name) = descr.split_at_checked(1)?;
    let code_type = match name {
        "i1" => CodeType::I8,
        "u1" => CodeType::U8,
        "i2" => CodeType::I16,
        "u2" => CodeType::U16,
        "u4" => CodeType::U32,
        "i4" => CodeType::I32,
        "f4" => CodeType::F32,
        "f8" => CodeType::F64,
        _ => return None,
    };
    // The byte order of single bytes is irrelevant.
    match order {
        "<" | "=" => Some((code_type, false)),
        ">" => Some((code_type, true)),
        "|" if code_type.bytes() == 1 => Some((code_type, false)),
        _ => None,
    }
}

/// A type of numbers that [`write()`] accepts.
pub trait Number: Copy {
    /// The type as the header names it.
    const DESCR: &'static str;
    /// Its bytes, least significant first.
    fn bytes(self) -> impl AsRef<[u8]>;
}

macro_rules! number {
    ($($native:ty, $descr:literal;)*) => {$(
        impl Number for $native {
            const DESCR: &'static str = $descr;
            fn bytes(self) -> impl AsRef<[u8]> { self.to_le_bytes() }
        }
    )*};
}
number! {
    i8, "|i1";
    u8, "|u1";
    i16, "<i2";
    u16, "<u2";
    i32, "<i4";
    f32, "<f4";
    f64, "<f8";
}

/// Writes an array of `shape` in C order.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When the number of values contradicts the shape.
pub fn write<T: Number>(out: &mut impl Write, shape: &[u64], values: &[T]) -> io::Result<()> {
    assert_eq!(shape.iter().product::<u64>(), values.len() as u64, "as many values as the shape says");
    write_head::<T>(out, shape)?;
    let mut block = Vec::new();
    for values in values.chunks(1 << 16) {
        block.clear();
        values.iter().for_each(|value| block.extend_from_slice(value.bytes().as_ref()));
        out.write_all(&block)?;
    }
    Ok(())
}

/// Writes what stands before the values of an array, for those that come piece by piece, little-endian.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_head<T: Number>(out: &mut impl Write, shape: &[u64]) -> io::Result<()> {
    let lengths: Vec<String> = shape.iter().map(|length| format!("{length},")).collect();
    let mut text = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}", T::DESCR, lengths.join(" "));
    // The format demands that numbers begin at a multiple of 64, after magic, version, length and a text that ends its
    // line.
    while (10 + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&u16::try_from(text.len()).expect("a shape of few axes").to_le_bytes())?;
    out.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder;

    fn read(bytes: &[u8]) -> Result<Option<Array>, FormatError> {
        Array::read(bytes, bytes.len() as u64, None)
    }

    /// The same array in both orders: equal records in equal order.
    #[test]
    fn fortran_order_is_read() {
        let (mut c, shape) = (Vec::new(), [2, 3, 4]);
        write(&mut c, &shape, &(0..24).collect::<Vec<i16>>()).unwrap();
        let mut fortran = c[..c.len() - 48].to_vec();
        let at = fortran.windows(5).position(|bytes| bytes == b"False").expect("the order");
        fortran[at..at + 5].copy_from_slice(b"True ");
        for sample in 0..4 {
            for middle in 0..3 {
                fortran.extend((0..2).flat_map(|first: i16| (12 * first + 4 * middle + sample).to_le_bytes()));
            }
        }
        let records = |bytes: &[u8]| crate::hostile::decode(&Npy, bytes);
        let (c, fortran_records) = (records(&c), records(&fortran));
        assert_eq!(c.len(), fortran_records.len());
        for ((c, values), (record, fortran_values)) in c.iter().zip(&fortran_records) {
            assert_eq!((values, c.segment, &c.head.shape), (fortran_values, record.segment, &record.head.shape));
        }
        crate::hostile::change_anywhere(&Npy, &fortran, 3000);
        crate::hostile::appended_is_reported(&Npy, &fortran);
    }

    #[test]
    fn bytes_that_the_shape_does_not_count_are_reported() {
        let mut bytes = Vec::new();
        write(&mut bytes, &[2, 3], &[1, 2, 3, 4, 5, 6]).unwrap();
        crate::hostile::surplus_is_reported(&Npy, &bytes);
    }

    #[test]
    fn files_are_those_of_another_writer_and_its_files_are_read() {
        for shape in [vec![], vec![7], vec![3, 4], vec![2, 1, 5]] {
            let values: Vec<i16> = (0..shape.iter().product::<u64>() as i16).collect();
            let mut theirs = Vec::new();
            let mut writer =
                npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut theirs).begin_nd().unwrap();
            writer.extend(values.iter().copied()).unwrap();
            writer.finish().unwrap();
            let mut ours = Vec::new();
            write(&mut ours, &shape, &values).unwrap();
            let parsed = npyz::NpyFile::new(ours.as_slice()).unwrap();
            assert_eq!(parsed.shape(), shape);
            assert_eq!(parsed.into_vec::<i16>().unwrap(), values);
            for bytes in [ours, theirs] {
                let array = read(&bytes).unwrap();
                let lengths = |array: Array| {
                    let leading = array.grid.shape().into_iter().map(|length| length as u64);
                    leading.chain([array.grid.samples()]).collect::<Vec<u64>>()
                };
                let lengths = array.map(lengths);
                assert_eq!(lengths.unwrap_or_default(), shape);
            }
        }
    }

    #[test]
    fn headers_as_python_writes_them() {
        let parse = |text: &'static str| Header::parse(text.as_bytes());
        let expected = Header { descr: ">u2", fortran_order: true, shape: vec![2, 30] };
        assert_eq!(parse("{'shape': (2L, 30L), \"descr\": '>u2', 'fortran_order': True}  \n").unwrap(), expected);
        for text in [
            "",
            "{",
            "{}",
            "{'descr': '<i2'}",
            "{'descr': '<i2', 'fortran_order': False, 'shape': (3,), } x",
            "{'descr': '<i2', 'fortran_order': 0, 'shape': (3,), }",
            "{'descr': '<i2', 'fortran_order': False, 'shape': (-3,), }",
            "{'descr': '<i2', 'fortran_order': False, 'shape': (99999999999999999999,), }",
            "{'descr': '<i2' 'fortran_order': False, 'shape': (3,), }",
            "{'descr': '<i2, 'fortran_order: False, shape: (3,), }",
            "{'colour': 'red', 'descr': '<i2', 'fortran_order': False, 'shape': (3,), }",
        ] {
            assert!(parse(text).unwrap_err().starts_with("header: "), "{text}");
        }
        assert!(
            parse("{'descr': [('a', '<i2')], 'fortran_order': False, 'shape': (3,), }")
                .unwrap_err()
                .contains("structured")
        );
        for (descr, is_valid) in
            [("<i2", true), ("|u1", true), ("|i2", false), ("<c8", false), ("", false), (">u4", true), ("<u8", false)]
        {
            assert_eq!(code_type(descr).is_some(), is_valid, "{descr}");
        }
    }
}
