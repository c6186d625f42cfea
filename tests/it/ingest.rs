//! From raw files to rows: values that the campaign adds to a file, records larger than memory, header and samples in
//! two files.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use periscope::formats::{self, Input, Source};
use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::Spec;
use periscope::tables::{Reject, Trace};

use crate::lab::Lab;

/// Codes in the table, so that they can be looked at.
const TRACES: &str = "[traces]\nstage = 'ingest'\nparams = { codes = 'none' }\n";

fn edit_rules(lab: &Lab, more: &str) {
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    let edited = text.replace("segments = \"shot\"", &format!("segments = \"shot\"\n{more}"));
    assert_ne!(text, edited);
    fs::write(&path, edited).unwrap();
}

#[test]
fn a_rounded_step_is_corrected_only_on_request_and_on_record() {
    let lab = Lab::tiny();
    lab.run("plain", TRACES, &Settings::default()).unwrap();
    let plain: Vec<Trace> = lab.rows("plain", "traces");
    let rounded_ps = f64::from(50e-12_f32) * 1e12;
    assert!(plain.iter().all(|row| row.dt_ps == rounded_ps && row.file_dt_ps.is_none()));
    edit_rules(&lab, "nominal_rate_hz = 20e9");
    lab.run("out", TRACES, &Settings::default()).unwrap();
    let rows: Vec<Trace> = lab.rows("out", "traces");
    assert!(!rows.is_empty() && rows.iter().all(|row| row.dt_ps == 50.0 && row.file_dt_ps == Some(rounded_ps)));
    assert!(rows.iter().zip(&plain).all(|(row, plain)| row.t0_ps == plain.t0_ps && row.codes == plain.codes));
}

#[test]
fn codes_without_compression_are_the_same_rows() {
    let lab = Lab::tiny();
    let small = "traces.codes='zstd'".to_owned();
    lab.run_with("small", TRACES, std::slice::from_ref(&small), &Settings::default()).unwrap();
    lab.run("plain", TRACES, &Settings::default()).unwrap();
    let (small, rows): (Vec<Trace>, Vec<Trace>) = (lab.rows("small", "traces"), lab.rows("plain", "traces"));
    assert!(!small.is_empty() && small == rows);
    let bytes = |out: &str| -> u64 {
        let files = fs::read_dir(lab.path(out).join("traces")).unwrap();
        files.map(|file| fs::metadata(file.unwrap().path()).unwrap().len()).sum()
    };
    let codes: usize = rows.iter().map(|row| row.codes.as_ref().unwrap().len()).sum();
    assert!(bytes("plain") > codes as u64 && bytes("small") < codes as u64, "{} {}", bytes("plain"), bytes("small"));
    let unknown = Spec::parse("test", TRACES, &["traces.codes='lz4'".to_owned()]);
    let error = unknown.map(|_| ()).unwrap_err().to_string();
    assert!(["lz4", "indexed", "zstd", "none"].iter().all(|word| error.contains(word)), "{error}");
}

#[test]
fn a_nominal_rate_that_is_another_is_refused() {
    let lab = Lab::tiny();
    edit_rules(&lab, "nominal_rate_hz = 25e9");
    let rejected = lab.run("out", TRACES, &Settings::default()).unwrap().rejects;
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    assert!(rejected > 0 && rejects.iter().all(|row| row.reason.contains("nominal_rate_hz")), "{rejects:?}");
    edit_rules(&lab, "dt_ps = 50.0");
    let error = periscope::campaign::Campaign::load(&lab.campaign()).unwrap_err().to_string();
    assert!(error.contains("give one of them"), "{error}");
}

/// Bytes that belong to no record, and a file that ends within a segment: what is whole is used, and `rejects` says the
/// rest, once a file.
#[test]
fn what_a_file_holds_besides_its_records_is_in_rejects() {
    let lab = Lab::tiny();
    lab.run("before", TRACES, &Settings::default()).unwrap();
    let before: Vec<Trace> = lab.rows("before", "traces");
    let file = |number: usize| {
        let mut files: Vec<_> =
            fs::read_dir(lab.campaign().join("raw/scene")).unwrap().map(|file| file.unwrap().path()).collect();
        files.retain(|file| file.to_string_lossy().ends_with("C1.trc"));
        files.sort();
        files.swap_remove(number)
    };
    let mut longer = fs::read(file(0)).unwrap();
    longer.extend([7; 100]);
    fs::write(file(0), longer).unwrap();
    let cut = fs::read(file(1)).unwrap();
    fs::write(file(1), &cut[..cut.len() - 10]).unwrap();
    lab.run("out", TRACES, &Settings::default()).unwrap();
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    let of = |path: &Path| -> Vec<String> {
        let name = path.file_name().unwrap().to_str().unwrap();
        let its = rejects.iter().filter(|row| row.file.as_ref().is_some_and(|file| file.ends_with(name)));
        its.map(|row| row.reason.to_string()).collect()
    };
    let (surplus, short) = (of(&file(0)), of(&file(1)));
    assert!(surplus.len() == 1 && surplus[0].contains("100 bytes at the end"), "{rejects:?}");
    assert!(!short.is_empty() && short[0].contains("it ends within segment 23"), "{rejects:?}");
    let rows: Vec<Trace> = lab.rows("out", "traces");
    assert!(
        rows.len() < before.len() && rows.iter().all(|row| before.contains(row)),
        "{} {}",
        rows.len(),
        before.len()
    );
}

/// A `.npy` of one record of zero bytes, which costs no room on disk.
fn sparse(path: &Path, samples: u64) -> File {
    let mut file = File::create(path).unwrap();
    let dict = format!("{{'descr': '|i1', 'fortran_order': False, 'shape': ({samples},), }}");
    file.write_all(b"\x93NUMPY\x01\x00\x76\x00").unwrap();
    file.write_all(format!("{dict:<117}\n").as_bytes()).unwrap();
    file.set_len(128 + samples).unwrap();
    file
}

#[test]
fn two_gibibytes_are_read_in_a_mebibyte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.npy");
    sparse(&path, 1 << 31);
    let mut samples = 0;
    let memory = allocation_counter::measure(|| {
        let mut source = Source::open(&path).unwrap();
        let record = formats::records(&mut source).unwrap().remove(0);
        record.visit(source.file(), 0..record.head.samples, &mut |codes| samples += codes.len()).unwrap();
    });
    assert_eq!(samples, 1 << 31);
    assert!(memory.bytes_max < 1 << 20, "{} bytes", memory.bytes_max);
}

#[test]
fn of_a_long_record_only_the_samples_that_count_are_in_memory() {
    let lab = Lab::bulk(0);
    let mut file = sparse(&lab.campaign().join("raw/L1_P2.npy"), 1 << 28);
    std::io::Seek::seek(&mut file, std::io::SeekFrom::Start(128 + 200_000_000)).unwrap();
    file.write_all(&[1, 2, 3, 4]).unwrap();
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.clone() + "samples = [199999998, 200000006]\n").unwrap();
    let settings = Settings { memory_bytes: 64 << 20, ..Settings::default() };
    lab.run("out", TRACES, &settings).unwrap();
    let rows: Vec<Trace> = lab.rows("out", "traces");
    assert_eq!((rows.len(), rows[0].codes.as_deref()), (1, Some(&[0_u8, 0, 1, 2, 3, 4, 0, 0][..])));
    assert_eq!((rows[0].samples, rows[0].t0_ps), (8, 199_999_998.0 * 50.0));
    // Without the key the record does not fit, and the refusal says so.
    fs::write(&path, text).unwrap();
    let error = crate::lab::chain(lab.run("whole", TRACES, &settings).unwrap_err());
    assert!(error.contains("--memory") && error.contains("L1_P2.npy"), "{error}");
}
