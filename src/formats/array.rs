//! Arrays of numbers from files of whole data sets: HDF5, MAT and `.npz`.

use std::collections::BTreeMap;

use crate::waveform::CodeType;

/// Numbers over several axes; the last axis is contiguous.
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
    /// An array of 64 bit floating numbers in order.
    ///
    /// # Panics
    /// When their number contradicts the axes.
    #[must_use]
    pub fn of(axes: &[usize], values: &[f64]) -> Self {
        assert_eq!(axes.iter().product::<usize>(), values.len(), "as many values as the axes say");
        let codes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { axes: axes.to_vec(), code_type: CodeType::F64, codes }
    }

    /// The number of elements.
    #[must_use]
    pub fn count(&self) -> usize {
        self.codes.len() / self.code_type.bytes()
    }

    /// All elements.
    #[must_use]
    pub fn values(&self) -> Vec<f64> {
        self.code_type.decode(&self.codes)
    }

    /// Returns `count` elements from `start` on, each `stride` after the previous one.
    ///
    /// # Panics
    /// When the array ends before.
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

/// Converts little-endian 64 bit integers to floating numbers, since records have no such integers.
pub(super) fn from_long(codes: &[u8], signed: bool) -> Vec<u8> {
    let number = |code: &[u8]| {
        let code: [u8; 8] = code.try_into().expect("eight bytes");
        let value = if signed { i64::from_le_bytes(code) as f64 } else { u64::from_le_bytes(code) as f64 };
        value.to_le_bytes()
    };
    codes.chunks_exact(8).flat_map(number).collect()
}

/// Bytes of an array, or `None` if memory cannot hold them.
pub(super) fn bytes_of(axes: &[u64], width: usize) -> Option<u64> {
    let count = axes.iter().try_fold(1_u64, |product, length| product.checked_mul(*length))?;
    count.checked_mul(width as u64).filter(|bytes| usize::try_from(*bytes).is_ok())
}

/// Refuses an array of more than `most_bytes`.
pub(super) fn check_size(name: &str, bytes: u64, most_bytes: u64) -> Result<(), String> {
    if bytes <= most_bytes {
        return Ok(());
    }
    Err(format!("{name} takes {bytes} bytes in memory, and may take {most_bytes}; allow more, or save a part of it"))
}

/// Lengths of axes that [`bytes_of`] has accepted.
pub(super) fn lengths(axes: &[u64]) -> Vec<usize> {
    axes.iter().map(|length| *length as usize).collect()
}
