use super::checksum::sum_of_bytes;
use super::frames::acquired_at;
use super::*;
use crate::hostile::{cut_everywhere, damage, read};

/// A file as an instrument would write it, of any version and byte order.
#[derive(Clone)]
struct Built {
    version: u8,
    big_endian: bool,
    format: i32,
    /// Codes of each frame, little-endian.
    frames: Vec<Vec<u8>>,
    width: usize,
    /// Bytes before and behind the samples of a frame.
    charge: usize,
    /// Whether frames beyond the first have curve objects of their own.
    own_curves: bool,
    summary: u16,
    /// Fields that are not as in a plain record: place and bytes, little-endian.
    put: Vec<(usize, Vec<u8>)>,
    trailer: Vec<u8>,
    checksum: bool,
}

impl Built {
    /// Three samples of i16 codes in a frame, with TT offset i/4, at second 1,000,000,000 + 10 i plus 0.75 + 1e-9 i.
    fn new(version: u8, big_endian: bool, frames: usize) -> Self {
        let codes = |frame: usize| [frame as i16, -2, 300].iter().flat_map(|code| code.to_le_bytes()).collect();
        Self {
            version,
            big_endian,
            format: 0,
            frames: (0..frames).map(codes).collect(),
            width: 2,
            charge: 4,
            own_curves: false,
            summary: 0,
            put: Vec::new(),
            trailer: Vec::new(),
            checksum: true,
        }
    }

    fn layout(&self) -> &'static Layout {
        &LAYOUTS[usize::from(self.version) - 1]
    }

    fn of(self, format: i32, width: usize, codes: &[u8]) -> Self {
        Self { format, width, frames: vec![codes.to_vec()], ..self }
    }

    fn with(mut self, at: usize, field: &[u8]) -> Self {
        self.put.push((at, field.to_vec()));
        self
    }

    fn curves_end(&self) -> usize {
        self.layout().end
            + (self.frames.len() - 1) * (UPDATE + CURVE)
            + self.frames.len() * (self.frames[0].len() + 2 * self.charge)
    }

    fn bytes(&self) -> Vec<u8> {
        let (layout, used) = (self.layout(), self.frames[0].len());
        let mut bytes = vec![0; layout.end + (self.frames.len() - 1) * (UPDATE + CURVE)];
        let (more, data) = (self.frames.len() - 1, bytes.len());
        let count = self.curves_end() + if self.checksum { 8 } else { 0 } - 15;
        let mut put = |at: usize, field: &[u8]| {
            let field = if self.big_endian { field.iter().rev().copied().collect() } else { field.to_vec() };
            bytes[at..at + field.len()].copy_from_slice(&field);
        };
        put(11, &(count as u32).to_le_bytes());
        put(15, &[self.width as u8]);
        put(16, &(data as u32).to_le_bytes());
        put(72, &(more as u32).to_le_bytes());
        for (at, value) in [(114, 1), (118, 1), (122, 2)] {
            put(at, &i32::to_le_bytes(value));
        }
        if self.version > 1 {
            put(154, &self.summary.to_le_bytes());
        }
        put(layout.explicit, &0.5_f64.to_le_bytes());
        put(layout.explicit + 8, &10.0_f64.to_le_bytes());
        put(layout.explicit + 72, &self.format.to_le_bytes());
        put(layout.implicit, &1e-10_f64.to_le_bytes());
        put(layout.implicit + 8, &(-1e-9_f64).to_le_bytes());
        for i in 0..=more {
            let own = i == 0 || self.own_curves;
            let (update, curve) = match i {
                0 => (layout.update, layout.curve),
                _ => (layout.end + (i - 1) * UPDATE, layout.end + more * UPDATE + (i - 1) * CURVE),
            };
            put(update + 4, &(0.25 * i as f64).to_le_bytes());
            put(update + 12, &(0.75 + 1e-9 * i as f64).to_le_bytes());
            put(update + 20, &(1_000_000_000 + 10 * i as i32).to_le_bytes());
            let (start, stop, end) = (self.charge, self.charge + used, 2 * self.charge + used);
            for (at, value) in [(14, start), (18, stop), (22, end), (26, end)] {
                put(curve + at, &(if own { value } else { 0 } as u32).to_le_bytes());
            }
        }
        self.put.iter().for_each(|(at, field)| put(*at, field));
        let mark = if self.big_endian { b"\xf0\xf0" } else { b"\x0f\x0f" };
        bytes[..2].copy_from_slice(mark);
        bytes[2..10].copy_from_slice(format!(":WFM#{:03}", self.version).as_bytes());
        let texts = [(40, &b"Ch 3"[..]), (layout.explicit + 20, b"V"), (layout.implicit + 20, b"s")];
        for (at, text) in texts.into_iter().filter(|(at, _)| self.put.iter().all(|(put, _)| put != at)) {
            bytes[at..at + text.len()].copy_from_slice(text);
        }
        for codes in &self.frames {
            bytes.resize(bytes.len() + self.charge, 0x55);
            let swapped = codes.chunks(self.width).flat_map(|code| code.iter().rev().copied().collect::<Vec<_>>());
            bytes.extend(if self.big_endian { swapped.collect() } else { codes.clone() });
            bytes.resize(bytes.len() + self.charge, 0x55);
        }
        if self.checksum {
            let sum: u64 = bytes.iter().copied().map(u64::from).sum();
            bytes.extend(if self.big_endian { sum.to_be_bytes() } else { sum.to_le_bytes() });
            bytes.extend(&self.trailer);
        }
        bytes
    }

    fn read(&self) -> Result<Vec<(Record, Vec<f64>)>, String> {
        read(&TekWfm, &self.bytes())
    }
}

/// The sum of all bytes before `end`, written there.
fn summed(mut bytes: Vec<u8>, end: usize, big_endian: bool) -> Vec<u8> {
    if let Some((before, behind)) = bytes.split_at_mut_checked(end)
        && let Some(place) = behind.get_mut(..8)
    {
        let sum: u64 = before.iter().copied().map(u64::from).sum();
        place.copy_from_slice(&if big_endian { sum.to_be_bytes() } else { sum.to_le_bytes() });
    }
    bytes
}

fn entry(key: &str, value: &[u8]) -> Vec<u8> {
    let length = |bytes: usize| (bytes as u32).to_le_bytes();
    [&length(key.len()), key.as_bytes(), &[1], &length(value.len()), value].concat()
}

#[test]
fn all_versions_are_read_in_both_byte_orders() {
    for (version, big_endian, own_curves) in
        [1, 2, 3].into_iter().flat_map(|v| [(v, false, false), (v, true, false), (v, true, true), (v, false, true)])
    {
        let records = Built { own_curves, ..Built::new(version, big_endian, 3) }.read().unwrap();
        assert_eq!(records.len(), 3);
        for (i, (record, volts)) in records.iter().enumerate() {
            assert_eq!(*volts, [10.0 + 0.5 * i as f64, 9.0, 160.0]);
            assert!((record.t0_s.unwrap() - (-1e-9 + 0.25e-10 * i as f64)).abs() < 1e-24);
            assert!((record.trigger_s.unwrap() - (10.0 * i as f64 + 1e-9 * i as f64)).abs() < 1e-14);
            assert_eq!((record.segment, record.head.kind), (Some(i as u32), Kind::Waveform));
        }
        let head = &records[0].0.head;
        assert_eq!((head.channel.as_deref(), head.unit.as_deref(), head.dt_s), (Some("Ch 3"), Some("V"), Some(1e-10)));
        assert_eq!((head.header_gain, head.header_offset, head.rails), (Some(0.5), Some(10.0), None));
        assert_eq!(head.acquired_at.as_deref(), Some("2001-09-09T01:46:40.750000000000Z"));
        let (record, _) = Built::new(version, big_endian, 1).read().unwrap().remove(0);
        assert_eq!((record.segment, record.trigger_s), (None, None));
    }
}

#[test]
fn all_formats_of_codes_are_read() {
    let is = |format: i32, codes: &[u8], width: usize, code_type: CodeType, value: f64| {
        for (version, big_endian) in [(1, false), (2, true), (3, false), (3, true)] {
            let built = Built::new(version, big_endian, 1).of(format, width, codes);
            if format > 5 && version < 3 {
                assert!(built.read().unwrap_err().contains("is none of WFM#00"));
                continue;
            }
            let (record, values) = built.read().unwrap().remove(0);
            assert_eq!((record.head.code_type, values), (code_type, vec![10.0 + 0.5 * value]));
            assert_eq!(record.head.rails, code_type.limits().filter(|_| width == 1));
        }
    };
    is(0, &(-300_i16).to_le_bytes(), 2, CodeType::I16, -300.0);
    is(1, &(-70_000_i32).to_le_bytes(), 4, CodeType::I32, -70_000.0);
    is(2, &3_000_000_000_u32.to_le_bytes(), 4, CodeType::U32, 3e9);
    is(4, &0.375_f32.to_le_bytes(), 4, CodeType::F32, 0.375);
    is(5, &1e-40_f64.to_le_bytes(), 8, CodeType::F64, 1e-40);
    is(6, &[200], 1, CodeType::U8, 200.0);
    is(7, &[0x80], 1, CodeType::I8, -128.0);
    assert!(Built::new(3, false, 1).of(3, 8, &[0; 8]).read().unwrap_err().contains("64 bits"));
}

#[test]
fn records_that_are_no_waveforms_are_named() {
    let built = || Built::new(3, false, 1);
    let trailer =
        |entries: &[Vec<u8>]| [&b"tekmeta!"[..], &(entries.len() as u32).to_le_bytes(), &entries.concat()].concat();
    let kind = |built: Built| built.read().unwrap().remove(0).0.head;
    let digital = kind(built().with(122, &[6, 0, 0, 0]).with(168 + 20, &[0]));
    assert_eq!((digital.kind, digital.unit.as_deref()), (Kind::Digital, Some("logic")));
    assert_eq!(kind(built().with(168 + 76, &[1])).kind, Kind::Envelope);
    assert_eq!(kind(built().with(488 + 20, b"Hz")).kind, Kind::Spectrum);
    assert_eq!(kind(built().with(760 + 8, &[1])).kind, Kind::Spectrum);
    let trailed = |trailer: Vec<u8>| kind(Built { trailer, ..built().with(40, &[0]) });
    assert_eq!(trailed(trailer(&[entry("x", b""), entry("d0", b"")])).kind, Kind::Digital);
    assert_eq!(trailed([b"\n\0".to_vec(), trailer(&[entry("IQ_span", b"1")])].concat()).kind, Kind::Iq);
    assert_eq!(trailed(trailer(&[entry("waveform_label", b"laser")])).channel.as_deref(), Some("laser"));
    assert_eq!(trailed(b"something else".to_vec()).channel, None);
    for summary in [1, 2] {
        let records = Built { summary, ..Built::new(2, true, 3) }.read().unwrap();
        let kinds: Vec<_> = records.iter().map(|(record, _)| (record.head.kind, record.trigger_s.is_some())).collect();
        let last = if summary == 1 { Kind::Average } else { Kind::Envelope };
        assert_eq!(kinds, [(Kind::Waveform, true), (Kind::Waveform, true), (last, false)]);
    }
    let rails = kind(built().with(168 + 92, &32_752_i16.to_le_bytes()).with(168 + 96, &i16::MIN.to_le_bytes())).rails;
    assert_eq!(rails, Some((-32_768.0, 32_752.0)));
}

#[test]
fn fields_that_make_no_sense_are_named() {
    let nan = f64::NAN.to_le_bytes();
    for (at, value, says) in [
        (0, &b"\x0f\xf0"[..], "byte order mark"),
        (9, b"9", "WFM#009"),
        (15, &[4], "bytes per point = 4"),
        (16, &[0; 4], "curve buffer = 0"),
        (16, &[0xff; 4], "curve buffer = -1"),
        (72, &[0xfe, 0xff, 0xff, 0xff], "FastFrames minus one = 4294967294"),
        (114, &[2], "implicit dimension count = 2"),
        (118, &[2], "explicit dimension count = 2"),
        (122, &[5], "data type 5"),
        (168, &nan, "scale of the explicit dimension = NaN"),
        (168, &[0; 8], "scale of the explicit dimension = 0"),
        (176, &nan, "offset of the explicit dimension = NaN"),
        (168 + 72, &[9], "format 9"),
        (168 + 76, &[2], "histogram"),
        (488, &nan, "scale of the implicit dimension = NaN"),
        (488, &[0; 8], "not positive"),
        (496, &nan, "offset of the implicit dimension = NaN"),
        (508, b"m", "over \"m\""),
        (788, &nan, "TT offset = NaN"),
        (788, &f64::MAX.to_le_bytes(), "checksum"),
        (796, &f64::INFINITY.to_le_bytes(), "fractional second = inf"),
        (822, &[0xff; 4], "data start offset 4294967295"),
        (826, &[0xff; 4], "curve buffer of 14"),
        (834, &[0xff; 4], "cut short"),
    ] {
        let mut bytes = Built::new(3, false, 1).bytes();
        bytes[at..at + value.len()].copy_from_slice(value);
        let error = read(&TekWfm, &bytes).unwrap_err();
        assert!(error.contains(says), "{at}: {error}");
    }
    assert!(Built { summary: 3, ..Built::new(3, false, 2) }.read().unwrap_err().contains("summary frame type 3"));
    let mut unequal = Built { own_curves: true, ..Built::new(3, false, 2) }.bytes();
    unequal[838 + 24 + 18] -= 2;
    assert!(read(&TekWfm, &unequal).unwrap_err().contains("frame 1 has 4 bytes of samples"));
    assert!(read(&TekWfm, b"RIGOL").unwrap_err().contains("no WFM# mark"));
}

#[test]
fn a_file_that_was_cut_or_changed_is_refused() {
    for built in [
        Built::new(3, false, 1),
        Built::new(1, true, 3),
        Built { own_curves: true, ..Built::new(2, false, 2) },
        Built { checksum: false, ..Built::new(3, true, 2) },
        Built { trailer: b"tekmeta!\x01\0\0\0\x01\0\0\0x\x02\x01\0\0\0".to_vec(), ..Built::new(3, false, 1) },
    ] {
        cut_everywhere(&TekWfm, &built.bytes());
        let mut flipped = built.bytes();
        let sample = built.curves_end() - built.charge - 1;
        flipped[sample] ^= 1;
        assert_eq!(read(&TekWfm, &flipped).is_err(), built.checksum);
    }
    let cut = Built { trailer: b"tekmeta!\x01\0\0\0\x01\0\0\0x\x02\x01\0".to_vec(), ..Built::new(3, false, 1) };
    assert!(cut.read().unwrap_err().contains("trailer is cut"));
}

/// Whatever is missing of the last frame: those before it are whole, and one remark says so.
#[test]
fn a_file_that_ends_within_its_last_frame_gives_the_frames_before() {
    for built in
        [Built::new(3, false, 3), Built::new(1, true, 3), Built { own_curves: true, ..Built::new(2, false, 3) }]
    {
        let (bytes, whole) = (built.bytes(), crate::hostile::decode(&TekWfm, &built.bytes()));
        for missing in 1..built.frames[0].len() + 2 * built.charge {
            let mut source = crate::hostile::source(&bytes[..built.curves_end() - missing]);
            let crate::Contents { records, remarks } = crate::contents(&mut source).unwrap();
            assert_eq!(records.len(), 2, "{missing} bytes are missing");
            for (record, (_, values)) in records.iter().zip(&whole) {
                assert_eq!(source.values(record).unwrap(), *values);
            }
            assert!(remarks[0].is_cut && remarks[0].problem.contains("it ends within frame 2"), "{remarks:?}");
        }
    }
}

#[test]
fn damaged_files_never_claim_what_they_do_not_hold() {
    for built in [
        Built { trailer: [b"tekmeta!\x01\0\0\0".to_vec(), entry("IQ", b"12")].concat(), ..Built::new(3, false, 1) },
        Built { own_curves: true, ..Built::new(2, true, 4) },
        Built::new(1, false, 4),
    ] {
        let (end, big_endian) = (built.curves_end(), built.big_endian);
        let repair = |bytes: &mut Vec<u8>| *bytes = summed(std::mem::take(bytes), end, big_endian);
        assert!(damage(&TekWfm, &built.bytes(), 4000, repair) > 0, "some edits are harmless");
        damage(&TekWfm, &built.bytes(), 500, |_| {});
    }
}

#[test]
fn bytes_are_summed() {
    for length in [0, 1, 7, 8, 9, 1023, 1024, 1025, 5000] {
        let bytes: Vec<u8> = (0..length).map(|i| if i % 5 == 0 { 0xff } else { (i * 37 % 256) as u8 }).collect();
        assert_eq!(sum_of_bytes(&bytes), bytes.iter().copied().map(u64::from).sum::<u64>());
    }
    assert_eq!(sum_of_bytes(&[0xff; 10_000]), 2_550_000);
}

#[test]
fn dates_follow_the_calendar() {
    assert_eq!(acquired_at((951_782_400, 0.5)).unwrap(), "2000-02-29T00:00:00.500000000000Z");
    assert_eq!(acquired_at((1_767_225_599, 0.0)).unwrap(), "2025-12-31T23:59:59.000000000000Z");
    assert_eq!(acquired_at((i32::MAX, 1.0 - f64::EPSILON)).unwrap(), "2038-01-19T03:14:07.999999999999Z");
    assert_eq!((acquired_at((0, 0.5)), acquired_at((-1, 0.5)), acquired_at((1, 1.5))), (None, None, None));
}

#[test]
fn what_is_written_is_read_back() {
    for (bits, frames) in [(8, 1), (8, 3), (12, 1), (12, 5)] {
        let head = FrameHead {
            label: "CH2".to_owned(),
            gain_v: 3.9e-5,
            offset_v: -0.25,
            dt_s: 4e-11,
            bits,
            acquired: (1_780_000_000, 0.9),
        };
        let frame = |i: usize| {
            let codes = [-128, 0, 127, i as i16].map(|code: i16| if bits == 8 { code } else { code * 16 });
            (0.3 * i as f64 + 1e-12, -2.000_000_123e-6 + 3.97e-11 * ((i * 7 % 10) as f64 / 10.0), codes.to_vec())
        };
        let frames: Vec<_> = (0..frames).map(frame).collect();
        let mut bytes = Vec::new();
        write(&mut bytes, &head, &frames).unwrap();
        let records = read(&TekWfm, &bytes).unwrap();
        assert_eq!(records.len(), frames.len());
        for ((record, volts), (trigger_s, t0_s, codes)) in records.iter().zip(&frames) {
            let expected: Vec<_> = codes.iter().map(|&code| 3.9e-5 * f64::from(code) - 0.25).collect();
            assert_eq!(*volts, expected);
            assert!((record.t0_s.unwrap() - t0_s).abs() < 1e-20);
            if frames.len() > 1 {
                assert!((record.trigger_s.unwrap() - (trigger_s - frames[0].0)).abs() < 1e-15);
            }
        }
        let head = &records[0].0.head;
        let rails = if bits == 8 { (-128.0, 127.0) } else { (-32_768.0, 32_752.0) };
        assert_eq!((head.channel.as_deref(), head.rails, head.dt_s), (Some("CH2"), Some(rails), Some(4e-11)));
        assert!(head.acquired_at.as_deref().unwrap().starts_with("2026-05-28T20:26:40.900000000001"));
        cut_everywhere(&TekWfm, &bytes);
    }
}
