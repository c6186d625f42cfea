use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, read, refusal, source, surplus_is_reported};
use crate::waveform::Scale;

/// A value of a property or of raw data, as bytes of either order.
#[derive(Clone)]
enum Field {
    U32(u32),
    U64(u64),
    F64(f64),
    I16(i16),
    Text(String),
}

/// Fields of a segment.
struct Built {
    big_endian: bool,
    bytes: Vec<u8>,
}

impl Built {
    fn put(&mut self, field: &Field) {
        let mut bytes = match field {
            Field::U32(number) => number.to_le_bytes().to_vec(),
            Field::U64(number) => number.to_le_bytes().to_vec(),
            Field::F64(number) => number.to_le_bytes().to_vec(),
            Field::I16(number) => number.to_le_bytes().to_vec(),
            Field::Text(text) => {
                self.put(&Field::U32(text.len() as u32));
                return self.bytes.extend(text.bytes());
            }
        };
        if self.big_endian {
            bytes.reverse();
        }
        self.bytes.extend(bytes);
    }
}

/// An object: path, fields of its raw data index, properties with their types.
type Object = (&'static str, Vec<Field>, Vec<(&'static str, u32, Field)>);

/// A raw data index of so many values of a type.
fn index(kind: u32, values: u64) -> Vec<Field> {
    vec![Field::U32(20), Field::U32(kind), Field::U32(1), Field::U64(values)]
}

fn segment(flags: u32, objects: &[Object], raw: &[Field]) -> Vec<u8> {
    let big_endian = flags & BIG_ENDIAN != 0;
    let mut meta = Built { big_endian, bytes: Vec::new() };
    if flags & META != 0 {
        meta.put(&Field::U32(objects.len() as u32));
    }
    for (path, index, properties) in objects {
        meta.put(&Field::Text((*path).to_owned()));
        index.iter().for_each(|field| meta.put(field));
        meta.put(&Field::U32(properties.len() as u32));
        for (name, kind, value) in properties {
            meta.put(&Field::Text((*name).to_owned()));
            meta.put(&Field::U32(*kind));
            meta.put(value);
        }
    }
    let mut data = Built { big_endian, bytes: Vec::new() };
    raw.iter().for_each(|field| data.put(field));
    let mut built = Built { big_endian, bytes: b"TDSm".to_vec() };
    built.bytes.extend(flags.to_le_bytes());
    built.put(&Field::U32(4713));
    built.put(&Field::U64((meta.bytes.len() + data.bytes.len()) as u64));
    built.put(&Field::U64(meta.bytes.len() as u64));
    [built.bytes, meta.bytes, data.bytes].concat()
}

fn text(text: &str) -> Field {
    Field::Text(text.to_owned())
}

fn codes(codes: &[i16]) -> Vec<Field> {
    codes.iter().map(|code| Field::I16(*code)).collect()
}

/// Properties of a channel of 16 bit codes: 500 ps a sample from -1 ns on, 2 mV a code.
fn waveform(samples: u32) -> Vec<(&'static str, u32, Field)> {
    vec![
        ("wf_increment", 10, Field::F64(500e-12)),
        ("wf_start_offset", 10, Field::F64(-1e-9)),
        ("wf_samples", 3, Field::U32(samples)),
        ("unit_string", 0x20, text("mV")),
        ("NI_Number_Of_Scales", 7, Field::U32(2)),
        ("NI_Scale[0]_Scale_Type", 0x20, text("Polynomial")),
        ("NI_Scale[0]_Polynomial_Coefficients[0]", 10, Field::F64(3.0)),
        ("NI_Scale[0]_Polynomial_Coefficients[1]", 10, Field::F64(4.0)),
        ("NI_Scale[1]_Scale_Type", 0x20, text("Linear")),
        ("NI_Scale[1]_Linear_Slope", 10, Field::F64(0.5)),
        ("NI_Scale[1]_Linear_Y_Intercept", 10, Field::F64(1.0)),
        ("NI_Scale[1]_Linear_Input_Source", 7, Field::U32(0)),
    ]
}

const WHOLE: u32 = META | NEW_LIST | RAW;

/// Two channels of waveforms of three values; the second segment repeats the objects, and has two chunks.
fn shots(flags: u32) -> Vec<u8> {
    let objects = [
        ("/", vec![Field::U32(NO_DATA)], vec![("name", 0x20, text("scope"))]),
        ("/'g'", vec![Field::U32(NO_DATA)], vec![]),
        ("/'g'/'it''s A'", index(2, 3), waveform(3)),
        ("/'g'/'B'", index(2, 3), vec![]),
    ];
    let first = segment(WHOLE | flags, &objects, &codes(&[1, 2, 3, 11, 12, 13]));
    let more = codes(&[4, 5, 6, 14, 15, 16, 7, 8, 9, 17, 18, 19]);
    [first, segment(RAW | flags, &[], &more)].concat()
}

const NO_DATA: u32 = u32::MAX;

fn values(bytes: &[u8]) -> Vec<(String, Vec<f64>)> {
    decode(&Tdms, bytes)
        .into_iter()
        .map(|(record, values)| (record.head.channel.clone().unwrap_or_default(), values))
        .collect()
}

fn problems(bytes: &[u8]) -> Vec<String> {
    let contents = crate::contents(&mut source(bytes)).unwrap();
    contents.remarks.into_iter().map(|remark| remark.problem).collect()
}

#[test]
fn chunks_of_a_channel_are_waveforms() {
    for order in [0, BIG_ENDIAN] {
        let bytes = shots(order);
        assert!(Tdms.recognises(&bytes));
        let records = decode(&Tdms, &bytes);
        let (record, values) = &records[2];
        assert_eq!((record.head.channel.as_deref(), record.segment), (Some("it's A"), Some(2)));
        // (0.5 (4 x + 3) + 1) mV
        let scale = record.head.scale.unwrap();
        assert!((scale.gain - 2e-3).abs() < 1e-18 && (scale.offset - 2.5e-3).abs() < 1e-18, "{scale:?}");
        assert!(values.iter().zip([16.5e-3, 18.5e-3, 20.5e-3]).all(|(a, b)| (a - b).abs() < 1e-12), "{values:?}");
        assert_eq!((record.head.dt_s, record.t0_s), (Some(500e-12), Some(-1e-9)));
        assert_eq!((record.head.unit.as_deref(), record.head.rails), (Some("V"), Some((-32768.0, 32767.0))));
        assert_eq!(records.len(), 6);
        assert_eq!((&records[3].1[..], &records[5].1[..]), (&[11.0, 12.0, 13.0][..], &[17.0, 18.0, 19.0][..]));
        assert_eq!((records[5].0.head.dt_s, records[5].0.t0_s, records[5].0.head.scale), (None, None, None));
        let problems = problems(&bytes);
        assert!(problems.len() == 1 && problems[0].contains("pieces of 3 values without wf_samples"), "{problems:?}");
    }
}

#[test]
fn interleaved_channels_are_separated() {
    let objects = [("/'g'/'a'", index(2, 2), vec![]), ("/'h'/'b'", index(10, 2), vec![])];
    let row = |a: i16, b: f64| [Field::I16(a), Field::F64(b)];
    let raw = [row(1, 0.5), row(2, 0.25), row(3, 8.0), row(4, -1.0)].concat();
    let bytes = segment(WHOLE | INTERLEAVED, &objects, &raw);
    let expected =
        [("g/a", vec![1.0, 2.0]), ("g/a", vec![3.0, 4.0]), ("h/b", vec![0.5, 0.25]), ("h/b", vec![8.0, -1.0])];
    assert_eq!(values(&bytes), expected.map(|(name, values)| (name.to_owned(), values)));
}

/// The driver's logging writes a number of samples of 1 for a recording without end.
#[test]
fn a_channel_may_lie_in_several_places() {
    for order in [0, BIG_ENDIAN] {
        let one = vec![("wf_samples", 3, Field::U32(1))];
        let objects = [("/'g'/'a'", index(2, 2), one), ("/'g'/'b'", index(2, 1), vec![])];
        let first = segment(WHOLE | order, &objects, &codes(&[1, 2, 10, 3, 4, 11]));
        let other = [("/'g'/'a'", index(2, 3), vec![]), ("/'g'/'b'", vec![Field::U32(NO_DATA)], vec![])];
        let second = segment(META | RAW | order, &other, &codes(&[5, 6, 7]));
        let again = [("/'g'/'b'", vec![Field::U32(0)], vec![])];
        let third = segment(META | NEW_LIST | RAW | order, &again, &codes(&[12]));
        let bytes = [first, second, third].concat();
        let expected = [("a", vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]), ("b", vec![10.0, 11.0, 12.0])];
        assert_eq!(values(&bytes), expected.map(|(name, values)| (name.to_owned(), values)));
        assert_eq!(problems(&bytes), [""; 0]);
        let records = decode(&Tdms, &bytes);
        let mut file = source(&bytes);
        assert_eq!(records[0].0.read(file.file(), 1..4).unwrap(), [2, 0, 3, 0, 4, 0]);
        surplus_is_reported(&Tdms, &bytes);
        change_anywhere(&Tdms, &bytes, 3000);
    }
}

#[test]
fn what_is_no_waveform_of_numbers_is_skipped_with_a_remark() {
    let names = vec![Field::U32(28), Field::U32(0x20), Field::U32(1), Field::U64(1), Field::U64(6)];
    let objects = [
        ("/'g'/'names'", names, vec![]),
        ("/'g'/'long'", index(4, 1), vec![]),
        ("/'g'/'lines'", index(2, 2), vec![("NI_LineNames", 0x20, text("port0"))]),
        ("/'g'/'hot'", index(2, 1), vec![("NI_Scale[0]_Scale_Type", 0x20, text("Table"))]),
        ("/'g'/'f'", index(2, 3), vec![("wf_xunit_string", 0x20, text("Hz")), ("wf_samples", 3, Field::U32(2))]),
    ];
    let raw = [vec![Field::U32(2), Field::I16(0x6261), Field::U64(7)], codes(&[0, 1, 9, 4, 5, 6])].concat();
    let bytes = segment(WHOLE, &objects, &raw);
    let records = decode(&Tdms, &bytes);
    let kinds: Vec<_> = records.iter().map(|(record, _)| record.head.kind).collect();
    assert_eq!(kinds, [Kind::Digital, Kind::Waveform, Kind::Spectrum]);
    assert_eq!((&records[1].1[..], &records[2].1[..]), (&[9.0][..], &[4.0, 5.0, 6.0][..]));
    let problems = problems(&bytes);
    for (problem, says) in problems.iter().zip(["are text; save it", "scale of type Table", "not a multiple"]) {
        assert!(problem.contains(says), "{problem}");
    }
    assert!(problems.len() == 3 && problems[0].contains("1 more"), "{problems:?}");
    assert!(refusal(&Tdms, &segment(WHOLE, &objects[1..2], &[Field::U64(7)])).contains("64 bit integers"));
}

#[test]
fn scales_of_a_group_are_those_of_its_channels() {
    let scale = vec![
        ("NI_Scale[0]_Scale_Type", 0x20, text("Linear")),
        ("NI_Scale[0]_Linear_Slope", 10, Field::F64(0.25)),
        ("NI_Scale[0]_Linear_Y_Intercept", 10, Field::F64(-1.0)),
    ];
    let objects = [("/'g'", vec![Field::U32(NO_DATA)], scale), ("/'g'/'a'", index(2, 2), vec![])];
    let records = decode(&Tdms, &segment(WHOLE, &objects, &codes(&[4, 8])));
    assert_eq!(records[0].0.head.scale, Some(Scale { gain: 0.25, offset: -1.0 }));
    assert_eq!(records[0].1, [0.0, 1.0]);
}

#[test]
fn what_is_wrong_is_said() {
    let bytes = shots(0);
    let changed = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        refusal(&Tdms, &bytes)
    };
    assert!(changed(8, 0).contains("byte 8: version 4608"));
    assert!(changed(4, (WHOLE | DAQMX) as u8).contains("DAQmx"));
    assert!(changed(28, 200).contains("end within a field"));
    let daqmx = [("/'g'/'a'", vec![Field::U32(0x1269)], vec![])];
    assert!(refusal(&Tdms, &segment(WHOLE, &daqmx, &[])).contains("DAQmx"));
    assert!(refusal(&Tdms, &segment(RAW, &[], &codes(&[1]))).contains("no channel has values"));
    let before = [("/'g'/'a'", vec![Field::U32(0)], vec![])];
    assert!(refusal(&Tdms, &segment(WHOLE, &before, &[])).contains("had none before"));
    let negative = [("/'g'/'a'", index(2, 1), vec![("wf_increment", 10, Field::F64(-1.0))])];
    assert!(refusal(&Tdms, &segment(WHOLE, &negative, &codes(&[1]))).contains("wf_increment = -1"));
    // Its end lies beyond all numbers. Found by fuzzing.
    let endless = [("/'g'/'a'", index(1, u64::MAX - 8), vec![])];
    assert!(refusal(&Tdms, &segment(WHOLE, &endless, &codes(&[1]))).contains("no channel has values"));
    let uneven = [("/'g'/'a'", index(2, 1), vec![]), ("/'g'/'b'", index(2, 2), vec![])];
    assert!(refusal(&Tdms, &segment(WHOLE | INTERLEAVED, &uneven, &codes(&[1, 2, 3]))).contains("unequal length"));
}

/// A writer that is stopped leaves the length of its last segment open.
#[test]
fn whole_chunks_before_a_cut_are_read() {
    let mut bytes = shots(0);
    let first = bytes.len() - 28 - 24;
    bytes[first + 12..first + 20].fill(0xFF);
    assert_eq!(read(&Tdms, &bytes).unwrap().len(), 6);
    for (length, waveforms) in [(bytes.len() - 1, 4), (first + 28 + 3, 2), (first + 9, 2)] {
        let contents = crate::contents(&mut source(&bytes[..length])).unwrap();
        assert_eq!(contents.records.len(), waveforms);
        assert_eq!(contents.remarks.iter().filter(|remark| remark.is_cut).count(), 1, "{:?}", contents.remarks);
    }
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    for flags in [0, INTERLEAVED, BIG_ENDIAN] {
        surplus_is_reported(&Tdms, &shots(flags));
        change_anywhere(&Tdms, &shots(flags), 5000);
        let first = segment(WHOLE | flags, &[("/'g'/'a'", index(2, 3), waveform(3))], &codes(&[1, 2, 3, 4, 5, 6]));
        cut_everywhere(&Tdms, &[first, segment(RAW | flags, &[], &codes(&[7, 8, 9]))].concat());
    }
}
