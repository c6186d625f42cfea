use std::io::Cursor;
use std::path::Path;

use super::super::hostile;
use super::*;
use crate::Source;

fn chunk(name: &str, bytes: &[u8]) -> Vec<u8> {
    let mut chunk = [name.as_bytes(), &(bytes.len() as u32).to_le_bytes(), bytes].concat();
    if bytes.len() % 2 == 1 {
        chunk.push(0);
    }
    chunk
}

fn plain(tag: u16, channels: u16, bits: u16) -> Vec<u8> {
    let block = channels * (bits / 8);
    let mut bytes = [tag.to_le_bytes(), channels.to_le_bytes()].concat();
    bytes.extend(1000_u32.to_le_bytes());
    bytes.extend((1000 * u32::from(block)).to_le_bytes());
    bytes.extend([block.to_le_bytes(), bits.to_le_bytes()].concat());
    chunk("fmt ", &bytes)
}

fn file(format: &[u8], data: &[u8]) -> Vec<u8> {
    let body = [b"WAVE".as_slice(), &chunk("LIST", b"odd"), format, &chunk("data", data)].concat();
    [b"RIFF".as_slice(), &(body.len() as u32).to_le_bytes(), &body].concat()
}

fn values(bytes: &[u8]) -> Result<Vec<Vec<f64>>, String> {
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.wav")).unwrap();
    let records = Wav.records(&mut source).map_err(|error| error.to_string())?;
    let read = |record: &Record| {
        let codes = record.read(source.file(), 0..record.head.samples).unwrap();
        assert_eq!(record.head.dt_s, Some(0.001));
        assert_eq!((record.head.unit.as_deref(), record.t0_s), (Some("full-scale"), None));
        record.values(&codes)
    };
    Ok(records.iter().map(read).collect())
}

#[test]
fn integers_of_all_widths_are_fractions_of_full_scale() {
    assert_eq!(values(&file(&plain(1, 1, 8), &[0, 128, 255])).unwrap(), [[-1.0, 0.0, 127.0 / 128.0]]);
    let two = [0x8000_u16, 0, 0x4000, 0x7FFF].map(u16::to_le_bytes).concat();
    assert_eq!(values(&file(&plain(1, 2, 16), &two)).unwrap(), [[-1.0, 0.5], [0.0, 32767.0 / 32768.0]]);
    let three = [0, 0, 0x80, 1, 0, 0, 0, 0, 0x40, 0xFF, 0xFF, 0xFF];
    let step = 1.0 / 8_388_608.0;
    assert_eq!(values(&file(&plain(1, 2, 24), &three)).unwrap(), [[-1.0, 0.5], [step, -step]]);
    let four = [i32::MIN, i32::MAX].map(i32::to_le_bytes).concat();
    assert_eq!(values(&file(&plain(1, 1, 32), &four)).unwrap(), [[-1.0, 1.0 - 1.0 / 2_147_483_648.0]]);
}

#[test]
fn floating_numbers_are_as_they_are() {
    let four = [0.25_f32, -3.0].map(f32::to_le_bytes).concat();
    assert_eq!(values(&file(&plain(3, 2, 32), &four)).unwrap(), [[0.25], [-3.0]]);
    assert_eq!(values(&file(&plain(3, 1, 64), &0.1_f64.to_le_bytes())).unwrap(), [[0.1]]);
}

/// 12 bits in the upper part of 16, declared in `WAVEFORMATEXTENSIBLE`.
fn extensible() -> Vec<u8> {
    let mut format = plain(1, 1, 16)[8..].to_vec();
    format[..2].copy_from_slice(&0xFFFE_u16.to_le_bytes());
    format.extend([22, 0, 12, 0, 0, 0, 0, 0]);
    format.extend([1, 0, 0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xAA, 0, 0x38, 0x9B, 0x71]);
    file(&chunk("fmt ", &format), &0x4000_u16.to_le_bytes())
}

#[test]
fn extensible_formats_are_read() {
    let mut source = Source::new(Cursor::new(extensible()), Path::new("a.wav")).unwrap();
    let record = Wav.records(&mut source).unwrap().remove(0);
    assert_eq!((record.head.channel.as_deref(), record.head.rails), (Some("mono"), None));
    assert_eq!(values(&extensible()).unwrap(), [[0.5]]);
}

#[test]
fn rails_are_those_of_the_codes() {
    let rails = |format: &[u8], data: &[u8]| {
        let mut source = Source::new(Cursor::new(file(format, data)), Path::new("a.wav")).unwrap();
        Wav.records(&mut source).unwrap()[0].head.rails
    };
    assert_eq!(rails(&plain(1, 1, 8), &[0]), Some((0.0, 255.0)));
    assert_eq!(rails(&plain(1, 1, 24), &[0; 3]), Some((-8_388_608.0, 8_388_607.0)));
    assert_eq!(rails(&plain(1, 1, 32), &[0; 4]), Some((-2_147_483_648.0, 2_147_483_647.0)));
    assert_eq!(rails(&plain(3, 1, 32), &[0; 4]), None);
}

#[test]
fn long_records_of_24_bits_are_read_in_pieces() {
    let count = 3 * PIECE_SAMPLES + 5;
    let data: Vec<u8> = (0..count as u32).flat_map(|i| [i.to_le_bytes()[0], i.to_le_bytes()[1], 0]).collect();
    let values = values(&file(&plain(1, 1, 24), &data)).unwrap().remove(0);
    assert_eq!(values.len(), count);
    assert!(values.iter().enumerate().all(|(i, value)| *value * 8_388_608.0 == (i & 0xFFFF) as f64));
}

#[test]
fn what_is_wrong_is_said() {
    let good = file(&plain(1, 2, 16), &[0; 8]);
    let with = |at: usize, bytes: &[u8]| {
        let mut file = good.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        values(&file).unwrap_err()
    };
    // RIFF head 12, LIST 12, head of fmt 8: the fmt chunk is at 32, the head of data at 48.
    assert!(with(0, b"RF64").contains("RF64"));
    assert!(with(0, b"RIFX").contains("RIFX"));
    assert!(with(32, &[0x11]).contains("byte 32: wFormatTag = 0x0011"));
    assert!(with(34, &[0]).contains("nChannels = 0"));
    assert!(with(34, &[0xFF, 0xFF]).contains("nChannels = 65535"));
    assert!(with(36, &[0; 4]).contains("nSamplesPerSec = 0"));
    assert!(with(44, &[5]).contains("nBlockAlign = 5"));
    assert!(with(46, &[17]).contains("17 bits"));
    assert!(with(52, &[7]).contains("no whole number of 4 byte blocks"));
    assert!(with(52, &[12]).contains("cut short: the data chunk needs 12 bytes from byte 56"));
    assert!(with(52, &[255; 4]).contains("was not closed"));
    assert!(with(24, b"data").contains("before the fmt chunk"));
    assert!(with(48, b"JUNK").contains("the data chunk has not come yet"));
    assert!(values(b"riff").unwrap_err().contains("cut short"));
}

#[test]
fn other_riff_files_are_not_taken() {
    assert!(Wav.recognises(&file(&plain(1, 1, 8), &[0])));
    assert!(Wav.recognises(b"riff\x2e\x91\xcf\x11\xa5\xd6\x28\xdb\x04\xc1\0\0\0\0\0\0\0\0\0\0wave"));
    assert!(!Wav.recognises(b"RIFF\0\0\0\0AVI LIST") && !Wav.recognises(b"RIFF"));
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    for bytes in [file(&plain(1, 2, 24), &[7; 18]), file(&plain(3, 1, 32), &[7; 8]), extensible()] {
        hostile::cut_everywhere(&Wav, &bytes);
        hostile::change_anywhere(&Wav, &bytes, 4000);
    }
}
