//! Flipped bits: one bit of one file at a time, in a result folder and in raw files. Who finds it, and does anybody get wrong numbers?
//!
//! `-- flips 500 200`: so many flips in a result folder, so many in raw files.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use arrow::record_batch::RecordBatch;
use periscope::campaign::{Campaign, seal};
use periscope::pipeline::run::{RunError, Settings};
use periscope::simulate::Format;
use periscope::store::runs::RunRecord;
use periscope::store::{Shelf, StageId};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::{Lab, chain};
use crate::score::Rate;

const SCENE: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
const PIPELINE: &str = include_str!("../../pipelines/around-the-corner.toml");

/// Kinds of files, and how many of 500 flips go to each. Within a kind every file has the same chance, and within a file every bit.
const KINDS: [(&str, usize); 7] = [
    ("table `traces`", 100),
    ("other tables", 200),
    ("record of a part", 70),
    ("record of a table", 50),
    ("record of a stage", 30),
    ("notes of raw files", 30),
    ("record of a run, or of rejects", 20),
];

/// What came of reading, or of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// An error that names the file.
    Refused,
    /// Values as before.
    Harmless,
    /// Other values, and no error.
    Silent,
}

/// Flips in a result folder, then in raw files.
pub fn study(numbers: &[usize]) {
    results(numbers.first().copied().unwrap_or(500));
    raw_files(numbers.get(1).copied().unwrap_or(200));
}

fn kind(path: &str) -> &'static str {
    let name = path.rsplit('/').next().unwrap_or_default();
    let index = match name {
        "stage.json" => 4,
        "table.json" => 3,
        "manifest.json" => 5,
        _ if path.contains("/runs/") || path.contains("/rejects-") => 6,
        _ if name.ends_with(".json") => 2,
        _ if name.ends_with(".traces.parquet") => 0,
        _ => 1,
    };
    KINDS[index].0
}

/// A copy of a folder, hard links and links kept.
fn copy(from: &Path, to: &Path) {
    let _ = fs::remove_dir_all(to);
    assert!(Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap().success());
}

/// Files with anything in them, by path; the views' links to parts are those parts.
fn files(folder: &Path) -> BTreeMap<String, u64> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).unwrap().flatten() {
            let (path, found) = (entry.path(), entry.metadata().unwrap());
            if found.is_dir() {
                folders.push(path);
            } else if found.is_file() && found.len() > 0 {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                if !name.contains("/table-") || name.ends_with(".json") {
                    files.insert(name, found.len());
                }
            }
        }
    }
    files
}

/// Flips a bit in place; size and time of change stay, as on a disk that decays.
fn flip(path: &Path, bit: u64) {
    let modified = fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = fs::read(path).unwrap();
    bytes[(bit / 8) as usize] ^= 1 << (bit % 8);
    fs::write(path, bytes).unwrap();
    File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
}

/// All values of all views.
fn values(out: &Path) -> Result<BTreeMap<String, Vec<RecordBatch>>, String> {
    let shelf = Shelf::look(out).map_err(chain)?;
    let mut views: Vec<String> = shelf.tables().map_err(chain)?.into_iter().map(|(view, _)| view).collect();
    views.push("rejects".to_owned());
    views.into_iter().map(|view| Ok((view.clone(), shelf.batches(&view).map_err(chain)?))).collect()
}

/// Whether `periscope verify` ends with 1 and names the file.
fn verified(folder: &Path, options: &[&str], file: &str) -> bool {
    let output =
        Command::new(env!("CARGO_BIN_EXE_periscope")).arg("verify").arg(folder).args(options).output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    output.status.code() == Some(1) && String::from_utf8_lossy(&said).contains(file)
}

/// Takes away what was made from the tables of a stage's folder, so that a run must read them.
fn take_consumers(out: &Path, stage: &str, stages: &BTreeMap<String, StageId>) {
    let Some(id) = stages.get(stage) else { return };
    let made = |table: &str| periscope::store::lineage::table_recipe(table, &id.recipe());
    let tables: Vec<_> = periscope::tables::all().into_iter().map(|(table, _)| made(table)).collect();
    for (folder, consumer) in stages {
        if consumer.inputs.values().any(|input| tables.contains(input)) {
            fs::remove_dir_all(out.join(".shelf").join(folder)).unwrap();
        }
    }
}

fn results(flips: usize) {
    let lab = Lab::of(SCENE, 1, Format::Trc);
    let whole = lab.path("whole");
    lab.run("whole", PIPELINE, &Settings::default()).unwrap();
    record_a_run(&lab, &whole);
    let (baseline, parts) = (values(&whole).unwrap(), lab.parts("whole"));
    let files = files(&whole);
    let stages: BTreeMap<String, StageId> = files
        .keys()
        .filter_map(|file| file.strip_prefix(".shelf/")?.strip_suffix("/stage.json"))
        .map(|stage| {
            let text = fs::read(whole.join(".shelf").join(stage).join("stage.json")).unwrap();
            (stage.to_owned(), serde_json::from_slice(&text).unwrap())
        })
        .collect();
    let total: u64 = files.values().sum();
    println!("{} files of {total} bytes in the result folder\n", files.len());
    println!(
        "| files | flips | found by `verify` [95 %] | read: refused | harmless | silent | run: refused | harmless | silent |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let mut draws = ChaCha8Rng::seed_from_u64(9);
    let mut all: Vec<(bool, Outcome, Outcome)> = Vec::new();
    for (name, weight) in KINDS {
        let of_kind: Vec<(&String, &u64)> = files.iter().filter(|(file, _)| kind(file) == name).collect();
        let mut rows = Vec::new();
        for _ in 0..flips * weight / 500 {
            let (file, bytes) = of_kind[draws.random_range(0..of_kind.len())];
            let bit = draws.random_range(0..8 * bytes);
            let work = lab.path("work");
            copy(&whole, &work);
            flip(&work.join(file), bit);
            let short = Path::new(file).file_name().unwrap().to_str().unwrap();
            let found = verified(&work, &["--campaign", lab.campaign().to_str().unwrap()], short);
            let read = match values(&work) {
                Err(error) => refused(&error, "read", file),
                Ok(values) if values == baseline => Outcome::Harmless,
                Ok(_) => Outcome::Silent,
            };
            // The run must read the file: what was made from it is taken away.
            let stage = file.split('/').nth(1).unwrap_or_default();
            take_consumers(&work, stage, &stages);
            let run = match lab.run("work", PIPELINE, &Settings::default()) {
                Err(error) => refused(&broken(error), "run", file),
                // A damaged table that nothing is made from is not read by a run; reading it is refused.
                Ok(_) if made_alike(&lab, &parts, file) => Outcome::Harmless,
                Ok(_) => Outcome::Silent,
            };
            if !found || read == Outcome::Silent || run == Outcome::Silent {
                eprintln!("{file} bit {bit}: found {found}, read {read:?}, run {run:?}");
            }
            rows.push((found, read, run));
        }
        print(name, &rows);
        all.extend(rows);
    }
    print("all", &all);
}

/// Whether every part on the shelf, that with the flip apart, has the bytes that it had.
fn made_alike(lab: &Lab, parts: &BTreeMap<String, blake3::Hash>, flipped: &str) -> bool {
    let name = flipped.rsplit('/').next().unwrap_or_default();
    let now = lab.parts("work");
    parts
        .iter()
        .filter(|(file, _)| file.contains("/part-") && !file.contains("/table-") && !file.ends_with(name))
        .all(|(file, digest)| now.get(file) == Some(digest))
}

fn refused(error: &str, who: &str, file: &str) -> Outcome {
    let name = Path::new(file).file_name().unwrap().to_str().unwrap();
    if !error.contains("damaged") {
        eprintln!("{who}: {file}: {error}");
    }
    assert!(error.contains(name) || error.contains("part-"), "{who} names no file: {error}");
    Outcome::Refused
}

/// An error's text; a panic is a defect.
fn broken(error: RunError) -> String {
    assert!(!matches!(error, RunError::Panic { .. }), "{error}");
    chain(error)
}

fn record_a_run(lab: &Lab, out: &Path) {
    let run = RunRecord {
        periscope: "0.1.0".to_owned(),
        pipeline: "around-the-corner.toml".into(),
        set: Vec::new(),
        campaigns: BTreeMap::from([("around-the-corner".to_owned(), lab.campaign())]),
        host: "bench".to_owned(),
        process: 1,
        started: "2026-03-14T09:15:00Z".to_owned(),
        ended: None,
        ending: None,
        failure: None,
        rejects: 0,
        tables: BTreeMap::new(),
    };
    Shelf::open(out).unwrap().write_run(&run).unwrap();
}

fn print(name: &str, rows: &[(bool, Outcome, Outcome)]) {
    let found = Rate::of(rows.iter().map(|(found, ..)| *found));
    let count =
        |of: fn(&(bool, Outcome, Outcome)) -> Outcome, what: Outcome| rows.iter().filter(|row| of(row) == what).count();
    let outcomes = |of: fn(&(bool, Outcome, Outcome)) -> Outcome| {
        [Outcome::Refused, Outcome::Harmless, Outcome::Silent].map(|what| count(of, what).to_string()).join(" | ")
    };
    println!(
        "| {name} | {} | {} = {found} | {} | {} |",
        rows.len(),
        found.hits,
        outcomes(|row| row.1),
        outcomes(|row| row.2)
    );
}

/// Flips in raw files of a sealed campaign.
fn raw_files(flips: usize) {
    let lab = Lab::of(SCENE, 1, Format::Trc);
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    seal(&campaign, &campaign.survey().unwrap(), false).unwrap();
    lab.run("whole", PIPELINE, &Settings::default()).unwrap();
    let parts = lab.parts("whole");
    let survey = campaign.survey().unwrap();
    let files: Vec<PathBuf> = survey.files().into_iter().map(|file| campaign.path_of(file)).collect();
    let mut draws = ChaCha8Rng::seed_from_u64(10);
    let (mut verify, mut run, mut silent) = (Vec::new(), Vec::new(), 0);
    for _ in 0..flips {
        let file = &files[draws.random_range(0..files.len())];
        let bit = draws.random_range(0..8 * fs::metadata(file).unwrap().len());
        flip(file, bit);
        let name = file.file_name().unwrap().to_str().unwrap();
        verify.push(verified(&lab.campaign(), &["--rehash"], name));
        // Into an empty folder, so that every raw file is read.
        let _ = fs::remove_dir_all(lab.path("again"));
        let refused = match lab.run("again", PIPELINE, &Settings::default()) {
            Err(error) => broken(error).contains(name),
            Ok(_) => false,
        };
        // What was finished before it stopped must be what an undamaged campaign gives.
        silent += usize::from(lab.parts("again").iter().any(|(file, digest)| parts.get(file) != Some(digest)));
        run.push(refused);
        flip(file, bit);
    }
    let (verify, run) = (Rate::of(verify), Rate::of(run));
    println!(
        "\n| raw files | flips | found by `verify --rehash` [95 %] | refused by a run that reads them [95 %] | wrong parts left behind |"
    );
    println!("|---|---|---|---|---|");
    println!("| {} | {flips} | {} = {verify} | {} = {run} | {silent} |", files.len(), verify.hits, run.hits);
}
