use super::*;
use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal, source};

const STOPS: [u16; 3] = [0, 1, 700];

/// Width of a cell: every other one is wide, as in a real chip, and each channel differs.
fn width_ns(channel: usize, cell: usize) -> f32 {
    let odd = if cell.is_multiple_of(2) { 0.26 } else { 0.14 };
    odd + 0.02 * ((cell * (channel + 2)) as f32 * 0.37).sin()
}

/// Time of a sample after the first sample of channel 0, in ns, added up cell by cell.
fn time_ns(channel: usize, stop: usize, sample: usize) -> f64 {
    let sum = |channel: usize, cells: std::ops::Range<usize>| -> f64 {
        cells.map(|cell| f64::from(width_ns(channel, cell % CELLS))).sum()
    };
    let to_cell_0 = |channel: usize| if stop == 0 { 0.0 } else { sum(channel, stop..CELLS) };
    sum(channel, stop..stop + sample) + to_cell_0(0) - to_cell_0(channel)
}

/// A slow signal, as codes.
fn signal(time_ns: f64) -> f64 {
    30_000.0 + 20_000.0 * (time_ns * 0.9).sin()
}

fn file(boards: &[u16], channels: usize, events: usize) -> Vec<u8> {
    let tag = |channel: usize| format!("C{:03}", channel + 1).into_bytes();
    let mut bytes = START.to_vec();
    for serial in boards {
        bytes.extend([&b"B#"[..], &serial.to_le_bytes()].concat());
        for channel in 0..channels {
            bytes.extend(tag(channel));
            bytes.extend((0..CELLS).flat_map(|cell| width_ns(channel, cell).to_le_bytes()));
        }
    }
    for event in 0..events {
        bytes.extend(EVENT);
        bytes.extend((event as u32 + 1).to_le_bytes());
        bytes.extend([2026_u16, 3, 4, 5, 6, 7, 8, 450].iter().flat_map(|word| word.to_le_bytes()));
        let stop = STOPS[event % 3];
        for serial in boards {
            bytes.extend([&b"B#"[..], &serial.to_le_bytes(), b"T#", &stop.to_le_bytes()].concat());
            for channel in 0..channels {
                bytes.extend(tag(channel));
                bytes.extend(1000_u32.to_le_bytes());
                let code = |i: usize| signal(time_ns(channel, stop.into(), i)).round() as u16;
                bytes.extend((0..CELLS).flat_map(|i| code(i).to_le_bytes()));
            }
        }
    }
    bytes
}

/// The same signal in both channels has the same values at the same samples, whatever the widths and the stop cell.
#[test]
fn codes_are_at_equal_steps_that_channels_share() {
    let bytes = file(&[2345], 2, 3);
    assert!(Drs4.recognises(&bytes));
    let records = decode(&Drs4, &bytes);
    assert_eq!(records.len(), 6);
    let step_ns = (0..CELLS).map(|cell| f64::from(width_ns(0, cell))).sum::<f64>() / CELLS as f64;
    for (number, (record, volts)) in records.iter().enumerate() {
        let head = &record.head;
        assert_eq!(head.channel.as_deref(), Some(["CH1", "CH2"][number % 2]));
        assert_eq!((record.segment, record.t0_s, head.samples), (Some(number as u32 / 2), None, 1024));
        assert!((head.dt_s.unwrap() - step_ns * 1e-9).abs() < 1e-22);
        for (i, volt) in volts.iter().enumerate().take(1020).skip(4) {
            let expected = signal(i as f64 * step_ns) / 65_536.0 + 0.45 - 0.5;
            assert!((volt - expected).abs() < 3e-5, "record {number}, sample {i}: {volt} V, not {expected} V");
        }
    }
    let head = &records[0].0.head;
    assert_eq!(head.acquired_at.as_deref(), Some("2026-03-04T05:06:07.008"));
    assert_eq!(head.instrument.as_deref(), Some("DRS4 evaluation board 2345"));
}

#[test]
fn boards_are_named_where_there_are_several() {
    let records = decode(&Drs4, &file(&[7, 9], 1, 1));
    let names: Vec<_> = records.iter().map(|(record, _)| record.head.channel.as_deref().unwrap()).collect();
    assert_eq!(names, ["board7/CH1", "board9/CH1"]);
    assert_eq!(records[0].0.segment, None);
}

#[test]
fn cells_of_equal_width_leave_the_codes_as_they_are() {
    let mut bytes = file(&[1], 1, 1);
    let widths = START.len() + 8;
    bytes[widths..widths + WIDTHS as usize].copy_from_slice(&0.25_f32.to_le_bytes().repeat(CELLS));
    let codes = bytes.len() - CODES as usize;
    let step = [[0, 0], [0xFF, 0xFF]].concat().repeat(CELLS / 2);
    bytes[codes..].copy_from_slice(&step);
    let records = decode(&Drs4, &bytes);
    let (low, high) = (0.45 - 0.5, 65_535.0 / 65_536.0 + 0.45 - 0.5);
    assert!(records[0].1.chunks(2).all(|pair| pair == [low, high]), "{:?}", &records[0].1[..8]);
}

#[test]
fn what_is_wrong_is_said() {
    let good = file(&[1], 1, 2);
    let changed = |at: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[at] = byte;
        refusal(&Drs4, &bytes)
    };
    let event = START.len() + 8 + WIDTHS as usize;
    assert!(changed(event - 1, 0x7F).contains("cell 1023 is"));
    assert!(changed(8, b'X').contains("byte 8: a board, a channel or an event should begin"));
    assert!(changed(event + 24 + 2, 9).contains("board 1 should begin"));
    assert!(changed(event + 24 + 7, 4).contains("sampling stopped in cell 1024"));
    assert!(changed(event + 24 + 8, b'B').contains("channel C001 should begin"));
    assert!(refusal(&Drs4, &good[..event + 100]).contains("cut short: an event needs 2088 bytes"));
    assert!(refusal(&Drs4, &[START, EVENT, &[0; 40]].concat()).contains("no channel has widths"));
    assert!(refusal(&Drs4, &[&good[..], &good].concat()).contains("an event (EHDR) should begin"));
    let contents = crate::contents(&mut source(&good[..good.len() - 1])).unwrap();
    assert_eq!((contents.records.len(), contents.remarks.len(), contents.remarks[0].is_cut), (1, 1, true));
}

#[test]
fn hostile_files_are_refused_or_decoded_whole() {
    cut_everywhere(&Drs4, &file(&[1], 1, 2));
    change_anywhere(&Drs4, &file(&[1, 2], 2, 2), 2000);
}
