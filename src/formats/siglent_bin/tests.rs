use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal, source};

/// Bytes of a header, with values put in.
struct Built {
    layout: Layout,
    bytes: Vec<u8>,
}

impl Built {
    /// Channels 1 and 3 on, three samples 2 ns apart, with a delay of 10 ns.
    fn new(version: u32) -> Self {
        let layout = if version == 1 { VERSION_1 } else { later(version) };
        let mut built = Self { layout, bytes: vec![0; if version == 4 { 0x1000 } else { 0x800 }] };
        if version > 1 {
            built.u32(0, version);
        }
        if version == 4 {
            built.u32(4, 0x1000);
        }
        for i in [0, 2] {
            built.u32(layout.on + 4 * i, 1);
        }
        for i in 0..4 {
            built.value(layout.per_division + i * layout.value, 250.0, 7, [1, 0]);
            built.value(layout.offset + i * layout.value, -0.5, 8, [1, 0]);
        }
        built.value(layout.delay - layout.value, 1e-6, 8, [0, 0]);
        built.value(layout.delay, 10.0, 5, [0, 0]);
        built.value(layout.rate, 500.0, 10, [0, 0]);
        built.u32(layout.samples, 3);
        if let Some(shift) = layout.later {
            (0..4).for_each(|i| built.f64(PROBE + shift + 8 * i, 10.0));
        }
        if version > 2 {
            (0..4).for_each(|i| built.u32(CODES + 4 * i + layout.later.unwrap_or(0), 30));
        }
        built
    }

    fn put(&mut self, at: usize, bytes: &[u8]) {
        self.bytes[at..at + bytes.len()].copy_from_slice(bytes);
    }

    fn u32(&mut self, at: usize, number: u32) {
        self.put(at, &number.to_le_bytes());
    }

    fn f64(&mut self, at: usize, number: f64) {
        self.put(at, &number.to_le_bytes());
    }

    /// A value with its power of 1000 and the powers of volts and amperes in its unit.
    fn value(&mut self, at: usize, number: f64, power: u32, [volts, amperes]: [u32; 2]) {
        self.f64(at, number);
        self.u32(at + 8, power);
        if self.layout.value == 16 {
            return self.u32(at + 12, amperes);
        }
        let words = [0, volts, 1, amperes, 1, 1 - volts - amperes, 1];
        words.into_iter().enumerate().for_each(|(i, word)| self.u32(at + 12 + 4 * i, word));
    }

    fn with(&self, data: &[u8]) -> Vec<u8> {
        [&self.bytes, data].concat()
    }
}

const CODES_OF_TWO: [u8; 6] = [128, 153, 103, 0, 255, 128];

#[test]
fn volts_and_times_of_each_version() {
    for (version, probe, codes) in [(1, 1.0, 25.0), (2, 10.0, 25.0), (3, 10.0, 30.0), (4, 10.0, 30.0)] {
        let bytes = Built::new(version).with(&CODES_OF_TWO);
        assert!(SiglentBin.recognises(&bytes));
        let records = decode(&SiglentBin, &bytes);
        let volts: Vec<f64> =
            CODES_OF_TWO[..3].iter().map(|code| ((f64::from(*code) - 128.0) * 0.25 / codes + 0.5) * probe).collect();
        let (record, values) = &records[0];
        assert!(values.iter().zip(&volts).all(|(a, b)| (a - b).abs() < 1e-12), "{version}: {values:?} {volts:?}");
        assert_eq!(records[1].0.head.channel.as_deref(), Some("C3"));
        assert_eq!((record.head.dt_s, record.t0_s), (Some(2e-9), Some(10e-9 - 3e-9)));
        assert_eq!((record.head.unit.as_deref(), record.head.t0_nominal), (Some("V"), true));
        cut_everywhere(&SiglentBin, &bytes);
        change_anywhere(&SiglentBin, &bytes, 3000);
    }
}

#[test]
fn words_of_either_order() {
    for (order, codes) in [(0, [0, 0x80, 0, 0x90, 0, 0x70]), (1, [0x80, 0, 0x90, 0, 0x70, 0])] {
        let mut built = Built::new(4);
        built.u32(built.layout.on + 8, 0);
        built.put(WIDTH + 4, &[1, order]);
        built.u32(CODES + 4, 4096);
        let records = decode(&SiglentBin, &built.with(&codes));
        assert_eq!(records[0].1, [5.0, 7.5, 2.5]);
        assert_eq!((records.len(), records[0].0.head.rails), (1, None));
    }
    let mut built = Built::new(2);
    built.put(WIDTH, &[1]);
    let records = decode(&SiglentBin, &built.with(&[1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0]));
    assert_eq!((&records[1].1[..], records[1].0.head.scale), (&[4.0, 5.0, 6.0][..], None));
}

/// Channels 5 to 8, math, logic and a zoomed window of version 4.
#[test]
fn what_version_4_has_in_addition() {
    let mut built = Built::new(4);
    built.u32(ON_5 + 4, 1);
    built.value(PER_DIVISION_5 + 40, 2.0, 8, [0, 1]);
    built.value(OFFSET_5 + 40, 0.0, 8, [0, 1]);
    built.f64(PROBE_5 + 8, 1.0);
    built.u32(CODES_5 + 4, 2);
    built.u32(MATH_ON + 4 + 4, 1);
    built.value(MATH_PER_DIVISION + 4 + 40, 1.0, 8, [1, 0]);
    built.value(MATH_OFFSET + 4 + 40, 3.0, 8, [1, 0]);
    built.u32(MATH_SAMPLES + 4 + 4, 2);
    built.f64(MATH_STEP + 4 + 8, 4e-9);
    built.u32(MATH_CODES + 4, 1);
    built.u32(built.layout.logic, 1);
    built.u32(built.layout.logic + 4 + 8, 1);
    built.u32(built.layout.logic_samples, 9);
    built.u32(ZOOM, 1);
    built.value(ZOOM_DELAY, 1.0, 6, [0, 0]);
    let bytes = built.with(&[&CODES_OF_TWO[..], &[128, 129, 130, 130, 131, 0xAA, 1]].concat());
    let records = decode(&SiglentBin, &bytes);
    let names: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap()).collect();
    assert_eq!(names, ["C1", "C3", "C6", "F2"]);
    assert_eq!((&records[2].1[..], records[2].0.head.unit.as_deref()), (&[0.0, 1.0, 2.0][..], Some("A")));
    assert_eq!((&records[3].1[..], records[3].0.head.dt_s), (&[-1.0, 0.0][..], Some(4e-9)));
    assert_eq!(records[3].0.t0_s, Some(1e-6 - 4e-9));
    let contents = crate::contents(&mut source(&bytes)).unwrap();
    assert!(contents.remarks.len() == 1 && contents.remarks[0].problem.contains("1 logic channels"));
    cut_everywhere(&SiglentBin, &bytes);
}

#[test]
fn what_is_wrong_is_said() {
    let mut none = Built::new(1);
    (0..4).for_each(|i| none.u32(4 * i, 0));
    assert!(refusal(&SiglentBin, &none.with(&[])).contains("no channel and no math trace"));
    let mut empty = Built::new(3);
    empty.u32(empty.layout.samples, 0);
    assert!(refusal(&SiglentBin, &empty.with(&[])).contains("C1 has 0 samples"));
    let mut flat = Built::new(4);
    flat.u32(CODES + 4, 0);
    assert!(refusal(&SiglentBin, &flat.with(&CODES_OF_TWO)).contains("0 codes and a probe of 10"));
    let cut = Built::new(4).with(&CODES_OF_TWO[..2]);
    assert!(refusal(&SiglentBin, &cut).contains("cut short: a trace needs 3 bytes from byte 4096"));
    let contents = crate::contents(&mut source(&Built::new(4).with(&CODES_OF_TWO[..5]))).unwrap();
    assert_eq!((contents.records.len(), contents.remarks[0].is_cut), (1, true));
    for other in [&[0; 0x900][..], &[1; 0x900], b"RG01"] {
        assert!(!SiglentBin.recognises(other));
    }
}
