use super::tags::{BOOLEAN, DATE, FLOAT, INTEGER, TAG_BYTES, TEXT, iso};
use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal};
use crate::waveform::Kind;

/// 2019-06-14 13:30:15.250 in days since 1899-12-30.
const WHEN: f64 = 43_630.0 + (13.0 * 3600.0 + 30.0 * 60.0 + 15.25) / 86_400.0;

fn with(bytes: &mut Vec<u8>, name: &str, index: i32, kind: u32, value: u64) {
    let start = bytes.len();
    bytes.extend(name.as_bytes());
    bytes.resize(start + 32, 0);
    bytes.extend(index.to_le_bytes());
    bytes.extend(kind.to_le_bytes());
    bytes.extend(value.to_le_bytes());
}

/// Magic, what every file has, and a tag that is not read.
fn start(magic: &[u8]) -> Vec<u8> {
    let mut bytes = magic.to_vec();
    bytes.extend(b"1.0.00\0\0");
    with(&mut bytes, "File_Comment", WHOLE, 0x4002_FFFF, 8);
    bytes.extend(b"h\0i\0\0\0\0\0");
    with(&mut bytes, "File_CreatingTime", WHOLE, DATE, WHEN.to_bits());
    with(&mut bytes, "HW_Type", WHOLE, TEXT, 16);
    bytes.extend(b"HydraHarp 400\0\0\0");
    with(&mut bytes, "MeasDesc_Resolution", WHOLE, FLOAT, 4e-12_f64.to_bits());
    bytes
}

/// Curves of these channels, each of three bins that count up from ten times its index.
fn phu(channels: &[u64]) -> Vec<u8> {
    let mut bytes = start(HISTOGRAMS);
    with(&mut bytes, "HistoResult_BitsPerBin", WHOLE, INTEGER, 32);
    with(&mut bytes, "HistoResult_NumberOfCurves", WHOLE, INTEGER, channels.len() as u64);
    let data = bytes.len() as u64 + TAG_BYTES * (5 * channels.len() as u64 + 1);
    for (index, channel) in (0_i32..).zip(channels) {
        let offset = data + 12 * u64::from(index.cast_unsigned());
        with(&mut bytes, "HistResDscr_HWInpChanIdx", index, INTEGER, *channel);
        with(&mut bytes, "HistResDscr_MDescResolution", index, FLOAT, 8e-12_f64.to_bits());
        with(&mut bytes, "HistResDscr_MDescOffset", index, INTEGER, 5);
        with(&mut bytes, "HistResDscr_HistogramBins", index, INTEGER, 3);
        with(&mut bytes, "HistResDscr_DataOffset", index, INTEGER, offset);
    }
    with(&mut bytes, "Header_End", WHOLE, 0xFFFF_0008, 0);
    for index in 0..channels.len() as u32 {
        bytes.extend([10 * index, 10 * index + 1, 70_000].iter().flat_map(|count| count.to_le_bytes()));
    }
    bytes
}

fn ptu(record_type: u64, events: &[u32]) -> Vec<u8> {
    image(record_type, &[], events)
}

/// The same with tags of an image.
fn image(record_type: u64, tags: &[(&str, u32, u64)], events: &[u32]) -> Vec<u8> {
    let mut bytes = start(EVENTS);
    tags.iter().for_each(|(name, kind, value)| with(&mut bytes, name, WHOLE, *kind, *value));
    with(&mut bytes, "TTResultFormat_TTTRRecType", WHOLE, INTEGER, record_type);
    with(&mut bytes, "TTResultFormat_BitsPerRecord", WHOLE, INTEGER, 32);
    with(&mut bytes, "TTResult_NumberOfRecords", WHOLE, INTEGER, events.len() as u64);
    with(&mut bytes, "Header_End", WHOLE, 0xFFFF_0008, 0);
    bytes.extend(events.iter().flat_map(|event| event.to_le_bytes()));
    bytes
}

fn pico_harp(channel: u32, time: u32, sync: u32) -> u32 {
    channel << 28 | time << 16 | sync
}

fn t2(special: u32, channel: u32, time: u32) -> u32 {
    special << 31 | channel << 25 | time
}

fn hydra_harp(special: u32, channel: u32, time: u32, sync: u32) -> u32 {
    special << 31 | channel << 25 | time << 10 | sync
}

/// Photons, overflows and markers of the newer record layout.
fn hydra_harp_events() -> Vec<u32> {
    vec![
        hydra_harp(0, 0, 2, 1000),
        hydra_harp(1, 63, 0, 2),
        hydra_harp(0, 1, 0, 5),
        hydra_harp(1, 3, 32767, 6),
        hydra_harp(0, 0, 2, 7),
        hydra_harp(0, 63, 4, 8),
        hydra_harp(0, 0, 0, 9),
    ]
}

#[test]
fn curves_are_read_where_they_lie() {
    let records = decode(&PicoquantPhu, &phu(&[0, 2]));
    assert_eq!(records[0].1, [0.0, 1.0, 70_000.0]);
    assert_eq!(records[1].1, [10.0, 11.0, 70_000.0]);
    let (record, head) = (&records[1].0, &records[1].0.head);
    assert_eq!((head.kind, head.channel.as_deref(), record.segment), (Kind::Counts, Some("2"), None));
    assert_eq!((head.dt_s, record.t0_s), (Some(8e-12), Some(5.0 * 1e-9)));
    assert_eq!(head.instrument.as_deref(), Some("HydraHarp 400"));
    assert_eq!(head.acquired_at.as_deref(), Some("2019-06-14T13:30:15.250"));
}

#[test]
fn curves_of_one_channel_are_its_segments() {
    let segments: Vec<_> = decode(&PicoquantPhu, &phu(&[1, 0, 1])).iter().map(|(record, _)| record.segment).collect();
    assert_eq!(segments, [Some(0), None, Some(1)]);
}

#[test]
fn photons_of_each_record_type_are_counted() {
    for record_type in [0x1_0304, 0x101_0304, 0x1_0305, 0x101_0306, 0x1_0307] {
        let records = decode(&PicoquantPtu, &ptu(record_type, &hydra_harp_events()));
        let counts: Vec<_> =
            records.iter().map(|(record, counts)| (record.head.channel.as_deref(), &counts[..])).collect();
        let expected: [(_, &[f64]); 3] = [
            (Some("0"), &[1.0, 0.0, 2.0, 0.0, 0.0]),
            (Some("1"), &[1.0, 0.0, 0.0, 0.0, 0.0]),
            (Some("63"), &[0.0, 0.0, 0.0, 0.0, 1.0]),
        ];
        assert_eq!(counts, expected);
        assert_eq!((records[0].0.head.dt_s, records[0].0.t0_s), (Some(4e-12), Some(0.0)));
    }
    let events = [pico_harp(1, 3, 0), pico_harp(15, 0, 0), pico_harp(15, 2, 9), pico_harp(4, 1, 7), pico_harp(1, 3, 8)];
    let records = decode(&PicoquantPtu, &ptu(0x1_0303, &events));
    assert_eq!(records[0].1, [0.0, 0.0, 0.0, 2.0]);
    assert_eq!((records[1].1.as_slice(), records[1].0.head.channel.as_deref()), (&[0.0, 1.0, 0.0, 0.0][..], Some("4")));
}

#[test]
fn more_events_than_a_piece_are_counted() {
    let events: Vec<u32> = (0..40_000).map(|event| hydra_harp(0, event % 3, event % 7, 0)).collect();
    let records = decode(&PicoquantPtu, &ptu(0x1_0307, &events));
    let total: f64 = records.iter().flat_map(|(_, counts)| counts).sum();
    assert_eq!((records.len(), total), (3, 40_000.0));
    assert_eq!(records[0].1[0], (0..40_000).filter(|event| event % 21 == 0).count() as f64);
}

/// Many events of T3 mode are counted in a table: as one by one, also in wider bins.
#[test]
fn a_table_of_counts_has_those_of_single_events() {
    let mut state = 1_u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 8
    };
    let count = 100_000;
    let pico_harps: Vec<u32> =
        (0..count).map(|_| pico_harp([1, 2, 4, 15][random() as usize % 4], random() % 3001, random() % 99)).collect();
    let hydra_harps: Vec<u32> =
        (0..count).map(|_| hydra_harp(random() / 9 % 2, random() % 64, random() % 2999, random() % 1024)).collect();
    let by_event = |record_type: u64, events: &[u32], of: usize, units: usize, bins: usize| {
        let (mut counts, mut clock) = (vec![0_u32; bins], Clock::new(Layout::of(record_type).unwrap()));
        for event in events {
            match clock.event(*event).unwrap() {
                Event::Photon(channel, time) if channel == of => counts[time as usize / units] += 1,
                _ => {}
            }
        }
        counts
    };
    for (record_type, events, channels) in [(0x1_0303, &pico_harps, 3), (0x1_0307, &hydra_harps, 64)] {
        let bytes: Vec<u8> = events.iter().flat_map(|event| event.to_le_bytes()).collect();
        let all = Events { byte_offset: 0, count: count as u64, layout: Layout::of(record_type).unwrap() };
        let table = Table::count(&all, &mut io::Cursor::new(bytes)).unwrap();
        let survey = table.survey(&all);
        assert_eq!(survey.channels.iter().filter(|is_there| **is_there).count(), channels);
        for (channel, units) in (0..64).filter(|channel| survey.channels[*channel]).zip([1, 3].into_iter().cycle()) {
            let bins = survey.times.div_ceil(units as u64) as usize;
            let expected: Vec<u8> =
                by_event(record_type, events, channel, units, bins).iter().flat_map(|n| n.to_le_bytes()).collect();
            assert_eq!(table.histogram(channel, bins, units), expected, "{record_type:#x} {channel}");
        }
    }
    // A file is counted so where the table is no larger than it.
    let (records, values) = described(&ptu(0x1_0303, &pico_harps), Some(4.0), None).unwrap();
    let counts = by_event(0x1_0303, &pico_harps, 1, 1, records[0].head.samples);
    assert_eq!(values[0], counts.iter().map(|count| f64::from(*count)).collect::<Vec<_>>());
    let few = Events { byte_offset: 0, count: count as u64, layout: Layout::of(0x1_0307).unwrap() };
    assert!(Table::of(&few, &mut io::empty()).unwrap().is_none());
    // A channel that a PicoHarp does not have is named as it is among few events.
    let mut damaged = vec![pico_harp(1, 3, 0); count];
    damaged[count - 1] = pico_harp(7, 0, 0);
    assert!(refusal(&PicoquantPtu, &ptu(0x1_0303, &damaged)).contains("channel 7"));
}

/// Times count from the last sync pulse, over any number of overflows; what comes before the first is left out.
#[test]
fn absolute_times_become_times_after_the_sync() {
    let events = [
        t2(0, 0, 3), // no sync yet
        t2(1, 0, 1 << 24),
        t2(0, 0, (1 << 24) + 2),
        t2(1, 5, 0), // a marker
        t2(1, 63, 2),
        t2(1, 0, 7),
        t2(0, 2, 7),
        t2(0, 0, 9),
        t2(1, 63, 0), // overflows of old software do not say how many: one
        t2(0, 2, 7),
    ];
    let records = decode(&PicoquantPtu, &ptu(0x101_0204, &events));
    let channels: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap()).collect();
    assert_eq!(channels, ["0", "2"]);
    // The last photon is 2^25 units after its sync pulse: 65,536 bins of 512 units would be one too few.
    assert_eq!((records[0].0.head.samples, records[0].0.head.dt_s), (32_769, Some(1024.0 * 4e-12)));
    assert_eq!(records[0].1[0], 2.0);
    assert_eq!((records[1].1[0], records[1].1[32_768]), (1.0, 1.0));
    let near = decode(&PicoquantPtu, &ptu(0x1_0206, &events[..8]));
    assert_eq!((near[0].0.head.dt_s, near[0].1.as_slice()), (Some(4e-12), &[0.0, 0.0, 2.0][..]));
    // A PicoHarp: channel 0 is the sync input, an overflow is channel 15 without markers.
    let pico = |channel: u32, time: u32| channel << 28 | time;
    let events = [pico(0, 210_698_239), pico(15, 0), pico(15, 1), pico(1, 3), pico(2, 1)];
    let records = decode(&PicoquantPtu, &ptu(0x1_0203, &events));
    assert_eq!(
        (records[0].1.as_slice(), records[1].1.as_slice()),
        (&[0.0, 0.0, 0.0, 0.0, 1.0][..], &[0.0, 0.0, 1.0, 0.0, 0.0][..])
    );
}

/// A measurement that was not ended has no number of events: they are counted by the length of the file.
#[test]
fn events_that_the_head_does_not_count_are_read() {
    let mut file = ptu(0x1_0307, &hydra_harp_events());
    let name = b"TTResult_NumberOfRecords";
    let at = file.windows(name.len()).position(|bytes| bytes == name).unwrap() + 40;
    file[at..at + 8].fill(0);
    assert_eq!(decode(&PicoquantPtu, &file).len(), 3);
    let mut source = crate::hostile::source(&file);
    let remarks = crate::contents(&mut source).unwrap().remarks;
    assert_eq!(remarks.len(), 1);
    assert!(remarks[0].problem.contains("was not ended"), "{remarks:?}");
}

#[test]
fn refusals_are_named() {
    let bad_phu = |name: &str, value: u64| {
        let mut file = phu(&[0, 1]);
        let at = file.windows(name.len()).position(|bytes| bytes == name.as_bytes()).unwrap();
        file[at + 40..at + 48].copy_from_slice(&value.to_le_bytes());
        refusal(&PicoquantPhu, &file)
    };
    for (name, value, says) in [
        ("HistoResult_NumberOfCurves", 0, "= 0: 1 to 1024"),
        ("HistoResult_NumberOfCurves", 3, "HistResDscr_HistogramBins(2) is missing"),
        ("HistoResult_NumberOfCurves", u64::MAX, "is negative"),
        ("HistoResult_BitsPerBin", 16, "only 32"),
        ("HistResDscr_HistogramBins", 0, "the curve is empty"),
        ("HistResDscr_HistogramBins", i64::MAX as u64, "cut short"),
        ("HistResDscr_DataOffset", i64::MAX as u64, "cut short"),
        ("HistResDscr_MDescResolution", 4.0_f64.to_bits(), "= 4 is no width"),
        ("HistResDscr_MDescResolution", f64::NAN.to_bits(), "= NaN is no width"),
        ("HW_Type", u64::MAX, "cut short"),
    ] {
        let error = bad_phu(name, value);
        assert!(error.contains(says), "{error}");
    }
    for (record_type, events, says) in [
        (0x1_0204, &[t2(0, 1, 5)][..], "no photon follows an event of the sync channel"),
        (0x77, &[], "0x00000077 is not known"),
        (0x1_0303, &[pico_harp(7, 0, 0)], "channel 7"),
        (0x1_0303, &[pico_harp(15, 0, 0)], "none of the events is a photon"),
    ] {
        let error = refusal(&PicoquantPtu, &ptu(record_type, events));
        assert!(error.contains(says), "{error}");
    }
    assert!(refusal(&PicoquantPtu, &phu(&[0])).contains("PQTTTR"));
}

#[test]
fn dates_are_those_of_the_calendar() {
    for (days, date) in [
        (36_526.0, "2000-01-01T00:00:00.000"),
        (36_585.0, "2000-02-29T00:00:00.000"),
        (45_657.999_999_99, "2024-12-31T23:59:59.999"),
        (73_109.5, "2100-02-28T12:00:00.000"),
        (73_110.0, "2100-03-01T00:00:00.000"),
    ] {
        assert_eq!(iso(days).as_deref(), Some(date));
    }
    assert_eq!((iso(0.0), iso(f64::NAN), iso(1e300)), (None, None, None));
}

#[test]
fn hostile_files_are_survived() {
    let file = phu(&[0, 1]);
    cut_everywhere(&PicoquantPhu, &file);
    change_anywhere(&PicoquantPhu, &file, 5000);
    let t2_events = ptu(0x101_0204, &[t2(1, 0, 1), t2(0, 3, 9), t2(1, 63, 1), t2(0, 0, 1)]);
    cut_everywhere(&PicoquantPtu, &t2_events);
    change_anywhere(&PicoquantPtu, &t2_events, 5000);
    for file in [ptu(0x1_0303, &[pico_harp(1, 3, 0), pico_harp(2, 1, 0)]), ptu(0x1_0307, &hydra_harp_events())] {
        cut_everywhere(&PicoquantPtu, &file);
        assert!(refusal(&PicoquantPtu, &file[..file.len() - 1]).contains("cut short"));
        change_anywhere(&PicoquantPtu, &file, 5000);
    }
}

fn described(file: &[u8], bin_ps: Option<f64>, marker: Option<u32>) -> Result<(Vec<Record>, Vec<Vec<f64>>), String> {
    let description = Description { bin_ps, marker, ..Description::default() };
    let mut source = crate::hostile::source(file).described(description);
    let contents = crate::contents(&mut source).map_err(|error| error.to_string())?;
    let remark = contents.remarks.first().map(|remark| remark.problem.clone());
    assert!(remark.is_none_or(|remark| remark.contains("1 photons come before the first marker")));
    let values = contents.records.iter().map(|record| source.values(record).unwrap()).collect();
    Ok((contents.records, values))
}

/// Each event of a marker begins a new histogram; in T2 mode times go on counting from the last sync pulse.
#[test]
fn markers_begin_histograms() {
    let events = [
        hydra_harp(0, 0, 2, 1), // before the first marker
        hydra_harp(1, 2, 0, 2), // marker 2
        hydra_harp(0, 0, 1, 3),
        hydra_harp(0, 0, 3, 3),
        hydra_harp(1, 1, 0, 4), // marker 1
        hydra_harp(1, 63, 0, 1),
        hydra_harp(0, 1, 3, 5),
        hydra_harp(1, 3, 0, 6), // markers 1 and 2
        hydra_harp(0, 0, 0, 7),
    ];
    let file = ptu(0x1_0307, &events);
    let (records, values) = described(&file, None, Some(2)).unwrap();
    let key = |record: &Record| (record.head.channel.clone().unwrap(), record.segment.unwrap());
    let keys: Vec<_> = records.iter().map(key).collect();
    assert_eq!(keys, [("0".to_owned(), 0), ("0".to_owned(), 1), ("1".to_owned(), 0), ("1".to_owned(), 1)]);
    assert_eq!(values[..2], [[0.0, 1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]]);
    assert_eq!(values[2..], [[0.0, 0.0, 0.0, 1.0], [0.0; 4]]);
    assert!(described(&file, None, Some(4)).unwrap_err().contains("`marker` = 4: no such marker"));
    let events = [t2(1, 0, 5), t2(0, 3, 6), t2(1, 1, 6), t2(0, 3, 8), t2(1, 1, 9), t2(1, 63, 1), t2(0, 3, 1)];
    let (records, values) = described(&ptu(0x101_0204, &events), None, Some(1)).unwrap();
    assert_eq!(records.len(), 2);
    assert_eq!((values[0][0], records[0].head.dt_s), (1.0, Some(512.0 * 4e-12)));
    assert_eq!(values[1].iter().rposition(|count| *count == 1.0), Some(((1 << 25) + 1 - 5) / 512));
}

/// Two lines of 60 sync pulses, marker 1 at their start and marker 2 at their end, in three pixels each; the sync
/// counter begins anew in the second one. Photons before, between and behind them count nowhere.
#[test]
fn lines_are_cut_into_pixels() {
    let syncs = |start: u32, pixels: [u32; 3]| -> Vec<u32> {
        let photons = (0..3).flat_map(move |pixel| (0..pixels[pixel as usize]).map(move |n| start + 20 * pixel + n));
        photons.map(|sync| hydra_harp(0, 0, 1, sync)).collect()
    };
    let mut events = vec![hydra_harp(0, 0, 1, 3), hydra_harp(1, 1, 0, 900)];
    events.extend(syncs(900, [2, 0, 3]));
    events.extend([hydra_harp(1, 2, 0, 960), hydra_harp(0, 0, 1, 970), hydra_harp(1, 1, 0, 1010)]);
    events.extend([
        hydra_harp(0, 0, 1, 1015),
        hydra_harp(1, 63, 0, 1),
        hydra_harp(0, 0, 1, 10),
        hydra_harp(0, 0, 2, 26),
    ]);
    events.extend([hydra_harp(1, 2, 0, 46), hydra_harp(0, 0, 1, 50)]);
    let pixels = |file: &[u8], marker: Option<u32>, pixels: u32| {
        let description = Description { marker, pixels: Some(pixels), ..Description::default() };
        let mut source = crate::hostile::source(file).described(description);
        let contents = crate::contents(&mut source).map_err(|error| error.to_string())?;
        let remarks: Vec<String> = contents.remarks.iter().map(|remark| remark.problem.clone()).collect();
        let counts = contents.records.iter().map(|record| source.values(record).unwrap().iter().sum::<f64>());
        Ok::<_, String>((counts.collect::<Vec<_>>(), remarks))
    };
    let stop = ("ImgHdr_LineStop", INTEGER, 2);
    let file = image(0x1_0305, &[stop], &events);
    let (counts, remarks) = pixels(&file, Some(1), 3).unwrap();
    assert_eq!(counts, [2.0, 0.0, 3.0, 1.0, 1.0, 1.0]);
    assert!(remarks.iter().any(|remark| remark.contains("3 photons lie outside of all lines")), "{remarks:?}");
    // Without a tag for their end, lines last until the next one, and the last as long as the one before.
    let (counts, _) = pixels(&image(0x1_0305, &[], &events), Some(1), 2).unwrap();
    assert_eq!(counts, [5.0, 1.0, 3.0, 1.0]);
    assert!(pixels(&file, None, 3).unwrap_err().contains("`pixels` cuts lines: give the marker"));
    assert!(pixels(&file, Some(4), 3).unwrap_err().contains("no such marker"));
    assert!(pixels(&file, Some(1), 1 << 20).unwrap_err().contains("too many for the file"));
    let backwards = image(0x1_0305, &[stop, ("ImgHdr_BiDirect", BOOLEAN, 1)], &events);
    assert!(pixels(&backwards, Some(1), 3).unwrap_err().contains("every other line runs backwards"));
    let single = [hydra_harp(1, 1, 0, 900), hydra_harp(0, 0, 1, 905)];
    assert!(pixels(&ptu(0x1_0305, &single), Some(1), 3).unwrap_err().contains("has no end"));
}

/// The time of events of each layout, as markers have it: overflows counted one by one, or many at a time.
#[test]
fn time_goes_on_over_overflows() {
    for (record_type, events, now) in [
        (0x1_0303, [pico_harp(15, 0, 0), pico_harp(15, 0, 0), pico_harp(15, 1, 7)], (2 << 16) + 7),
        (0x1_0304, [hydra_harp(1, 63, 0, 5), hydra_harp(1, 63, 0, 0), hydra_harp(1, 1, 0, 7)], (2 << 10) + 7),
        (0x101_0304, [hydra_harp(1, 63, 0, 5), hydra_harp(1, 63, 0, 0), hydra_harp(1, 1, 0, 7)], (6 << 10) + 7),
        (0x101_0204, [t2(1, 63, 3), t2(1, 0, 1), t2(1, 1, 7)], (3 << 25) + 7),
    ] {
        let mut clock = Clock::new(Layout::of(record_type).unwrap());
        let last = events.map(|event| clock.event(event).unwrap())[2];
        assert_eq!((last, clock.now()), (Event::Markers(1), now), "{record_type:#x}");
    }
}

#[test]
fn bins_are_as_wide_as_the_caller_says() {
    let file = ptu(0x1_0307, &hydra_harp_events());
    let (records, values) = described(&file, Some(8.0), None).unwrap();
    assert_eq!((records[0].head.dt_s, values[0].as_slice()), (Some(8e-12), &[1.0, 2.0, 0.0][..]));
    let error = described(&file, Some(10.0), None).unwrap_err();
    assert!(error.contains("`bin_ps` = 10 is no whole number of the file's 4 ps; give 8 or 12"), "{error}");
    assert!(described(&file, Some(1.0), None).unwrap_err().contains("no whole number of the file's 4 ps"));
    let long = ptu(0x101_0204, &[t2(1, 0, 0), t2(0, 3, 1 << 20)]);
    let error = described(&long, Some(4.0), None).unwrap_err();
    assert!(error.contains("makes 1048577 bins, more than 65536; give 68 or more"), "{error}");
}

/// A file of nothing but markers must not take much more memory than it has bytes.
#[test]
fn markers_are_refused_where_they_are_too_many() {
    let mut events = vec![hydra_harp(1, 1, 0, 0); 200_000];
    events.push(hydra_harp(0, 0, 1, 0));
    assert!(described(&ptu(0x1_0307, &events), None, Some(1)).unwrap_err().contains("cut the measurement into files"));
}
