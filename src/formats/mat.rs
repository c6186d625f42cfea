//! MATLAB's `.mat` files of version 5 to 7.3: one array of real numbers is read, the one that the caller names
//! (`variable`), or the only one. The caller names its axes in the order in which MATLAB's `size` has them.
//!
//! The file has no scale and no time base. Without names of axes the array must be a row or a column. Numbers that are
//! not compressed stay in the file. A compressed array is unpacked whole, if it is at most twice as large as the file.
//! Version 7.3 is HDF5, with the axes in reverse order. Complex, sparse and text variables, cells and structures are
//! not read. Version 4 is read where PicoScope wrote it. Built from the specification; tested on files of the tests.

use std::sync::Arc;

use super::description::{Description, Key, Misfit};
use super::grid::Grid;
use super::hdf5::{self, Hdf5};
use super::mat5::{self, Variable};
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{Head, Record};

/// The reader.
pub struct Mat;

/// First bytes of a file of version 7.3, and where its HDF5 begins.
const VERSION_7_3: &[u8] = b"MATLAB 7.3 MAT-file";
const USER_BLOCK: usize = 512;

impl Reader for Mat {
    fn format(&self) -> &'static str {
        "mat"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        let is_7_3 = || head.starts_with(VERSION_7_3) && head.get(USER_BLOCK..).is_some_and(|h| Hdf5.recognises(h));
        mat5::recognises(head) || is_7_3()
    }
    fn keys(&self) -> &'static [Key] {
        &[Key::Variable, Key::Axes]
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let description = input.description().clone();
        let head = input.peek("the head", 0, input.length().min(USER_BLOCK as u64))?;
        if head.starts_with(VERSION_7_3) {
            return hdf5::variable::records(input, self.format(), &description, grid);
        }
        let mut variables = mat5::variables(input)?;
        let names: Vec<&str> = variables.iter().map(|variable| variable.name.as_str()).collect();
        let variable = variables.swap_remove(description.array(&names)?);
        let grid = grid(&variable.name, &variable.lengths, &description)?;
        grid.limit(input.length(), 0, size_of::<Record>())?;
        let head = grid.head(self.format(), variable.code_type);
        let head = Head { channel: Some(variable.name.clone()), ..head };
        if let Some(at) = variable.byte_offset.filter(|_| !variable.is_long) {
            return Ok(grid.list(head, |i| grid.payload(i, at, variable.code_type, false)));
        }
        let codes = Arc::new(numbers(input, &variable)?);
        Ok(grid.list(head, |i| grid.gather(i, &codes, variable.code_type)))
    }
}

/// The numbers of an array in memory.
fn numbers(input: &mut dyn Input, variable: &Variable) -> Result<Vec<u8>, FormatError> {
    let most = 2 * input.length() + (1 << 18);
    if variable.bytes > most {
        let problem =
            format!("{} unpacks to {} bytes, too many for its file; save it with -v6", variable.name, variable.bytes);
        return Err(FormatError::Field { byte_offset: 0, problem });
    }
    let (mut arrays, _) = mat5::arrays(input, |name| name == variable.name, most)?;
    let array = arrays.remove(&variable.name);
    array.map(|array| array.codes).ok_or_else(|| {
        let problem = format!("{} was there a moment ago: the file is being changed", variable.name);
        FormatError::Field { byte_offset: 0, problem }
    })
}

/// The records of an array with these lengths of axes, as MATLAB has them: the first is contiguous.
fn grid(name: &str, lengths: &[u64], description: &Description) -> Result<Grid, Misfit> {
    let Some(names) = &description.axes else {
        let long: Vec<String> = lengths.iter().filter(|length| **length > 1).map(u64::to_string).collect();
        if long.len() > 1 {
            let problem =
                format!("is missing: {name} is {}; name each, such as [\"time\", \"shot\"]", long.join(" x "));
            return Err(Key::Axes.refuse(problem));
        }
        return Grid::new(&[lengths.iter().product()], true, None);
    };
    // MATLAB drops axes of length 1 at the end.
    let mut lengths = lengths.to_vec();
    lengths.resize(lengths.len().max(names.len()), 1);
    Grid::new(&lengths, true, Some(names))
}

#[cfg(test)]
mod tests;
