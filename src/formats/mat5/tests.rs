use std::io::{Cursor, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::*;
use crate::{Source, hostile};

fn read(bytes: &[u8]) -> Result<(Arrays, Vec<String>), String> {
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.mat")).unwrap();
    arrays(&mut source, |name| name != "unwanted", 1 << 20).map_err(|error| error.to_string())
}

/// An element; data of up to four bytes stand in the tag.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = if data.len() <= 4 {
        [(kind | (data.len() as u32) << 16).to_le_bytes().as_slice(), data].concat()
    } else {
        [kind.to_le_bytes().as_slice(), &(data.len() as u32).to_le_bytes(), data].concat()
    };
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

pub fn variable(name: &str, class: u8, axes: &[i32], kind: u32, data: &[u8]) -> Vec<u8> {
    let axes: Vec<u8> = axes.iter().flat_map(|axis| axis.to_le_bytes()).collect();
    let parts = [
        element(6, &[class, 0, 0, 0, 0, 0, 0, 0]),
        element(5, &axes),
        element(1, name.as_bytes()),
        element(kind, data),
    ];
    let parts = parts.concat();
    [MATRIX.to_le_bytes().as_slice(), &(parts.len() as u32).to_le_bytes(), &parts].concat()
}

pub fn file(variables: &[Vec<u8>], packed: bool) -> Vec<u8> {
    let mut bytes = b"MATLAB 5.0 MAT-file".to_vec();
    bytes.resize(124, b' ');
    bytes.extend([0, 1, b'I', b'M']);
    for variable in variables {
        if packed {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(variable).unwrap();
            let data = encoder.finish().unwrap();
            bytes.extend([COMPRESSED.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat());
            bytes.extend(data);
        } else {
            bytes.extend(variable);
        }
    }
    bytes
}

fn scan() -> Vec<Vec<u8>> {
    let counts: Vec<u8> = (0..24_u16).flat_map(u16::to_le_bytes).collect();
    vec![
        // Doubles that fit 16 bits are stored as such.
        variable("rect_data", 6, &[2, 3, 4], 4, &counts),
        variable("width", 6, &[1, 1], 9, &0.5_f64.to_le_bytes()),
        variable("small", 12, &[1, 1], 5, &(-7_i32).to_le_bytes()),
        variable("long", 14, &[1, 1], 12, &(-9_i64).to_le_bytes()),
        variable("unwanted", 6, &[1, 1], 9, &[0; 8]),
        variable("text", 4, &[1, 2], 4, &[65, 0, 66, 0]),
    ]
}

#[test]
fn variables_are_read_packed_and_plain() {
    for packed in [false, true] {
        let bytes = file(&scan(), packed);
        assert!(recognises(&bytes));
        let (arrays, names) = read(&bytes).unwrap();
        assert_eq!(names, ["rect_data", "width", "small", "long", "unwanted", "text"]);
        let values = |name: &str| arrays[name].values();
        assert_eq!(arrays["rect_data"].axes, [4, 3, 2]);
        assert_eq!(values("rect_data"), (0..24).map(f64::from).collect::<Vec<f64>>());
        assert_eq!((values("width"), values("small"), values("long")), (vec![0.5], vec![-7.0], vec![-9.0]));
        assert!(!arrays.contains_key("unwanted") && !arrays.contains_key("text"));
    }
}

#[test]
fn damage_is_refused_without_much_memory() {
    let look = |damaged: &[u8]| {
        let arrays = read(damaged).map_or_else(|_| Arrays::new(), |(arrays, _)| arrays);
        assert!(arrays.values().all(|array| array.axes.iter().product::<usize>() == array.count()));
    };
    for bytes in [file(&scan(), false), file(&scan(), true)] {
        hostile::each_cut(&bytes, look);
        hostile::each_damaged(&bytes, 20_000, |damaged| look(&damaged));
    }
    let wrong = variable("rect_data", 6, &[2, 3, 5], 4, &[0; 48]);
    let error = read(&file(&[wrong], false)).unwrap_err();
    assert!(error.contains("rect_data holds 48 bytes"), "{error}");
}
