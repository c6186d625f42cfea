//! Writes arrays as an HDF5 file of superblock 0, which every version of the HDF5 library reads: one root group,
//! contiguous data sets.

use std::io::{self, Write};

use super::super::array::Arrays;
use super::file::{SIGNATURE, UNDEFINED};
use crate::waveform::CodeType;

/// Bytes of a superblock, of the head of an object header, and of an entry in a symbol table.
const SUPERBLOCK: usize = 96;
const HEADER: usize = 16;
const SYMBOL: usize = 40;
/// Half of the most children in a node of the group's tree (Group Internal Node K). The tree has one node.
const INTERNAL_K: u16 = 16;

/// Writes the arrays. Those without numbers become null data spaces.
///
/// # Errors
/// When `out` cannot be written, or there are more arrays than one node of a group holds (32,767).
pub fn write(out: &mut impl Write, arrays: &Arrays) -> io::Result<()> {
    // One leaf holds twice K entries.
    let leaf_k = u16::try_from(arrays.len().div_ceil(2).max(4))
        .ok()
        .filter(|k| *k <= u16::MAX / 4)
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "more arrays than a group holds"))?;
    let mut names = vec![0; 8];
    let name_places: Vec<u64> = arrays
        .keys()
        .map(|name| {
            let at = names.len() as u64;
            names.extend(name.as_bytes());
            names.resize((names.len() + 1).next_multiple_of(8), 0);
            at
        })
        .collect();
    let root = SUPERBLOCK;
    let tree = root + HEADER + 24;
    let heap = tree + 24 + 8 * (4 * usize::from(INTERNAL_K) + 1);
    let leaf = heap + 32 + names.len();
    let mut at = leaf + 8 + SYMBOL * 2 * usize::from(leaf_k);
    let mut symbols = Vec::new();
    let mut headers = Vec::new();
    for (array, name) in arrays.values().zip(&name_places) {
        let header = |data: u64| object_header(&array_messages(array.code_type, &array.axes, data, array.codes.len()));
        let data = at + header(0).len();
        headers.push(header(data as u64));
        symbols.extend([name.to_le_bytes(), (at as u64).to_le_bytes()].concat());
        symbols.extend([0; 24]);
        at = (data + array.codes.len()).next_multiple_of(8);
    }
    let addresses = |places: &[u64]| places.iter().flat_map(|place| place.to_le_bytes()).collect::<Vec<u8>>();
    let mut head = SIGNATURE.to_vec();
    head.extend([0, 0, 0, 0, 0, 8, 8, 0]);
    head.extend([leaf_k, INTERNAL_K].map(u16::to_le_bytes).concat());
    head.extend([0; 4]);
    head.extend(addresses(&[0, UNDEFINED, at as u64, UNDEFINED]));
    // The root's own entry: where its tree and names are.
    head.extend(addresses(&[0, root as u64, 1, tree as u64, heap as u64]));
    head.extend(object_header(&[(0x11, addresses(&[tree as u64, heap as u64]))]));
    head.extend([b"TREE".as_slice(), &[0, 0], &1_u16.to_le_bytes()].concat());
    head.extend(addresses(&[UNDEFINED, UNDEFINED, 0, leaf as u64, name_places.last().copied().unwrap_or(0)]));
    head.resize(heap, 0);
    head.extend(b"HEAP\0\0\0\0");
    head.extend(addresses(&[names.len() as u64, FREE_LIST_END, heap as u64 + 32]));
    head.extend(names);
    head.extend([b"SNOD".as_slice(), &[1, 0], &(arrays.len() as u16).to_le_bytes()].concat());
    head.extend(symbols);
    head.resize(leaf + 8 + SYMBOL * 2 * usize::from(leaf_k), 0);
    out.write_all(&head)?;
    for (array, header) in arrays.values().zip(headers) {
        out.write_all(&header)?;
        out.write_all(&array.codes)?;
        out.write_all(&[0; 8][..array.codes.len().next_multiple_of(8) - array.codes.len()])?;
    }
    Ok(())
}

/// Marks the end of a heap's list of free blocks.
const FREE_LIST_END: u64 = 1;

/// A header of version 1 with these messages.
fn object_header(messages: &[(u16, Vec<u8>)]) -> Vec<u8> {
    let mut block = Vec::new();
    for (kind, data) in messages {
        let padded = data.len().next_multiple_of(8);
        block.extend([kind.to_le_bytes(), (padded as u16).to_le_bytes()].concat());
        block.extend([0; 4]);
        block.extend(data);
        block.resize(block.len() + padded - data.len(), 0);
    }
    let head = [[1, 0].as_slice(), &(messages.len() as u16).to_le_bytes(), &1_u32.to_le_bytes()].concat();
    [head.as_slice(), &(block.len() as u32).to_le_bytes(), &[0; 4], &block].concat()
}

/// Data space, data type, fill value and layout of an array.
fn array_messages(code_type: CodeType, axes: &[usize], data: u64, bytes: usize) -> Vec<(u16, Vec<u8>)> {
    let is_null = bytes == 0;
    let space = if is_null {
        vec![2, 0, 0, 2]
    } else {
        let lengths = axes.iter().flat_map(|length| (*length as u64).to_le_bytes());
        [1, axes.len() as u8, 0, 0, 0, 0, 0, 0].into_iter().chain(lengths).collect()
    };
    let place = if is_null { UNDEFINED } else { data };
    let layout = [[3, 1].as_slice(), &place.to_le_bytes(), &(bytes as u64).to_le_bytes()].concat();
    // Space is allocated late, and no fill value is stored.
    vec![(0x01, space), (0x03, data_type(code_type)), (0x05, vec![2, 2, 0, 0]), (0x08, layout)]
}

/// Data type message of little-endian numbers.
fn data_type(code_type: CodeType) -> Vec<u8> {
    let size = code_type.bytes() as u8;
    match code_type {
        CodeType::F32 => vec![0x11, 0x20, 31, 0, 4, 0, 0, 0, 0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0],
        CodeType::F64 => vec![0x11, 0x20, 63, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 255, 3, 0, 0],
        _ => {
            let signed = matches!(code_type, CodeType::I8 | CodeType::I16 | CodeType::I32);
            vec![0x10, u8::from(signed) << 3, 0, 0, size, 0, 0, 0, 0, 0, 8 * size, 0]
        }
    }
}
