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

/// Longest header that is read.
const HEADER_BYTES: u64 = 1 << 16;

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
        let refuse = |problem: String| FormatError::Field { byte_offset: 0, problem };
        let bytes = input.bytes("the header", 0, input.length().min(HEADER_BYTES))?;
        plain_header(&bytes).map_err(refuse)?;
        let mut rest = bytes.as_slice();
        let header = NpyHeader::from_reader(&mut rest).map_err(|error| refuse(format!("header: {error}")))?;
        let data = (bytes.len() - rest.len()) as u64;
        if header.order() != Order::C && header.shape().len() > 1 {
            return Err(refuse("the array is in Fortran order; save it with numpy.ascontiguousarray".to_owned()));
        }
        let (code_type, big_endian) = code_type(&header.dtype()).ok_or_else(|| {
            refuse(format!(
                "numbers of type {} are not read; save them as i1, i2, i4, u1, u2, f4 or f8",
                header.dtype().descr()
            ))
        })?;
        let Some((&samples, axes)) = header.shape().split_last() else {
            return Err(refuse("a single number is no waveform".to_owned()));
        };
        let count = header.shape().iter().try_fold(1_u64, |product, &length| product.checked_mul(length));
        let needed = count.and_then(|count| count.checked_mul(code_type.bytes() as u64));
        let available = input.length() - data;
        match needed {
            Some(0) => {
                return Err(refuse(format!("shape {:?} holds no sample", header.shape())));
            }
            Some(needed) if needed <= available => {}
            _ => {
                let problem = format!(
                    "shape {:?} does not fit the {available} bytes that follow the header; copy the file again",
                    header.shape()
                );
                return Err(FormatError::Field { byte_offset: data, problem });
            }
        }
        let head = Arc::new(Head {
            format: self.format(),
            instrument: None,
            channel: None,
            unit: None,
            code_type,
            samples: samples as usize,
            dt_s: None,
            scale: None,
            header_gain: None,
            header_offset: None,
            rails: code_type.limits(),
            acquired_at: None,
            shape: axes.iter().map(|&length| length as usize).collect(),
        });
        let records: u64 = axes.iter().product();
        let record_bytes = samples * code_type.bytes() as u64;
        let record = |i: u64| Record {
            head: Arc::clone(&head),
            segment: (records > 1).then_some(i as u32),
            t0_s: None,
            trigger_s: None,
            payload: Payload::File { byte_offset: data + i * record_bytes, big_endian },
        };
        Ok((0..records).map(record).collect())
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
