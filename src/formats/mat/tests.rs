//! MATLAB files of both kinds, and what is said where the array is not clear.

use std::io::Cursor;
use std::path::Path;

use super::*;
use crate::array::{Array, Arrays};
use crate::mat5::tests::{file, variable};
use crate::{Source, hdf5, hostile};

/// `waves` with size 4 x 2 in MATLAB, each number 10 * sample + shot, and a row.
fn version_5(packed: bool) -> Vec<u8> {
    let waves: Vec<u8> = (0..8).flat_map(|n: i16| (10 * (n % 4) + n / 4).to_le_bytes()).collect();
    let row: Vec<u8> = (0..3).flat_map(|n| f64::from(n).to_le_bytes()).collect();
    file(&[variable("waves", 6, &[4, 2], 3, &waves), variable("row", 6, &[1, 3], 9, &row)], packed)
}

/// The same as HDF5 behind a user block, with the axes in reverse order.
fn version_7_3() -> Vec<u8> {
    let waves: Vec<f64> = (0..8).map(|n| f64::from(10 * (n % 4) + n / 4)).collect();
    let arrays = [("waves", Array::of(&[2, 4], &waves)), ("row", Array::of(&[3, 1], &[0.0, 1.0, 2.0]))];
    let mut content = Vec::new();
    hdf5::write(&mut content, &arrays.map(|(name, array)| (name.to_owned(), array)).into_iter().collect::<Arrays>())
        .unwrap();
    let mut bytes = VERSION_7_3.to_vec();
    bytes.resize(USER_BLOCK, 0);
    // The superblock's base address.
    content[24..32].copy_from_slice(&(USER_BLOCK as u64).to_le_bytes());
    bytes.extend(content);
    bytes
}

fn read(bytes: &[u8], variable: Option<&str>, axes: Option<&[&str]>) -> Result<Vec<Vec<f64>>, String> {
    let axes = axes.map(|axes| axes.iter().map(ToString::to_string).collect());
    let description = Description { variable: variable.map(str::to_owned), axes, ..Description::default() };
    let source = Source::new(Cursor::new(bytes.to_vec()), Path::new("a.mat")).unwrap();
    let mut source = source.described(description);
    let contents = crate::contents(&mut source).map_err(|error| error.to_string())?;
    assert_eq!(contents.remarks, []);
    Ok(contents.records.iter().map(|record| source.values(record).unwrap()).collect())
}

#[test]
fn axes_stand_in_the_order_of_matlab() {
    let by_shot = [vec![0.0, 10.0, 20.0, 30.0], vec![1.0, 11.0, 21.0, 31.0]];
    let by_sample = [vec![0.0, 1.0], vec![10.0, 11.0], vec![20.0, 21.0], vec![30.0, 31.0]];
    for bytes in [version_5(false), version_5(true), version_7_3()] {
        assert!(Mat.recognises(&bytes));
        assert_eq!(read(&bytes, Some("waves"), Some(&["time", "shot"])).unwrap(), by_shot);
        assert_eq!(
            read(&bytes, Some("waves"), Some(&["time", "shot", "lit"])).unwrap(),
            by_shot,
            "MATLAB drops the last"
        );
        assert_eq!(read(&bytes, Some("waves"), Some(&["shot", "time"])).unwrap(), by_sample);
        assert_eq!(read(&bytes, Some("row"), None).unwrap(), [[0.0, 1.0, 2.0]]);
        assert_eq!(read(&bytes, Some("row"), Some(&["time"])).unwrap(), [[0.0, 1.0, 2.0]]);
    }
}

#[test]
fn an_array_that_is_not_clear_is_refused_with_those_that_are_there() {
    for bytes in [version_5(false), version_5(true), version_7_3()] {
        let refusal = |variable, axes: Option<&[&str]>| read(&bytes, variable, axes).unwrap_err();
        let ambiguous = refusal(None, None);
        assert!(
            ambiguous.contains("`variable` is missing") && ambiguous.contains("waves") && ambiguous.contains("row")
        );
        let absent = refusal(Some("wave"), None);
        assert!(absent.contains("= \"wave\" is not in this file") && absent.contains("waves"), "{absent}");
        let axes = refusal(Some("waves"), None);
        assert!(axes.contains("`axes` is missing: waves is 4 x 2"), "{axes}");
        assert!(refusal(Some("waves"), Some(&["time"])).contains("names 1 axes"));
    }
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    let row: Vec<u8> = (0..90).flat_map(|n| f64::from(n).to_le_bytes()).collect();
    for packed in [false, true] {
        let bytes = file(&[variable("row", 6, &[1, 90], 9, &row)], packed);
        hostile::change_anywhere(&Mat, &bytes, 3000);
        hostile::appended_is_reported(&Mat, &bytes);
    }
}
