use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal};
use crate::{READERS, lecroy_trc::LecroyTrc};

/// A trace of words 1000, -2000, 3000, -4000, in two segments if `sequence`.
fn file(big_endian: bool, wide: bool, sequence: bool) -> Vec<u8> {
    let order = |mut bytes: Vec<u8>| {
        if big_endian {
            bytes.reverse();
        }
        bytes
    };
    let mut bytes = vec![0; DESCRIPTOR as usize];
    let mut put = |at: usize, field: Vec<u8>| bytes[at..at + field.len()].copy_from_slice(&field);
    let codes: [i16; 4] = if wide { [1000, -2000, 3000, -4000] } else { [10, -20, 30, -40] };
    let data: Vec<u8> = if wide {
        codes.iter().flat_map(|code| order(code.to_le_bytes().into())).collect()
    } else {
        codes.iter().map(|code| *code as u8).collect()
    };
    put(0, b"WAVEDESC".to_vec());
    put(16, TEMPLATE.to_vec());
    put(32, order(i16::from(wide).to_le_bytes().into()));
    put(34, order(i16::from(!big_endian).to_le_bytes().into()));
    let longs = [(36, 320), (44, if sequence { 32 } else { 0 }), (48, data.len() as i32), (92, 4), (116, 1)];
    for (at, value) in longs.into_iter().chain([(108, if sequence { 2 } else { 1 })]) {
        put(at, order(i32::to_le_bytes(value).into()));
    }
    put(56, b"LeCroy 7200 DSO".to_vec());
    for (at, value) in [(120, 0.5_f32), (124, 0.25), (134, 1e-9), (290, 2.5)] {
        put(at, order(value.to_le_bytes().into()));
    }
    for (at, value) in [(128, 32512), (130, -32768), (262, 1993), (294, 2), (296, 3)] {
        put(at, order(i16::to_le_bytes(value).into()));
    }
    put(138, order((-3.25e-9_f64).to_le_bytes().into()));
    put(154, b"V".to_vec());
    put(202, b"S".to_vec());
    put(250, order(2.5_f64.to_le_bytes().into()));
    put(258, vec![25, 16, 8, 1]);
    for value in [0.0, -3.25e-9, 1e-3, -3.75e-9_f64].into_iter().take(if sequence { 4 } else { 0 }) {
        bytes.extend(order(value.to_le_bytes().into()));
    }
    bytes.extend(data);
    bytes
}

#[test]
fn volts_times_and_names_are_read_in_both_orders_and_widths() {
    for (big_endian, wide) in [(false, true), (true, true), (false, false), (true, false)] {
        let records = decode(&Lecroy10, &file(big_endian, wide, false));
        let (record, volts) = &records[0];
        let expected = if wide { [499.75, -1000.25, 1499.75, -2000.25] } else { [4.75, -10.25, 14.75, -20.25] };
        assert_eq!((records.len(), volts.as_slice()), (1, expected.as_slice()));
        assert_eq!((record.t0_s, record.head.dt_s), (Some(-3.25e-9), Some(f64::from(1e-9_f32))));
        assert_eq!(record.head.channel.as_deref(), Some("B3"));
        assert_eq!(record.head.rails, Some(if wide { (-32768.0, 32512.0) } else { (-128.0, 127.0) }));
        assert_eq!(record.head.acquired_at.as_deref(), Some("1993-01-08T16:25:02.500000000"));
    }
}

#[test]
fn each_segment_has_its_own_trigger() {
    for big_endian in [false, true] {
        let records = decode(&Lecroy10, &file(big_endian, true, true));
        let times: Vec<_> = records.iter().map(|(record, _)| (record.segment, record.trigger_s, record.t0_s)).collect();
        assert_eq!(times, [(Some(0), Some(0.0), Some(-3.25e-9)), (Some(1), Some(1e-3), Some(-3.75e-9))]);
        assert_eq!(records[1].1, [1499.75, -2000.25]);
    }
}

#[test]
fn the_two_templates_have_one_reader_each() {
    let mut other = file(false, true, false);
    assert_eq!(READERS.iter().filter(|reader| reader.recognises(&other)).count(), 1);
    assert!(Lecroy10.recognises(&other) && !LecroyTrc.recognises(&other));
    other[16..26].copy_from_slice(b"LECROY_9_9");
    other.resize(400, 0);
    assert!(!Lecroy10.recognises(&other) && LecroyTrc.recognises(&other));
    assert!(refusal(&LecroyTrc, &other).contains("LECROY_9_9"));
}

#[test]
fn kinds_are_recognised_and_others_refused() {
    let with = |at: usize, bytes: &[u8]| {
        let mut file = file(false, true, false);
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    };
    for (at, bytes, kind) in [
        (116, &[100_u8][..], Kind::Average),
        (272, &[8], Kind::Average),
        (270, &[6], Kind::Envelope),
        (202, b"Hz", Kind::Spectrum),
    ] {
        assert_eq!(decode(&Lecroy10, &with(at, bytes))[0].0.head.kind, kind);
    }
    for (at, bytes, says) in [
        (32, &[2_u8][..], "COMM_TYPE 2"),
        (34, &[2], "COMM_ORDER 0x02"),
        (36, &[63, 1], "WAVE_DESCRIPTOR = 319"),
        (40, &[251, 255, 255, 255], "USER_TEXT = -5"),
        (52, &[4], "second data array"),
        (92, &[255, 255, 255, 127], "WAVE_ARRAY_COUNT = 2147483647"),
        (108, &[3], "SUBARRAY_COUNT = 3"),
        (108, &[2], "TRIGTIME_ARRAY = 0"),
        (120, &[0; 4], "VERTICAL_GAIN = 0"),
        (120, &[0, 0, 192, 127], "VERTICAL_GAIN = NaN"),
        (134, &[0; 4], "HORIZ_INTERVAL = 0"),
        (138, &[255; 8], "HORIZ_OFFSET = NaN"),
        (202, b"m", "over \"m\""),
        (270, &[1], "RECORD_TYPE"),
        (270, &[12], "not corrected"),
        (48, &[255, 255, 255, 127], "cut short"),
    ] {
        let error = refusal(&Lecroy10, &with(at, bytes));
        assert!(error.contains(says), "{error}");
    }
}

#[test]
fn hostile_files_are_survived() {
    for file in [file(false, true, true), file(true, false, false)] {
        cut_everywhere(&Lecroy10, &file);
        assert!(refusal(&Lecroy10, &file[..file.len() - 1]).contains("cut short"));
        change_anywhere(&Lecroy10, &file, 5000);
    }
}
