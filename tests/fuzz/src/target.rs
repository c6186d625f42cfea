//! Feeds bytes to the reader that the target is named after.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use periscope_formats::description::Key;
use periscope_formats::{Description, FormatError, Input, READERS, Reader, Source};

/// Codes that are unpacked of one record; a compressed record may be a thousand times its file.
const UNPACKED_BYTES: usize = 1 << 22;

/// First bytes of the companion of a PulseWaves file.
const WAVES: &[u8] = b"PulseWavesWaves\0";

fuzz_target!(|data: &[u8]| {
    let name = env!("CARGO_BIN_NAME");
    let named = |reader: &&dyn Reader| reader.format().replace('.', "-") == name;
    let reader = READERS.into_iter().find(named).expect("a target is named after its format");
    // Of a format in two files, the first four bytes say where the companion begins.
    let (length, bytes) = match data.split_first_chunk::<4>() {
        Some((length, bytes)) if name == "rs-bin" => (u32::from_le_bytes(*length).into(), bytes),
        // The companion of a lidar begins with a mark of its own.
        _ if name == "pulsewaves" => {
            let companion = data.windows(WAVES.len()).position(|bytes| bytes == WAVES);
            (companion.unwrap_or(data.len()) as u64, data)
        }
        _ => (data.len() as u64, data),
    };
    read(reader, length, bytes, Description::default());
    if !reader.keys().is_empty() {
        read(reader, length, bytes, description(reader.keys(), length));
    }
});

/// Something for each of these keys.
fn description(keys: &[Key], length: u64) -> Description {
    let has = |key: Key| keys.contains(&key);
    let text = |key: Key, text: &str| has(key).then(|| text.to_owned());
    Description {
        unit: text(Key::Unit, "mV"),
        time_unit: text(Key::TimeUnit, "ns"),
        variable: None,
        axes: has(Key::Axes).then(|| vec!["time".to_owned(), "shot".to_owned()]),
        bin_ps: has(Key::Bin).then_some(64.0),
        marker: has(Key::Marker).then_some(1),
        // Of some files lines are cut at markers alone.
        pixels: (has(Key::Pixels) && length.is_multiple_of(8)).then_some(3),
    }
}

/// Reads a file and its samples.
fn read(reader: &dyn Reader, length: u64, bytes: &[u8], description: Description) {
    let size = bytes.len() as u64;
    let Ok(mut source) = Source::with_companion(Cursor::new(bytes), length, Path::new("a")) else { return };
    source = source.described(description);
    let mut records = Err(FormatError::Empty);
    let memory = allocation_counter::measure(|| records = reader.records(&mut source));
    assert!(memory.bytes_max <= 4 * size + (1 << 20), "{} bytes allocated for a file of {size}", memory.bytes_max);
    let mut left = UNPACKED_BYTES;
    for record in records.unwrap_or_default() {
        if let Some((at, _)) = record.contiguous() {
            assert!(at + record.code_bytes() as u64 <= size, "samples beyond the end of the file");
        }
        let samples = record.head.samples.min(left / record.head.code_type.bytes());
        left -= samples * record.head.code_type.bytes();
        let mut bytes = 0;
        let memory = allocation_counter::measure(|| {
            // An error is an answer: a packed record may turn out to be broken.
            if record.visit(source.file(), 0..samples, &mut |codes| bytes += codes.len()).is_err() {
                bytes = samples * record.head.code_type.bytes();
            }
        });
        assert_eq!(bytes, samples * record.head.code_type.bytes(), "fewer codes than samples");
        assert!(memory.bytes_max <= 4 * size + (2 << 20), "{} bytes to unpack a file of {size}", memory.bytes_max);
    }
}
