//! `traces` as an index: where the samples lie in the raw files, and tables below that are made from these.

use std::collections::BTreeMap;
use std::fs;
use std::io::BufWriter;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use periscope::formats::npy;
use periscope::pipeline::plan::Action;
use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Profile, Trace};

use crate::lab::{ALL_VISIBLE, AVERAGES, Lab, TINY, chain};

const ROLES: &str = "[traces]\nstage = 'ingest'\nparams = { roles = ['scene', 'response'] }\n";
const AS_THEY_ARE: &str = "traces.codes='none'";

/// The codes of a row of an index, little-endian, by nothing but its own columns and the raw file; `None` where codes
/// do not lie there as plain numbers.
pub fn read_back(campaign: &Path, row: &Trace) -> Option<Vec<u8>> {
    let bytes = fs::read(campaign.join(&**row.codes_file.as_ref().unwrap())).unwrap();
    assert_eq!(&*blake3::hash(&bytes).to_hex(), &**row.codes_file_digest.as_ref().unwrap(), "{}", row.file);
    let (offset, stride) = (row.codes_offset_bytes? as usize, row.codes_stride_bytes.unwrap() as usize);
    let width = row.code_type[1..].parse::<usize>().unwrap() / 8;
    let mut codes = Vec::new();
    for sample in 0..row.samples as usize {
        let mut code = bytes[offset + sample * stride..][..width].to_vec();
        if row.codes_big_endian.unwrap() {
            code.reverse();
        }
        codes.extend(code);
    }
    Some(codes)
}

/// Holds an index against the table with codes of the same campaign. Returns how many of its rows have a place.
pub fn compare(campaign: &Path, index: &[Trace], archive: &[Trace]) -> usize {
    assert_eq!(index.len(), archive.len());
    let mut placed = 0;
    for (row, archived) in index.iter().zip(archive) {
        assert!(row.codes.is_none() && archived.codes_file.is_none() && archived.codes_offset_bytes.is_none());
        if let Some(codes) = read_back(campaign, row) {
            assert!(archived.codes.as_deref() == Some(&codes[..]), "{} {:?}", row.file, row.segment);
            placed += 1;
        }
        let without_place = Trace {
            codes_file: None,
            codes_file_digest: None,
            codes_offset_bytes: None,
            codes_stride_bytes: None,
            codes_big_endian: None,
            ..row.clone()
        };
        assert_eq!(without_place, Trace { codes: None, ..archived.clone() });
    }
    placed
}

/// Runs a pipeline into `out`, and with codes into `archive`; returns the rows of both.
fn both(lab: &Lab, pipeline: &str, settings: &Settings) -> (Vec<Trace>, Vec<Trace>) {
    lab.run("out", pipeline, settings).unwrap();
    lab.run_with("archive", pipeline, &[AS_THEY_ARE.to_owned()], settings).unwrap();
    (lab.rows("out", "traces"), lab.rows("archive", "traces"))
}

#[test]
fn samples_are_read_back_by_the_columns_of_the_index_alone() {
    let text = TINY.replace("response_shots = 400", "response_shots = 8");
    for format in [Format::Trc, Format::Wfm, Format::Bin, Format::Npy] {
        let lab = Lab::of(&text, 3, format);
        // Each file in one go; and larger than a batch, so that its rows pass on before it is hashed to its end.
        for settings in [Settings::default(), Settings { batch_bytes: 1, ..Settings::default() }] {
            let (index, archive) = both(&lab, ROLES, &settings);
            assert_eq!(compare(&lab.campaign(), &index, &archive), index.len());
            assert!(index.len() > 700);
            fs::remove_dir_all(lab.path("out")).unwrap();
            fs::remove_dir_all(lab.path("archive")).unwrap();
        }
    }
}

#[test]
fn of_some_samples_of_a_record_the_index_has_the_first_and_text_has_no_place() {
    let lab = Lab::of(TINY, 3, Format::Npy);
    let path = lab.campaign().join("campaign.toml");
    let rules = fs::read_to_string(&path).unwrap();
    fs::write(&path, rules.replace("segments = \"shot\"", "segments = \"shot\"\nsamples = [40, 300]")).unwrap();
    let (index, archive) = both(&lab, ROLES, &Settings::default());
    assert_eq!(compare(&lab.campaign(), &index, &archive), index.len());
    assert!(index.iter().all(|row| row.samples == 260));
    let lab = Lab::bulk(0);
    fs::write(lab.campaign().join("raw/L1_P2.csv"), "s,V\n0,0.5\n1e-9,0.25\n2e-9,0.125\n").unwrap();
    let path = lab.campaign().join("campaign.toml");
    fs::write(&path, fs::read_to_string(&path).unwrap().replace(".npy", ".csv")).unwrap();
    let (index, archive) = both(&lab, ROLES, &Settings::default());
    assert_eq!((index.len(), compare(&lab.campaign(), &index, &archive)), (1, 0));
    assert!(index[0].codes_stride_bytes.is_none() && index[0].codes_big_endian.is_none());
}

/// Inode and time of change of each part of a table on the shelf.
fn stamps(lab: &Lab, out: &str, table: &str) -> BTreeMap<PathBuf, (u64, SystemTime)> {
    let stamp = |path: PathBuf| {
        let metadata = fs::metadata(&path).unwrap();
        (path, (metadata.ino(), metadata.modified().unwrap()))
    };
    let files = lab.parts(out).into_keys().filter(|file| file.ends_with(&format!(".{table}.parquet")));
    files.filter(|file| file.contains("/part-")).map(|file| stamp(lab.path(out).join(file))).collect()
}

/// A campaign of several parts.
fn in_parts() -> Lab {
    let lab = Lab::tiny();
    let file = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replacen("[campaign]\n", "[campaign]\npart_bytes = 40000\n", 1)).unwrap();
    lab
}

/// Law 4, for a table that does not stand in for its stage.
#[test]
fn tables_below_are_made_from_raw_files_again_and_the_index_stays_as_it_is() {
    let lab = in_parts();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let (traces, before) = (stamps(&lab, "out", "traces"), lab.parts("out"));
    assert!(traces.len() > 4, "{}", traces.len());
    let set = ["profiles.shots_min=3".to_owned()];
    let decisions = lab.plan("out", ALL_VISIBLE, &set);
    let of = |heading: &str| decisions.iter().find(|decision| decision.heading == heading).unwrap();
    assert_eq!((of("traces").action, of("profiles").action), (Action::Reuse, Action::Compute));
    assert!(of("traces").why.contains("read from the raw files again"), "{}", of("traces").why);
    let outcome = lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    assert!(outcome.computed.contains(&"profiles".to_owned()), "{:?}", outcome.computed);
    assert!(!outcome.computed.contains(&"traces".to_owned()), "{:?}", outcome.computed);
    assert_eq!(stamps(&lab, "out", "traces"), traces);
    lab.run_with("fresh", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    let (after, fresh) = (lab.parts("out"), lab.parts("fresh"));
    assert!(fresh.iter().all(|(file, digest)| after[file] == *digest));
    // A part that is lacking takes no more than its own raw bytes, and none is read where nothing lacks.
    let whole: u64 = outcome.passes.iter().map(|pass| pass.raw_bytes).sum();
    for part in before.keys().filter(|file| file.contains("/part-") && file.ends_with(".profiles.parquet")) {
        fs::remove_file(lab.path("out").join(part)).unwrap();
        let again = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
        let read: u64 = again.passes.iter().map(|pass| pass.raw_bytes).sum();
        assert!(read > 0 && 2 * read < whole, "{read} of {whole} bytes");
        assert_eq!((&stamps(&lab, "out", "traces"), &lab.parts("out")), (&traces, &after));
    }
    let none = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert!(none.computed.is_empty() && none.passes.is_empty(), "{:?}", none.computed);
}

#[test]
fn a_lost_part_of_the_index_is_made_again_and_nothing_else() {
    let lab = in_parts();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let (profiles, before) = (stamps(&lab, "out", "profiles"), lab.parts("out"));
    // One after the other: before some of them, and behind others, all parts stand.
    for part in before.keys().filter(|file| file.contains("/part-") && file.ends_with(".traces.parquet")) {
        fs::remove_file(lab.path("out").join(part)).unwrap();
        let outcome = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
        assert_eq!(outcome.computed.len(), 1, "{:?}", outcome.computed);
        assert_eq!((&stamps(&lab, "out", "profiles"), &lab.parts("out")), (&profiles, &before));
    }
}

#[test]
fn an_index_is_a_small_part_of_what_it_points_to_and_an_archive_is_not() {
    let lab = Lab::bulk(2);
    let (index, _) = both(&lab, AVERAGES, &Settings::default());
    let bytes = |out: &str| -> u64 {
        let files = fs::read_dir(lab.path(out).join("traces")).unwrap();
        files.map(|file| fs::metadata(file.unwrap().path()).unwrap().len()).sum()
    };
    let raw: u64 = index.iter().map(|row| 2 * row.samples as u64).sum();
    assert!(500 * bytes("out") < raw && bytes("archive") > raw, "{} {} {raw}", bytes("out"), bytes("archive"));
    assert_eq!(lab.rows::<Profile>("out", "profiles"), lab.rows::<Profile>("archive", "profiles"));
}

/// Some shots of a ramp with noise, as a file of a campaign.
fn write(lab: &Lab, name: &str, shots: usize) {
    let samples = 700;
    let code = |n: usize| (n.wrapping_mul(2_654_435_761 + shots) >> 7) as i16 % 50 + (n % samples) as i16;
    let codes: Vec<i16> = (0..shots * samples).map(code).collect();
    let file = fs::File::create(lab.campaign().join(format!("raw/{name}.npy"))).unwrap();
    npy::write(&mut BufWriter::new(file), &[shots as u64, samples as u64], &codes).unwrap();
}

/// With small batches, each file is read in pieces where its capture is averaged, one after the other; with large ones,
/// captures are read side by side. One file ends before its shots do.
#[test]
fn a_capture_in_several_large_files_is_averaged_as_one() {
    let lab = Lab::bulk(0);
    let rules = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&rules).unwrap();
    fs::write(&rules, text.replace("_P{seen}.npy", "_P{seen}_*.npy")).unwrap();
    for (capture, shots) in [[60, 41, 52], [40, 90, 45], [70, 71, 72], [33, 44, 55]].into_iter().enumerate() {
        let of_file = |(file, shots): (usize, usize)| write(&lab, &format!("L{}_P3_{file}", capture + 20), shots);
        shots.into_iter().enumerate().for_each(of_file);
    }
    let cut = lab.campaign().join("raw/L21_P3_1.npy");
    let bytes = fs::read(&cut).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let in_one = lab.run("side by side", AVERAGES, &Settings::default()).unwrap();
    assert!(in_one.rejects > 0, "the file that was cut short");
    let (traces, profiles) =
        (lab.rows::<Trace>("side by side", "traces"), lab.rows::<Profile>("side by side", "profiles"));
    assert_eq!(profiles.len(), 4);
    assert_eq!((profiles[0].shots + profiles[0].rejected, profiles[3].shots + profiles[3].rejected), (153, 132));
    for batch_bytes in [1, 20_000, 50_000] {
        let out = format!("batches of {batch_bytes}");
        let outcome = lab.run(&out, AVERAGES, &Settings { batch_bytes, ..Settings::default() }).unwrap();
        assert_eq!(outcome.rejects, in_one.rejects);
        assert_eq!(lab.rows::<Trace>(&out, "traces"), traces);
        assert_eq!(lab.rows::<Profile>(&out, "profiles"), profiles);
    }
}

/// Row groups of an archive hold many small captures, and of large ones a part: both are averaged as from raw files.
#[test]
fn an_archive_is_averaged_again_as_the_raw_files_are() {
    let lab = Lab::bulk(4);
    (0..80).for_each(|capture| write(&lab, &format!("L{}_P3", capture + 20), 60 + capture));
    for codes in ["traces.codes='none'", "traces.codes='zstd'"] {
        lab.run_with("archive", AVERAGES, &[codes.to_owned()], &Settings::default()).unwrap();
        let set = [codes.to_owned(), "profiles.shots_min=3".to_owned()];
        let again = lab.run_with("archive", AVERAGES, &set, &Settings::default()).unwrap();
        assert_eq!(again.computed, ["profiles"]);
        assert_eq!(again.passes.iter().map(|pass| pass.raw_bytes).sum::<u64>(), 0);
        lab.run_with("out", AVERAGES, &set[1..], &Settings::default()).unwrap();
        let profiles = lab.rows::<Profile>("archive", "profiles");
        assert_eq!(profiles.len(), 84);
        assert_eq!(profiles, lab.rows::<Profile>("out", "profiles"));
    }
}

/// An `import` of the table of traces of a result folder, and averages of it.
fn imported(lab: &Lab, out: &str) -> String {
    let folder = lab.path(out).join("traces");
    let import = format!("stage = 'import'\nparams = {{ table = 'traces', path = '{}' }}", folder.display());
    AVERAGES.replace("stage = 'ingest'", &import)
}

#[test]
fn without_raw_files_an_index_names_them_and_the_archive_that_would_do() {
    let lab = Lab::bulk(2);
    both(&lab, AVERAGES, &Settings::default());
    let (from_index, from_archive) = (imported(&lab, "out"), imported(&lab, "archive"));
    fs::remove_dir_all(lab.campaign().join("raw")).unwrap();
    let before = lab.parts("out");
    // The campaign itself: no table without rows takes the place of those that stand.
    let set = ["profiles.shots_min=3".to_owned()];
    let error = chain(lab.run_with("out", AVERAGES, &set, &Settings::default()).unwrap_err());
    assert!(error.contains("the samples lie in ") && error.contains("campaign/raw/"), "{error}");
    assert!(error.contains("put them back") && error.contains("codes = \"zstd\""), "{error}");
    assert_eq!(lab.parts("out"), before);
    // Its tables, in place of the stage.
    let error = chain(lab.run("second", &from_index, &Settings::default()).unwrap_err());
    assert!(error.contains("[profiles]") && error.contains("the samples lie in raw/"), "{error}");
    assert!(error.contains("codes = \"zstd\""), "{error}");
    lab.run("third", &from_archive, &Settings::default()).unwrap();
    assert_eq!(lab.rows::<Profile>("third", "profiles"), lab.rows::<Profile>("archive", "profiles"));
}
