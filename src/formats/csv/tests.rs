//! Texts of all dialects, whole and broken.

use std::io::Cursor;
use std::path::Path;

use super::*;
use crate::Source;

fn read(text: impl AsRef<[u8]>) -> Result<Vec<(Record, Vec<f64>)>, String> {
    let bytes = text.as_ref().to_vec();
    let length = bytes.len();
    let mut source = Source::new(Cursor::new(bytes), Path::new("a.csv")).map_err(|error| error.to_string())?;
    let records = Csv.records(&mut source).map_err(|error| error.to_string())?;
    let codes: usize = records.iter().map(|record| record.code_bytes() + 256).sum();
    assert!(codes <= 4 * length + (1 << 18), "{codes} bytes of records from {length} bytes of text");
    let values = |record: Record| {
        let codes = record.read(source.file(), 0..record.head.samples).expect("decoded records are in memory");
        let values = record.values(&codes);
        (record, values)
    };
    Ok(records.into_iter().map(values).collect())
}

fn one(text: impl AsRef<[u8]>) -> (Record, Vec<f64>) {
    let mut records = read(text).unwrap();
    assert_eq!(records.len(), 1);
    records.remove(0)
}

fn near(value: Option<f64>, expected: f64) -> bool {
    value.is_some_and(|value| (value - expected).abs() <= 1e-12 * expected.abs())
}

/// A table that is appended to a table has a line of names between rows; padding is no text.
#[test]
fn what_is_appended_is_refused() {
    for text in [LECROY, TEK, "time_ns,ch1\n0,1\n0.5,2\n1,3\n"] {
        crate::hostile::appended_is_reported(&Csv, text.as_bytes());
    }
}

const LECROY: &str = "LECROYWR104MXi-A,52137,Waveform\nSegments,2,SegmentSize,3\nSegment,TrigTime,TimeSinceSegment1\n\
    #1,03-May-2017 11:41:40,0\n#2,03-May-2017 11:41:41,1.25\nTime,Ampl\n-1.01e-9,1\n0,2\n1.01e-9,3\n-1.51e-9,4\n-0.5e-9,5\n0.51e-9,6\n";

const TEK: &str = "Model,MSO64\nLabel,\nWaveform Type,ANALOG\nHorizontal Units,s\nSample Interval,4.0e-11\nRecord Length,4\nZero Index,1.25\n\
    Vertical Units,V\n\nLabels,\nTIME,REF7\n-5.00e-11,1\n-1.00e-11,2\n3.00e-11,3\n7.00e-11,4\n";

const TEK_LOGIC: &str = "Model,MDO3014\nFirmware Version,1.20\n\nWaveform Type,ANALOG,,Waveform Type,DIGITAL,,\nPoint Format,Y,,Point Format,Y,,\n\
    Horizontal Units,s,,Horizontal Units,s,,\nSample Interval,4e-09,,Sample Interval,4e-09,,\nRecord Length,3,,Record Length,3,,\n\
    Vertical Units,A,,Vertical Units,V,V,\n,,,,,\nLabel,PCLK,,Label,FV,LV\nTIME,CH1,,TIME,D1,D0\n-4.720000e-07,0.68,,-4.720000e-07,0,1\n\
    -4.680000e-07,0.28,,-4.680000e-07,1,1\n-4.640000e-07,0.2,,-4.640000e-07,0,0\n\n";

const KEYSIGHT: &str = "x-axis,1,2\nsecond,Volt,Ampere\n-1.0E-06,+1.5E-03,2\n+0.0E-06,-2.5E-03,3\n+1.0E-06,,\n";

const RIGOL: &str =
    "X,CH1,CH4,Start,Increment,\nSequence,Volt,Volt,-2.5e-06,1.0e-08,\n2,0.5,1,\n3,0.25,2,\n4,0.125,3, \n";

const RIGOL_TIMES: &str = ",CH1,CH2\nSecond,Volt,Volt\n-1e-9,1,2, \n0,3,4, \n1e-9,5,6, \n";

const ASCII: &str = "\"Record Length\"\t3\t\"Points\"\t-2e-008\t1.5\n\"Sample Interval\"\t5e-011\ts\t-1e-008\t2.5\n\
    \"Trigger Point\"\t400\t\"Samples\"\t0\t3.5\n\"Trigger Time\"\t0.25\ts\t\t\n\"Horizontal Offset\"\t-2e-008\ts\t\t\n";

const PLAIN: &str = "# taken by hand\ntime (ns),ch1 [mV],ch2\n-1,500,1\n0,250,2\n1,125,3\n";

#[test]
fn segments_of_a_lecroy_are_records() {
    let records = read(LECROY).unwrap();
    let (second, values) = &records[1];
    assert_eq!((records.len(), second.segment, second.trigger_s), (2, Some(1), Some(1.25)));
    assert_eq!((&records[0].1[..], &values[..]), (&[1.0, 2.0, 3.0][..], &[4.0, 5.0, 6.0][..]));
    assert!(near(second.head.dt_s, 1.01e-9) && second.t0_s == Some(-1.51e-9), "{second:?}");
    assert_eq!((second.head.format, second.head.instrument.as_deref()), ("lecroy-csv", Some("LECROYWR104MXi-A")));
    assert_eq!(second.head.acquired_at.as_deref(), Some("2017-05-03T11:41:40"));
    // The same with decimal commas, after a model with meaningless bytes.
    let semicolons = LECROY.replace(',', ";").replace('.', ",");
    let with_bytes = [b"LECROYX\xa9\xcb".as_slice(), &semicolons.as_bytes()["LECROYWR104MXi-A".len()..]].concat();
    assert_eq!(read(with_bytes).unwrap()[1].0.trigger_s, Some(1.25));
    for (from, to, says) in [
        ("Segments,2", "Segments,3", "line 6: does not begin with #3"),
        ("Segments,2", "Segments,99999999", "more than the file can hold"),
        ("SegmentSize,3", "SegmentSize,4", "SegmentSize = 4 in 2 segments, but the file has 6 rows"),
        ("SegmentSize,3", "SegmentSize,0", "no count under SegmentSize"),
        ("41,1.25", "41,soon", "line 5: has no TimeSinceSegment1"),
        ("Time,Ampl\n", "", "single line of names"),
        ("-1.51e-9", "9.99e-9", "do not increase"),
        ("-1.51e-9,4\n-0.5e-9,5\n0.51e-9", "2.02e-9,4\n3.03e-9,5\n4.04e-9", "segments one by one"),
        ("-0.5e-9,5", "-0.2e-9,5", "line 11: time"),
    ] {
        let error = read(LECROY.replace(from, to)).unwrap_err();
        assert!(error.contains(says), "{to}: {error}");
    }
}

#[test]
fn the_head_of_a_tektronix_has_the_time_base() {
    let (record, values) = one(TEK);
    assert_eq!((values, record.head.format), (vec![1.0, 2.0, 3.0, 4.0], "tek-csv"));
    assert!(record.head.dt_s == Some(4e-11) && near(record.t0_s, -5e-11), "{record:?}");
    assert_eq!((record.head.channel.as_deref(), record.head.instrument.as_deref()), (Some("REF7"), Some("MSO64")));
    let frames = TEK.replace("Record Length,4\nZero Index,1.25", "Record Length,2\nFastFrame Count,2");
    let frames = read(frames.replace("3.00e-11", "-4.00e-11").replace("7.00e-11", "0")).unwrap();
    assert_eq!((frames[1].0.segment, &frames[1].1[..]), (Some(1), &[3.0, 4.0][..]));
    assert!(near(frames[1].0.t0_s, -4e-11));
    for (from, to, says) in [
        ("Record Length,4", "Record Length,5", "copy it from the instrument again"),
        ("Record Length,4", "Record Length,0", "line 6: Record Length = 0"),
        ("Record Length,4", "Record Length,4\nFastFrame Count,1e14", "more than the file can hold"),
        ("4.0e-11", "0", "line 5: Sample Interval is no step"),
        ("4.0e-11", "nan", "line 5: Sample Interval"),
        ("Horizontal Units,s", "Horizontal Units,m", "neither s nor Hz"),
        ("3.00e-11", "4.20e-11", "line 14: time"),
        ("1.25", "9.25", "line 12: time"),
    ] {
        let error = read(TEK.replace(from, to)).unwrap_err();
        assert!(error.contains(says), "{to}: {error}");
    }
    // The times have too few digits for their step. The header has the step, but nothing gives the time of the first
    // sample.
    let coarse = "Model,M\nSample Interval,1e-9\nTIME,CH1\n1.00000e+00,1\n1.00000e+00,2\n1.00000e+00,3\n";
    let (record, _) = one(coarse);
    assert_eq!((record.head.dt_s, record.t0_s), (Some(1e-9), None));
}

#[test]
fn records_of_other_kinds_are_named() {
    let records = read(TEK_LOGIC).unwrap();
    let kinds: Vec<_> =
        records.iter().map(|(record, _)| (record.head.channel.as_deref().unwrap(), record.head.kind)).collect();
    assert_eq!(kinds, [("CH1", Kind::Waveform), ("D1", Kind::Digital), ("D0", Kind::Digital)]);
    assert_eq!((records[0].0.head.unit.as_deref(), records[1].0.head.unit.as_deref()), (Some("A"), None));
    assert_eq!((&records[1].1[..], records[2].0.head.dt_s), (&[0.0, 1.0, 0.0][..], Some(4e-9)));
    let error = read(TEK_LOGIC.replace(",-4.68", ",-4.67")).unwrap_err();
    assert!(error.contains("line 14: has two times"), "{error}");
    let error = read(TEK_LOGIC.replace(",,Sample Interval,4", ",,Sample Interval,5")).unwrap_err();
    assert!(error.contains("two Sample Intervals"), "{error}");
    for (from, to, kind) in [
        ("Waveform Type,ANALOG", "Waveform Type,ANALOG\nPoint Format,ENV", Kind::Envelope),
        ("Waveform Type,ANALOG", "Waveform Type,RF_IQ", Kind::Iq),
        ("Horizontal Units,s", "Horizontal Units,Hz", Kind::Spectrum),
    ] {
        assert_eq!(one(TEK.replace(from, to)).0.head.kind, kind);
    }
    let (record, _) = one("Frequency (MHz),Power (dBm)\n1,-10\n2,-20\n");
    assert_eq!((record.head.kind, record.head.dt_s, record.t0_s), (Kind::Spectrum, Some(1e6), Some(1e6)));
    assert_eq!(record.head.unit.as_deref(), Some("dBm"));
}

#[test]
fn keysight_may_end_with_blank_cells() {
    let records = read(KEYSIGHT).unwrap();
    assert_eq!((&records[0].1[..], &records[1].1[..]), (&[1.5e-3, -2.5e-3][..], &[2.0, 3.0][..]));
    assert_eq!((records[1].0.head.format, records[1].0.head.unit.as_deref()), ("keysight-csv", Some("A")));
    assert!(near(records[0].0.head.dt_s, 1e-6) && records[0].0.t0_s == Some(-1e-6));
    let error = read(KEYSIGHT.to_owned() + "+2.0E-06,1,2\n").unwrap_err();
    assert!(error.contains("line 5: is blank, or has blank cells"), "{error}");
    assert!(read(KEYSIGHT.replace("-06,-2.5E-03,3", "-06,-2.5E-03")).unwrap_err().contains("line 4: has 2 fields"));
    assert!(read("x-axis,1\nsecond,Volt\n").unwrap_err().contains("no line of numbers"));
    assert!(read("x-axis,1\nfurlong,Volt\n1,2\n2,3\n").unwrap_err().contains("no unit of times"));
    assert_eq!(one("x-axis,1\nHertz,dB\n1,2\n2,3\n").0.head.kind, Kind::Spectrum);
}

#[test]
fn rigol_counts_samples_or_has_times() {
    let records = read(RIGOL).unwrap();
    assert_eq!((&records[0].1[..], records[1].0.head.channel.as_deref()), (&[0.5, 0.25, 0.125][..], Some("CH4")));
    assert!(records[0].0.head.dt_s == Some(1e-8) && near(records[0].0.t0_s, -2.48e-6), "{records:?}");
    for (from, to, says) in [
        ("3,0.25", "4,0.25", "line 4: time"),
        ("1.0e-08", "0", "line 2: Increment"),
        ("-2.5e-06", "soon", "line 2: has no number under Start"),
        ("3,0.25,2,", "3,0.25,2,7", "line 4: has 4 fields"),
        ("3,0.25,2,", "3,,2,", "line 4: has a blank cell in column 2"),
        ("1.0e-08", "1e308", "line 3: the time of the first sample is beyond all numbers"),
    ] {
        let error = read(RIGOL.replace(from, to)).unwrap_err();
        assert!(error.contains(says), "{to}: {error}");
    }
    let records = read(RIGOL_TIMES).unwrap();
    assert_eq!((&records[1].1[..], records[1].0.head.format), (&[2.0, 4.0, 6.0][..], "rigol-csv"));
    assert!(near(records[1].0.head.dt_s, 1e-9));
}

/// The same rows as LeCroy's ASCII writes them. There may be more keys than rows, or more rows than keys.
fn ascii() -> String {
    ASCII.replace("Length\"\t3", "Length\"\t5").replace("\t\t\n", "\t1e-8\t4.5\n") + "\t\t\t2e-8\t5.5\n"
}

#[test]
fn lecroy_ascii_has_its_head_beside_the_rows() {
    let text = ascii().replace("Length\"\t5", "Length\"\t6");
    let (record, values) = one(&text);
    assert_eq!((values, record.head.format), (vec![1.5, 2.5, 3.5, 4.5, 4.5, 5.5], "lecroy-ascii"));
    assert_eq!((record.head.dt_s, record.t0_s), (Some(5e-11), Some(-400.25 * 5e-11)));
    assert!(read(ascii()).unwrap_err().contains("Record Length = 5"));
    assert!(read(text.replace("Trigger Time", "Trigger")).unwrap_err().contains("no \"Trigger Time\""));
    assert!(read(text.replace("5e-011", "0")).unwrap_err().contains("no time base"));
    assert!(read(text.replace("Length\"\t6", "Length\"\t-6")).unwrap_err().contains("no count"));
    assert!(read(text.replace("2e-8\t5.5", "2e-8\tx")).unwrap_err().contains("line 6: \"x\" in column 5"));
}

#[test]
fn plain_columns_are_read_with_their_names_and_units() {
    let records = read(PLAIN).unwrap();
    let (record, values) = &records[0];
    assert_eq!((&values[..], record.head.channel.as_deref()), (&[0.5, 0.25, 0.125][..], Some("ch1")));
    assert_eq!((record.t0_s, record.head.dt_s, record.head.format), (Some(-1e-9), Some(1e-9), "csv"));
    for text in [
        "time_ps,ch1_mv\n-1000,500\n0,250\n",
        "# time_ps, ch1_mv\n-1000,500\n0,250\n",
        "\u{feff}Time;ch1\r\n(ns);(mV)\r\n\r\n-1;500\r\n0;250\r\n",
        "t(ns)\tch1(V)\n-1,0\t0,5\n0,0\t0,25\n\n",
        "Time[us] ch1\n -1e-3   0.5\n 0   0.25\n",
        "nr,time_s,ch1,\n0,-1e-9,0.5,\n1,0,0.25,\n",
    ] {
        let (record, values) = one(text);
        assert_eq!((values, record.t0_s, record.head.dt_s), (vec![0.5, 0.25], Some(-1e-9), Some(1e-9)), "{text}");
        assert_eq!(record.head.channel.as_deref(), Some("ch1"), "{text}");
    }
    assert_eq!(one(b"Time (\xb5s),volts\n0,1\n1,2\n").0.head.dt_s, Some(1e-6));
    let (record, _) = one("time_s,voltage_v\n0,1\n1,2\n");
    assert_eq!((record.head.channel.as_deref(), record.head.unit.as_deref()), (None, Some("V")));
    assert!(read("time,CH1_MV\n0,1\n1,2\n").unwrap_err().contains("may mean mV"));
    assert!(read("time (min),ch1\n0,1\n1,2\n").unwrap_err().contains("no unit of times"));
    assert!(read("time and voltage\n0,1\n1,2\n").unwrap_err().contains("names 1 columns, but the rows have 2"));
}

#[test]
fn columns_without_names_are_times_if_they_increase() {
    let (record, values) = one("0,5\n1,4\n2,3\n");
    assert_eq!((values, record.head.dt_s), (vec![5.0, 4.0, 3.0], None), "times without a unit");
    assert_eq!(record.head.channel.as_deref(), Some("col1"));
    let records = read("0,5\n1,4\n1,3\n").unwrap();
    assert_eq!((&records[0].1[..], &records[1].1[..]), (&[0.0, 1.0, 1.0][..], &[5.0, 4.0, 3.0][..]));
    assert_eq!((records[0].0.head.dt_s, records[0].0.t0_s), (None, None));
    assert_eq!(one("3\n4\n5\n").1, [3.0, 4.0, 5.0]);
    assert!(read("0,5\n1,4\n3,3\n4,2\n").unwrap_err().contains("even step"));
    assert_eq!(read("CH1,CH2\n1,2\n2,3\n").unwrap()[0].0.head.dt_s, None);
}

/// 48.8 could be picoseconds or milliseconds: only a heading says it.
#[test]
fn without_a_unit_there_is_none() {
    let facts = |text: &str| {
        let (record, values) = one(text);
        let head = record.head.clone();
        (head.unit.clone(), head.kind, head.dt_s, record.t0_s, head.scale.is_some(), values[1])
    };
    let (counts, volts) = (Some("counts".to_owned()), Some("V".to_owned()));
    assert_eq!(facts("time,counts\n0,1\n48.8,2\n"), (counts.clone(), Kind::Counts, None, None, true, 2.0));
    assert_eq!(
        facts("time (ps),signal (counts)\n0,1\n50,2\n"),
        (counts.clone(), Kind::Counts, Some(50e-12), Some(0.0), true, 2.0)
    );
    assert_eq!(facts("time_ns,photon counts\n1,1\n2,7\n"), (counts, Kind::Counts, Some(1e-9), Some(1e-9), true, 7.0));
    assert_eq!(facts("time,signal\n0,1\n1,2\n"), (None, Kind::Waveform, None, None, false, 2.0));
    assert_eq!(facts("seconds,volts\n0,1\n1,2\n"), (volts, Kind::Waveform, Some(1.0), Some(0.0), true, 2.0));
}

#[test]
fn errors_name_their_line() {
    for (text, says) in [
        ("", "line 1: no line of numbers"),
        ("time,volts\n", "line 1: no line of numbers"),
        ("time,volts\nmore,words\n0,1\n1,2\n", "line 2: \"more words\" is no row of numbers"),
        ("time,volts\n0,1\n1,overload\n2,3\n", "line 3: \"overload\" in column 2 is no number"),
        ("time,volts\n0,1\nsoon,2\n2,3\n", "line 3: \"soon\" in column 1"),
        ("time,volts\n0,1\n1,inf\n2,3\n", "line 3: \"inf\""),
        ("time,ch1 (kV)\n0,1\n1,1e307\n2,3\n", "line 3: \"1e307\""),
        ("time,volts\n0,1\n\n2,3\n", "line 3: is blank"),
        ("time,volts\n0,1\n1\n2,3\n", "line 3: has 1 fields, those before have 2"),
        ("time,volts\n0,1\n1,2,3\n2,3\n", "line 3: has 3 fields, those before have 2"),
        ("time,volts\n0,1\n", "line 2: a single time"),
        ("time,volts\n1,1\n0,2\n", "line 2: times do not increase"),
        ("time,volts\n0,1\n1,2\n2.4,3\n3,4\n", "line 4: time 2.4 is off the even step of 1"),
        ("time;volts\n0,0;1\n1.0;2\n", "line 3: \"1.0\""),
        ("time\n1\n2\n", "no column of values"),
        ("time,volts,time\n0,1,0\n1,2,1.5\n", "line 3: has two times"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.contains(says), "{text:?}: {error}");
    }
    assert!(read("1,".repeat(300) + "\n").unwrap_err().contains("300 columns"));
    assert!(read("1,".repeat(40_000)).unwrap_err().contains("more than 65536 bytes"));
    assert!(read("words\n".repeat(100)).unwrap_err().contains("line 1: \"words\""));
}

#[test]
fn dense_texts_stay_within_memory() {
    assert_eq!(one("0\n".repeat(100_000)).0.head.samples, 100_000);
    let segments = 20_000;
    let head = format!("LECROY,0,Waveform\nSegments,{segments},SegmentSize,2\nSegment,TrigTime,TimeSinceSegment1\n");
    let lines = (1..=segments).map(|segment| format!("#{segment},,0\n")).collect::<Vec<_>>().concat();
    let error = read(head + &lines + "Time,Ampl\n" + &"0,1\n1,1\n".repeat(segments)).unwrap_err();
    assert!(error.contains("more than the file can hold") || error.contains("too many for so few rows"), "{error}");
}

fn all() -> [String; 8] {
    [LECROY, TEK, TEK_LOGIC, KEYSIGHT, RIGOL, RIGOL_TIMES, &ascii().replace("Length\"\t5", "Length\"\t6"), PLAIN]
        .map(str::to_owned)
}

#[test]
fn every_cut_is_an_error_or_whole_rows() {
    for text in all() {
        let whole = read(&text).unwrap();
        for length in 0..text.len() {
            let Ok(records) = read(&text[..length]) else { continue };
            assert!(records.len() <= whole.len());
            for ((record, values), (_, expected)) in records.iter().zip(&whole) {
                // The last number may be cut within its digits, which a text cannot show.
                let sound = values.len() - 1;
                assert_eq!(values[..sound], expected[..sound]);
                assert!(record.head.samples <= expected.len());
            }
            let counted = ["tek-csv", "lecroy-csv", "lecroy-ascii"].contains(&whole[0].0.head.format);
            assert!(!counted || records[0].1.len() == whole[0].1.len(), "silently shorter at {length}: {text}");
        }
    }
}

#[test]
fn no_mutation_panics() {
    let mut state = 3_u32;
    let mut next = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let (texts, mut whole) = (all(), 0);
    for round in 0..8000 {
        let mut bytes = texts[round % texts.len()].clone().into_bytes();
        for _ in 0..=next(3) {
            let at = next(bytes.len());
            match next(4) {
                0 => bytes[at] ^= 1 << next(8),
                1 => bytes[at] = b"0123456789e-+.,;\t\n \"#"[next(21)],
                2 => bytes.insert(at, b"09.,\ne"[next(6)]),
                _ => drop(bytes.drain(at..(at + next(9)).min(bytes.len()))),
            }
        }
        whole += u32::from(read(&bytes).is_ok());
    }
    assert!(whole > 500, "{whole} mutations leave the text whole");
}

#[test]
fn what_is_written_is_read_back() {
    let mut text = Vec::new();
    write(&mut text, -2e-9, 5e-11, &[0.5, -1.25, 3.0]).unwrap();
    let (record, values) = one(text);
    assert_eq!((values, record.t0_s), (vec![0.5, -1.25, 3.0], Some(-2e-9)));
    assert!(near(record.head.dt_s, 5e-11));
}

fn described(text: &str, unit: Option<&str>, time_unit: Option<&str>) -> Result<Vec<Record>, String> {
    let (unit, time_unit) = (unit.map(str::to_owned), time_unit.map(str::to_owned));
    let source = Source::new(Cursor::new(text.as_bytes().to_vec()), Path::new("a.csv")).unwrap();
    let mut source = source.described(Description { unit, time_unit, ..Description::default() });
    crate::records(&mut source).map_err(|error| error.to_string())
}

#[test]
fn a_caller_gives_the_units_that_headings_lack() {
    let bare = "time,counts_raw\n0,3\n0.5,4\n1,5\n";
    let head = |records: Vec<Record>| (records[0].head.clone(), records[0].t0_s);
    let (none, t0_s) = head(described(bare, None, None).unwrap());
    assert_eq!((&none.unit, none.scale, none.dt_s, t0_s), (&None, None, None, None), "no unit is no unit");
    let (given, t0_s) = head(described(bare, Some("photons"), Some("ns")).unwrap());
    assert_eq!((given.kind, given.unit.as_deref(), t0_s), (Kind::Counts, Some("counts"), Some(0.0)));
    assert!(near(given.dt_s, 0.5e-9));
    // Without a heading at all, the first column holds times, since it increases.
    let records = described("0 1\n20 250\n40 -3\n", Some("mV"), Some("ps")).unwrap();
    assert_eq!(records[0].values(&records[0].read(&mut Cursor::new([]), 0..3).unwrap()), [0.001, 0.25, -0.003]);
    assert!(near(records[0].head.dt_s, 20e-12) && records[0].head.unit.as_deref() == Some("V"));
    // Columns with a unit keep it, if it is the same.
    let records = described("time_ns,a (mV),b\n0,1,2\n1,2,3\n", Some("mV"), Some("ns")).unwrap();
    assert!(records.iter().all(|record| record.head.unit.as_deref() == Some("V")));
}

#[test]
fn units_that_contradict_a_heading_are_refused() {
    let plain = "time_ns,ch1 (mV)\n0,1\n0.5,2\n";
    for (text, unit, time_unit, says) in [
        (plain, Some("V"), None, "`unit` = \"V\" contradicts the heading of ch1 (csv), which says mV; take it out"),
        (plain, None, Some("ps"), "`time_unit` = \"ps\" contradicts the heading of the times, which says ns"),
        (plain, Some("ns"), None, "is no unit of values; write counts"),
        (plain, None, Some("mV"), "is no unit of times; write s, ms"),
        ("5\n3\n4\n", None, Some("ns"), "no column increases"),
        ("f (Hz),x\n1,2\n2,3\n", None, Some("ns"), "frequencies"),
        (KEYSIGHT, Some("counts"), None, "keysight-csv"),
    ] {
        let error = described(text, unit, time_unit).unwrap_err();
        assert!(error.contains(says), "{error}");
    }
    let source = Source::new(Cursor::new(b"\x93NUMPY".to_vec()), Path::new("a.npy")).unwrap();
    let mut source = source.described(Description { unit: Some("V".into()), ..Description::default() });
    let error = crate::records(&mut source).unwrap_err().to_string();
    assert_eq!(error, "`unit` is for text, and this file is npy; take it out");
}
