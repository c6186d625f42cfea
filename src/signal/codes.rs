//! Raw codes of a converter, as they lie in a file: little-endian bytes of a number type, at any alignment.

#![allow(clippy::useless_conversion, reason = "one of the eight types is f64 already")]
#![allow(clippy::cast_lossless, reason = "one macro serves eight types, and its casts lose nothing for some of them")]

use std::ops::Range;

use super::widest::widest;

/// Codes of one record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Codes<'a> {
    /// Signed, 8 bits.
    I8(&'a [u8]),
    /// Unsigned, 8 bits.
    U8(&'a [u8]),
    /// Signed, 16 bits.
    I16(&'a [u8]),
    /// Unsigned, 16 bits.
    U16(&'a [u8]),
    /// Signed, 32 bits.
    I32(&'a [u8]),
    /// Unsigned, 32 bits.
    U32(&'a [u8]),
    /// Floating, 32 bits.
    F32(&'a [u8]),
    /// Floating, 64 bits.
    F64(&'a [u8]),
}

/// Runs `$body` with `$numbers` an iterator over the codes as their own type.
macro_rules! each {
    ($codes:expr, $numbers:ident => $body:expr) => {
        match $codes {
            Codes::I8(bytes) => {
                let $numbers = bytes.iter().map(|&byte| byte as i8);
                $body
            }
            Codes::U8(bytes) => {
                let $numbers = bytes.iter().copied();
                $body
            }
            Codes::I16(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| i16::from_le_bytes(*code));
                $body
            }
            Codes::U16(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| u16::from_le_bytes(*code));
                $body
            }
            Codes::I32(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| i32::from_le_bytes(*code));
                $body
            }
            Codes::U32(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| u32::from_le_bytes(*code));
                $body
            }
            Codes::F32(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| f32::from_le_bytes(*code));
                $body
            }
            Codes::F64(bytes) => {
                let $numbers = bytes.as_chunks().0.iter().map(|code| f64::from_le_bytes(*code));
                $body
            }
        }
    };
}

impl<'a> Codes<'a> {
    /// Whether every code is a number: floats may be infinite or none.
    #[must_use]
    pub fn is_finite(self) -> bool {
        match self {
            Self::F32(_) | Self::F64(_) => {
                each!(self, codes => codes.into_iter().all(|code| f64::from(code).is_finite()))
            }
            _ => true,
        }
    }

    /// Codes of the type of this name (`i8`, `u8`, `i16`, `u16`, `i32`, `u32`, `f32`, `f64`); `None` for another.
    #[must_use]
    pub fn of(code_type: &str, bytes: &'a [u8]) -> Option<Self> {
        Some(match code_type {
            "i8" => Self::I8(bytes),
            "u8" => Self::U8(bytes),
            "i16" => Self::I16(bytes),
            "u16" => Self::U16(bytes),
            "i32" => Self::I32(bytes),
            "u32" => Self::U32(bytes),
            "f32" => Self::F32(bytes),
            "f64" => Self::F64(bytes),
            _ => return None,
        })
    }

    fn bytes(&self) -> (&'a [u8], usize) {
        match self {
            Self::I8(bytes) | Self::U8(bytes) => (bytes, 1),
            Self::I16(bytes) | Self::U16(bytes) => (bytes, 2),
            Self::I32(bytes) | Self::U32(bytes) | Self::F32(bytes) => (bytes, 4),
            Self::F64(bytes) => (bytes, 8),
        }
    }

    /// Whether samples are whole numbers, rounded by a converter.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        !matches!(self, Self::F32(_) | Self::F64(_))
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        let (bytes, width) = self.bytes();
        bytes.len() / width
    }

    /// Whether there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The codes of a range of samples.
    ///
    /// # Panics
    /// When the range exceeds the record.
    #[must_use]
    pub fn slice(&self, range: Range<usize>) -> Self {
        let cut = |bytes: &'a [u8], width: usize| &bytes[range.start * width..range.end * width];
        match *self {
            Self::I8(bytes) => Self::I8(cut(bytes, 1)),
            Self::U8(bytes) => Self::U8(cut(bytes, 1)),
            Self::I16(bytes) => Self::I16(cut(bytes, 2)),
            Self::U16(bytes) => Self::U16(cut(bytes, 2)),
            Self::I32(bytes) => Self::I32(cut(bytes, 4)),
            Self::U32(bytes) => Self::U32(cut(bytes, 4)),
            Self::F32(bytes) => Self::F32(cut(bytes, 4)),
            Self::F64(bytes) => Self::F64(cut(bytes, 8)),
        }
    }

    /// The codes as numbers.
    #[must_use]
    pub fn to_f64(&self) -> Vec<f64> {
        each!(*self, numbers => numbers.map(f64::from).collect())
    }

    /// The codes as numbers, in place of what `values` held.
    pub fn read_into(&self, values: &mut Vec<f64>) {
        values.resize(self.len(), 0.0);
        each!(*self, numbers => widest(|| {
            values.iter_mut().zip(numbers).for_each(|(value, number)| *value = f64::from(number));
        }));
    }

    /// Mean of the codes.
    #[must_use]
    pub fn mean(&self) -> f64 {
        let sum = match self {
            Self::F32(_) | Self::F64(_) => each!(*self, numbers => numbers.map(f64::from).sum::<f64>()),
            // Whole numbers have exact sums, which the processor can take side by side.
            _ => each!(*self, numbers => numbers.map(|number| number as i64).sum::<i64>()) as f64,
        };
        sum / self.len() as f64
    }

    /// Whether any code, less `level`, lies below its `low` or above its `high`; codes without bounds do not count.
    #[must_use]
    #[allow(clippy::needless_bitwise_bool, reason = "comparisons without branches go side by side")]
    pub fn leaves(&self, low: &[f64], high: &[f64], level: f64) -> bool {
        // In blocks: none is left before its end, so that the processor can compare several at a time.
        const BLOCK: usize = 256;
        let count = self.len().min(low.len()).min(high.len());
        (0..count).step_by(BLOCK).any(|start| {
            let block = start..count.min(start + BLOCK);
            let bounds = low[block.clone()].iter().zip(&high[block.clone()]);
            each!(self.slice(block), numbers => widest(|| {
                numbers.map(f64::from).zip(bounds).fold(false, |out, (value, (low, high))| {
                    let value = value - level;
                    out | (value < *low) | (value > *high)
                })
            }))
        })
    }

    /// Differences of the codes from `mean`, a stretch of the size of `room` at a time: with the number of its first
    /// sample they go to `take`, which is inlined into the kernel. Their squares less the shot's `own` level are added
    /// to `squares`.
    ///
    /// # Panics
    /// When `room` is empty.
    pub fn subtract(
        &self,
        mean: &[f64],
        own: f64,
        squares: &mut [f64],
        room: &mut [f64],
        mut take: impl FnMut(usize, &[f64]),
    ) {
        let stretch = room.len();
        for (at, (mean, squares)) in
            (0..self.len()).step_by(stretch).zip(mean.chunks(stretch).zip(squares.chunks_mut(stretch)))
        {
            let part = self.slice(at..self.len().min(at + stretch));
            each!(part, numbers => widest(
                #[inline(always)]
                || {
                    let room = &mut room[..part.len()];
                    for (((number, mean), square), difference) in numbers.zip(mean).zip(squares).zip(&mut *room) {
                        *difference = f64::from(number) - mean;
                        let residual = *difference - own;
                        *square += residual * residual;
                    }
                    take(at, room);
                }
            ));
        }
    }

    /// Adds the codes to sums, sample by sample. Exact for whole numbers while the sums stay within `i32`.
    ///
    /// # Panics
    /// When there are more codes than sums, or the codes are floating.
    pub fn add_to(&self, sums: &mut [i32]) {
        let sums = &mut sums[..self.len()];
        match *self {
            Self::F32(_) | Self::F64(_) => panic!("floating codes are summed by add_to_f64"),
            Self::I32(_) | Self::U32(_) => panic!("32 bit codes are summed by add_to_f64"),
            Self::I8(bytes) => {
                widest(|| sums.iter_mut().zip(bytes).for_each(|(sum, &byte)| *sum += i32::from(byte as i8)));
            }
            Self::U8(bytes) => {
                widest(|| sums.iter_mut().zip(bytes).for_each(|(sum, &byte)| *sum += i32::from(byte)));
            }
            Self::I16(bytes) => {
                let codes = bytes.as_chunks().0.iter().map(|code| i16::from_le_bytes(*code));
                widest(|| sums.iter_mut().zip(codes).for_each(|(sum, code)| *sum += i32::from(code)));
            }
            Self::U16(bytes) => {
                let codes = bytes.as_chunks().0.iter().map(|code| u16::from_le_bytes(*code));
                widest(|| sums.iter_mut().zip(codes).for_each(|(sum, code)| *sum += i32::from(code)));
            }
        }
    }

    /// Adds the codes to sums in `f64`: exact for whole numbers below 2^53, else rounded in the order of the calls.
    ///
    /// # Panics
    /// When there are more codes than sums.
    pub fn add_to_f64(&self, sums: &mut [f64]) {
        let sums = &mut sums[..self.len()];
        each!(*self, numbers => sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += f64::from(number)));
    }

    /// Samples at or beyond the rails `low` and `high` of the converter.
    #[must_use]
    pub fn count_at_or_beyond(&self, low: f64, high: f64) -> usize {
        // 16 bit codes are the hot path: a minimum and a maximum vectorise, and nearly always settle it.
        if let Self::I16(bytes) = *self {
            let numbers = bytes.as_chunks().0.iter().map(|code| i16::from_le_bytes(*code));
            let (least, most) =
                widest(|| numbers.fold((i16::MAX, i16::MIN), |(least, most), code| (least.min(code), most.max(code))));
            if f64::from(least) > low && f64::from(most) < high {
                return 0;
            }
        }
        each!(*self, numbers => numbers.map(f64::from).filter(|number| *number <= low || *number >= high).count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_may_be_no_numbers_and_integers_may_not() {
        let bytes = |values: [f32; 3]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        assert!(Codes::of("f32", &bytes([0.0, -1.5, f32::MAX])).unwrap().is_finite());
        for odd in [f32::NAN, f32::INFINITY] {
            let bytes = bytes([0.0, odd, 1.0]);
            assert!(!Codes::of("f32", &bytes).unwrap().is_finite());
            assert!(Codes::of("i32", &bytes).unwrap().is_finite());
        }
    }

    #[test]
    fn every_type_reads_back_what_was_written() {
        let values = [-3_i16, 7, 120, -128, 0];
        let i16s: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let f32s: Vec<u8> = values.iter().flat_map(|value| f32::from(*value).to_le_bytes()).collect();
        let f64s: Vec<u8> = values.iter().flat_map(|value| f64::from(*value).to_le_bytes()).collect();
        let i32s: Vec<u8> = values.iter().flat_map(|value| i32::from(*value).to_le_bytes()).collect();
        let i8s: Vec<u8> = values.iter().map(|value| *value as i8 as u8).collect();
        let expected: Vec<f64> = values.iter().map(|value| f64::from(*value)).collect();
        for (name, bytes) in [("i16", &i16s), ("f32", &f32s), ("f64", &f64s), ("i32", &i32s), ("i8", &i8s)] {
            let codes = Codes::of(name, bytes).unwrap();
            assert_eq!(codes.to_f64(), expected, "{name}");
            assert_eq!(codes.len(), 5);
            assert_eq!(codes.slice(1..3).to_f64(), expected[1..3], "{name}");
            assert_eq!(codes.count_at_or_beyond(-128.0, 120.0), 2, "{name}");
            assert_eq!(codes.count_at_or_beyond(-129.0, 121.0), 0, "{name}");
        }
        assert!(Codes::of("i24", &i8s).is_none());
    }
}
