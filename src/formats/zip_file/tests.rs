use std::io::{Cursor, Write};
use std::path::Path;

use flate2::{Compression, Crc, write::DeflateEncoder};

use super::*;
use crate::Source;

/// How the local headers of a file give the lengths.
#[derive(Clone, Copy, PartialEq)]
pub(in super::super) enum Local {
    Lengths,
    /// Not at all: they follow the member, and are in the directory.
    Streamed,
    /// In a Zip64 field, as NumPy writes for members of any length.
    Zip64,
}

/// A zip file of these members.
pub(in super::super) fn zip(members: &[(&str, &[u8])], deflate: bool, local: Local) -> Vec<u8> {
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in members {
        let mut crc = Crc::new();
        crc.update(bytes);
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        let packed = if deflate { encoder.finish().unwrap() } else { bytes.to_vec() };
        let (flags, method) = (8 * u16::from(local == Local::Streamed), 8 * u16::from(deflate));
        let lengths = [crc.sum(), packed.len() as u32, bytes.len() as u32].map(u32::to_le_bytes).concat();
        let sizes = match local {
            Local::Lengths => lengths.clone(),
            Local::Streamed => vec![0; 12],
            Local::Zip64 => [lengths[..4].to_vec(), vec![255; 8]].concat(),
        };
        let extra = if local == Local::Zip64 { 20_u16 } else { 0 };
        let head = |lengths: &[u8], extra: u16| {
            let begin = [20, flags, method, 0, 0].map(u16::to_le_bytes).concat();
            [&begin, lengths, &(name.len() as u16).to_le_bytes(), &extra.to_le_bytes()].concat()
        };
        let begin = file.len() as u32;
        file.extend([MARK, &head(&sizes, extra), name.as_bytes()].concat());
        file.extend_from_slice(&[[1, 0, 16, 0].as_slice(), &[0; 16]].concat()[..usize::from(extra)]);
        file.extend(&packed);
        if local == Local::Streamed {
            file.extend([b"PK\x07\x08".as_slice(), &lengths].concat());
        }
        directory.extend([ENTRY_MARK, &[20, 0], &head(&lengths, 0), &[0; 10], &begin.to_le_bytes()].concat());
        directory.extend(name.as_bytes());
    }
    let end = [0, 0, members.len() as u16, members.len() as u16].map(u16::to_le_bytes).concat();
    let place = [directory.len() as u32, file.len() as u32].map(u32::to_le_bytes).concat();
    [file.as_slice(), &directory, END_MARK, &end, &place, &[0, 0]].concat()
}

fn read(bytes: &[u8]) -> Result<Vec<(String, Vec<u8>)>, String> {
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.npz")).unwrap();
    let members = members(&mut source).map_err(|error| error.to_string())?;
    let mut read = Vec::new();
    for member in members {
        let mut bytes = Vec::new();
        let mut take = |piece: &mut [u8]| {
            bytes.extend_from_slice(piece);
            Ok(ControlFlow::Continue(()))
        };
        let _ = member
            .unpack(&mut member.unpacker(), source.file(), member.length, &mut take)
            .map_err(|error| error.to_string())?;
        read.push((member.name, bytes));
    }
    Ok(read)
}

const MEMBERS: [(&str, &[u8]); 3] = [("one", b"first"), ("empty", b""), ("two", &[7; 300_000])];

#[test]
fn members_are_unpacked_stored_or_deflated() {
    for (deflate, local) in
        [(false, Local::Lengths), (true, Local::Lengths), (true, Local::Streamed), (false, Local::Zip64)]
    {
        let bytes = zip(&MEMBERS, deflate, local);
        assert_eq!(first_name(&bytes), Some(b"one".as_slice()));
        let read = read(&bytes).unwrap();
        assert!(read.iter().zip(MEMBERS).all(|(read, member)| (read.0.as_str(), read.1.as_slice()) == member));
    }
    assert_eq!(read(&zip(&[], false, Local::Lengths)).unwrap(), []);
    assert_eq!(first_name(b"PK\x03\x04"), None);
}

#[test]
fn a_file_may_have_a_comment() {
    let mut bytes = zip(&MEMBERS[..1], false, Local::Lengths);
    let (last, comment) = (bytes.len() - 2, b"PK\x05\x06 and more than the twenty-two bytes of an end");
    bytes[last] = comment.len() as u8;
    bytes.extend(comment);
    assert_eq!(read(&bytes).unwrap(), [("one".to_owned(), b"first".to_vec())]);
}

/// The error for a file with some bytes changed, at an offset from the first entry of the directory.
fn changed(deflate: bool, offset: usize, bytes: &[u8]) -> String {
    let mut file = zip(&MEMBERS[..1], deflate, Local::Lengths);
    let at = offset + file.windows(4).position(|window| window == ENTRY_MARK).unwrap();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    read(&file).unwrap_err()
}

#[test]
fn what_is_wrong_is_said() {
    let whole = zip(&MEMBERS, true, Local::Lengths);
    assert!(read(&whole[..whole.len() - 1]).unwrap_err().contains("no end-of-central-directory record"));
    assert!(changed(false, 0, b"KP").contains("entry of the central directory is damaged"));
    assert!(changed(false, 8, &[1]).contains("\"one\" is encrypted"));
    assert!(changed(false, 10, &[12]).contains("method 12"));
    assert!(changed(false, 16, &[0; 4]).contains("checksum (CRC-32)"));
    assert!(changed(false, 20, &[255; 4]).contains("needs Zip64"));
    assert!(changed(false, 24, &[9]).contains("claims 9 bytes"));
    assert!(changed(true, 24, &[9]).contains("fewer bytes than it claims"));
    assert!(changed(true, 24, &[3]).contains("more bytes than it claims"));
    assert!(changed(true, 24, &[0, 0, 0, 99]).contains("claims 1660944384 bytes"));
    assert!(changed(false, 28, &[255]).contains("entry of the central directory is damaged"));
    assert!(changed(false, 42, &[9]).contains("is not where the central directory says"));
    // The end record, 46 bytes, and the name follow.
    assert!(changed(false, 49 + 4, &[1]).contains("one part of several"));
    assert!(changed(false, 49 + 8, &[9, 0, 9]).contains("does not fit the file"));
    assert!(changed(false, 49 + 10, &[255; 2]).contains("Zip64"));
}

#[test]
fn overlapping_members_are_refused() {
    let mut bytes = zip(&[("a", &[1; 100]), ("b", &[1; 100])], false, Local::Lengths);
    let entries: Vec<usize> = (0..bytes.len() - 4).filter(|&at| &bytes[at..at + 4] == ENTRY_MARK).collect();
    bytes[entries[1] + 42..entries[1] + 46].fill(0);
    assert!(read(&bytes).unwrap_err().contains("overlap"));
}
