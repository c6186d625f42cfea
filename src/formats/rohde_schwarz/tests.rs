//! Recordings built here, whole and broken.

use std::fmt::Write;
use std::io::Cursor;
use std::path::Path;

use super::*;
use crate::Source;

/// A recording as its two files.
struct Built {
    properties: Vec<(&'static str, String)>,
    payload: Vec<u8>,
}

/// Codes of the raw recordings: settling, samples, settling.
const CODES: [i8; 5] = [99, 10, -20, 30, 88];

impl Built {
    fn new(format: &str, code: u32, rows: u32, leading: u32, samples: u32) -> Self {
        let mut properties: Vec<(&str, String)> = [
            ("SourceType", "eRS_SIGNAL_SOURCE_TYPE_SOURCE"),
            ("TraceType", "eRS_TRACE_TYPE_NORMAL"),
            ("BaseUnit", "eRS_UNIT_LEVEL_V"),
            ("XStart", "-2e-10"),
            ("XStop", "1e-10"),
            ("NofQuantisationLevels", "250"),
            ("VerticalDivisionCount", "10"),
            ("VerticalScale", "0.5"),
            ("VerticalOffset", "0.25"),
            ("VerticalPosition", "2"),
            ("Source", "eRS_SIGNAL_SOURCE_CH3_TR1"),
            ("MultiChannelExport", "eRS_ONOFF_OFF"),
            ("NumberOfAcquisitions", "1"),
            ("TimestampState", "eRS_ONOFF_OFF"),
            ("Timestamp", "2024:03:04 05:06 07,008.009.010 s"),
        ]
        .map(|(name, value)| (name, value.to_owned()))
        .into();
        properties.push(("SignalFormat", format!("eRS_SIGNAL_FORMAT_{format}")));
        let counts =
            [("RecordLength", samples), ("SignalHardwareRecordLength", rows), ("LeadingSettlingSamples", leading)];
        properties.extend(counts.map(|(name, count)| (name, count.to_string())));
        Self { properties, payload: [code.to_le_bytes(), rows.to_le_bytes()].concat() }
    }

    fn raw() -> Self {
        let mut built = Self::new("INT8BIT", 0, 5, 1, 3);
        built.payload.extend(CODES.map(i8::cast_unsigned));
        built
    }

    fn set(mut self, name: &'static str, value: &str) -> Self {
        self.properties.retain(|(property, _)| *property != name);
        self.properties.push((name, value.to_owned()));
        self
    }

    /// Two channels, of `I_0` and `I_2`.
    fn two_channels(self) -> Self {
        self.set("MultiChannelExport", "eRS_ONOFF_ON")
            .set("MultiChannelExportState", "eRS_ONOFF_ON|eRS_ONOFF_OFF|eRS_ONOFF_ON")
            .set("MultiChannelSource", "eRS_SIGNAL_SOURCE_CH1_TR1|eRS_SIGNAL_SOURCE_NONE|eRS_SIGNAL_SOURCE_CH3_TR2")
            .set("MultiChannelVerticalScale", "1|0|0.1")
            .set("MultiChannelVerticalOffset", "0|0|0.5")
            .set("MultiChannelVerticalPosition", "0|0|-1")
            .set("MultiChannelViewUnit", "eRS_UNIT_LEVEL_V|eRS_UNIT_NONE|eRS_UNIT_LEVEL_A")
    }

    fn xml(&self) -> Vec<u8> {
        let mut xml = "<?xml version=\"1.0\"?>\n<Database FWVersion=\"\">\n<Group Name=\"Attributes\">\n".to_owned();
        for (name, value) in &self.properties {
            let unit = if name.starts_with('X') { " UnitName=\"s\"" } else { "" };
            let value = if name.starts_with("MultiChannel") && *name != "MultiChannelExport" {
                let items = value.split('|').enumerate();
                items.fold(String::new(), |items, (i, item)| items + &format!("I_{i}=\"{item}\" "))
            } else {
                format!("Value=\"{value}\"")
            };
            writeln!(xml, "<Prop Avail=\"0\" Name=\"{name}\" {value}{unit}/>").unwrap();
        }
        (xml + "</Group>\n<PreviewImage ImageData=\"AAAA\"/>\n</Database>").into_bytes()
    }

    fn read(&self) -> Result<Vec<(Record, Vec<f64>)>, String> {
        let xml = self.xml();
        let length = xml.len() as u64;
        read([xml, self.payload.clone()].concat(), length)
    }
}

fn read(bytes: Vec<u8>, length: u64) -> Result<Vec<(Record, Vec<f64>)>, String> {
    let total = bytes.len() as u64;
    let mut source =
        Source::with_companion(Cursor::new(bytes), length, Path::new("a.bin")).map_err(|e| e.to_string())?;
    let records = RohdeSchwarz.records(&mut source).map_err(|error| error.to_string())?;
    assert!(records.len() as u64 * RECORD_BYTES <= 4 * total + (1 << 20));
    let values = |record: Record| {
        let codes = record.read(source.file(), 0..record.head.samples).expect("what is claimed lies within the files");
        let values = record.values(&codes);
        (record, values)
    };
    Ok(records.into_iter().map(values).collect())
}

fn near(values: &[f64], expected: &[f64]) -> bool {
    values.len() == expected.len() && values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12)
}

/// A head that was padded, or written twice, is told; the end of its last line is none.
#[test]
fn what_follows_the_xml_is_reported() {
    let built = Built::raw();
    let remarks = |xml: Vec<u8>| {
        let length = xml.len() as u64;
        let bytes = [xml, built.payload.clone()].concat();
        let mut source = Source::with_companion(Cursor::new(bytes), length, Path::new("a.bin")).unwrap();
        crate::contents(&mut source).unwrap().remarks
    };
    assert_eq!(remarks(built.xml()), []);
    assert_eq!(remarks([built.xml(), b"\r\n".to_vec()].concat()), []);
    for more in [vec![0; 3], vec![0; 4096], built.xml()] {
        let place = built.xml().len() as u64;
        let remarks = remarks([built.xml(), more].concat());
        assert!(remarks.len() == 1 && remarks[0].byte_offset == place, "{remarks:?}");
    }
}

#[test]
fn raw_codes_become_volts() {
    let records = Built::raw().read().unwrap();
    let (record, values) = &records[0];
    // 0.5 V * 10 / 250 a code, 0.25 V - 2 * 0.5 V at 0.
    assert!(near(values, &[-0.55, -1.15, -0.15]), "{values:?}");
    assert!((record.head.dt_s.unwrap() - 1e-10).abs() < 1e-22 && record.t0_s == Some(-2e-10));
    assert_eq!((record.segment, record.trigger_s, record.head.kind), (None, None, Kind::Waveform));
    assert_eq!((record.head.channel.as_deref(), record.head.unit.as_deref()), (Some("C3"), Some("V")));
    assert_eq!(record.head.acquired_at.as_deref(), Some("2024-03-04T05:06:07.008009010"));
    let mut words = Built::new("INT16BIT", 1, 4, 0, 3).set("TraceType", "eRS_TRACE_TYPE_AVERAGE");
    words.payload.extend([1000_i16, -2000, 3, 4].iter().flat_map(|code| code.to_le_bytes()));
    let (record, values) = words.read().unwrap().remove(0);
    assert!(near(&values, &[19.25, -40.75, -0.69]) && record.head.kind == Kind::Average, "{values:?}");
}

#[test]
fn channels_lie_side_by_side() {
    let mut built = Built::new("INT8BIT", 0, 4, 1, 3).two_channels();
    built.payload.extend([9_u8, 9, 1, 2, 3, 4, 5, 6]);
    let records = built.read().unwrap();
    assert!(near(&records[0].1, &[0.04, 0.12, 0.2]) && near(&records[1].1, &[0.608, 0.616, 0.624]), "{records:?}");
    let names: Vec<_> = records.iter().map(|(record, _)| record.head.channel.clone().unwrap()).collect();
    assert_eq!((names, records[1].0.head.unit.as_deref()), (vec!["C1".to_owned(), "CH3_TR2".to_owned()], Some("A")));
    assert!(built.set("MultiChannelExportState", "eRS_ONOFF_OFF").read().unwrap_err().contains("no channel on"));
}

/// XY rows of two channels.
fn xy(first_x: f64) -> Built {
    let mut built = Built::new("XYDOUBLEFLOAT", 6, 4, 1, 3).two_channels();
    for i in 0..4_u8 {
        let x = first_x + (f64::from(i) - 1.0) * 1e-10;
        built.payload.extend(x.to_le_bytes());
        built.payload.extend([f32::from(i), -f32::from(i)].iter().flat_map(|value| value.to_le_bytes()));
    }
    built
}

#[test]
fn x_of_xy_has_the_trigger_within_the_sample() {
    let records = xy(-1.7e-10).read().unwrap();
    assert!(records.iter().all(|(record, _)| record.t0_s == Some(-1.7e-10)));
    assert_eq!((&records[0].1[..], &records[1].1[..]), (&[1.0, 2.0, 3.0][..], &[-1.0, -2.0, -3.0][..]));
    assert!(xy(5e-10).read().unwrap_err().contains("XStart"));
    assert!(xy(f64::NAN).read().unwrap_err().contains("XStart"));
    let mut uneven = xy(-2e-10);
    uneven.payload[8 + 2 * 16..][..8].copy_from_slice(&(-1.3e-10_f64).to_le_bytes());
    assert!(uneven.read().unwrap_err().contains("even step"));
}

#[test]
fn a_history_has_segments_and_stamps() {
    let mut built = Built::new("FLOAT", 4, 3, 0, 3)
        .two_channels()
        .set("NumberOfAcquisitions", "3")
        .set("TimestampState", "eRS_ONOFF_ON");
    for acquisition in 0..3_u8 {
        built.payload.extend((-2e-3 + 1e-3 * f64::from(acquisition)).to_le_bytes());
        let values = (0..6_u8).map(|i| f32::from(10 * acquisition + i));
        built.payload.extend(values.flat_map(f32::to_le_bytes));
    }
    let records = built.read().unwrap();
    let places: Vec<_> =
        records.iter().map(|(record, _)| (record.head.channel.clone().unwrap(), record.segment.unwrap())).collect();
    let expected = [("C1", 0), ("C1", 1), ("C1", 2), ("CH3_TR2", 0), ("CH3_TR2", 1), ("CH3_TR2", 2)];
    assert_eq!(places, expected.map(|(name, segment)| (name.to_owned(), segment)));
    assert_eq!((&records[1].1[..], &records[5].1[..]), (&[10.0, 12.0, 14.0][..], &[21.0, 23.0, 25.0][..]));
    assert!((records[2].0.trigger_s.unwrap() - 2e-3).abs() < 1e-12);
    built.payload[8..16].copy_from_slice(&f64::INFINITY.to_le_bytes());
    assert!(built.read().unwrap_err().contains("time stamp of acquisition 0"));
}

#[test]
fn other_records_are_named() {
    let mut envelope = Built::new("FLOAT", 4, 2, 0, 2).set("TraceType", "eRS_TRACE_TYPE_ENVELOPE");
    envelope.payload.extend([1_f32, 2.0, 3.0, 4.0].iter().flat_map(|value| value.to_le_bytes()));
    let records = envelope.read().unwrap();
    assert!(records.iter().all(|(record, _)| record.head.kind == Kind::Envelope));
    assert_eq!(records[1].0.head.channel.as_deref(), Some("C3 maxima"));
    assert_eq!((&records[0].1[..], &records[1].1[..]), (&[1.0, 3.0][..], &[2.0, 4.0][..]));
    let peaks = Built::raw().set("DecimationMode", "eRS_DECIMATION_MODE_PEAK_DETECT");
    assert_eq!(peaks.read().unwrap()[0].0.head.kind, Kind::Envelope);
    let built = Built::raw();
    let spectrum = String::from_utf8(built.xml()).unwrap().replace("UnitName=\"s\"", "UnitName=\"Hz\"").into_bytes();
    let length = spectrum.len() as u64;
    let records = read([spectrum, built.payload].concat(), length).unwrap();
    assert_eq!(records[0].0.head.kind, Kind::Spectrum);
}

#[test]
fn contradictions_are_refused_in_words() {
    for (name, value, says) in [
        ("SourceType", "eRS_SIGNAL_SOURCE_TYPE_DIGITAL", "SourceType = eRS_SIGNAL_SOURCE_TYPE_DIGITAL"),
        ("SignalFormat", "eRS_SIGNAL_FORMAT_FLOAT", "not of one recording"),
        ("XStop", "-2e-10", "give no step"),
        ("XStop", "nan", "XStop = \"nan\""),
        ("SignalResolution", "2e-10", "SignalResolution"),
        ("SignalRecordLength", "4", "SignalRecordLength"),
        ("XAxisMode", "eRS_LINLOG_LOG", "XAxisMode"),
        ("RecordLength", "5", "does not fit"),
        ("RecordLength", "0", "does not fit"),
        ("RecordLength", "3.5", "no count"),
        ("LeadingSettlingSamples", "4294967295", "does not fit"),
        ("SignalHardwareRecordLength", "6", "not of one recording"),
        ("NumberOfAcquisitions", "2", "need 18 bytes"),
        ("NumberOfAcquisitions", "4294967295", "copy it from the instrument again"),
        ("InterleavedTraceCount", "3", "InterleavedTraceCount = 3"),
        ("NofQuantisationLevels", "0", "no scale"),
        ("VerticalScale", "0", "no scale"),
        ("VerticalScale", "inf", "VerticalScale = \"inf\""),
    ] {
        let error = Built::raw().set(name, value).read().unwrap_err();
        assert!(error.contains(says), "{name} = {value}: {error}");
    }
    for name in ["XStart", "RecordLength", "LeadingSettlingSamples", "VerticalOffset", "SignalFormat", "Source"] {
        let mut built = Built::raw();
        built.properties.retain(|(property, _)| *property != name);
        assert!(built.read().unwrap_err().contains(&format!("no {name}")));
    }
    let mut twice = Built::raw();
    twice.properties.push(("XStart", "0".to_owned()));
    assert!(twice.read().unwrap_err().contains("twice"));
    let mut code = Built::raw();
    code.payload[0] = 2;
    assert!(code.read().unwrap_err().contains("type 2"));
    let deep = [b"<Database>".repeat(40), b"</Database>".repeat(40)].concat();
    assert!(read([&deep[..], &[0; 13]].concat(), deep.len() as u64).unwrap_err().contains("nested"));
}

#[test]
fn either_file_alone_says_what_is_missing() {
    let built = Built::raw();
    let xml = built.xml();
    let length = xml.len() as u64;
    assert!(read(xml, length).unwrap_err().contains(".Wfm.bin; copy it next to"));
    assert!(read(built.payload.clone(), built.payload.len() as u64).unwrap_err().contains("give NAME.bin"));
}

#[test]
fn short_histories_do_not_fill_memory() {
    let mut built = Built::new("INT8BIT", 0, 1, 0, 1).set("NumberOfAcquisitions", "100000");
    built.payload.resize(100_008, 0);
    assert!(built.read().unwrap_err().contains("too short for records"));
}

#[test]
fn every_cut_is_refused() {
    let built = xy(-2e-10);
    let xml = built.xml();
    for length in 0..xml.len() {
        let bytes = [&xml[..length], &built.payload].concat();
        assert!(read(bytes, length as u64).is_err(), "XML of {length} bytes");
    }
    for length in 0..built.payload.len() {
        let bytes = [&xml, &built.payload[..length]].concat();
        assert!(read(bytes, xml.len() as u64).is_err(), "samples of {length} bytes");
    }
}

#[test]
fn no_mutation_panics() {
    let mut history = Built::raw().set("NumberOfAcquisitions", "2");
    history.payload.extend(CODES.map(i8::cast_unsigned));
    let seeds = [xy(-2e-10), history];
    let mut state = 7_u32;
    let mut next = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let mut whole = 0;
    for round in 0..6000 {
        let built = &seeds[round % 2];
        let (mut xml, mut payload) = (built.xml(), built.payload.clone());
        for _ in 0..=next(3) {
            let file = if next(4) == 0 { &mut payload } else { &mut xml };
            let at = next(file.len());
            match next(3) {
                0 => file[at] ^= 1 << next(8),
                1 => file[at] = b"0123456789e-\"<>/"[next(16)],
                _ => drop(file.drain(at..(at + next(4)).min(file.len()))),
            }
        }
        let length = xml.len() as u64;
        whole += u32::from(read([xml, payload].concat(), length).is_ok());
    }
    assert!(whole > 100, "{whole} mutations leave the recording whole");
}
