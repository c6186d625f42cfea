//! Data sets of several axes.

use std::io::Cursor;
use std::path::Path;

use super::super::{Array, Arrays, arrays, write};
use super::builder::{Builder, Storage, numbers};
use crate::waveform::CodeType;
use crate::{Source, hostile};

fn read(bytes: &[u8]) -> Result<(Arrays, Vec<String>), String> {
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.hdf5")).unwrap();
    arrays(&mut source, |name| name != "unwanted", 1 << 20).map_err(|error| error.to_string())
}

/// Numbers that differ everywhere.
fn counting(axes: &[usize], code_type: CodeType) -> Array {
    let count = axes.iter().product::<usize>() * code_type.bytes();
    let codes = (0..count).map(|i| (i * 7 % 63) as u8).collect();
    Array { axes: axes.to_vec(), code_type, codes }
}

fn file(array: &Array, chunk: Option<&[u32]>, deflate: bool) -> Vec<u8> {
    let mut file = Builder::new();
    let lengths: Vec<u64> = array.axes.iter().map(|length| *length as u64).collect();
    let datatype = numbers(array.code_type, false);
    let at = match chunk {
        Some(chunk) => file.chunked(datatype, &lengths, &array.codes, chunk, deflate),
        None => file.dataset(datatype, Some(lengths[0]), &array.codes, Storage::Contiguous, &[]),
    };
    let root = file.group(&[("H", at)], &[]);
    file.finish(root)
}

#[test]
fn an_array_that_takes_too_much_memory_is_refused_by_what_it_claims() {
    let zeros = Array { axes: vec![1 << 10, 300], code_type: CodeType::F32, codes: vec![0; 4 * 300 * 1024] };
    let bytes = file(&zeros, Some(&[1 << 10, 300]), true);
    assert!(bytes.len() < 100_000, "{}", bytes.len());
    let error = read(&bytes).unwrap_err();
    assert!(error.contains("H takes 1228800 bytes in memory, and may take 1048576"), "{error}");
}

#[test]
fn what_is_written_is_read() {
    let expected: Arrays = CodeType::ALL
        .into_iter()
        .zip([vec![], vec![1], vec![5], vec![2, 3], vec![3, 1, 2], vec![2, 2, 2, 2], vec![4], vec![7, 3]])
        .map(|(code_type, axes)| (format!("of {}", code_type.name()), counting(&axes, code_type)))
        .collect();
    let empty = Array { axes: Vec::new(), code_type: CodeType::F64, codes: Vec::new() };
    let others = [("nothing", empty), ("unwanted", counting(&[2], CodeType::U8))];
    let all: Arrays =
        expected.clone().into_iter().chain(others.map(|(name, array)| (name.to_owned(), array))).collect();
    let mut bytes = Vec::new();
    write(&mut bytes, &all).unwrap();
    let (arrays, names) = read(&bytes).unwrap();
    assert_eq!(arrays, expected);
    assert!(all.keys().eq(names.iter()), "{names:?}");
    // Behind the block that MATLAB writes before its files.
    let mut behind = vec![b' '; 512];
    behind.extend(&bytes);
    behind[512 + 24..512 + 32].copy_from_slice(&512_u64.to_le_bytes());
    assert_eq!(read(&behind).unwrap().0, expected);
}

#[test]
fn chunks_are_put_in_their_places() {
    for (axes, chunk) in [
        (vec![5], vec![2]),
        (vec![4, 6], vec![2, 3]),
        (vec![5, 7], vec![2, 3]),
        (vec![3, 4, 5], vec![2, 4, 2]),
        (vec![3, 2, 5, 3], vec![1, 2, 3, 2]),
    ] {
        for deflate in [false, true] {
            let array = counting(&axes, CodeType::I16);
            assert_eq!(read(&file(&array, Some(&chunk), deflate)).unwrap().0["H"], array, "{axes:?} in {chunk:?}");
        }
    }
}

#[test]
fn damage_is_refused_without_much_memory() {
    let array = counting(&[6, 5, 4], CodeType::F32);
    let files = [file(&array, Some(&[4, 2, 3]), true), file(&array, Some(&[6, 5, 1]), false)];
    let mut plain = Vec::new();
    write(&mut plain, &Arrays::from([("H".to_owned(), array)])).unwrap();
    for bytes in files.into_iter().chain([plain]) {
        let look = |damaged: &[u8]| {
            let Ok((arrays, _)) = read(damaged) else { return };
            let array_bytes: usize = arrays.values().map(|array| array.codes.len()).sum();
            assert!(array_bytes <= 1032 * damaged.len(), "{array_bytes} bytes");
            assert!(arrays.values().all(|array| array.axes.iter().product::<usize>() == array.count()));
        };
        hostile::each_cut(&bytes, look);
        hostile::each_damaged(&bytes, 20_000, |damaged| look(&damaged));
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let array = counting(&[4, 6], CodeType::U8);
    let bytes = file(&array, Some(&[2, 3]), false);
    // One of the tree's keys: the second chunk begins at (0, 3).
    let key = [0_u64, 3, 0].map(u64::to_le_bytes).concat();
    let at = bytes.windows(key.len()).position(|window| window == key).unwrap();
    let mut moved = bytes;
    moved[at + 8] = 0;
    let error = read(&moved).unwrap_err();
    assert!(error.contains("H has 4 of 4 chunks in their places"), "{error}");
}
