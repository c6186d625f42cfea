//! Real oscilloscope files, where present: every one against its reference decoding, by `inspect --format json` and
//! through a campaign; broken ones refused within a small multiple of their size. docs/formats.md says what they cover.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use periscope::campaign::Campaign;
use periscope::formats::companions::companion;
use periscope::formats::{self, Input, Source};
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::signal::codes::Codes;
use periscope::store::Shelf;
use periscope::tables::{Reject, Row, Trace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::formats::mutate;
use crate::index;

/// What the files of a format do not hold, though the reference names it: these keys are null.
const NOT_IN_THE_FILE: [(&str, &[&str]); 4] = [
    ("rs-csv", &["dt_s", "t0_s", "unit"]),  // rows without a heading
    ("npy-tdr", &["dt_s", "t0_s", "unit"]), // and the values are codes
    ("sigrok-sr", &["t0_s", "unit"]),
    ("wav", &["t0_s"]),
];
/// Formats without a scale or time base of their own.
const THROUGH_A_CAMPAIGN: [&str; 4] = ["npy-tdr", "sigrok-sr", "wav", "caen-wavedump"];
/// Where the reference, another parser's arithmetic, is contradicted by the instrument itself: files, and keys that are
/// not compared.
const CONTRADICTED: [(&str, &[&str]); 3] = [
    // That parser takes off an offset of 2.5 divisions as 2.5 V: traces triggered at 13 mV would lie at -2.4 V.
    ("lecroy/lc7200a_trace1.000", &["volts"]),
    ("lecroy/lc7200a_trace2.000", &["volts"]),
    // The scope's own CSV of the same capture has other volts (by up to 0.4 V) and begins 3.6 us later: the file has
    // neither scale nor time.
    ("rigol/DS1054Z-ch1SquareCH4Uart.wfm", &["volts", "unit", "t0_s"]),
];
/// Words and descriptions that lie next to a recording.
const BESIDE: [&str; 2] = ["rs-payload", "text"];
/// Real records that are no voltage over time: channel, and what they are.
const OTHER: [(&str, &str, &str); 4] = [
    ("tektronix/digital_waveform.wfm", "", "digital"),
    ("tektronix/sample_ENV.isf", "", "envelope"),
    ("tektronix/rf_tek0002NRM.isf", "", "spectrum"),
    ("keysight/dsox1102g_digital.bin", "EXT", "digital"),
];

/// Folder of real files, where present; says loudly when it is not.
pub fn samples() -> Option<PathBuf> {
    let folder = std::env::var_os("PERISCOPE_SAMPLES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scope-samples"), PathBuf::from);
    if !folder.join("reference.json").exists() {
        eprintln!(
            "\n!!! no real oscilloscope files here (PERISCOPE_SAMPLES says where they are): what they would test is NOT tested\n"
        );
        return None;
    }
    Some(folder)
}

fn reference(folder: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join("reference.json")).unwrap()).unwrap()
}

fn inspect(file: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(["inspect", "--format", "json"]).arg(file).output().unwrap()
}

/// The reference's entries: file, format, waveforms.
fn entries(reference: &Value) -> impl Iterator<Item = (&str, &str, &[Value])> {
    let all = ["files", "derived"].into_iter().flat_map(|part| reference[part].as_array().unwrap());
    all.map(|entry| {
        let waveforms = entry["waveforms"].as_array().map_or(&[][..], Vec::as_slice);
        (entry["file"].as_str().unwrap(), entry["format"].as_str().unwrap(), waveforms)
    })
}

fn not_in_the_file(format: &str) -> &'static [&'static str] {
    NOT_IN_THE_FILE.iter().find(|(name, _)| *name == format).map_or(&[], |(_, keys)| keys)
}

fn contradicted(file: &str) -> &'static [&'static str] {
    CONTRADICTED.iter().find(|(name, _)| *name == file).map_or(&[], |(_, keys)| keys)
}

#[test]
fn inspect_equals_every_reference_decoding() {
    let Some(folder) = samples() else { return };
    let reference = reference(&folder);
    let (mut files, mut waveforms) = (BTreeMap::<&str, usize>::new(), 0);
    for (file, format, expected) in entries(&reference).filter(|(_, format, _)| !BESIDE.contains(format)) {
        let output = inspect(&folder.join(file));
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let actual: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(actual.len(), expected.len(), "{file}");
        for (actual, expected) in actual.iter().zip(expected) {
            compare(file, format, actual, expected);
        }
        *files.entry(format).or_default() += 1;
        waveforms += actual.len();
    }
    let count: usize = files.values().sum();
    eprintln!("{count} files with {waveforms} waveforms equal their reference: {files:?}");
    assert!(count >= 259 && waveforms >= 400, "{count} files, {waveforms} waveforms");
}

fn compare(file: &str, format: &str, actual: &Value, expected: &Value) {
    let place = format!("{file} channel {} segment {}", actual["channel"], actual["segment"]);
    let missing = not_in_the_file(format);
    let contradicted = contradicted(file);
    for key in ["dt_s", "t0_s", "unit"] {
        let (actual, expected) = (&actual[key], &expected[key]);
        match (actual.as_f64(), expected.as_f64()) {
            _ if contradicted.contains(&key) => assert!(actual.is_null(), "{place}: {key} is not in the file"),
            _ if missing.contains(&key) => assert!(actual.is_null(), "{place}: the file has no {key}"),
            (Some(actual), Some(expected)) if key == "t0_s" => {
                assert!((actual - expected).abs() <= 1e-14, "{place}: {key} {actual}, not {expected}");
            }
            _ => assert_eq!(actual, expected, "{place}: {key}"),
        }
    }
    assert_eq!(actual["segment"], expected["segment"], "{place}");
    let other = OTHER.iter().find(|(name, channel, _)| {
        *name == file && (channel.is_empty() || actual["channel"].as_str() == Some(channel))
    });
    assert_eq!(actual["kind"], other.map_or("waveform", |(_, _, kind)| *kind), "{place}");
    if format == "npy-tdr" {
        return; // Codes, and a word behind them: their volts are compared through a campaign.
    }
    assert_eq!(actual["samples"], expected["n"], "{place}");
    if expected["sha_exact"] == true {
        assert_eq!(actual["sha256_f32le"], expected["sha256_f32le"], "{place}");
        return;
    }
    if contradicted.contains(&"volts") {
        return;
    }
    let number = |value: &Value| value.as_f64().unwrap();
    let full_scale = number(&expected["max"]).abs().max(number(&expected["min"]).abs());
    let near = |a: &Value, b: &Value| (number(a) - number(b)).abs() <= 2.0 * f64::from(f32::EPSILON) * full_scale;
    for (ours, theirs) in [("first", "first5"), ("last", "last5")] {
        let (ours, theirs) = (actual[ours].as_array().unwrap(), expected[theirs].as_array().unwrap());
        assert!(ours.iter().zip(theirs).all(|(a, b)| near(a, b)), "{place}: {ours:?}, not {theirs:?}");
    }
    assert!(["min", "max", "mean"].iter().all(|key| near(&actual[*key], &expected[*key])), "{place}: {actual}");
}

/// Spread samples of the files whose reference is another parser's arithmetic.
#[test]
fn probes_of_parser_defined_files_are_within_two_ulp() {
    let Some(folder) = samples() else { return };
    let reference = reference(&folder);
    let mut probes = 0;
    for (file, _, expected) in entries(&reference).filter(|(file, _, _)| contradicted(file).is_empty()) {
        for (i, expected) in expected.iter().enumerate().filter(|(_, expected)| expected["sha_exact"] == false) {
            let mut source = Source::open(&folder.join(file)).unwrap();
            let record = formats::records(&mut source).unwrap().swap_remove(i);
            let values = source.values(&record).unwrap();
            let full_scale = expected["max"].as_f64().unwrap().abs().max(expected["min"].as_f64().unwrap().abs());
            let at = expected["probe_index"].as_array().unwrap().iter().map(|at| at.as_u64().unwrap() as usize);
            for (at, value) in at.zip(expected["probe_value"].as_array().unwrap()) {
                let missed = (values[at] - value.as_f64().unwrap()).abs();
                assert!(
                    missed <= 2.0 * f64::from(f32::EPSILON) * full_scale,
                    "{file} {i}: sample {at} off by {missed}"
                );
                probes += 1;
            }
        }
    }
    assert!(probes > 200, "{probes}");
}

/// A campaign says what its files do not; and refuses to time what has no times.
#[test]
fn a_campaign_rule_gives_scale_and_time_base() {
    let Some(folder) = samples() else { return };
    let here = tempfile::tempdir().unwrap();
    let campaign = here.path().join("campaign");
    for (from, to) in [("campaign-tdr", "tdr"), ("sigrok", "sigrok"), ("caen-wavedump/sipm_coincidence", "caen")] {
        fs::create_dir_all(campaign.join(to)).unwrap();
        for entry in fs::read_dir(folder.join(from)).unwrap().flatten() {
            fs::copy(entry.path(), campaign.join(to).join(entry.file_name())).unwrap();
        }
    }
    fs::create_dir(campaign.join("other")).unwrap();
    for (file, _, _) in OTHER {
        let file = folder.join(file);
        fs::copy(&file, campaign.join("other").join(file.file_name().unwrap())).unwrap();
    }
    let text = include_str!("scope_samples.toml");
    let campaigns = [Campaign::parse(&campaign, text).unwrap()];
    let ingest = "[traces]\nstage = 'ingest'\nparams = { roles = ['response', 'dark'] }\n";
    let read = |codes: &str| {
        let spec = Spec::parse("ingest", ingest, &[format!("traces.codes='{codes}'")]).unwrap();
        let shelf = Shelf::open(&here.path().join(codes)).unwrap();
        let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
        run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
        drop(plan);
        shelf
    };
    let shelf = read("none");
    let rejects: Vec<Reject> =
        shelf.batches("rejects").unwrap().iter().flat_map(|batch| Reject::rows(batch).unwrap()).collect();
    for (file, _, kind) in OTHER {
        let name = Path::new(file).file_name().unwrap().to_str().unwrap();
        let reject = rejects.iter().find(|reject| reject.file.as_deref().is_some_and(|file| file.ends_with(name)));
        assert!(reject.is_some_and(|reject| reject.reason.contains(kind)), "{file}: {reject:?}");
    }
    assert_eq!(rejects.len(), OTHER.len(), "{rejects:?}");
    let rows: Vec<Trace> = shelf.batches("traces").unwrap().iter().flat_map(|b| Trace::rows(b).unwrap()).collect();
    let batches = read("indexed").batches("traces").unwrap();
    let index: Vec<Trace> = batches.iter().flat_map(|batch| Trace::rows(batch).unwrap()).collect();
    let placed = index::compare(&campaign, &index, &rows);
    eprintln!("{placed} of {} records are read back from their files by the columns of the index", rows.len());
    assert!(2 * placed > rows.len(), "{placed}");
    let reference = reference(&folder);
    let mut compared = 0;
    for (file, format, expected) in entries(&reference).filter(|(_, format, _)| THROUGH_A_CAMPAIGN.contains(format)) {
        let name = Path::new(file).file_name().unwrap().to_str().unwrap();
        for expected in expected {
            let row = rows.iter().find(|row| {
                row.file.ends_with(name)
                    && (format == "npy-tdr" || row.channel.as_deref() == expected["channel"].as_str())
                    && row.segment.map(i64::from) == expected["segment"].as_i64()
            });
            let row = row.unwrap_or_else(|| panic!("{file}: no row for {}", expected["channel"]));
            compare_row(file, row, expected);
            compared += 1;
        }
    }
    eprintln!("{compared} waveforms equal their reference through a campaign's rules");
    assert!(compared >= 228, "{compared}");
}

/// A recording in two files is one exposure, and both files count as its content.
#[test]
fn a_change_of_the_samples_beside_a_head_is_noticed() {
    let Some(folder) = samples() else { return };
    let here = tempfile::tempdir().unwrap();
    let campaign = here.path().join("campaign");
    fs::create_dir(&campaign).unwrap();
    for name in ["rs_rtp_01.bin", "rs_rtp_01.Wfm.bin"] {
        fs::copy(folder.join("rohde-schwarz").join(name), campaign.join(name)).unwrap();
    }
    let text = "[campaign]\nname = 'c'\n[sensors.s1]\n[[captures]]\nrole = 'response'\nfiles = '*.bin'\n";
    fs::write(campaign.join("campaign.toml"), text).unwrap();
    fs::write(here.path().join("p.toml"), "[traces]\nstage = 'ingest'\nparams = { roles = ['response'] }\n").unwrap();
    let run = || {
        let args = ["run", "p.toml", "--campaign", "campaign", "--out", "out"];
        let output =
            Command::new(env!("CARGO_BIN_EXE_periscope")).current_dir(here.path()).args(args).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(run().0, Some(0), "{}", run().1);
    let batches = Shelf::look(&here.path().join("out")).unwrap().batches("traces").unwrap();
    let rows: Vec<Trace> = batches.iter().flat_map(|batch| Trace::rows(batch).unwrap()).collect();
    assert_eq!((rows.len(), rows[0].samples, &*rows[0].file), (1, 4000, "rs_rtp_01.bin"));
    let payload = campaign.join("rs_rtp_01.Wfm.bin");
    let mut bytes = fs::read(&payload).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&payload, bytes).unwrap();
    let (code, said) = run();
    assert!(code == Some(1) && said.contains("rs_rtp_01.Wfm.bin"), "{code:?} {said}");
    fs::remove_file(&payload).unwrap();
    assert_eq!(run().0, Some(3));
    let batches = Shelf::look(&here.path().join("out")).unwrap().batches("rejects").unwrap();
    let rejects: Vec<Reject> = batches.iter().flat_map(|batch| Reject::rows(batch).unwrap()).collect();
    assert!(rejects[0].reason.contains(".Wfm.bin"), "{rejects:?}");
}

fn compare_row(file: &str, row: &Trace, expected: &Value) {
    let codes = Codes::of(&row.code_type, row.codes.as_ref().unwrap()).unwrap().to_f64();
    let mut sha = Sha256::new();
    codes.iter().for_each(|code| sha.update(((row.gain_v * code + row.offset_v) as f32).to_le_bytes()));
    let sha = sha.finalize().iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
    assert_eq!(sha, expected["sha256_f32le"].as_str().unwrap(), "{file}");
    assert_eq!(i64::from(row.samples), expected["n"].as_i64().unwrap(), "{file}");
    for (found_ps, expected) in [(row.dt_ps, &expected["dt_s"]), (row.t0_ps, &expected["t0_s"])] {
        let Some(expected_s) = expected.as_f64() else { continue };
        assert!((found_ps - expected_s * 1e12).abs() <= 1e-12 * found_ps.abs(), "{file}: {found_ps} ps");
    }
}

/// Expectations of the folder's own table; the words are ours.
#[test]
fn broken_files_are_refused_in_words_and_within_four_times_their_size() {
    let Some(folder) = samples() else { return };
    let reference = reference(&folder);
    let mut worst: f64 = 0.0;
    let broken = reference["broken"].as_array().unwrap();
    for entry in broken {
        let file = entry["file"].as_str().unwrap();
        let path = folder.join(file);
        let mut said = None;
        let memory = allocation_counter::measure(|| {
            let records = Source::open(&path).and_then(|mut source| {
                let records = formats::records(&mut source)?;
                records
                    .iter()
                    .try_for_each(|record| record.visit(source.file(), 0..record.head.samples, &mut |_| ()))?;
                Ok(records.len())
            });
            said = Some(records.map_err(|error| error.to_string()));
        });
        let error = said.unwrap().expect_err(file);
        assert!(error.len() > 15, "{file}: {error}");
        let size = fs::metadata(&path).unwrap().len();
        assert!(memory.bytes_max <= 4 * size + (1 << 20), "{file} of {size} bytes: {} allocated", memory.bytes_max);
        worst = worst.max(memory.bytes_max as f64 / (4 * size + (1 << 20)) as f64);
        eprintln!("{file}: {error}");
        let output = inspect(&path);
        let printed = String::from_utf8_lossy(&output.stderr).into_owned();
        let stdout = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        assert!(output.status.code() == Some(1) && printed.contains(file), "{printed}");
        assert!(stdout.is_empty() || stdout == "[]", "{stdout}");
    }
    eprintln!("{} broken files refused; the most memory was {worst:.2} of 4 x size + 1 MiB", broken.len());
    for (file, says) in [
        ("lecroy_truncated_data.trc", "needs 1004 bytes from byte 357"),
        ("lecroy_nan_gain.trc", "VERTICAL_GAIN"),
        ("lecroy_segments_do_not_divide.trc", "10040"),
        ("tek_isf_truncated.isf", "cut short"),
        ("tek_isf_no_ymult.isf", "no YMULT"),
        ("tek_isf_absurd_block.isf", "cut short"),
        ("tek_flipped_sample.wfm", "checksum"),
        ("tek_bad_version.wfm", "009"),
        ("rs_payload_missing.bin", ".Wfm.bin"),
        ("csv_bad_cell.csv", "line "),
        ("csv_ragged.csv", "line "),
        ("npy_absurd_shape.npy", "9000000000000"),
    ] {
        let error =
            Source::open(&folder.join("broken").join(file)).and_then(|mut source| formats::records(&mut source));
        let error = error.map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(says), "{file}: {error}");
    }
}

/// A short run of what `tests/fuzz` does for hours: damaged copies of the smaller real files.
#[test]
fn damaged_copies_neither_panic_nor_take_memory_nor_claim_more_than_they_hold() {
    let Some(folder) = samples() else { return };
    let reference = reference(&folder);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut accepted = BTreeMap::<String, (usize, usize)>::new();
    for (file, format, _) in
        entries(&reference).filter(|(file, format, _)| !BESIDE.contains(format) && !file.contains("campaign"))
    {
        let bytes = fs::read(folder.join(file)).unwrap();
        let whole = companion(&folder.join(file)).and_then(|companion| fs::read(companion).ok()).unwrap_or_default();
        for _ in 0..(2_000_000 / bytes.len()).clamp(2, 60) {
            let mut damaged = bytes.clone();
            (0..rng.random_range(1..4)).for_each(|_| mutate(&mut damaged, &mut rng));
            let (length, size) = (damaged.len() as u64, (damaged.len() + whole.len()) as u64);
            damaged.extend(&whole);
            let mut read = false;
            let memory = allocation_counter::measure(|| read = reads(&damaged, length, Path::new(file)));
            assert!(memory.bytes_max <= 4 * size + (1 << 21), "{file} of {size} bytes: {} allocated", memory.bytes_max);
            let (tried, accepted) = accepted.entry(format.to_owned()).or_default();
            *tried += 1;
            *accepted += usize::from(read);
        }
    }
    eprintln!("format: damaged copies, of which were read: {accepted:?}");
}

/// Whether a file is read to its end; what it claims lies within it.
fn reads(bytes: &[u8], length: u64, path: &Path) -> bool {
    let mut source = Source::with_companion(Cursor::new(bytes), length, path).unwrap();
    let Ok(records) = formats::records(&mut source) else { return false };
    records.iter().all(|record| {
        let end = record.contiguous().map(|(at, _)| at + record.code_bytes() as u64);
        assert!(end.is_none_or(|end| end <= bytes.len() as u64), "{}", path.display());
        let samples = record.head.samples.min(1 << 20);
        let mut seen = 0;
        let read = record.visit(source.file(), 0..samples, &mut |codes| seen += codes.len());
        assert!(read.is_err() || seen == samples * record.head.code_type.bytes(), "{}", path.display());
        read.is_ok()
    })
}
