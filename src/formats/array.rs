//! Arrays of numbers, as files of whole data sets hold them: HDF5 and MAT.

use std::collections::BTreeMap;

use crate::waveform::CodeType;

/// Numbers over several axes, those of the last axis beside each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Lengths of the axes; none for a single number.
    pub axes: Vec<usize>,
    /// Type of the numbers.
    pub code_type: CodeType,
    /// The numbers, little-endian.
    pub codes: Vec<u8>,
}

/// Arrays of a file by their names.
pub type Arrays = BTreeMap<String, Array>;

impl Array {
    /// Of numbers in order.
    ///
    /// # Panics
    /// When there are not as many as the axes say.
    #[must_use]
    pub fn of(axes: &[usize], values: &[f64]) -> Self {
        assert_eq!(axes.iter().product::<usize>(), values.len(), "as many values as the axes say");
        let codes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { axes: axes.to_vec(), code_type: CodeType::F64, codes }
    }

    /// How many numbers it has.
    #[must_use]
    pub fn count(&self) -> usize {
        self.codes.len() / self.code_type.bytes()
    }

    /// All numbers.
    #[must_use]
    pub fn values(&self) -> Vec<f64> {
        self.code_type.decode(&self.codes)
    }

    /// The `count` numbers from place `start` on, each `stride` after the one before.
    ///
    /// # Panics
    /// When one of them is not there.
    #[must_use]
    pub fn strided(&self, start: usize, stride: usize, count: usize) -> Vec<f64> {
        let width = self.code_type.bytes();
        let codes = (0..count).flat_map(|i| {
            let at = (start + i * stride) * width;
            self.codes[at..at + width].iter().copied()
        });
        self.code_type.decode(&codes.collect::<Vec<u8>>())
    }
}

/// Little-endian integers of 64 bits as floating numbers, which records can have.
pub(super) fn from_long(codes: &[u8], signed: bool) -> Vec<u8> {
    let number = |code: &[u8]| {
        let code: [u8; 8] = code.try_into().expect("eight bytes");
        let value = if signed { i64::from_le_bytes(code) as f64 } else { u64::from_le_bytes(code) as f64 };
        value.to_le_bytes()
    };
    codes.chunks_exact(8).flat_map(number).collect()
}

/// Bytes of so many numbers, if memory can have them.
pub(super) fn bytes_of(axes: &[u64], width: usize) -> Option<u64> {
    let count = axes.iter().try_fold(1_u64, |product, length| product.checked_mul(*length))?;
    count.checked_mul(width as u64).filter(|bytes| usize::try_from(*bytes).is_ok())
}

/// Lengths of axes that [`bytes_of`] has allowed.
pub(super) fn lengths(axes: &[u64]) -> Vec<usize> {
    axes.iter().map(|length| *length as usize).collect()
}
