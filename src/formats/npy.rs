//! NumPy `.npy`: integer and floating arrays in C order. The last axis counts samples, the leading ones are for the campaign to name.
//!
//! The header is parsed by `npyz`; the file has neither scale nor time base. Fortran order, structured and complex types are refused.

use std::io::{self, Write};
use std::sync::Arc;

use npyz::{DType, NpyHeader, Order, TypeChar, WriterBuilder};

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record};

/// The reader.
pub struct Npy;

/// Longest header that is read: the dictionary of a plain array has some hundred bytes.
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

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let bytes = input.bytes("the header", 0, input.length().min(HEADER_BYTES))?;
        let Some(array) = Array::read(&bytes, input.length())? else {
            return Err(refuse("a single number is no waveform"));
        };
        array.limit(input.length(), 0, size_of::<Record>())?;
        let head = Arc::new(array.head(self.format()));
        let record = |i: u64| Record {
            head: Arc::clone(&head),
            segment: array.segment(i),
            t0_s: None,
            trigger_s: None,
            payload: Payload::File {
                byte_offset: array.data + i * array.record_bytes(),
                stride: array.code_type.bytes() as u64,
                big_endian: array.big_endian,
            },
        };
        Ok((0..array.records).map(record).collect())
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
    /// The last axis.
    samples: u64,
    /// The leading axes, and their product.
    axes: Vec<usize>,
    pub records: u64,
}

impl Array {
    /// From the first bytes of an array, which has `length` bytes with its header; `None` for a single number.
    pub fn read(bytes: &[u8], length: u64) -> Result<Option<Self>, FormatError> {
        plain_header(bytes).map_err(refuse)?;
        let mut rest = bytes;
        let header = NpyHeader::from_reader(&mut rest).map_err(|error| refuse(format!("header: {error}")))?;
        let data = (bytes.len() - rest.len()) as u64;
        let Some((&samples, axes)) = header.shape().split_last() else {
            return Ok(None);
        };
        if header.order() != Order::C && header.shape().len() > 1 {
            return Err(refuse("the array is in Fortran order; save it with numpy.ascontiguousarray"));
        }
        let (code_type, big_endian) = code_type(&header.dtype()).ok_or_else(|| {
            refuse(format!(
                "numbers of type {} are not read; save them as i1, i2, i4, u1, u2, f4 or f8",
                header.dtype().descr()
            ))
        })?;
        let count = header.shape().iter().try_fold(1_u64, |product, &length| product.checked_mul(length));
        let needed = count.and_then(|count| count.checked_mul(code_type.bytes() as u64));
        let available = length.saturating_sub(data);
        match needed {
            Some(0) => return Err(refuse(format!("shape {:?} holds no sample", header.shape()))),
            Some(needed) if needed <= available => {}
            _ => {
                let problem = format!(
                    "shape {:?} does not fit the {available} bytes that follow the header; copy the file again",
                    header.shape()
                );
                return Err(FormatError::Field { byte_offset: data, problem });
            }
        }
        let axes: Vec<usize> = axes.iter().map(|&length| length as usize).collect();
        let records = axes.iter().map(|&length| length as u64).product();
        Ok(Some(Self { code_type, big_endian, data, samples, axes, records }))
    }

    /// Bytes of its numbers.
    pub fn bytes(&self) -> u64 {
        self.records * self.record_bytes()
    }

    /// Bytes of one record.
    pub fn record_bytes(&self) -> u64 {
        self.samples * self.code_type.bytes() as u64
    }

    pub fn segment(&self, record: u64) -> Option<u32> {
        (self.records > 1).then_some(record as u32)
    }

    /// Refuses so many short records that what is kept of them and of those before, `each` bytes, is far more than the file.
    pub fn limit(&self, file_bytes: u64, before: usize, each: usize) -> Result<(), FormatError> {
        let most = (3 * file_bytes.min(1 << 60) + (1 << 19)) / each as u64;
        if self.records > most.min(u64::from(u32::MAX)).saturating_sub(before as u64) {
            return Err(refuse(format!(
                "{} records of {} samples are not read; samples are on the last axis: transpose the array, \
                 or cut it into files",
                self.records, self.samples
            )));
        }
        Ok(())
    }

    pub fn head(&self, format: &'static str) -> Head {
        let rails = self.code_type.limits();
        Head { rails, shape: self.axes.clone(), ..Head::new(format, self.code_type, self.samples as usize) }
    }
}

/// What `npyz` does not check: it allocates what the header claims, and its parser's time doubles with each nested bracket.
fn plain_header(bytes: &[u8]) -> Result<(), String> {
    let (length, text) = match bytes {
        [_, _, _, _, _, _, 1, _, a, b, text @ ..] => (u32::from(u16::from_le_bytes([*a, *b])), text),
        [_, _, _, _, _, _, 2 | 3, _, a, b, c, d, text @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]), text),
        _ => return Err("header: neither version 1, 2 nor 3, or cut short; save the array again".to_owned()),
    };
    let Some(text) = text.get(..length as usize) else {
        return Err(format!(
            "the header claims {length} bytes, of which {} are there; copy the file again",
            text.len()
        ));
    };
    // The dictionary and the tuple of the shape.
    if text.iter().filter(|byte| b"([{".contains(byte)).count() > 2 {
        return Err("structured types are not read; save the numbers as a plain array".to_owned());
    }
    Ok(())
}

fn code_type(dtype: &DType) -> Option<(CodeType, bool)> {
    let DType::Plain(plain) = dtype else {
        return None;
    };
    let code_type = match (plain.type_char(), plain.size_field()) {
        (TypeChar::Int, 1) => CodeType::I8,
        (TypeChar::Uint, 1) => CodeType::U8,
        (TypeChar::Int, 2) => CodeType::I16,
        (TypeChar::Uint, 2) => CodeType::U16,
        (TypeChar::Int, 4) => CodeType::I32,
        (TypeChar::Float, 4) => CodeType::F32,
        (TypeChar::Float, 8) => CodeType::F64,
        _ => return None,
    };
    Some((code_type, plain.endianness() == npyz::Endianness::Big))
}

/// Writes an array of `shape` in C order.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When there are not as many values as the shape says.
pub fn write<T: npyz::AutoSerialize + Copy>(out: &mut impl Write, shape: &[u64], values: &[T]) -> io::Result<()> {
    assert_eq!(shape.iter().product::<u64>(), values.len() as u64, "as many values as the shape says");
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(out).begin_nd()?;
    writer.extend(values.iter().copied())?;
    writer.finish()
}
