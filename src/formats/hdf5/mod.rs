//! HDF5 files of oscilloscopes: Keysight Infiniium (`keysight-h5`) and Tektronix DPO5000 (`tek-h5`). The formulas are
//! in `keysight.rs` and `tektronix.rs`.
//!
//! Of HDF5 itself, the reader covers what both vendors write, which is the default of the HDF5 library: superblock
//! version 0 or 1, object headers version 1, groups as symbol tables, attributes in the headers. Data sets have one
//! axis and are contiguous, compact, or chunked with or without deflate (HDF5 File Format Specification 3.0, sections
//! II to IV). Contiguous samples stay in the file; chunks are inflated piece by piece.
//!
//! Of files of other programs, one data set is read: the one that the caller names by its path (`variable`), or the
//! only one. Its last axis counts samples, unless the caller names the axes. Where it is chunked over several axes it
//! is unpacked whole, if it is no larger than the file.
//!
//! [`arrays`] reads data sets of several axes whole; [`write()`] writes them.
//!
//! Refused by name: later superblocks and layouts, other filters, shared types. `h5repack -f GZIP=6` makes a file with
//! other filters readable.

mod array;
mod dataset;
mod file;
mod keysight;
mod tektronix;
mod value;
pub(super) mod variable;
mod write;

use super::array::{Array, Arrays};
use super::description::{Description, Key};
use super::grid::Grid;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::Record;
use file::{File, SIGNATURE};
pub use write::write;

/// The reader.
pub struct Hdf5;

impl Reader for Hdf5 {
    fn format(&self) -> &'static str {
        "hdf5"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["h5", "hdf5"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(SIGNATURE)
    }

    fn keys(&self) -> &'static [Key] {
        &[Key::Variable, Key::Axes]
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let description = input.description().clone();
        if description.variable.is_none() && description.axes.is_none() {
            let (mut file, root) = File::open(input)?;
            let entries = file.group(root)?;
            if let Some(waveforms) = entries.find("Waveforms") {
                return keysight::records(&mut file, &entries, waveforms);
            }
            if let (Some(data), Some(spacing), Some(start)) =
                (entries.find("Data"), entries.find("Spacing"), entries.find("StartTime"))
            {
                return tektronix::records(&mut file, data, spacing, start);
            }
        }
        let grid = |_: &str, lengths: &[u64], description: &Description| {
            let lengths: Vec<u64> = lengths.iter().rev().copied().collect();
            Grid::new(&lengths, false, description.axes.as_deref())
        };
        variable::records(input, self.format(), &description, grid)
    }
}

/// Returns the arrays in the root group whose names `wanted` accepts, without null data spaces, and the names of all
/// entries. An array may have `most_bytes`.
///
/// # Errors
/// When the file contradicts the format, or a wanted entry is no array of numbers, or a larger one.
pub fn arrays(
    input: &mut dyn Input,
    wanted: impl Fn(&str) -> bool,
    most_bytes: u64,
) -> Result<(Arrays, Vec<String>), FormatError> {
    let (mut file, root) = File::open(input)?;
    let entries = file.group(root)?;
    let mut arrays = Arrays::new();
    for entry in entries.iter().filter(|entry| wanted(&entry.name)) {
        let array = Array::read(&mut file, &entry.name, entry.at, most_bytes)?;
        arrays.extend(array.map(|array| (entry.name.clone(), array)));
    }
    Ok((arrays, entries.iter().map(|entry| entry.name.clone()).collect()))
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

#[cfg(test)]
mod tests;
