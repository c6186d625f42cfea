use super::walk::WAVEFORM;
use super::*;
use crate::hostile::{cut_everywhere, damage, read};
use crate::waveform::Kind;

/// A file of Keysight's or Rigol's layout.
pub(crate) struct Built {
    /// `AG10` and the like; a version 03 has sizes of 64 bits.
    pub cookie: &'static str,
    pub waveforms: Vec<Waveform>,
    /// Bytes behind the last waveform, counted by the file size or not.
    pub counted: usize,
    pub uncounted: usize,
}

/// One waveform: fields as in its header, and its buffers with type, bytes per point and bytes.
#[derive(Clone)]
pub(crate) struct Waveform {
    pub header_bytes: usize,
    pub kind: u32,
    pub points: u32,
    pub increment: f64,
    pub origin: f64,
    pub units: (u32, u32),
    pub texts: [&'static str; 4],
    pub tag_s: f64,
    pub index: u32,
    pub buffers: Vec<(u16, u16, Vec<u8>)>,
}

impl Waveform {
    /// Three samples of channel 1.
    pub fn new(label: &'static str, volts: [f32; 3]) -> Self {
        Self {
            header_bytes: 140,
            kind: 1,
            points: 3,
            increment: 1e-9,
            origin: -2.5e-9,
            units: (2, 1),
            texts: ["12 MAY 2026", "13:05:10", "DSO9404A:MY1234", label],
            tag_s: 0.0,
            index: 0,
            buffers: vec![(1, 4, bytes(&volts))],
        }
    }

    pub fn segment(self, index: u32, tag_s: f64) -> Self {
        Self { tag_s, index, ..self }
    }
}

fn bytes(volts: &[f32]) -> Vec<u8> {
    volts.iter().flat_map(|volts| volts.to_le_bytes()).collect()
}

impl Built {
    pub fn new(cookie: &'static str, waveforms: Vec<Waveform>) -> Self {
        Self { cookie, waveforms, counted: 0, uncounted: 0 }
    }

    pub fn bytes(&self) -> Vec<u8> {
        let wide = self.cookie.ends_with("03");
        let size =
            |bytes: usize| if wide { bytes.to_le_bytes().to_vec() } else { (bytes as u32).to_le_bytes().to_vec() };
        let mut body = Vec::new();
        for waveform in &self.waveforms {
            let mut header = vec![0; waveform.header_bytes.max(WAVEFORM)];
            let mut put = |at: usize, field: &[u8]| header[at..at + field.len()].copy_from_slice(field);
            put(0, &(waveform.header_bytes as u32).to_le_bytes());
            put(4, &waveform.kind.to_le_bytes());
            put(8, &(waveform.buffers.len() as u32).to_le_bytes());
            put(12, &waveform.points.to_le_bytes());
            put(32, &waveform.increment.to_le_bytes());
            put(40, &waveform.origin.to_le_bytes());
            put(48, &waveform.units.0.to_le_bytes());
            put(52, &waveform.units.1.to_le_bytes());
            [56, 72, 88, 112].iter().zip(waveform.texts).for_each(|(at, text)| put(*at, text.as_bytes()));
            put(128, &waveform.tag_s.to_le_bytes());
            put(136, &waveform.index.to_le_bytes());
            body.extend(&header[..waveform.header_bytes]);
            for (what, width, codes) in &waveform.buffers {
                let header = if wide { 20_u32 } else { 12 };
                body.extend(header.to_le_bytes());
                body.extend(what.to_le_bytes());
                body.extend(width.to_le_bytes());
                body.extend(size(codes.len()));
                body.resize(body.len() + if wide { 4 } else { 0 }, 0);
                body.extend(codes);
            }
        }
        body.resize(body.len() + self.counted, 0x0a);
        let total = 4 + size(0).len() + 4 + body.len();
        let count = (self.waveforms.len() as u32).to_le_bytes();
        body.resize(body.len() + self.uncounted, 0x0a);
        [self.cookie.as_bytes(), &size(total), &count, &body].concat()
    }

    fn read(&self) -> Result<Vec<(Record, Vec<f64>)>, String> {
        read(&KeysightBin, &self.bytes())
    }
}

fn one(waveform: Waveform) -> Result<(Record, Vec<f64>), String> {
    Built::new("AG10", vec![waveform]).read().map(|mut records| records.remove(0))
}

#[test]
fn all_versions_and_header_sizes_are_read() {
    for (cookie, header_bytes) in ["AG01", "AG03", "AG10"].into_iter().flat_map(|c| [(c, 128), (c, 140), (c, 156)]) {
        let waveform = |label, volts| Waveform { header_bytes, ..Waveform::new(label, volts) };
        let built = Built::new(cookie, vec![waveform("1", [1.0, -2.5, 0.0]), waveform("", [7.0, 8.0, 9.0])]);
        let records = built.read().unwrap();
        assert_eq!([&records[0].1[..], &records[1].1[..]], [[1.0, -2.5, 0.0], [7.0, 8.0, 9.0]]);
        let (record, _) = &records[0];
        assert_eq!((record.t0_s, record.segment, record.trigger_s), (Some(-2.5e-9), None, None));
        let head = &record.head;
        assert_eq!((head.kind, head.dt_s, head.unit.as_deref()), (Kind::Waveform, Some(1e-9), Some("V")));
        assert_eq!((head.channel.as_deref(), head.instrument.as_deref()), (Some("1"), Some("DSO9404A")));
        assert_eq!(head.acquired_at.as_deref(), Some("2026-05-12T13:05:10"));
        assert_eq!(records[1].0.head.channel.as_deref(), Some("wf1"));
        cut_everywhere(&KeysightBin, &built.bytes());
    }
}

#[test]
fn segments_are_numbered_within_their_channel() {
    for (first, labels) in [(1, ["1", "2"]), (0, ["1", "2"]), (1, ["", ""])] {
        let waveforms = labels.into_iter().flat_map(|label| {
            (0..3).map(move |i| {
                let segment = Waveform::new(label, [i as f32, 0.0, 1.0]).segment(first + i, 0.5 + 1e-3 * f64::from(i));
                Waveform { origin: -2.5e-9 + 1e-12 * f64::from(i), ..segment }
            })
        });
        let records = Built::new("AG10", waveforms.collect()).read().unwrap();
        for (i, (record, volts)) in records.iter().enumerate() {
            let (channel, segment) = (i / 3, (i % 3) as u32);
            let name = if labels[channel].is_empty() { format!("wf{channel}") } else { labels[channel].to_owned() };
            assert_eq!((record.segment, record.head.channel.as_deref()), (Some(segment), Some(name.as_str())));
            assert!((record.trigger_s.unwrap() - 1e-3 * f64::from(segment)).abs() < 1e-15);
            assert_eq!(record.t0_s, Some(-2.5e-9 + 1e-12 * f64::from(segment)));
            assert_eq!(volts[0], f64::from(segment));
            assert!(Arc::ptr_eq(&record.head, &records[3 * channel].0.head));
        }
    }
    // Segments of channels in turn, without time tags.
    let waveforms = (0..4).map(|i| Waveform::new(["a", "b"][i % 2], [0.0; 3]).segment(1 + i as u32 / 2, 0.0)).collect();
    let records = Built::new("AG01", waveforms).read().unwrap();
    let segments: Vec<_> = records.iter().map(|(record, _)| (record.segment, record.trigger_s)).collect();
    assert_eq!(segments, [(Some(0), None), (Some(0), None), (Some(1), None), (Some(1), None)]);
    // One saved segment, and two channels of one label, are no segments.
    assert_eq!(one(Waveform::new("1", [0.0; 3]).segment(7, 1.0)).unwrap().0.segment, None);
    let same = Built::new("AG10", vec![Waveform::new("a", [0.0; 3]), Waveform::new("a", [0.0; 3])]).read().unwrap();
    assert!(same.iter().all(|(record, _)| record.segment.is_none()));
}

#[test]
fn kinds_follow_types_and_units() {
    let wave = |kind| Waveform { kind, ..Waveform::new("1", [1.0, 2.0, 3.0]) };
    let head = |waveform| one(waveform).unwrap().0.head;
    assert_eq!([0, 1, 3].map(|kind| head(wave(kind)).kind), [Kind::Waveform, Kind::Waveform, Kind::Average]);
    let spectrum = one(Waveform { units: (6, 5), ..wave(1) }).unwrap().0;
    assert_eq!((spectrum.head.kind, spectrum.head.unit.as_deref()), (Kind::Spectrum, Some("dB")));
    let unknown = one(Waveform { units: (0, 3), ..wave(1) }).unwrap().0;
    assert_eq!((unknown.t0_s, unknown.head.dt_s, unknown.head.unit.as_deref()), (Some(-2.5e-9), Some(1e-9), None));
    let logic = Waveform { units: (2, 0), buffers: vec![(6, 1, vec![0, 1, 255])], ..wave(1) };
    let (record, values) = one(logic.clone()).unwrap();
    assert_eq!(
        (record.head.kind, record.head.unit.as_deref(), &values[..]),
        (Kind::Digital, Some("?"), &[0.0, 1.0, 255.0][..])
    );
    assert_eq!(head(Waveform { kind: 6, ..logic }).kind, Kind::Digital);
    let extremes = vec![(2, 4, bytes(&[4.0, 5.0, 6.0])), (3, 4, bytes(&[1.0, 2.0, 3.0]))];
    let built = Built::new("AG03", vec![Waveform { buffers: extremes, ..wave(2) }]);
    let records = built.read().unwrap();
    let kinds: Vec<_> = records.iter().map(|(r, v)| (r.head.kind, r.head.channel.as_deref().unwrap(), v[0])).collect();
    assert_eq!(kinds, [(Kind::Envelope, "1 max", 4.0), (Kind::Envelope, "1 min", 1.0)]);
    cut_everywhere(&KeysightBin, &built.bytes());
    for unfilled in ["", "               "] {
        let blank = Waveform { texts: [unfilled, unfilled, unfilled, "1"], ..wave(1) };
        assert_eq!((head(blank.clone()).acquired_at.as_ref(), head(blank).instrument.as_ref()), (None, None));
    }
}

#[test]
fn fields_that_make_no_sense_are_named() {
    let base = || Waveform::new("1", [0.0; 3]);
    for (waveform, says) in [
        (Waveform { header_bytes: 100, ..base() }, "Header Size = 100"),
        (Waveform { kind: 4, ..base() }, "Waveform Type 4"),
        (Waveform { buffers: Vec::new(), ..base() }, "Number of Waveform Buffers = 0"),
        (Waveform { points: 4, ..base() }, "Points = 4"),
        (Waveform { points: 2, ..base() }, "Points = 2"),
        (Waveform { points: 0, buffers: vec![(1, 4, Vec::new())], ..base() }, "Points = 0"),
        (Waveform { increment: 0.0, ..base() }, "X Increment = 0"),
        (Waveform { increment: f64::NAN, ..base() }, "X Increment = NaN"),
        (Waveform { origin: f64::INFINITY, ..base() }, "X Origin = inf"),
        (Waveform { units: (1, 1), ..base() }, "over V"),
        (Waveform { units: (9, 1), ..base() }, "an unknown unit"),
        (Waveform { tag_s: f64::NAN, ..base() }, "Time Tag = NaN"),
        (Waveform { buffers: vec![(4, 4, vec![0; 12])], ..base() }, "Buffer Type 4"),
        (Waveform { buffers: vec![(1, 8, vec![0; 24])], ..base() }, "8 Bytes Per Point"),
    ] {
        let error = one(waveform).unwrap_err();
        assert!(error.contains(says) && error.starts_with("byte "), "{error}");
    }
    let good = Built::new("AG10", vec![base(), base()]).bytes();
    for (at, value, says) in [
        (0, &b"AX"[..], "no cookie AG"),
        (2, b"77", "version \"77\""),
        (4, &[0xff; 4], "cut short: the whole file"),
        (8, &[0xff, 0xff, 0xff, 0x7f], "Number of Waveforms = 2147483647"),
        (8, &[0], "Number of Waveforms = 0"),
        (8, &[1], "164 bytes follow"),
        (8, &[3], "Number of Waveforms = 3"),
        (12, &[0xff; 4], "the waveform header needs 4294967295"),
        (152, &[0xff; 4], "the waveform data header needs 4294967295"),
        (152, &[4], "Waveform Data Header Size = 4"),
        (160, &[0xff; 4], "the waveform buffer needs 4294967295"),
    ] {
        let mut bytes = good.clone();
        bytes[at..at + value.len()].copy_from_slice(value);
        let error = read(&KeysightBin, &bytes).unwrap_err();
        assert!(error.contains(says), "{at}: {error}");
    }
    assert!(Built { uncounted: 2, ..Built::new("AG10", vec![base()]) }.read().is_ok(), "the file says where it ends");
    assert!(Built { counted: 2, ..Built::new("AG10", vec![base()]) }.read().unwrap_err().contains("2 bytes follow"));
}

/// Whole waveforms before a cut are read, with one remark; a time base without a unit is one of seconds, with another.
#[test]
fn what_the_waveforms_do_not_show_is_remarked() {
    let bytes = Built::new("AG10", (0..3).map(|i| Waveform::new("1", [1.0; 3]).segment(i, 0.0)).collect()).bytes();
    let mut cut = crate::hostile::source(&bytes[..bytes.len() - 3]);
    let contents = crate::contents(&mut cut).unwrap();
    assert_eq!((contents.records.len(), contents.remarks.len()), (2, 1));
    assert!(contents.remarks[0].problem.contains("within waveform 2"), "{:?}", contents.remarks);
    let unknown = Waveform { units: (0, 0), ..Waveform::new("1", [1.0; 3]) };
    let remarks =
        crate::contents(&mut crate::hostile::source(&Built::new("AG10", vec![unknown]).bytes())).unwrap().remarks;
    assert_eq!((remarks.len(), remarks[0].byte_offset), (1, 60));
}

#[test]
fn records_do_not_outgrow_their_file() {
    let tiny = Waveform { points: 1, buffers: vec![(6, 1, vec![0]); 3], ..Waveform::new("1", [0.0; 3]) };
    assert_eq!(Built::new("AG10", vec![tiny.clone(); 300]).read().unwrap().len(), 900);
    assert!(Built::new("AG10", vec![tiny; 400]).read().unwrap_err().contains("1001 waveforms in"));
}

#[test]
fn damaged_files_never_claim_what_they_do_not_hold() {
    let segments = (0..3).map(|i| Waveform::new("1", [1.0; 3]).segment(i, f64::from(i))).collect();
    let extremes = vec![(2, 4, bytes(&[4.0, 5.0, 6.0])), (3, 4, bytes(&[1.0, 2.0, 3.0]))];
    let peaks = vec![Waveform { buffers: extremes, ..Waveform::new("", [0.0; 3]) }; 2];
    for built in [Built::new("AG10", segments), Built::new("AG03", peaks)] {
        assert!(damage(&KeysightBin, &built.bytes(), 5000, |_| {}) > 0, "some edits are harmless");
    }
}

#[test]
fn what_is_written_is_read_back() {
    let head = VoltsHead { instrument: "MSOX6004A:SIM".to_owned(), label: "2".to_owned(), dt_s: 5e-11 };
    for count in [1, 4] {
        let segment =
            |i: usize| (0.1 * i as f64 + 1e-13, -1.000_000_123e-6 + 1e-12 * i as f64, vec![0.1 * i as f32, -0.3]);
        let segments: Vec<_> = (0..count).map(segment).collect();
        let mut bytes = Vec::new();
        write(&mut bytes, &head, &segments).unwrap();
        let records = read(&KeysightBin, &bytes).unwrap();
        assert_eq!(records.len(), count);
        for (i, ((record, values), (trigger_s, t0_s, volts))) in records.iter().zip(&segments).enumerate() {
            assert_eq!((record.t0_s, record.head.dt_s), (Some(*t0_s), Some(5e-11)));
            assert_eq!(*values, volts.iter().copied().map(f64::from).collect::<Vec<_>>());
            assert_eq!(record.segment, (count > 1).then_some(i as u32));
            assert_eq!(record.trigger_s, (count > 1).then_some(trigger_s - segments[0].0));
            assert_eq!(record.head.instrument.as_deref(), Some("MSOX6004A"));
        }
        cut_everywhere(&KeysightBin, &bytes);
    }
}
