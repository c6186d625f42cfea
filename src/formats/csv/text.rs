//! Lines, cells and numbers of a text, byte by byte: only cells that are kept become strings.

use std::io::{BufRead, Read};

use super::super::reader::FormatError;
use super::refuse;

/// Longest line that is read.
const LINE_BYTES: usize = 1 << 16;

/// The lines of a text.
pub(super) struct Lines<R> {
    text: R,
    line: Vec<u8>,
    /// Number of the line read last, from 1.
    pub number: u64,
}

impl<R: BufRead> Lines<R> {
    pub(super) fn new(text: R) -> Self {
        Self { text, line: Vec::new(), number: 0 }
    }

    /// The next line, without its end and without a byte order mark.
    pub(super) fn next(&mut self) -> Result<Option<&[u8]>, FormatError> {
        self.line.clear();
        let limit = LINE_BYTES as u64 + 1;
        if self.text.by_ref().take(limit).read_until(b'\n', &mut self.line)? == 0 {
            return Ok(None);
        }
        self.number += 1;
        if self.line.len() > LINE_BYTES {
            return Err(refuse(self.number, format!("has more than {LINE_BYTES} bytes: this is no table of samples")));
        }
        let mut line = &self.line[..];
        line = line.strip_suffix(b"\n").unwrap_or(line);
        line = line.strip_suffix(b"\r").unwrap_or(line);
        if self.number == 1 {
            line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
        }
        Ok(Some(line))
    }
}

/// What separates cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    /// This byte.
    Byte(u8),
    /// Any number of spaces.
    Spaces,
}

impl Separator {
    /// The separator of a row of numbers. A comma next to another separator is a decimal mark.
    pub(super) fn of(line: &[u8]) -> Self {
        let byte = [b';', b'\t', b','].into_iter().find(|byte| line.trim_ascii().contains(byte));
        byte.map_or(Self::Spaces, Self::Byte)
    }

    pub(super) fn cells(self, line: &[u8]) -> Cells<'_> {
        Cells { rest: Some(line), separator: self }
    }

    /// Whether a line has nothing but separators.
    pub(super) fn is_blank(self, line: &[u8]) -> bool {
        line.iter().all(|byte| byte.is_ascii_whitespace() || Self::Byte(*byte) == self)
    }
}

/// The cells of a line, without spaces around them.
pub(super) struct Cells<'a> {
    rest: Option<&'a [u8]>,
    separator: Separator,
}

impl<'a> Iterator for Cells<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let mut rest = self.rest.take()?;
        let end = match self.separator {
            Separator::Byte(separator) => rest.iter().position(|byte| *byte == separator),
            Separator::Spaces => {
                rest = rest.trim_ascii();
                if rest.is_empty() {
                    return None;
                }
                rest.iter().position(u8::is_ascii_whitespace)
            }
        };
        let Some(end) = end else { return Some(rest.trim_ascii()) };
        self.rest = Some(&rest[end + 1..]);
        Some(rest[..end].trim_ascii())
    }
}

/// The cells of a line as text, without quotes and without blank cells at the end. Bytes that are not UTF-8 count as
/// Latin-1.
pub(super) fn texts(separator: Separator, line: &[u8]) -> Vec<String> {
    let text = |cell: &[u8]| match std::str::from_utf8(cell) {
        Ok(text) => text.trim_matches('"').trim().to_owned(),
        Err(_) => cell.iter().map(|byte| char::from(*byte)).collect(),
    };
    let mut cells: Vec<String> = separator.cells(line).map(text).collect();
    while cells.last().is_some_and(String::is_empty) {
        cells.pop();
    }
    cells
}

/// Parses numbers that all have the same decimal mark.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbers {
    /// The decimal mark of the first number that had one.
    mark: Option<u8>,
}

impl Numbers {
    pub(super) fn new(separator: Separator) -> Self {
        Self { mark: (separator == Separator::Byte(b',')).then_some(b'.') }
    }

    /// The number in a cell; `None` if it is no finite number, or has another decimal mark than earlier ones.
    pub(super) fn read(&mut self, cell: &[u8]) -> Option<f64> {
        let mut with_point = [0; 64];
        let mut cell = cell;
        if self.mark != Some(b'.')
            && let Some(at) = cell.iter().position(|byte| matches!(byte, b'.' | b','))
        {
            if *self.mark.get_or_insert(cell[at]) != cell[at] {
                return None;
            }
            let copy = with_point.get_mut(..cell.len())?;
            copy.copy_from_slice(cell);
            copy[at] = b'.';
            cell = copy;
        }
        let number: f64 = std::str::from_utf8(cell).ok()?.parse().ok()?;
        number.is_finite().then_some(number)
    }
}

/// Number of digits of a printed number, without leading zeros and without its exponent.
pub(super) fn digits(cell: &[u8]) -> usize {
    let mantissa = cell.iter().take_while(|byte| !matches!(byte, b'e' | b'E'));
    mantissa.filter(|byte| byte.is_ascii_digit()).skip_while(|byte| **byte == b'0').count().clamp(1, 17)
}
