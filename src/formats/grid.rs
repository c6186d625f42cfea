//! How the records of an array lie among its numbers: one axis counts samples, the others count records.

use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;

use super::description::{Key, Misfit, TIME};
use super::reader::FormatError;
use crate::waveform::{CodeType, Head, Payload, ReadSeek, Record, Unpack};

/// Bytes that are gathered at a time.
const PIECE_BYTES: usize = 1 << 16;

/// An array as records. Places and strides are in numbers, not bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Grid {
    /// Length and stride of each axis that counts records, in the order in which they are named.
    leading: Vec<(u64, u64)>,
    /// Length and stride of the axis that counts samples.
    samples: (u64, u64),
}

impl Grid {
    /// Of an array of these lengths. Its last axis is contiguous, or, in Fortran order, its first. Without names the
    /// last axis counts samples. An axis of length 1 may go without a name.
    ///
    /// # Panics
    /// When the product of the lengths exceeds 64 bits.
    pub fn new(lengths: &[u64], is_fortran: bool, names: Option<&[String]>) -> Result<Self, Misfit> {
        let mut axes: Vec<(u64, u64)> = Vec::with_capacity(lengths.len());
        let mut stride = 1;
        let mut put = |length: u64| {
            axes.push((length, stride));
            stride *= length;
        };
        if is_fortran {
            lengths.iter().copied().for_each(&mut put);
        } else {
            lengths.iter().rev().copied().for_each(&mut put);
            axes.reverse();
        }
        let Some(names) = names else {
            let samples = axes.pop().unwrap_or((1, 1));
            return Ok(Self { leading: axes, samples });
        };
        if names.len() < axes.len() {
            axes.retain(|(length, _)| *length != 1);
        }
        if names.len() != axes.len() {
            let problem =
                format!("= {names:?} names {} axes, but the array has the lengths {lengths:?}; name each", names.len());
            return Err(Key::Axes.refuse(problem));
        }
        let time = names.iter().position(|name| name == TIME);
        let time =
            time.ok_or_else(|| Key::Axes.refuse(format!("= {names:?} has no \"{TIME}\", which counts samples")))?;
        let samples = axes.remove(time);
        Ok(Self { leading: axes, samples })
    }

    /// Lengths of the axes that count records.
    pub fn shape(&self) -> Vec<usize> {
        self.leading.iter().map(|(length, _)| *length as usize).collect()
    }

    /// Number of records.
    pub fn records(&self) -> u64 {
        self.leading.iter().map(|(length, _)| length).product()
    }

    /// Samples of a record.
    pub fn samples(&self) -> u64 {
        self.samples.0
    }

    /// Whether the samples of a record lie side by side.
    pub fn is_contiguous(&self) -> bool {
        self.samples.1 == 1 || self.samples.0 == 1
    }

    /// Place of the first sample of a record. Of the axes that count records, the last varies fastest.
    pub fn start(&self, record: u64) -> u64 {
        let (mut place, mut rest) = (0, record);
        for (length, stride) in self.leading.iter().rev() {
            place += rest % length * stride;
            rest /= length;
        }
        place
    }

    /// Refuses an array of very many short records: their heads, `each` bytes long, would far exceed the file in
    /// memory. `before` were read already.
    pub fn limit(&self, file_bytes: u64, before: usize, each: usize) -> Result<(), FormatError> {
        let most = (3 * file_bytes.min(1 << 60) + (1 << 19)) / each as u64;
        let (records, samples) = (self.records(), self.samples());
        if records <= most.min(u64::from(u32::MAX)).saturating_sub(before as u64) {
            return Ok(());
        }
        let problem = format!(
            "{records} records of {samples} samples are not read; samples are on the last axis, unless `axes` names \
             another \"{TIME}\": name it, or cut the array into files"
        );
        Err(FormatError::Field { byte_offset: 0, problem })
    }

    /// A head for its records, which have no scale and no time base.
    pub fn head(&self, format: &'static str, code_type: CodeType) -> Head {
        let head = Head::new(format, code_type, self.samples() as usize);
        Head { rails: code_type.limits(), shape: self.shape(), ..head }
    }

    /// Its records.
    pub fn list(&self, head: Head, payload: impl Fn(u64) -> Payload) -> Vec<Record> {
        let (head, count) = (Arc::new(head), self.records());
        let record = |i: u64| Record {
            head: Arc::clone(&head),
            segment: (count > 1).then_some(i as u32),
            t0_s: None,
            trigger_s: None,
            payload: payload(i),
        };
        (0..count).map(record).collect()
    }

    /// Where the samples of a record lie in a file in which the array begins at `byte_offset`.
    pub fn payload(&self, record: u64, byte_offset: u64, code_type: CodeType, big_endian: bool) -> Payload {
        let width = code_type.bytes() as u64;
        let stride = if self.is_contiguous() { width } else { self.samples.1 * width };
        Payload::File { byte_offset: byte_offset + self.start(record) * width, stride, big_endian }
    }

    /// The samples of a record of an array in memory.
    pub fn gather(&self, record: u64, codes: &Arc<Vec<u8>>, code_type: CodeType) -> Payload {
        let width = code_type.bytes();
        let stride = if self.is_contiguous() { 1 } else { self.samples.1 as usize };
        let (start, stride) = (self.start(record) as usize * width, stride * width);
        Payload::Packed(Arc::new(Gather {
            codes: Arc::clone(codes),
            start,
            stride,
            width,
            samples: self.samples.0 as usize,
        }))
    }
}

/// Samples of a record in an array that is in memory; places in bytes.
struct Gather {
    codes: Arc<Vec<u8>>,
    start: usize,
    stride: usize,
    width: usize,
    samples: usize,
}

impl std::fmt::Debug for Gather {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} samples in memory, from byte {} on", self.samples, self.start)
    }
}

impl Unpack for Gather {
    fn unpack(
        &self,
        _: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let per_piece = PIECE_BYTES / self.width;
        let mut piece = Vec::new();
        for first in (0..self.samples).step_by(per_piece) {
            let samples = first..self.samples.min(first + per_piece);
            piece.clear();
            for sample in samples {
                let at = self.start + sample * self.stride;
                piece.extend_from_slice(&self.codes[at..at + self.width]);
            }
            if take(&piece)?.is_break() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(ToString::to_string).collect()
    }

    /// An array of 2 x 3 x 4 numbers, each 100 i + 10 j + k: in either order, any axis may count samples.
    #[test]
    fn any_axis_may_count_samples_in_both_orders() {
        let number = |i: u64, j: u64, k: u64| 100 * i + 10 * j + k;
        let c: Vec<u64> = (0..24).map(|n| number(n / 12, n / 4 % 3, n % 4)).collect();
        let fortran: Vec<u64> = (0..24).map(|n| number(n % 2, n / 2 % 3, n / 6)).collect();
        for (order, is_fortran) in [(&c, false), (&fortran, true)] {
            for (axes, second) in [
                (["lit", "shot", "time"], [number(0, 1, 0), number(0, 1, 1)]),
                (["lit", "time", "shot"], [number(0, 0, 1), number(0, 1, 1)]),
                (["time", "lit", "shot"], [number(0, 0, 1), number(1, 0, 1)]),
            ] {
                let grid = Grid::new(&[2, 3, 4], is_fortran, Some(&names(&axes))).unwrap();
                let Payload::File { byte_offset, stride, .. } = grid.payload(1, 8, CodeType::F64, false) else {
                    panic!()
                };
                let at = |sample: u64| order[((byte_offset + sample * stride) / 8 - 1) as usize];
                assert_eq!([at(0), at(1)], second, "{axes:?}, Fortran {is_fortran}");
            }
        }
    }

    #[test]
    fn axes_that_do_not_fit_are_refused() {
        let refusal = |axes: &[&str]| Grid::new(&[5, 1, 9], false, Some(&names(axes))).unwrap_err().to_string();
        assert!(refusal(&["time"]).contains("names 1 axes, but the array has the lengths [5, 1, 9]"));
        assert!(refusal(&["shot", "lit"]).contains("has no \"time\""));
        let grid = Grid::new(&[5, 1, 9], false, Some(&names(&["shot", "time"]))).unwrap();
        assert_eq!((grid.shape(), grid.samples()), (vec![5], 9), "an axis of length 1 may go without a name");
    }
}
