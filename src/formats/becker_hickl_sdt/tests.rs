use std::io::Write;

use flate2::Compression;
use flate2::write::DeflateEncoder;

use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal, source};

/// Bins of a curve.
const BINS: u16 = 64;

fn put(bytes: &mut [u8], at: usize, field: &[u8]) {
    bytes[at..at + field.len()].copy_from_slice(field);
}

/// A zip archive's first file, and nothing after it.
fn zip(data: &[u8], method: u16) -> Vec<u8> {
    let mut packed = data.to_vec();
    if method == 8 {
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(data).unwrap();
        packed = encoder.finish().unwrap();
    }
    let mut crc = flate2::Crc::new();
    crc.update(data);
    let mut bytes = vec![0; 30];
    put(&mut bytes, 0, b"PK\x03\x04");
    put(&mut bytes, 8, &method.to_le_bytes());
    put(&mut bytes, 14, &crc.sum().to_le_bytes());
    put(&mut bytes, 26, &[10, 0]);
    bytes.extend(b"data_block");
    bytes.extend(packed);
    bytes
}

fn description() -> Vec<u8> {
    let mut bytes = vec![0; 512];
    put(&mut bytes, 0, b"12:34:56\0");
    put(&mut bytes, 9, b"10-25-2019\0");
    put(&mut bytes, 64, &5e-8_f32.to_le_bytes());
    put(&mut bytes, 68, &4_i16.to_le_bytes());
    put(&mut bytes, 82, &BINS.to_le_bytes());
    put(&mut bytes, 117, b"SPC-150\0");
    put(&mut bytes, 271, &[5, 0]);
    bytes
}

/// A file of blocks, each of a type with its data, unpacked, and packed if it is to be.
fn sdt(revision: u16, blocks: &[(u16, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = vec![0; 42];
    put(&mut bytes, 0, &(0x280 | revision).to_le_bytes());
    put(&mut bytes, 14, &(42_u32 + 512).to_le_bytes());
    put(&mut bytes, 18, &(blocks.len() as u16).to_le_bytes());
    put(&mut bytes, 24, &42_u32.to_le_bytes());
    put(&mut bytes, 28, &1_u16.to_le_bytes());
    put(&mut bytes, 30, &512_u16.to_le_bytes());
    put(&mut bytes, 32, &VALID.to_le_bytes());
    seal(&mut bytes);
    bytes.extend(description());
    for (number, (kind, data)) in blocks.iter().enumerate() {
        let stored = if kind & COMPRESSED == 0 { data.clone() } else { zip(data, 8) };
        let mut header = vec![0; 22];
        let start = bytes.len() as u32 + 22;
        put(&mut header, 2, &start.to_le_bytes());
        put(&mut header, 6, &(start + stored.len() as u32).to_le_bytes());
        put(&mut header, 10, &kind.to_le_bytes());
        put(&mut header, 14, &(number as u32 + 1).to_le_bytes());
        put(&mut header, 18, &(data.len() as u32).to_le_bytes());
        bytes.extend(header);
        bytes.extend(stored);
    }
    bytes
}

/// Puts the checksum of the header right.
fn seal(bytes: &mut [u8]) {
    put(bytes, 40, &[0, 0]);
    let sum = bytes[..42].chunks(2).fold(0_u16, |sum, word| sum.wrapping_add(u16::from_le_bytes([word[0], word[1]])));
    put(bytes, 40, &SUM.wrapping_sub(sum).to_le_bytes());
}

/// Counts from `first` on, as they lie in a file.
fn counts(first: u32, number: u32, code_type: CodeType) -> Vec<u8> {
    let bytes = |count: u32| match code_type {
        CodeType::U16 => (count as u16).to_le_bytes().to_vec(),
        CodeType::U32 => count.to_le_bytes().to_vec(),
        _ => f64::from(count).to_le_bytes().to_vec(),
    };
    (first..first + number).flat_map(bytes).collect()
}

fn expected(first: u32) -> Vec<f64> {
    (first..first + u32::from(BINS)).map(f64::from).collect()
}

#[test]
fn blocks_of_all_numbers_are_read() {
    let blocks = [
        (0x01, counts(3, 64, CodeType::U16)),
        (0x108, counts(70_000, 64, CodeType::U32)),
        (0x201, counts(9, 64, CodeType::F64)),
    ];
    for revision in [14, 15] {
        let records = decode(&BeckerHicklSdt, &sdt(revision, &blocks));
        let names: Vec<_> =
            records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap_or_default()).collect();
        assert_eq!(names, ["M1 curve 1", "M1 routing 5", "M1 curve 3"]);
        for ((_, values), first) in records.iter().zip([3, 70_000, 9]) {
            assert_eq!(values, &expected(first));
        }
        let (record, head) = (&records[0].0, &records[0].0.head);
        assert_eq!((head.kind, record.t0_s, head.dt_s), (Kind::Counts, Some(0.0), Some(f64::from(5e-8_f32) / 256.0)));
        assert_eq!(head.instrument.as_deref(), Some("SPC-150"));
        assert_eq!(head.acquired_at.as_deref(), Some("2019-10-25T12:34:56"));
    }
}

#[test]
fn pages_packed_or_not_are_taken_apart() {
    for packed in [0, COMPRESSED] {
        let blocks =
            [(0x11 | packed, counts(0, 3 * 64, CodeType::U16)), (0x111 | packed, counts(7, 64, CodeType::U32))];
        let records = decode(&BeckerHicklSdt, &sdt(15, &blocks));
        let firsts = [0, 64, 128, 7];
        assert_eq!(records.len(), firsts.len());
        for ((_, values), first) in records.iter().zip(firsts) {
            assert_eq!(values, &expected(first));
        }
        assert_eq!(records[2].0.head.channel.as_deref(), Some("M1 curve 3"));
    }
}

#[test]
fn stored_archives_are_read_and_damaged_ones_refused() {
    let data = counts(5, 64, CodeType::U16);
    let stored = zip(&data, 0);
    let mut file = sdt(15, &[(0x01, stored.clone())]);
    let header = 42 + 512;
    put(&mut file, header + 10, &(COMPRESSED | 1).to_le_bytes());
    put(&mut file, header + 18, &128_u32.to_le_bytes());
    assert_eq!(decode(&BeckerHicklSdt, &file)[0].1, expected(5));
    let read = |file: &[u8]| {
        let mut source = source(file);
        let record = BeckerHicklSdt.records(&mut source).unwrap().remove(0);
        record.read(Input::file(&mut source), 0..record.head.samples).unwrap_err().to_string()
    };
    let archive = header + 22;
    for (at, byte, says) in [(archive + 50, 77, "checksum"), (archive, 0, "no zip"), (archive + 8, 14, "method 14")] {
        let mut damaged = file.clone();
        damaged[at] = byte;
        let error = read(&damaged);
        assert!(error.contains(says), "{error}");
    }
}

/// The maker's programs make the sum of the header's words 0x55AA; the field alone is another number.
#[test]
fn a_header_has_the_sum_of_its_words() {
    let file = sdt(15, &[(0x01, counts(3, 64, CodeType::U16))]);
    assert!(BeckerHicklSdt.recognises(&file));
    let mut wrong = file;
    put(&mut wrong, 40, &SUM.to_le_bytes());
    assert!(!BeckerHicklSdt.recognises(&wrong));
    assert!(refusal(&BeckerHicklSdt, &wrong).contains("do not add up to 0x55aa"));
}

/// Descriptions of old software end before the fields of FIFO measurements.
#[test]
fn short_descriptions_are_read() {
    let whole = sdt(15, &[(0x01, counts(3, 64, CodeType::U16))]);
    let mut file = [&whole[..42 + 203], &whole[42 + 512..]].concat();
    put(&mut file, 14, &(42_u32 + 203).to_le_bytes());
    put(&mut file, 30, &203_u16.to_le_bytes());
    let header = 42 + 203;
    put(&mut file, header + 2, &(header as u32 + 22).to_le_bytes());
    put(&mut file, header + 6, &(header as u32 + 22 + 128).to_le_bytes());
    seal(&mut file);
    assert_eq!(decode(&BeckerHicklSdt, &file)[0].1, expected(3));
}

/// The curves of an image are segments, whether they are packed or not, in order or not.
#[test]
fn curves_of_an_image_are_its_pixels() {
    for kind in [0x11, 0x69, 0x1069] {
        let mut file = sdt(15, &[(kind, counts(0, 6 * 64, CodeType::U16))]);
        let (columns, rows) = if kind == 0x11 { (173, 177) } else { (309, 313) };
        put(&mut file, 42 + columns, &3_u32.to_le_bytes());
        put(&mut file, 42 + rows, &2_u32.to_le_bytes());
        let records = decode(&BeckerHicklSdt, &file);
        assert_eq!((records.len(), &records[0].0.head.shape[..]), (6, &[2, 3][..]));
        assert_eq!(records[5].0.head.channel.as_deref(), Some("M1"));
        for (pixel, (record, values)) in records.iter().enumerate() {
            assert_eq!((record.segment, values), (Some(pixel as u32), &expected(64 * pixel as u32)));
        }
        let mut source = source(&file);
        for pixel in [4, 1, 5, 0] {
            assert_eq!(source.values(&records[pixel].0).unwrap(), expected(64 * pixel as u32));
        }
    }
}

#[test]
fn a_date_that_can_be_two_is_none() {
    for (date, read) in [
        (b"10-25-2019", Some("2019-10-25T12:34:56")),
        (b"25-10-2019", Some("2019-10-25T12:34:56")),
        (b"10-10-2019", Some("2019-10-10T12:34:56")),
        (b"10-11-2019", None),
        (b"40-40-2019", None),
    ] {
        let mut file = sdt(15, &[(1, counts(0, 64, CodeType::U16))]);
        put(&mut file, 42 + 9, date);
        assert_eq!(decode(&BeckerHicklSdt, &file)[0].0.head.acquired_at.as_deref(), read);
    }
}

#[test]
fn what_is_no_curve_is_left_out_or_refused() {
    let curve = (0x01, counts(0, 64, CodeType::U16));
    let correlation = (0x228, counts(0, 10, CodeType::F64));
    assert_eq!(decode(&BeckerHicklSdt, &sdt(15, &[correlation.clone(), curve.clone()])).len(), 1);
    for (kind, says) in [(0x228, "FCS"), (0x88, "images"), (0x9A, "moments"), (0x08, "before 8.3"), (0xF1, "not known")]
    {
        let error = refusal(&BeckerHicklSdt, &sdt(15, &[(kind, counts(0, 64, CodeType::U16))]));
        assert!(error.contains(says), "{error}");
    }
    let file = sdt(14, &[curve.clone(), curve]);
    let with = |at: usize, bytes: &[u8]| {
        let mut file = file.clone();
        put(&mut file, at, bytes);
        seal(&mut file);
        refusal(&BeckerHicklSdt, &file)
    };
    let header = 42 + 512;
    for (at, bytes, says) in [
        (18, &[0_u8, 0][..], "no_of_data_blocks = 0"),
        (18, &[0xFF, 0x7F], "no_of_data_blocks = 0"),
        (18, &[0xFF, 0x20], "no_of_data_blocks = 8447"),
        (30, &[100, 0], "meas_desc_block_length = 100"),
        (32, &[0x11, 0x11], "not completed"),
        (14, &[0xFF; 4], "data_block_offs = -1"),
        (24, &[0, 0, 0, 0x7F], "cut short"),
        (header + 2, &[0, 0, 0, 0x7F], "cut short"),
        (header + 6, &[1, 0, 0, 0], "does not lead on"),
        (header + 10, &[1, 3], "0x300 are not known"),
        (header + 12, &[1, 0], "meas_desc_block_no = 1"),
        (header + 18, &[127], "is no number of curves"),
        (header + 18, &[0x80, 0, 0, 0x7F], "an image of 16646145 curves"),
        (42 + 64, &[0; 4], "tac_r = 0"),
        (42 + 68, &[0; 2], "tac_g = 0"),
    ] {
        let error = with(at, bytes);
        assert!(error.contains(says), "{error}");
    }
    let packed = sdt(15, &[(0x1011, counts(0, 128, CodeType::U16))]);
    let mut bomb = packed;
    put(&mut bomb, header + 18, &(1_u32 << 20).to_le_bytes());
    put(&mut bomb, 42 + 82, &[0, 0]);
    assert!(refusal(&BeckerHicklSdt, &bomb).contains("cannot come from"));
}

#[test]
fn hostile_files_are_survived() {
    let blocks = [(0x11, counts(0, 128, CodeType::U16)), (0x1001, counts(0, 64, CodeType::U16))];
    for revision in [14, 15] {
        let file = sdt(revision, &blocks);
        cut_everywhere(&BeckerHicklSdt, &file);
        change_anywhere(&BeckerHicklSdt, &file, 5000);
    }
}
