use std::io::Cursor;
use std::path::Path;

use super::super::hostile;
use super::*;
use crate::lidar::flight;
use crate::reader::Source;

/// A variable length record, its head before what it says, or behind it.
fn variable(number: u32, payload: &[u8], is_appended: bool) -> Vec<u8> {
    let mut head = b"PulseWaves_Spec\0".to_vec();
    head.extend(number.to_le_bytes());
    head.extend([0; 4]);
    head.extend((payload.len() as u64).to_le_bytes());
    head.resize(VARIABLE as usize, 0);
    if is_appended { [payload, &head].concat() } else { [&head, payload].concat() }
}

/// A sampling: way, bits of duration, of segments, of samples, of a sample, and scale of durations.
fn sampling(way: u8, [duration, segments, samples]: [u8; 3], bits: u16, scale: f32) -> Vec<u8> {
    let mut bytes = 104_u32.to_le_bytes().to_vec();
    bytes.extend([0, 0, 0, 0, way, 0, 0, duration]);
    bytes.extend(scale.to_le_bytes());
    bytes.extend(10_f32.to_le_bytes());
    bytes.extend([segments, samples]);
    bytes.extend(1_u16.to_le_bytes());
    bytes.extend(3_u32.to_le_bytes());
    bytes.extend(bits.to_le_bytes());
    bytes.extend([0; 2]);
    bytes.extend(2_f32.to_le_bytes());
    bytes.resize(104, 0);
    bytes
}

fn descriptor() -> Vec<u8> {
    let mut bytes = 92_u32.to_le_bytes().to_vec();
    bytes.extend([0; 4]);
    bytes.extend(4_i32.to_le_bytes());
    bytes.extend(1_u16.to_le_bytes());
    bytes.extend(2_u16.to_le_bytes());
    bytes.extend(1_f32.to_le_bytes());
    bytes.resize(92, 0);
    // Outgoing: one segment of three samples of 8 bits. Returning: segments as each pulse has them.
    [bytes, sampling(1, [0, 0, 0], 8, 1.0), sampling(2, [16, 8, 8], 16, 0.5)].concat()
}

/// Waves of a pulse, one extra byte before them: its outgoing samples, and its returning segments (duration, samples).
fn waves(outgoing: [u8; 3], returning: &[(i16, &[u16])]) -> Vec<u8> {
    let mut bytes = vec![0xEE];
    bytes.extend(outgoing);
    bytes.push(returning.len() as u8);
    for (duration, samples) in returning {
        bytes.extend(duration.to_le_bytes());
        bytes.push(samples.len() as u8);
        bytes.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
    }
    bytes
}

/// NAME.pls and NAME.wvs of three pulses, of which the second came back in two segments and the third not at all.
fn two_files(is_appended: bool) -> [Vec<u8>; 2] {
    let mut samples = WAVES.to_vec();
    samples.resize(WAVES_HEAD as usize, 0);
    let of_pulses = [
        waves([1, 9, 2], &[(20, &[5, 600, 7, 8])]),
        waves([2, 8, 3], &[(-4, &[11]), (40, &[12, 13])]),
        waves([3, 7, 4], &[]),
    ];
    let mut pulses = Vec::new();
    for (i, of_pulse) in of_pulses.iter().enumerate() {
        pulses.extend((i as i64 + 5).to_le_bytes());
        pulses.extend((samples.len() as u64).to_le_bytes());
        for code in [100 * i as i32, 200, 3000, 100 * i as i32, 200, 3000 - 14_985] {
            pulses.extend(code.to_le_bytes());
        }
        pulses.extend([0, 0, 0, 0, 7, 0, 0, 0]);
        samples.extend(of_pulse);
    }
    let records = if is_appended { Vec::new() } else { variable(200_007, &descriptor(), false) };
    let mut head = PULSES.to_vec();
    head.resize(40, 0);
    head.extend(b"TEST SCANNER");
    head.resize(174, 0);
    head.extend((HEAD as u16).to_le_bytes());
    head.extend((HEAD + records.len() as u64).to_le_bytes());
    head.extend(3_u64.to_le_bytes());
    for number in [0, 0, PULSE as u32, 0, 0, 0, u32::from(!is_appended), u32::from(is_appended)] {
        head.extend(number.to_le_bytes());
    }
    for number in [1e-6, 1000.0, 0.0, 0.0, 0.01, 0.01, 0.01, 50.0, 60.0, 70.0] {
        head.extend(f64::to_le_bytes(number));
    }
    head.resize(HEAD as usize, 0);
    let mut tail = variable(FIRST_APPENDED, &[], true);
    if is_appended {
        tail.extend(variable(200_007, &descriptor(), true));
    }
    [[head, records, pulses, tail].concat(), samples]
}

fn source(files: &[Vec<u8>; 2]) -> Source<Cursor<Vec<u8>>> {
    let length = files[0].len() as u64;
    Source::with_companion(Cursor::new(files.concat()), length, Path::new("a.pls")).unwrap()
}

/// Reads both files one behind the other: the second begins where its head is.
struct BothFiles;

impl Reader for BothFiles {
    fn format(&self) -> &'static str {
        PulseWaves.format()
    }
    fn extensions(&self) -> &'static [&'static str] {
        PulseWaves.extensions()
    }
    fn recognises(&self, head: &[u8]) -> bool {
        PulseWaves.recognises(head)
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let mut bytes = Vec::new();
        input.stream()?.read_to_end(&mut bytes)?;
        let length = bytes.windows(WAVES.len()).position(|window| window == WAVES).unwrap_or(bytes.len());
        input.uses(0..bytes.len() as u64);
        let mut source = Source::with_companion(Cursor::new(bytes), length as u64, Path::new("a.pls"))?;
        let records = PulseWaves.records(&mut source)?;
        for remark in source.remarks(&records) {
            input.remark(remark.byte_offset, remark.problem);
        }
        Ok(records)
    }
}

#[test]
fn each_pulse_has_its_beam_and_its_waves() {
    for is_appended in [false, true] {
        let mut source = source(&two_files(is_appended));
        let flight = flight(&mut source).unwrap();
        assert_eq!(source.remarks(&flight.records), []);
        let values: Vec<Vec<f64>> = flight.records.iter().map(|record| source.values(record).unwrap()).collect();
        let expected: [&[f64]; 6] =
            [&[1.0, 9.0, 2.0], &[5.0, 600.0, 7.0, 8.0], &[2.0, 8.0, 3.0], &[11.0], &[12.0, 13.0], &[3.0, 7.0, 4.0]];
        assert_eq!(values, expected);
        // Of two pulses, as the third has no returning light.
        let [first, second] = &flight.pulses[..] else { panic!("{:?}", flight.pulses) };
        assert_eq!((first.outgoing, &first.returning[..]), (Some(0), &[1][..]));
        assert_eq!((second.outgoing, &second.returning[..]), (Some(2), &[3, 4][..]));
        assert_eq!(first.gps_time_s, 1_000.000_005);
        assert_eq!(second.anchor, [51.0, 62.0, 100.0]);
        // 149.85 m in 1000 ns, downwards.
        assert!((second.velocity_per_s[2] + 149.85e6).abs() < 1.0, "{:?}", second.velocity_per_s);
        // Outgoing: 10 units after the centre, 4 of which lie before the anchor. Returning: 10 + 0.5 * 40 units.
        let close = |record: usize, time_s: f64| (flight.records[record].t0_s.unwrap() - time_s).abs() < 1e-18;
        assert!(close(0, 6e-9) && close(3, 8e-9) && close(4, 30e-9));
        let head = &flight.records[1].head;
        assert_eq!((head.channel.as_deref(), head.instrument.as_deref()), (Some("returning"), Some("TEST SCANNER")));
        assert!((head.dt_s.unwrap() - 2e-9).abs() < 1e-24);
        assert_eq!(flight.records[4].segment, Some(2));
    }
}

#[test]
fn what_is_wrong_is_said() {
    let files = two_files(false);
    let says = |change: &dyn Fn(&mut [Vec<u8>; 2])| {
        let mut changed = files.clone();
        change(&mut changed);
        PulseWaves.records(&mut source(&changed)).unwrap_err().to_string()
    };
    let first = (HEAD + VARIABLE) as usize;
    assert!(says(&|files| files[0][184..192].fill(0xFF)).contains("-1 pulses"));
    assert!(says(&|files| files[0][204] = 1).contains("compressed PulseWaves file"));
    assert!(says(&|files| files[1][16] = 1).contains("compressed waves"));
    assert!(says(&|files| files[1][3] = b'X').contains("no PulseWaves file"));
    assert!(says(&|files| files[0][first + 92 + 28] = 12).contains("samples of 12 bits"));
    assert!(says(&|files| files[0][first + 92 + 11] = 7).contains("7 bits: [0, 8, 16, 32]"));
    assert!(says(&|files| files[0][first + 300 + 44] = 3).contains("descriptor 3 is not in the file"));
    assert!(says(&|files| files[1].truncate(90)).contains("the waves needs"));
    assert!(says(&|files| files[0].truncate(700)).contains("the pulses needs"));
    let alone = PulseWaves.records(&mut hostile::source(&files[0])).unwrap_err().to_string();
    assert!(alone.contains("ending .wvs next to it"), "{alone}");
}

#[test]
fn few_bytes_do_not_claim_many_records() {
    let mut files = two_files(false);
    let first = (HEAD + VARIABLE) as usize;
    // Segments of one sample: fixed in number, without a number of their own.
    let returning = first + 92 + 104;
    files[0][returning + 11] = 0;
    files[0][returning + 20..returning + 28].copy_from_slice(&[0, 0, 0xFF, 0xFF, 1, 0, 0, 0]);
    files[1].resize(200_000, 1);
    let error = PulseWaves.records(&mut source(&files)).unwrap_err().to_string();
    assert!(error.contains("segments in"), "{error}");
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    for is_appended in [false, true] {
        let bytes = two_files(is_appended).concat();
        hostile::cut_everywhere(&BothFiles, &bytes);
        hostile::change_anywhere(&BothFiles, &bytes, 5000);
    }
}
