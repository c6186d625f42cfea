//! The readers of oscilloscope files: round trips of our own writers, hostile files, and mutations. Real files:
//! `scope_samples.rs`.

use std::io::Cursor;
use std::path::Path;

use periscope::formats::{self, Input, csv, lecroy_trc, npy};
use periscope::waveform::{Payload, Record};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn decode_bytes(bytes: Vec<u8>, name: &str) -> Result<Vec<(Record, Vec<f64>)>, String> {
    let mut source = formats::Source::new(Cursor::new(bytes), Path::new(name)).map_err(|error| error.to_string())?;
    let records = formats::records(&mut source).map_err(|error| error.to_string())?;
    records
        .into_iter()
        .map(|record| {
            record
                .read(source.file(), 0..record.head.samples)
                .map(|codes| (record.clone(), record.values(&codes)))
                .map_err(|error| error.to_string())
        })
        .collect()
}

fn sequence(bits: u16, count: usize) -> (Vec<u8>, Vec<(f64, f64, Vec<i16>)>) {
    let top = if bits == 8 { 127 } else { 32_000 };
    let code = |i: usize, k: usize| ((i * 7 + k * 31) as i32 % (2 * top) - top) as i16;
    let segments: Vec<_> = (0..count)
        .map(|k| (k as f64 * 1e-3, -1e-9 - k as f64 * 1.3e-11, (0..50).map(|i| code(i, k)).collect()))
        .collect();
    let head = lecroy_trc::SequenceHead {
        instrument: "TEST".to_owned(),
        channel: 1,
        gain_v: 0.25,
        offset_v: -0.5,
        dt_s: 5e-11,
        bits,
        acquired: lecroy_trc::Acquired { year: 2026, month: 3, day: 4, hour: 5, minute: 6, second: 7.25 },
    };
    let mut bytes = Vec::new();
    lecroy_trc::write_sequence(&mut bytes, &head, &segments).unwrap();
    (bytes, segments)
}

/// A Tektronix record of 100 words.
fn isf() -> Vec<u8> {
    let head = ":WFMPRE:NR_PT 100;BYT_NR 2;ENCDG BINARY;BN_FMT RI;BYT_OR MSB;WFID \"Ch1, DC coupling\";PT_FMT Y;XUNIT \"s\";XINCR 5.0E-11;\
        XZERO -1.0E-9;PT_OFF 0;YUNIT \"V\";YMULT 1.0E-3;YOFF 0.0;YZERO 0.0;:CURVE #3200";
    let codes = (0..100_i16).flat_map(|i| (i * 300).to_be_bytes());
    head.bytes().chain(codes).collect()
}

#[test]
fn what_is_written_is_read_back() {
    for (bits, count) in [(8, 5), (12, 3), (8, 1)] {
        let (bytes, segments) = sequence(bits, count);
        let decoded = decode_bytes(bytes, "a.trc").unwrap();
        assert_eq!(decoded.len(), count);
        for (k, ((record, values), (trigger_s, t0_s, codes))) in decoded.iter().zip(&segments).enumerate() {
            assert_eq!(record.t0_s, Some(*t0_s));
            if count > 1 {
                assert_eq!((record.trigger_s, record.segment), (Some(*trigger_s), Some(k as u32)));
            }
            assert!(
                values.iter().zip(codes).all(|(value, code)| *value == 0.25 * f64::from(*code) + 0.5),
                "{bits} bits, segment {k}"
            );
            assert_eq!(record.head.channel.as_deref(), Some("C2"));
        }
    }
    let mut bytes = Vec::new();
    npy::write(&mut bytes, &[2, 3, 4], &(0..24).collect::<Vec<i16>>()).unwrap();
    let decoded = decode_bytes(bytes, "a.npy").unwrap();
    assert_eq!((decoded.len(), decoded[0].0.head.shape.clone()), (6, vec![2, 3]));
    assert_eq!(decoded[5].1, [20.0, 21.0, 22.0, 23.0]);
    let mut bytes = Vec::new();
    csv::write(&mut bytes, -2e-9, 5e-11, &[0.5, -1.25, 3.0]).unwrap();
    let (record, values) = decode_bytes(bytes, "a.csv").unwrap().remove(0);
    assert_eq!(values, [0.5, -1.25, 3.0]);
    assert!((record.head.dt_s.unwrap() - 5e-11).abs() < 1e-20 && record.t0_s == Some(-2e-9));
}

#[test]
fn a_csv_says_in_which_line_it_goes_wrong() {
    let lines: Vec<String> = (0..20).map(|i| format!("{:e},{}", f64::from(i) * 1e-10, i * i)).collect();
    let with = |line: usize, text: &str| {
        let mut lines = lines.clone();
        lines[line] = text.to_owned();
        format!("time,volts\n{}\n", lines.join("\n")).into_bytes()
    };
    assert_eq!(decode_bytes(with(0, &lines[0]), "a.csv").unwrap()[0].1[19], 361.0);
    assert_eq!(decode_bytes(lines.join("\n").replace(',', ";").into_bytes(), "a.csv").unwrap()[0].1.len(), 20);
    let error = decode_bytes(with(5, "5e-10,abc"), "a.csv").unwrap_err();
    assert!(error.contains("line 7"), "{error}");
    let error = decode_bytes(with(10, "1.05e-9,100"), "a.csv").unwrap_err();
    assert!(error.contains("line 12") && error.contains("even step"), "{error}");
}

/// Files of our own writers with bytes changed, cut, put in, and lengths made huge.
#[test]
fn no_mutation_makes_a_reader_panic_or_claim_more_than_the_file_holds() {
    let mut npy_bytes = Vec::new();
    npy::write(&mut npy_bytes, &[4, 30], &(0..120).collect::<Vec<i16>>()).unwrap();
    let mut csv_bytes = Vec::new();
    csv::write(&mut csv_bytes, 0.0, 1e-10, &[0.25; 40]).unwrap();
    let head = [
        "\"Record Length\"\t30",
        "\"Sample Interval\"\t5e-11",
        "\"Trigger Point\"\t10",
        "\"Trigger Time\"\t0.25",
        "\"Horizontal Offset\"\t-5e-10",
    ];
    let row = |i: usize| format!("{}\t\t{:e}\t{}", head.get(i).unwrap_or(&"\t"), i as f64 * 5e-11, 0.01 * i as f64);
    let ascii = (0..30).map(row).collect::<Vec<_>>().join("\r\n");
    assert_eq!(decode_bytes(ascii.clone().into_bytes(), "a.txt").unwrap()[0].0.t0_s, Some(-10.25 * 5e-11));
    let seeds: [(&str, Vec<u8>); 6] = [
        ("a.trc", sequence(8, 4).0),
        ("b.trc", sequence(12, 1).0),
        ("a.npy", npy_bytes),
        ("a.isf", isf()),
        ("a.csv", csv_bytes),
        ("a.txt", ascii.into_bytes()),
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let mut accepted = 0;
    for round in 0..4000 {
        for (name, seed) in &seeds {
            let mut bytes = seed.clone();
            for _ in 0..rng.random_range(1..4) {
                mutate(&mut bytes, &mut rng);
            }
            let length = bytes.len();
            let decoded = std::panic::catch_unwind(|| decode_bytes(bytes.clone(), name))
                .unwrap_or_else(|_| panic!("{name}, round {round}: a reader panicked"));
            let Ok(records) = decoded else { continue };
            accepted += 1;
            let mut claimed = 0;
            for (record, values) in &records {
                assert_eq!(values.len(), record.head.samples, "{name}, round {round}");
                match &record.payload {
                    Payload::Decoded(codes) => claimed += codes.len(),
                    Payload::File { byte_offset, .. } => {
                        assert!(*byte_offset as usize + record.code_bytes() <= length, "{name}, round {round}")
                    }
                    Payload::Packed(_) => {}
                }
            }
            assert!(claimed <= 16 * length, "{name}, round {round}: {claimed} bytes of a file of {length}");
        }
    }
    assert!(accepted > 1000, "mutations leave some files whole: {accepted}");
}

/// A small damage.
pub fn mutate(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    if bytes.is_empty() {
        return;
    }
    let at = rng.random_range(0..bytes.len());
    match rng.random_range(0..6) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes[at] = rng.random_range(0..=255),
        2 => bytes.truncate(at),
        3 => bytes.insert(at, rng.random_range(0..=255)),
        4 => {
            bytes.remove(at);
        }
        // Where a length may stand: the largest and the most negative.
        _ => {
            let value: i32 = if rng.random_bool(0.5) { i32::MAX } else { i32::MIN };
            let end = (at + 4).min(bytes.len());
            bytes[at..end].copy_from_slice(&value.to_le_bytes()[..end - at]);
        }
    }
}

/// Files that lie in ways that mutations seldom find.
#[test]
fn hostile_and_misleading_heads_are_refused() {
    let refused = |bytes: &[u8], name: &str| decode_bytes(bytes.to_vec(), name).map(|_| ()).unwrap_err();
    // A header that claims 4 GiB, and one whose brackets nest: neither may cost memory or time.
    let error = refused(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{'", "a.npy");
    assert!(error.contains("claims 4294967295 bytes"), "{error}");
    let nested = [b"\x93NUMPY\x01\x00\x40\x00{'descr': ".as_slice(), &[b'['; 54]].concat();
    assert!(refused(&nested, "a.npy").contains("structured"), "{}", refused(&nested, "a.npy"));
    // A first row of data that went wrong is no line of names; a byte order mark is no part of a number.
    let rows = |first: &str| format!("{first}\n1e-10,1\n2e-10,2\n").into_bytes();
    assert!(refused(&rows("0,overload"), "a.csv").contains("line 1"));
    assert_eq!(decode_bytes(rows("\u{feff}0,0"), "a.csv").unwrap()[0].1, [0.0, 1.0, 2.0]);
    // LeCroy: samples interleaved from several triggers, a spectrum, a descriptor that overlaps the samples.
    let with = |at: usize, field: &[u8]| {
        let mut bytes = sequence(8, 1).0;
        let start = 11 + at;
        bytes[start..start + field.len()].copy_from_slice(field);
        bytes
    };
    assert!(refused(&with(52, &8_i32.to_le_bytes()), "a.trc").contains("RIS_TIME_ARRAY"));
    assert!(refused(&with(244, b"Hz\0"), "a.trc").contains("Hz"));
    assert!(refused(&with(36, &100_i32.to_le_bytes()), "a.trc").contains("WAVE_DESCRIPTOR"));
}
