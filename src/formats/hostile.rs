//! What every reader must survive, for its tests: files cut at every length, and files with bytes changed anywhere.

use std::io::Cursor;
use std::path::Path;

use super::{Input, Reader, Source};
use crate::waveform::{Payload, Record};

/// A few compressed bytes may claim many samples: the tests unpack this many bytes at most.
const UNPACKED_BYTES: usize = 1 << 22;

/// Wraps these bytes as a file.
pub fn source(bytes: &[u8]) -> Source<Cursor<Vec<u8>>> {
    Source::new(Cursor::new(bytes.to_vec()), Path::new("a.file")).expect("memory has a length")
}

/// Reads the records of a file, each with its values, or returns why the reader refuses it.
///
/// # Panics
/// When a record claims bytes that the file does not hold.
pub fn read(reader: &dyn Reader, bytes: &[u8]) -> Result<Vec<(Record, Vec<f64>)>, String> {
    if bytes.is_empty() {
        return Err("is empty, which is found before any reader is asked".to_owned());
    }
    let mut source = source(bytes);
    let _ = reader.recognises(&bytes[..bytes.len().min(2048)]);
    let records = reader.records(&mut source).map_err(|error| error.to_string())?;
    assert!(!records.is_empty(), "a file without records is refused");
    assert!(size_of_val(records.as_slice()) <= 4 * bytes.len() + (1 << 20), "{} records", records.len());
    let mut left = UNPACKED_BYTES;
    let mut decoded = Vec::new();
    for record in records {
        check(&record, bytes.len() as u64);
        if record.code_bytes() <= left {
            left -= record.code_bytes();
            let codes = match record.read(source.file(), 0..record.head.samples) {
                Ok(codes) => codes,
                // A reader may discover only while it unpacks that the codes are broken.
                Err(error) if matches!(record.payload, Payload::Packed(_)) => return Err(error.to_string()),
                Err(error) => panic!("{record:?} is not in its file: {error}"),
            };
            assert_eq!(codes.len(), record.code_bytes(), "shorter than it says");
            decoded.push((record.clone(), record.values(&codes)));
        }
    }
    Ok(decoded)
}

fn check(record: &Record, length: u64) {
    let head = &record.head;
    assert!(head.samples > 0, "a record without samples");
    assert!(head.dt_s.is_none_or(|dt_s| dt_s > 0.0 && dt_s.is_finite()), "dt {:?}", head.dt_s);
    assert!(record.t0_s.is_none_or(f64::is_finite) && record.trigger_s.is_none_or(f64::is_finite));
    let scaled = head.scale.is_none_or(|scale| scale.gain.is_finite() && scale.offset.is_finite() && scale.gain != 0.0);
    assert!(scaled, "scale {:?}", head.scale);
    if let Payload::File { byte_offset, stride, .. } = record.payload {
        let end = byte_offset + (head.samples as u64 - 1) * stride + head.code_type.bytes() as u64;
        assert!(end <= length, "a record of {} samples ends beyond the file", head.samples);
    }
}

/// Reads the records of a valid file, each with its values.
///
/// # Panics
/// When the reader refuses it.
pub fn decode(reader: &dyn Reader, bytes: &[u8]) -> Vec<(Record, Vec<f64>)> {
    read(reader, bytes).expect("a file that is all right")
}

/// Returns why the reader refuses a file.
///
/// # Panics
/// When the reader accepts it.
pub fn refusal(reader: &dyn Reader, bytes: &[u8]) -> String {
    read(reader, bytes).map(|_| ()).expect_err("a file that is refused")
}

/// Cuts a file at every length: the reader must refuse each, or return values equal to those of the whole file.
///
/// # Panics
/// When neither holds.
pub fn cut_everywhere(reader: &dyn Reader, bytes: &[u8]) {
    let whole = decode(reader, bytes);
    leave_seed(reader, bytes);
    surplus_is_reported(reader, bytes);
    for length in 0..bytes.len() {
        for (i, (_, values)) in read(reader, &bytes[..length]).unwrap_or_default().into_iter().enumerate() {
            assert_eq!(values, whole[i].1, "record {i}, cut to {length} bytes");
        }
    }
}

/// Adds bytes to a file: at its end, as a second copy of it, and at every place within it. The reader must refuse each,
/// or the file's remarks must say so.
///
/// # Panics
/// When it says nothing.
pub fn surplus_is_reported(reader: &dyn Reader, bytes: &[u8]) {
    appended_is_reported(reader, bytes);
    let step = (bytes.len() / 500).max(1);
    for at in (0..bytes.len()).step_by(step) {
        let (start, end) = bytes.split_at(at);
        for put_in in [&[0xA5; 16][..], &[1, 2, 3]] {
            is_reported(reader, bytes, &[start, put_in, end].concat(), &format!("{put_in:?} put in at byte {at}"));
        }
    }
}

/// Pads a file and doubles it, as [`surplus_is_reported`]. (In a head of text, what is put in may be part of a name.)
///
/// # Panics
/// When the reader says nothing.
pub fn appended_is_reported(reader: &dyn Reader, bytes: &[u8]) {
    let before = remarks(reader, bytes).expect("a file that is all right");
    assert!(before.iter().all(|remark| !remark.problem.contains("belong")), "{}: {before:?}", reader.format());
    for count in [1, 7, 4096] {
        is_reported(reader, bytes, &[bytes, &vec![0; count]].concat(), "padded");
    }
    is_reported(reader, bytes, &[bytes, bytes].concat(), "doubled");
}

fn is_reported(reader: &dyn Reader, bytes: &[u8], changed: &[u8], how: &str) {
    let (before, after) = (remarks(reader, bytes), remarks(reader, changed));
    assert!(
        after.is_none() || after != before,
        "{}: {how} without a word: {:02x?}",
        reader.format(),
        &bytes[..bytes.len().min(4)]
    );
}

/// What is said about a file, if it is not refused.
fn remarks(reader: &dyn Reader, bytes: &[u8]) -> Option<Vec<crate::Remark>> {
    let mut source = source(bytes);
    reader.records(&mut source).ok().map(|records| source.remarks(&records))
}

/// Saves a file that a test built as a seed for the fuzzer (`tests/fuzz/run`), where the environment asks for it.
fn leave_seed(reader: &dyn Reader, bytes: &[u8]) {
    if let Some(folder) = std::env::var_os("PERISCOPE_SEEDS") {
        let folder = Path::new(&folder).join(reader.format().replace('.', "-"));
        std::fs::create_dir_all(&folder).expect("a folder that can be written");
        std::fs::write(folder.join(blake3::hash(bytes).to_string()), bytes).expect("a folder that can be written");
    }
}

/// Changes a few bytes of a file, many times over.
///
/// # Panics
/// When the reader panics, or when a record claims bytes that the file does not hold.
pub fn change_anywhere(reader: &dyn Reader, bytes: &[u8], times: u64) {
    damage(reader, bytes, times, |_| ());
}

/// Changes a few bytes as [`change_anywhere`] does, where `repair` corrects the checksums. Returns how many files were
/// accepted.
///
/// # Panics
/// When the reader panics, or when a record claims bytes that the file does not hold.
pub fn damage(reader: &dyn Reader, bytes: &[u8], times: u64, repair: impl Fn(&mut Vec<u8>)) -> usize {
    let mut survived = 0;
    each_damaged(bytes, times, |mut damaged| {
        repair(&mut damaged);
        survived += usize::from(read(reader, &damaged).is_ok());
    });
    survived
}

/// Calls `look` with the file cut at every length.
pub fn each_cut(bytes: &[u8], mut look: impl FnMut(&[u8])) {
    (0..bytes.len()).for_each(|length| look(&bytes[..length]));
}

/// Calls `look` with a few bytes of the file changed, many times over.
pub fn each_damaged(bytes: &[u8], times: u64, mut look: impl FnMut(Vec<u8>)) {
    // Linear congruential generator of Numerical Recipes: the same numbers in every run.
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below.max(1)
    };
    for _ in 0..times {
        let mut bytes = bytes.to_vec();
        for _ in 0..=random(3) {
            // Headers and ends matter most, so half of the edits are there.
            let near = bytes.len().min(512);
            let at = match random(4) {
                0 => random(near),
                1 => bytes.len() - near + random(near),
                _ => random(bytes.len()),
            };
            edit(&mut bytes, at, &mut random);
            if bytes.is_empty() {
                break;
            }
        }
        look(bytes);
    }
}

fn edit(bytes: &mut Vec<u8>, at: usize, random: &mut impl FnMut(usize) -> usize) {
    let rest = bytes.len() - at;
    match random(8) {
        0 => bytes[at] ^= 1 << random(8),
        1 => bytes[at] = random(256) as u8,
        2 => bytes[at..at + rest.min(1 << random(4))].fill([0, 1, 0x7f, 0x80, 0xff][random(5)]),
        3 => {
            let number = [0_u32, 1, 2, 3, 16, 255, 65_536, 0x7fff_ffff, 0xffff_fffe][random(9)].to_le_bytes();
            bytes[at..at + rest.min(4)].copy_from_slice(&number[..rest.min(4)]);
        }
        4 => bytes[at] = bytes[at].wrapping_add(1),
        5 => bytes[at] = bytes[at].wrapping_sub(1),
        6 if random(8) == 0 => bytes.truncate(at),
        6 => {
            let from = random(bytes.len() - rest.min(8) + 1);
            bytes.copy_within(from..from + rest.min(8), at);
        }
        _ => bytes.insert(at, random(256) as u8),
    }
}
