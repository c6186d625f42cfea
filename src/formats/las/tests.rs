use std::io::Cursor;
use std::path::Path;

use super::super::hostile;
use super::*;
use crate::lidar::flight;
use crate::reader::Source;

/// A point: place, number of its packet, place in the waveform (ps), direction along z (m/ps).
type Built = ([i32; 3], u64, f32, f32);

/// Two pulses: the first with two returns, in order of time and 3 m apart along the beam, the second with one.
const POINTS: [Built; 3] =
    [([10, 20, 3000], 0, 2000.0, 1.5e-4), ([10, 20, 2700], 0, 22_000.0, 1.5e-4), ([11, 21, 2900], 1, 500.0, 1.5e-4)];
const SAMPLES: [[u8; 4]; 2] = [[14, 15, 200, 16], [14, 14, 90, 15]];

fn record(number: u16, payload: &[u8], head: usize) -> Vec<u8> {
    let mut bytes = vec![0, 0];
    bytes.extend(b"LASF_Spec");
    bytes.resize(18, 0);
    bytes.extend(number.to_le_bytes());
    if head == EXTENDED as usize {
        bytes.extend((payload.len() as u64).to_le_bytes());
    } else {
        bytes.extend((payload.len() as u16).to_le_bytes());
    }
    bytes.resize(head, 0);
    bytes.extend(payload);
    bytes
}

/// A file, and the packets in an extended record, in the file where `is_inside`.
fn built(minor: u8, is_inside: bool, points: &[Built]) -> [Vec<u8>; 2] {
    let (head_bytes, format, packet, stride) = if minor == 3 { (235, 4, 28, 57) } else { (375, 9, 30, 59) };
    let mut descriptor = vec![8, 0];
    descriptor.extend([4_u32, 1000].iter().flat_map(|number| number.to_le_bytes()));
    descriptor.extend([0.5, -1.0].iter().flat_map(|number| f64::to_le_bytes(*number)));
    let descriptor = record(100, &descriptor, VARIABLE as usize);
    let start = head_bytes + descriptor.len();
    let end = start + stride * points.len();
    let mut entries = Vec::new();
    for (place, packet_number, location_ps, along) in points {
        let mut entry: Vec<u8> = place.iter().flat_map(|code| code.to_le_bytes()).collect();
        entry.resize(packet - 8, 0);
        entry.extend(7.25_f64.to_le_bytes());
        entry.push(1);
        entry.extend((EXTENDED + 4 * packet_number).to_le_bytes());
        entry.extend(4_u32.to_le_bytes());
        entry.extend([*location_ps, 0.0, 0.0, *along].iter().flat_map(|number| number.to_le_bytes()));
        entries.extend(entry);
    }
    let mut head = SIGNATURE.to_vec();
    head.resize(6, 0);
    head.extend(if is_inside { INTERNAL } else { EXTERNAL }.to_le_bytes());
    head.resize(24, 0);
    head.extend([1, minor]);
    head.extend(b"TEST");
    head.resize(94, 0);
    head.extend((head_bytes as u16).to_le_bytes());
    head.extend([start as u32, 1].iter().flat_map(|number| number.to_le_bytes()));
    head.push(format);
    head.extend((stride as u16).to_le_bytes());
    head.extend(if minor == 3 { points.len() as u32 } else { 0 }.to_le_bytes());
    head.resize(131, 0);
    head.extend([0.01, 0.01, 0.01, 100.0, 200.0, 300.0].iter().flat_map(|number| f64::to_le_bytes(*number)));
    head.resize(227, 0);
    head.extend(if is_inside { end as u64 } else { 0 }.to_le_bytes());
    if minor > 3 {
        head.extend(end.to_le_bytes());
        head.extend(u32::from(is_inside).to_le_bytes());
        head.extend(points.len().to_le_bytes());
        head.resize(head_bytes, 0);
    }
    let packets = record(PACKETS, &SAMPLES.concat(), EXTENDED as usize);
    let file = [head, descriptor, entries].concat();
    if is_inside { [[file, packets].concat(), Vec::new()] } else { [file, packets] }
}

fn source(files: &[Vec<u8>; 2]) -> Source<Cursor<Vec<u8>>> {
    let length = files[0].len() as u64;
    Source::with_companion(Cursor::new(files.concat()), length, Path::new("a.las")).unwrap()
}

#[test]
fn returns_of_a_pulse_share_its_waveform() {
    for (minor, is_inside) in [(3, true), (3, false), (4, true), (4, false)] {
        let mut source = source(&built(minor, is_inside, &POINTS));
        let flight = flight(&mut source).unwrap();
        assert_eq!(source.remarks(&flight.records), [], "LAS 1.{minor}, inside: {is_inside}");
        let values: Vec<Vec<f64>> = flight.records.iter().map(|record| source.values(record).unwrap()).collect();
        assert_eq!(values, [[6.0, 6.5, 99.0, 7.0], [6.0, 6.0, 44.0, 6.5]], "gain 0.5, offset -1");
        let [first, second] = &flight.pulses[..] else { panic!("{:?}", flight.pulses) };
        assert_eq!((first.outgoing, &first.returning[..], first.gps_time_s), (None, &[0][..], 7.25));
        assert_eq!((second.anchor, &second.returning[..]), ([100.11, 200.21, 329.0], &[1][..]));
        // The later return is the lower one: the direction in the file points back.
        assert!((first.velocity_per_s[2] + 1.5e8).abs() < 100.0, "{:?}", first.velocity_per_s);
        let record = &flight.records[0];
        assert!((record.t0_s.unwrap() + 2e-9).abs() < 1e-20 && record.head.dt_s == Some(1e-9));
        assert_eq!((record.head.unit.as_deref(), record.head.instrument.as_deref()), (Some("V"), Some("TEST")));
    }
}

#[test]
fn the_places_of_returns_say_which_way_a_direction_points() {
    let along = POINTS.map(|(place, packet, location_ps, along)| (place, packet, location_ps, -along));
    for points in [&POINTS[..], &along[..]] {
        let flight = flight(&mut source(&built(4, true, points))).unwrap();
        assert!(flight.pulses.iter().all(|pulse| pulse.velocity_per_s[2] < 0.0), "down, whatever the sign in the file");
    }
    let flight = flight(&mut source(&built(4, true, &POINTS[2..]))).unwrap();
    assert!(flight.pulses[0].velocity_per_s[2] < 0.0, "single returns: the direction points back to the scanner");
}

#[test]
fn what_is_wrong_is_said() {
    let says = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut files = built(3, true, &POINTS);
        change(&mut files[0]);
        Las.records(&mut source(&files)).unwrap_err().to_string()
    };
    let (descriptor, first) = (235 + 54, 235 + 54 + 26);
    assert!(says(&|bytes| bytes[104] = 1).contains("without waveform packets"));
    assert!(says(&|bytes| bytes[104] |= 0x80).contains("LAZ"));
    assert!(says(&|bytes| bytes[6] = 0).contains("neither in the file"));
    assert!(says(&|bytes| bytes[descriptor] = 12).contains("samples of 12 bits"));
    assert!(says(&|bytes| bytes[descriptor + 1] = 1).contains("compressed waveform packets"));
    assert!(says(&|bytes| bytes[first + 28] = 9).contains("waveform descriptor 9"));
    assert!(says(&|bytes| bytes[first + 29] = 200).contains("a waveform packet needs 4 bytes"));
    assert!(says(&|bytes| bytes[first + 37] = 3).contains("a packet of 3 bytes"));
    assert!(says(&|bytes| (0..3).for_each(|i| bytes[first + 57 * i + 28] = 0)).contains("none of whose points"));
    assert!(says(&|bytes| bytes[227] += 1).contains("waveform packets begin here"));
    let [alone, _] = built(3, false, &POINTS);
    let error = Las.records(&mut hostile::source(&alone)).unwrap_err().to_string();
    assert!(error.contains("ending .wdp next to it"), "{error}");
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    for minor in [3, 4] {
        let [bytes, _] = built(minor, true, &POINTS);
        hostile::cut_everywhere(&Las, &bytes);
        hostile::change_anywhere(&Las, &bytes, 5000);
    }
}
