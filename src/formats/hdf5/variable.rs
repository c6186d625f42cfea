//! One data set of a file, by its path, as records.

use std::sync::Arc;

use super::super::array::{Array, bytes_of};
use super::super::description::{Description, Misfit};
use super::super::grid::Grid;
use super::super::reader::{FormatError, Input};
use super::dataset::{Dataset, Layout};
use super::field;
use super::file::{File, Header, UNDEFINED, message};
use super::value::{Number, axes};
use crate::waveform::{CodeType, Head, Record};

/// Returns the records of the data set that is described, or of the only one. `grid` lays records into its axes, whose
/// lengths it takes with the first as the contiguous one.
pub fn records(
    input: &mut dyn Input,
    format: &'static str,
    description: &Description,
    grid: impl Fn(&str, &[u64], &Description) -> Result<Grid, Misfit>,
) -> Result<Vec<Record>, FormatError> {
    let (mut file, root) = File::open(input)?;
    let arrays = arrays(&mut file, root, description.variable.as_deref())?;
    let names: Vec<&str> = arrays.iter().map(|(path, _)| path.as_str()).collect();
    let (path, at) = &arrays[description.array(&names)?];
    let header = file.header(*at)?;
    let Some((number, mut lengths)) = numbers(&header)? else {
        return Err(field(*at, format!("{path} is no array of numbers; name another `variable`")));
    };
    lengths.reverse();
    let grid = grid(path, &lengths, description)?;
    grid.limit(file.length(), 0, size_of::<Record>())?;
    let code_type = number.code_type().unwrap_or(CodeType::F64);
    let head = Head { channel: Some(path.clone()), ..grid.head(format, code_type) };
    let bytes = bytes_of(&lengths, number.bytes());
    match Layout::read(&header)? {
        Layout::Contiguous { at, bytes: stored }
            if number.code_type().is_some() && Some(stored) == bytes && at != UNDEFINED =>
        {
            let at = file.claim(at, stored)?;
            Ok(grid.list(head, |i| grid.payload(i, at, code_type, number.big_endian)))
        }
        Layout::Chunked { .. } if lengths.len() == 1 && number.code_type().is_some() => {
            let payload = Dataset::read(&mut file, &header)?.payload;
            Ok(grid.list(head, |_| payload.clone()))
        }
        _ => {
            let most = file.length() + (1 << 17);
            if bytes.is_none_or(|bytes| bytes > most) {
                let problem = format!(
                    "{path} unpacks to more bytes than its file has; rewrite it with h5repack --layout=CONTI, or -v6"
                );
                return Err(field(*at, problem));
            }
            let array = Array::read(&mut file, path, *at, most)?;
            let codes = Arc::new(array.map(|array| array.codes).unwrap_or_default());
            Ok(grid.list(head, |i| grid.gather(i, &codes, code_type)))
        }
    }
}

/// Paths of all arrays of two and more numbers, and where their headers are. What cannot be read is passed over, but
/// for the one that is wanted.
fn arrays(file: &mut File, root: u64, wanted: Option<&str>) -> Result<Vec<(String, u64)>, FormatError> {
    let wanted = wanted.map(|wanted| wanted.trim_start_matches('/'));
    let mut groups = vec![(String::new(), file.header(root)?)];
    let mut arrays = Vec::new();
    while let Some((path, header)) = groups.pop() {
        for entry in file.entries(&header)?.iter() {
            let path = if path.is_empty() { entry.name.clone() } else { format!("{path}/{}", entry.name) };
            let header = match file.header(entry.at) {
                Ok(header) => header,
                Err(error) if wanted == Some(&path) => return Err(error),
                Err(_) => continue,
            };
            // MATLAB keeps what cells refer to in a group `#refs#`.
            let is_group = header.find(message::SYMBOL_TABLE)?.is_some();
            if is_group && !entry.name.starts_with('#') {
                groups.push((path, header));
            } else if let Some((_, lengths)) = numbers(&header)?
                && lengths.iter().any(|length| *length > 1)
                && !lengths.contains(&0)
            {
                arrays.push((path, entry.at));
            }
        }
    }
    arrays.sort();
    Ok(arrays)
}

/// Type and lengths of the axes of a data set; `None` for anything but numbers.
fn numbers(header: &Header) -> Result<Option<(Number, Vec<u64>)>, FormatError> {
    let number = header.find(message::DATATYPE)?.and_then(Number::parse);
    let lengths = header.find(message::DATASPACE)?.and_then(axes);
    Ok(number.zip(lengths).filter(|(number, lengths)| bytes_of(lengths, number.bytes()).is_some()))
}
