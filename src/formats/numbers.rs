//! Numbers and text in a range of a binary file.

use super::reader::{FormatError, Input};

/// A range of a file, with its byte order. Every access must stay within the range.
pub(super) struct Numbers {
    pub bytes: Vec<u8>,
    /// Where in the file it begins.
    pub origin: u64,
    pub big_endian: bool,
}

impl Numbers {
    /// The little-endian header of a file.
    pub fn head(input: &mut dyn Input, length: u64) -> Result<Self, FormatError> {
        Ok(Self::little(input.bytes("the head", 0, length)?, 0))
    }
    /// Little-endian bytes from `origin` on.
    pub fn little(bytes: Vec<u8>, origin: u64) -> Self {
        Self { bytes, origin, big_endian: false }
    }

    /// The bytes of a number, in little-endian order.
    pub fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = self.bytes[at..at + N].try_into().expect("fields lie within their block");
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }
    pub fn u8(&self, at: usize) -> u8 {
        self.bytes[at]
    }
    pub fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.array(at))
    }
    pub fn i16(&self, at: usize) -> i16 {
        i16::from_le_bytes(self.array(at))
    }
    pub fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.array(at))
    }
    pub fn i32(&self, at: usize) -> i32 {
        i32::from_le_bytes(self.array(at))
    }
    pub fn i64(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.array(at))
    }
    pub fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.array(at))
    }
    pub fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.array(at)))
    }
    pub fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.array(at))
    }

    /// A text field, up to its first zero byte; `None` if it is empty.
    pub fn text(&self, at: usize, length: usize) -> Option<String> {
        text(&self.bytes[at..at + length])
    }

    /// An error about the field at `at`.
    pub fn refuse(&self, at: usize, problem: impl Into<String>) -> FormatError {
        FormatError::Field { byte_offset: self.origin + at as u64, problem: problem.into() }
    }

    /// Returns the number of the field at `at` if it is finite.
    pub fn finite(&self, at: usize, name: &str, value: f64) -> Result<f64, FormatError> {
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.refuse(at, format!("{name} = {value} is no number; save the waveform again")))
        }
    }
}

/// A text field, up to its first zero byte; `None` if it is empty.
pub(super) fn text(bytes: &[u8]) -> Option<String> {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    let text = String::from_utf8_lossy(&bytes[..end]).trim().to_owned();
    (!text.is_empty()).then_some(text)
}
