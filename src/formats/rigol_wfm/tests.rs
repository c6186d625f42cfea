use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::RigolWfm;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal};
use crate::reader::Reader;
use crate::waveform::Kind;

/// A file as it is put together: bytes at their places.
struct Built(Vec<u8>);

impl Built {
    fn new(length: usize) -> Self {
        Self(vec![0; length])
    }
    fn put(mut self, at: usize, bytes: &[u8]) -> Self {
        self.0[at..at + bytes.len()].copy_from_slice(bytes);
        self
    }
    fn f32(self, at: usize, value: f32) -> Self {
        self.put(at, &value.to_le_bytes())
    }
    fn u32(self, at: usize, value: u32) -> Self {
        self.put(at, &value.to_le_bytes())
    }
    fn i64(self, at: usize, value: i64) -> Self {
        self.put(at, &value.to_le_bytes())
    }
    fn codes(mut self, codes: &[u8]) -> Vec<u8> {
        self.0.extend_from_slice(codes);
        self.0
    }
}

/// A channel of the DS1000: 2 V/div, probe 10x, 5 codes up; its two flags at `on`.
fn ds1000_channel(file: Built, at: usize, on: usize) -> Built {
    file.f32(at + 8, 10.0).put(at + on, &[1]).u32(at + 16, 200_000).put(at + 20, &5_i16.to_le_bytes())
}

/// Volts of a code of it.
const DS1000_GAIN: f64 = 1e-6 * 200_000.0 * 10.0 / 25.0;

/// Channels 2 and 3 on; 4 samples each, 1 GS/s, 7 ns after the middle.
fn ds1000b() -> Vec<u8> {
    let file = Built::new(420).put(0, &[0xA5, 0xA5, 0xA4, 1]).put(4, b"DS1204B").u32(60, 4).f32(180, 1e9);
    let file = ds1000_channel(ds1000_channel(file, 92, 14), 116, 14).i64(172, 7000).i64(192, 7000);
    file.codes(&[0, 0, 0, 0, 94, 95, 96, 97, 1, 2, 3, 4, 0, 0, 0, 0])
}

/// The second channel of two on.
fn ds1000e(padding: usize) -> Built {
    let file = Built::new(padding).put(0, &[0xA5, 0xA5, 0, 0]).u32(28, 4).f32(100, 1e9).i64(92, 7000).i64(112, 7000);
    ds1000_channel(file, 60, 13)
}

/// The channels of a mask are on, each with as many samples as the memory has for it; 1 GS/s.
fn ds1000z(mask: u8, codes: &[u8]) -> Vec<u8> {
    let file = Built::new(0x130).put(0, &[1, 0xFF, 0xFF, 0xFF, 0xA6, 0xA5, 0x38, 0]).put(8, b"DS1104Z");
    let file = file.put(0x54, &[0xD8, 0]).put(0x58, &[mask]).u32(0x74, codes.len() as u32).f32(0x78, 1.0);
    file.u32(0x100, 0x30).u32(0x104, 0x100).codes(codes)
}

/// A DS2000 or DS4000 with a range of four codes for each of two channels, `shift` bytes further down in the header.
fn ds2000(serial: &[u8], shift: usize) -> Built {
    let late = if shift > 0 { 0x10 } else { 0 };
    let file = Built::new(0x110).put(0, &[0xA5, 0xA5, 0x38, 0]).put(4, serial).put(0x40, &[3]);
    let file = file.u32(0x44, 0x110).u32(0x48, 0x114).f32(0x60 + shift, 1e9).u32(0xFC + late, 4);
    let channel = |file: Built, at: usize| file.put(at, &[1]).f32(at + 8, 0.5).f32(at + 12, 0.25).put(at + 17, &[2]);
    channel(channel(file, 0x78 + shift), 0x78 + shift + 28)
}

/// A block of settings, packed or not.
fn block(id: u16, kind: u16, content: &[u8], packed: bool) -> Vec<u8> {
    let mut bytes = content.to_vec();
    if packed {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(content).unwrap();
        bytes = encoder.finish().unwrap();
    }
    let fields = [id, kind, content.len() as u16, bytes.len() as u16, bytes.len() as u16 + 2, 0];
    let mut block: Vec<u8> = fields.iter().flat_map(|field| field.to_le_bytes()).collect();
    block.extend(bytes);
    block.extend([0, 0]);
    block
}

/// A DHO with channels `on` switched on, four samples each.
fn dho(kind: u16, on: &[u16], packed: bool) -> Vec<u8> {
    let mut file = Built::new(24).put(0, &[2]).0;
    file.extend(block(11, 17, b"Rigol Scope", false));
    for number in (1..=4_u16).rev() {
        let content = Built::new(80).put(0, &[u8::from(on.contains(&number))]).i64(1, 7_500_000_000);
        file.extend(block(number, kind, &content.i64(38, -250_000_000).0, packed));
    }
    file.extend([0; 24]);
    let total = 4 * on.len() as u64 + u64::from(kind == 9);
    let head = Built::new(40).put(0, &total.to_le_bytes()).u32(16, 500).u32(24, 4).u32(28, 4);
    let codes = (0..4 * on.len()).flat_map(|code| (32768 + code as u16).to_le_bytes()).collect::<Vec<_>>();
    file.extend(head.codes(&codes));
    file
}

fn channels(file: &[u8]) -> Vec<(String, Vec<f64>)> {
    let records = decode(&RigolWfm, file);
    records.into_iter().map(|(record, values)| (record.head.channel.clone().unwrap_or_default(), values)).collect()
}

#[test]
fn ds1000b_has_a_place_for_each_channel() {
    let records = decode(&RigolWfm, &ds1000b());
    let names: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap_or_default()).collect();
    assert_eq!(names, ["CH2", "CH3"]);
    // 2 V/div are 0.08 V a code; 5 codes up, 0 V is at code 94.
    let volts = |codes: [f64; 4]| codes.map(|code| -DS1000_GAIN * code + DS1000_GAIN * 94.0).to_vec();
    assert_eq!(records[0].1, volts([94.0, 95.0, 96.0, 97.0]));
    assert_eq!(records[1].1, volts([1.0, 2.0, 3.0, 4.0]));
    let record = &records[0].0;
    assert!((record.t0_s.unwrap() - 5e-9).abs() < 1e-20 && record.head.dt_s == Some(1e-9));
    assert_eq!(record.head.instrument.as_deref(), Some("DS1204B"));
}

#[test]
fn an_offset_that_was_turned_later_leaves_the_time_open() {
    let mut file = ds1000b();
    file[172] += 1;
    assert_eq!(decode(&RigolWfm, &file)[0].0.t0_s, None);
}

#[test]
fn ds1000e_and_ds1000c_are_distinguished_by_length() {
    // 0 V at code 120.
    let volts: Vec<f64> = [119.0, 120.0, 121.0, 122.0].map(|code| -DS1000_GAIN * code + DS1000_GAIN * 120.0).to_vec();
    let codes = [119, 120, 121, 122];
    let mut c = ds1000e(256).codes(&codes);
    c[0] = 0xA1;
    for file in [ds1000e(276).codes(&codes), ds1000e(272).codes(&codes), c] {
        assert_eq!(channels(&file), [("CH2".to_owned(), volts.clone())]);
    }
}

#[test]
fn ds1000e_leaves_out_what_a_rolling_capture_did_not_reach() {
    let file = ds1000e(276).u32(20, 1).codes(&[119, 0, 0, 0]);
    let (record, volts) = decode(&RigolWfm, &file).remove(0);
    assert_eq!((volts.len(), record.head.samples), (1, 1));
    assert!((record.t0_s.unwrap() - 5e-9).abs() < 1e-20);
    assert!(refusal(&RigolWfm, &ds1000e(276).u32(20, 2).codes(&[0; 4])).contains("no samples"));
}

#[test]
fn ds1000e_channel_with_a_trigger_of_its_own_has_its_own_times() {
    let file = ds1000e(276).put(142, &[4]).f32(252, 5e8).i64(244, -8000).i64(264, -8000).u32(232, 2);
    let (record, _) = decode(&RigolWfm, &file.codes(&[0; 2])).remove(0);
    assert!((record.t0_s.unwrap() + 10e-9).abs() < 1e-20 && record.head.dt_s == Some(2e-9));
}

#[test]
fn an_inverted_channel_has_no_scale() {
    let (record, _) = decode(&RigolWfm, &ds1000e(276).put(60 + 14, &[1]).codes(&[0; 4])).remove(0);
    assert_eq!((record.head.scale, record.head.unit.clone()), (None, None));
}

#[test]
fn ds1000z_lanes_are_taken_apart() {
    let codes = [1, 2, 3, 4, 5, 6, 7, 8];
    let lanes = |mask: u8| channels(&ds1000z(mask, &codes));
    let named = |name: &str, codes: &[f64]| (name.to_owned(), codes.to_vec());
    assert_eq!(lanes(0b0100), [named("CH3", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])]);
    assert_eq!(lanes(0b1001), [named("CH1", &[2.0, 4.0, 6.0, 8.0]), named("CH4", &[1.0, 3.0, 5.0, 7.0])]);
    let three = [named("CH1", &[4.0, 8.0]), named("CH2", &[3.0, 7.0]), named("CH4", &[1.0, 5.0])];
    assert_eq!(lanes(0b1011), three);
    let (record, _) = decode(&RigolWfm, &ds1000z(1, &codes)).remove(0);
    assert_eq!((record.t0_s, record.head.scale, record.head.dt_s), (None, None, Some(1e-9)));
}

#[test]
fn ds1000z_refusals_and_kinds_are_named() {
    let with = |at: usize, byte: u8| {
        let mut file = ds1000z(3, &[0; 8]);
        file[at] = byte;
        file
    };
    assert_eq!(decode(&RigolWfm, &with(0x70, 1))[0].0.head.kind, Kind::Envelope);
    assert_eq!(decode(&RigolWfm, &with(0x70, 2))[0].0.head.kind, Kind::Average);
    for (at, byte, says) in [
        (0x54, 0, "a head of 0 bytes"),
        (0x58, 0, "no channel"),
        (0x6C, 1, "logic channels"),
        (0x70, 9, "acquisition mode 9"),
        (0x74, 7, "7 bytes are no whole number"),
        (0x74, 10, "cut short"),
        (0x79, 0xFF, "the sample rate"),
        (0x105, 0, "would lie in the head"),
    ] {
        let mut file = with(at, byte);
        if at == 0x79 {
            file[0x78..0x7C].fill(0xFF);
        }
        let error = refusal(&RigolWfm, &file);
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn ds2000_and_ds4000_have_a_stretch_for_each_channel() {
    for (serial, shift, codes_per_division) in [(&b"DS2A1"[..], 0, 25.0), (b"MSO2A1", 0, 25.0), (b"DS4A1", 4, 32.0)] {
        let gain = 0.5 / codes_per_division;
        let volts = |codes: [f64; 4]| codes.map(|code| gain * code + (-gain * 127.0 - 0.25)).to_vec();
        let records = decode(&RigolWfm, &ds2000(serial, shift).codes(&[127, 128, 129, 130, 1, 2, 3, 4]));
        assert_eq!(records[0].1, volts([127.0, 128.0, 129.0, 130.0]));
        assert_eq!(records[1].1, volts([1.0, 2.0, 3.0, 4.0]));
        let head = &records[0].0.head;
        assert_eq!((records[0].0.t0_s, head.t0_nominal), (Some(-2e-9), true));
        assert_eq!((head.dt_s, head.unit.as_deref()), (Some(1e-9), Some("V")));
    }
}

#[test]
fn ds2000_interwoven_memory_is_put_in_order() {
    let file = ds2000(b"DS2A1", 0).put(0x40, &[2, 1]).u32(0xFC, 8).codes(&[1, 3, 5, 7, 2, 4, 6, 8]);
    let (record, _) = decode(&RigolWfm, &file).remove(0);
    assert_eq!(record.head.channel.as_deref(), Some("CH2"));
    let mut source = crate::hostile::source(&file);
    let read = |source: &mut crate::Source<_>, range| record.read(crate::Input::file(source), range).unwrap();
    assert_eq!(read(&mut source, 0..8), [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(read(&mut source, 3..6), [4, 5, 6]);
    assert!(refusal(&RigolWfm, &ds2000(b"DS2A1", 0).put(0x40, &[3, 1]).codes(&[0; 8])).contains("interwoven"));
    assert!(refusal(&RigolWfm, &ds2000(b"DS2A1", 0).put(0x40, &[1, 1]).codes(&[0; 5])).contains("cut short"));
}

#[test]
fn ds2000_flags_and_refusals_are_named() {
    let swapped = ds2000(b"DS2D1", 0).put(0x78, &[8]).put(0x78 + 16, &[1, 0]).codes(&[0; 8]);
    assert_eq!(decode(&RigolWfm, &swapped)[0].0.head.unit.as_deref(), Some("A"));
    for (file, says) in [
        (ds2000(b"DS6A1", 0), "DS6A1"),
        (ds2000(b"", 0), "instrument"),
        (ds2000(b"DS2A1", 0).u32(0x44, 12), "byte 12, within the head"),
        (ds2000(b"DS2A1", 0).u32(0xFC, 0), "no record"),
        (ds2000(b"DS2A1", 0).u32(0xFC, u32::MAX), "cut short"),
        (ds2000(b"DS2A1", 0).f32(0x60, 0.0), "the sample rate"),
        (ds2000(b"DS2A1", 0).f32(0x80, f32::NAN), "the scale = NaN"),
        (ds2000(b"DS2A1", 0).put(0x54, &[7]), "acquisition mode 7"),
        (ds2000(b"DS2A1", 0).put(0x40, &[0]), "no channel"),
    ] {
        let error = refusal(&RigolWfm, &file.codes(&[0; 8]));
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn dho_channels_are_scaled_by_their_own_blocks() {
    for (kind, packed, unit) in [(5, true, 7.5e12), (5, false, 7.5e12), (9, true, 7.5e11)] {
        let gain = 7.5e9 / unit;
        let centre = if kind == 5 { 0.25 } else { 2.5 };
        let volts = |codes: [f64; 4]| codes.map(|code| gain * (32768.0 + code) + (centre - gain * 32768.0)).to_vec();
        let file = dho(kind, &[1, 3], packed);
        let named = |name: &str, codes| (name.to_owned(), volts(codes));
        assert_eq!(channels(&file), [named("CH1", [0.0, 2.0, 4.0, 6.0]), named("CH3", [1.0, 3.0, 5.0, 7.0])]);
        let (record, _) = decode(&RigolWfm, &file).remove(0);
        assert_eq!(record.head.dt_s, Some(500.0 * if kind == 5 { 8e-10 } else { 1e-8 }));
        assert!(refusal(&RigolWfm, &file[..file.len() - 1]).contains("cut short"));
    }
}

#[test]
fn dho_number_of_samples_may_begin_with_zeros() {
    let mut file = dho(5, &[2], true);
    let codes = 8;
    let head = file.len() - codes - 40;
    file.truncate(head);
    let count = Built::new(40).put(0, &0x1_0000_u64.to_le_bytes()).u32(16, 1).u32(24, 0x1_0000).u32(28, 0x1_0000);
    file.extend(count.codes(&vec![7; 0x2_0000]));
    let (record, values) = decode(&RigolWfm, &file).remove(0);
    assert_eq!((record.head.samples, values.len()), (0x1_0000, 0x1_0000));
}

#[test]
fn dho_refusals_are_named() {
    let file = dho(5, &[1, 2], true);
    let first = file.windows(4).position(|bytes| bytes == [4, 0, 5, 0]).unwrap();
    let with = |at: usize, bytes: &[u8]| Built(file.clone()).put(at, bytes).0;
    for (file, says) in [
        (with(first, &[3]), "CH3 has two blocks"),
        (with(first + 6, &[0xFF, 0xFF]), "cannot hold 65535"),
        (with(first + 20, &[0xFF; 8]), "cannot be unpacked"),
        (with(file.len() - 16 - 40, &[4]), "1 channels have samples, but 4 settings"),
        (file[..file.len() - 16 - 30].to_vec(), "number of samples"),
        (file[..file.len() - 16 - 40].to_vec(), "cut short"),
    ] {
        let error = refusal(&RigolWfm, &file);
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn other_files_are_not_taken_for_rigols() {
    for head in [&[][..], &[0xA5], &[2, 0, 0, 0], &[2; 64], b"\x02\0\0\0 some other maker's head with text in it"] {
        assert!(!RigolWfm.recognises(head));
    }
    assert!(refusal(&RigolWfm, &[2, 0, 0, 0]).contains("no Rigol family"));
}

#[test]
fn hostile_files_are_survived() {
    let files = [
        ds1000b(),
        ds1000z(0b1001, &[1, 2, 3, 4]),
        ds2000(b"DS2A1", 0).codes(&[0; 8]),
        ds2000(b"DS2A1", 0).put(0x40, &[2, 1]).u32(0xFC, 8).codes(&[0; 8]),
        ds2000(b"DS4A1", 4).codes(&[0; 8]),
        dho(5, &[1, 2], true),
    ];
    for file in files {
        assert!(RigolWfm.recognises(&file));
        cut_everywhere(&RigolWfm, &file);
        change_anywhere(&RigolWfm, &file, 5000);
    }
    // Only the length distinguishes the longer header of a DS1000E from the shorter one. Cut by exactly these four
    // bytes, the file is valid.
    change_anywhere(&RigolWfm, &ds1000e(276).codes(&[1, 2, 3, 4]), 5000);
}
