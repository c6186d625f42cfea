mod arrays;
mod builder;

use std::io::Cursor;
use std::path::Path;

use super::super::hostile;
use super::*;
use crate::Source;
use crate::waveform::{CodeType, Kind, Scale};
use builder::{Builder, Message, Storage, attribute, enumerated, number, numbers, text_attribute, texts};

fn read(bytes: &[u8]) -> Result<Vec<Record>, String> {
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.h5")).unwrap();
    Hdf5.records(&mut source).map_err(|error| error.to_string())
}

fn values(record: &Record, bytes: &[u8]) -> Vec<f64> {
    record.values(&record.read(&mut Cursor::new(bytes), 0..record.head.samples).unwrap())
}

/// A file like Tektronix's, with samples of any type in any storage.
fn tektronix(code_type: CodeType, big_endian: bool, data: &[u8], storage: Storage) -> Vec<u8> {
    let mut file = Builder::new();
    let count = Some((data.len() / code_type.bytes()) as u64);
    let data = file.dataset(numbers(code_type, big_endian), count, data, storage, &[]);
    let spacing =
        file.dataset(numbers(CodeType::F64, false), Some(1), &1e-8_f64.to_le_bytes(), Storage::Contiguous, &[]);
    let start =
        file.dataset(numbers(CodeType::F64, true), Some(1), &(-8.25e-6_f64).to_be_bytes(), Storage::Compact, &[]);
    let root = file.group(&[("Spacing", spacing), ("Data", data), ("StartTime", start)], &[]);
    file.finish(root)
}

const STORAGES: [Storage; 5] = [
    Storage::Contiguous,
    Storage::Chunked(4, false),
    Storage::Chunked(4, true),
    Storage::Chunked(100, true),
    Storage::Chunked(1, true),
];

#[test]
fn numbers_of_all_types_are_read_in_any_storage() {
    for code_type in CodeType::ALL {
        for (big_endian, storage) in
            [false, true].into_iter().flat_map(|order| STORAGES.map(|storage| (order, storage)))
        {
            // 0x41 in the highest byte: small floating numbers.
            let mut data: Vec<u8> = (0..11 * code_type.bytes() as u8).map(|i| i.wrapping_mul(37)).collect();
            data.chunks_exact_mut(code_type.bytes()).for_each(|code| code[code.len() - 1] = 0x41);
            let expected = code_type.decode(&data);
            if big_endian {
                code_type.swap_bytes(&mut data);
            }
            let bytes = tektronix(code_type, big_endian, &data, storage);
            assert!(Hdf5.recognises(&bytes));
            let record = read(&bytes).unwrap().remove(0);
            assert_eq!(values(&record, &bytes), expected, "{code_type:?}");
            assert_eq!((record.head.dt_s, record.t0_s), (Some(1e-8), Some(-8.25e-6)));
            assert_eq!((record.head.format, record.head.code_type), ("tek-h5", code_type));
        }
    }
}

#[test]
fn long_chunks_are_inflated_in_pieces() {
    let codes: Vec<i16> = (0..100_000_i32).map(|i| (i.wrapping_mul(48_271) >> 5) as i16).collect();
    let data: Vec<u8> = codes.iter().flat_map(|code| code.to_le_bytes()).collect();
    let bytes = tektronix(CodeType::I16, false, &data, Storage::Chunked(70_000, true));
    let record = read(&bytes).unwrap().remove(0);
    assert!(values(&record, &bytes).into_iter().eq(codes.iter().map(|&code| f64::from(code))));
    let middle = record.read(&mut Cursor::new(&bytes), 69_999..70_001).unwrap();
    assert_eq!(middle, data[2 * 69_999..2 * 70_001]);
}

#[test]
fn damaged_chunks_are_found_when_they_are_read() {
    let data: Vec<u8> = (0..2000_u32).flat_map(|i| (i * i).to_le_bytes()).collect();
    let bytes = tektronix(CodeType::I32, false, &data, Storage::Chunked(2000, true));
    let packed = bytes.windows(2).position(|window| window == [0x78, 0x9C]).unwrap();
    let mut damaged = bytes.clone();
    let errors = (packed + 20..packed + 400).map(|at| {
        damaged[at] ^= 0x10;
        let record = read(&damaged).unwrap().remove(0);
        let error = record.read(&mut Cursor::new(&damaged), 0..2000).unwrap_err().to_string();
        damaged[at] ^= 0x10;
        error
    });
    let errors: Vec<String> = errors.collect();
    // Where the stream stays whole, only its checksum reveals the damage.
    assert!(errors.iter().any(|error| error.contains("incorrect data check")), "{errors:?}");
}

/// Attributes of a waveform of two samples.
fn attributes() -> Vec<Message> {
    vec![
        enumerated("WaveformType", 1),
        attribute("NumPoints", &numbers(CodeType::I32, false), &2_i32.to_le_bytes()),
        attribute("NumSegments", &numbers(CodeType::I32, false), &0_i32.to_le_bytes()),
        number("XInc", 5e-11),
        number("XOrg", -1.9696e-7),
        text_attribute("XUnits", "Second"),
        number("YInc", 0.5),
        number("YOrg", 10.0),
        text_attribute("YUnits", "Volt"),
    ]
}

/// The same attributes, some of them replaced.
fn changed(changes: &[Message]) -> Vec<Message> {
    let name = |message: &Message| message.1[8..].split(|byte| *byte == 0).next().unwrap().to_vec();
    let mut attributes = attributes();
    for change in changes {
        attributes.retain(|message| name(message) != name(change));
        attributes.push(change.clone());
    }
    attributes
}

/// A data set of two codes, and its attributes.
type Set<'a> = (&'a str, [i16; 2], &'a [Message]);

/// A file like Keysight's with one waveform.
fn keysight(name: &str, attributes: &[Message], sets: &[Set]) -> Vec<u8> {
    let mut file = Builder::new();
    let set = |file: &mut Builder, (name, codes, attributes): &Set| {
        let data = codes.map(i16::to_le_bytes).concat();
        let at = file.dataset(numbers(CodeType::I16, false), Some(2), &data, Storage::Chunked(2, true), attributes);
        (name.to_string(), at)
    };
    let sets: Vec<_> = sets.iter().map(|sets| set(&mut file, sets)).collect();
    let sets: Vec<_> = sets.iter().map(|(name, at)| (name.as_str(), *at)).collect();
    let waveform = file.group(&sets, attributes);
    let waveforms = file.group(&[(name, waveform)], &[]);
    let (types, value) = texts(&[("Model", "DSOS804A"), ("Serial", "MY1"), ("Date", "19-Aug-2026 16:03:40")]);
    let frame = file.dataset(types, None, &value, Storage::Contiguous, &[]);
    let frame = file.group(&[("TheFrame", frame)], &[]);
    let root = file.group(&[("Waveforms", waveforms), ("Frame", frame)], &[]);
    file.finish(root)
}

#[test]
fn integers_have_a_scale_and_the_frame_a_date() {
    let bytes = keysight("Channel 4", &attributes(), &[("Channel 4Data", [-4, 6], &[])]);
    let record = read(&bytes).unwrap().remove(0);
    assert_eq!(values(&record, &bytes), [8.0, 13.0]);
    assert_eq!((record.segment, record.t0_s, record.trigger_s), (None, Some(-1.9696e-7), None));
    let head = &record.head;
    assert_eq!((head.format, head.kind), ("keysight-h5", Kind::Waveform));
    assert_eq!(head.scale, Some(Scale { gain: 0.5, offset: 10.0 }));
    assert_eq!((head.channel.as_deref(), head.unit.as_deref()), (Some("Channel 4"), Some("V")));
    assert_eq!(head.instrument.as_deref(), Some("DSOS804A"));
    assert_eq!(head.acquired_at.as_deref(), Some("2026-08-19T16:03:40"));
}

/// Eleven segments, sorted as text: Seg10 and Seg11 before Seg2.
fn segmented(interpolation: f64, own_origin: impl Fn(u32) -> Option<f64>) -> Vec<u8> {
    let names: Vec<String> = (1..=11).map(|k| format!("Channel 4 Seg{k}Data")).collect();
    let attributes_of = |k: u32| {
        let mut attributes = vec![number("SegmentedTimeTag", 3.0 + f64::from(k))];
        attributes.extend(own_origin(k).map(|own| number("SegmentedXOrg", own)));
        attributes
    };
    let own: Vec<_> = (1..=11).map(attributes_of).collect();
    let sets: Vec<Set> =
        names.iter().zip(&own).zip(0..).map(|((name, own), i)| (name.as_str(), [2 * i, 1], own.as_slice())).collect();
    keysight("Channel 4", &changed(&[number("NumSegments", 11.0), number("SavedInterpFactor", interpolation)]), &sets)
}

#[test]
fn segments_have_their_own_origins() {
    let own = |k: u32| -1.9696e-7 + 3e-12 * f64::from(k);
    let bytes = segmented(1.0, |k| Some(own(k)));
    let records = read(&bytes).unwrap();
    assert_eq!(records.len(), 11);
    for (record, k) in records.iter().zip(1..) {
        assert_eq!((record.segment, record.t0_s), (Some(k - 1), Some(own(k))));
        assert_eq!(record.trigger_s, Some(f64::from(k - 1)));
        assert_eq!(values(record, &bytes)[0], 10.0 + f64::from(k - 1));
    }
    // With interpolated points, an origin may differ by more of them.
    let far = segmented(8.0, |k| Some(-1.9696e-7 + 5e-11 * f64::from(k % 8)));
    assert!(read(&far).unwrap().iter().all(|record| record.t0_s.is_some()));
    // An origin far from that of the group is not used; without one there is none.
    assert!(read(&segmented(1.0, |_| Some(0.0))).unwrap().iter().all(|record| record.t0_s.is_none()));
    assert!(read(&segmented(1.0, |_| None)).unwrap().iter().all(|record| record.t0_s.is_none()));
}

#[test]
fn other_records_are_labelled() {
    let kind = |name: &str, changes: &[Message]| {
        let set = format!("{name}Data");
        read(&keysight(name, &changed(changes), &[(&set, [0, 1], &[])])).map(|records| records[0].head.kind)
    };
    assert_eq!(kind("Memory 1", &[enumerated("WaveformType", 2)]), Ok(Kind::Envelope));
    assert_eq!(kind("Memory 1", &[enumerated("WaveformType", 3)]), Ok(Kind::Average));
    assert_eq!(kind("Memory 1", &[enumerated("WaveformType", 6)]), Ok(Kind::Digital));
    assert_eq!(kind("Digital 3", &[]), Ok(Kind::Digital));
    assert_eq!(kind("Function 1", &[text_attribute("XUnits", "Hertz")]), Ok(Kind::Spectrum));
    assert!(kind("Memory 1", &[enumerated("WaveformType", 4)]).unwrap_err().contains("histogram"));
    assert!(kind("Memory 1", &[text_attribute("XUnits", "Volt")]).unwrap_err().contains("neither Second nor Hertz"));
}

#[test]
fn what_is_wrong_with_a_waveform_is_said() {
    for (change, says) in [
        (number("XInc", 0.0), "XInc = 0 and XOrg = -0.00000019696"),
        (number("XInc", f64::NAN), "attribute XInc is no finite number"),
        (text_attribute("XOrg", "soon"), "attribute XOrg is no finite number"),
        (number("YInc", 0.0), "without YInc and YOrg"),
        (number("NumPoints", 3.0), "NumPoints = 3, its data set has 2"),
        (number("NumSegments", 2.0), "NumSegments = 2, and 1 data sets from number 0"),
    ] {
        let error = read(&keysight("C", &changed(&[change]), &[("CData", [0, 1], &[])])).unwrap_err();
        assert!(error.contains(says), "{error}");
    }
    let segments =
        |count: f64, sets: &[Set]| read(&keysight("C", &changed(&[number("NumSegments", count)]), sets)).unwrap_err();
    assert!(segments(0.0, &[]).contains("and 0 data sets"));
    assert!(segments(2.0, &[("C Seg1Data", [0; 2], &[]), ("C Seg3Data", [0; 2], &[])]).contains("NumSegments = 2"));
    assert!(
        segments(0.0, &[("C Seg1Data", [0; 2], &[]), ("CData", [0; 2], &[])]).contains("2 data sets from number 0")
    );
}

#[test]
fn other_files_are_named() {
    let mut file = Builder::new();
    let set = file.dataset(numbers(CodeType::I8, false), Some(1), &[0], Storage::Contiguous, &[]);
    let root = file.group(&[("traces", set)], &[]);
    let bytes = file.finish(root);
    assert!(read(&bytes).unwrap_err().contains("finds no array of real numbers over an axis"));
    let with = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        read(&bytes).unwrap_err()
    };
    assert!(with(8, 2).contains("superblock version 2"));
    assert!(with(13, 4).contains("Size of Offsets 4"));
    assert!(with(24, 1).contains("Base Address 1"));
    assert!(read(&bytes[..bytes.len() - 1]).unwrap_err().contains("cut short: all up to the End of File Address"));
}

#[test]
fn parts_that_refer_to_themselves_are_refused() {
    let bytes = segmented(1.0, |_| None);
    let trees: Vec<usize> = (0..bytes.len() - 4).filter(|&at| &bytes[at..at + 4] == b"TREE").collect();
    let root = *trees.iter().find(|&&at| bytes[at + 5] == 1).unwrap();
    let mut cyclic = bytes.clone();
    cyclic[root + 32..root + 40].copy_from_slice(&(root as u64).to_le_bytes());
    assert!(read(&cyclic).unwrap_err().contains("were read before"));
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    let float = tektronix(CodeType::F32, false, &[0x41; 24], Storage::Chunked(4, true));
    hostile::cut_everywhere(&Hdf5, &float);
    hostile::change_anywhere(&Hdf5, &float, 4000);
    let two: [Set; 2] = [("C Seg1Data", [3, 4], &[]), ("C Seg2Data", [5, 6], &[])];
    let segments = keysight("C", &changed(&[number("NumSegments", 2.0)]), &two);
    hostile::cut_everywhere(&Hdf5, &segments);
    hostile::change_anywhere(&Hdf5, &segments, 4000);
}
