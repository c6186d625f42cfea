//! Flipped bits: one bit of one file at a time, in a result folder and in raw files. Which command notices it, and does
//! any give wrong numbers?
//!
//! `-- flips 500 200`: 500 flips in a result folder, 200 in raw files.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::process::Command;

use arrow_array::RecordBatch;
use periscope::campaign::{Campaign, Manifest, seal};
use periscope::pipeline::run::{RunError, Settings};
use periscope::simulate::Format;
use periscope::store::lineage::table_recipe;
use periscope::store::runs::RunRecord;
use periscope::store::{Shelf, StageId};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::{Lab, chain};
use crate::score::Rate;

const SCENE: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
const PIPELINE: &str = include_str!("../../pipelines/scene.toml");

/// Kinds of files, and how many of 500 flips go to each. Within a kind every file has the same chance, and within a
/// file every bit.
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

/// Whether a file's name ends so.
fn is(file: &str, ending: &str) -> bool {
    Path::new(file).extension().is_some_and(|suffix| suffix == ending)
}

fn kind(path: &str) -> &'static str {
    let name = path.rsplit('/').next().unwrap_or_default();
    let index = match name {
        "stage.json" => 4,
        "table.json" => 3,
        "manifest.json" => 5,
        _ if path.contains("/runs/") || path.contains("/rejects-") => 6,
        _ if is(name, "json") => 2,
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

/// Non-empty files, by path; the views' links to parts count as those parts. Locks are left out: their text has no
/// meaning.
fn files(folder: &Path) -> BTreeMap<String, u64> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).unwrap().flatten() {
            let (path, metadata) = (entry.path(), entry.metadata().unwrap());
            if metadata.is_dir() {
                folders.push(path);
            } else if metadata.is_file() && metadata.len() > 0 && path.file_name().is_some_and(|name| name != "lock") {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                if !name.contains("/table-") || is(&name, "json") {
                    files.insert(name, metadata.len());
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
    let tables: Vec<_> =
        periscope::tables::all().into_iter().map(|(table, _)| table_recipe(table, &id.recipe())).collect();
    for (folder, consumer) in stages {
        if consumer.inputs.values().any(|input| tables.contains(input)) {
            fs::remove_dir_all(out.join(".shelf").join(folder)).unwrap();
        }
    }
}

/// A whole result folder, and what is known of it.
struct Whole {
    lab: Lab,
    files: BTreeMap<String, u64>,
    stages: BTreeMap<String, StageId>,
    values: BTreeMap<String, Vec<RecordBatch>>,
    parts: BTreeMap<String, blake3::Hash>,
}

/// What came of a flip: whether `verify` found it, of reading all tables, of a run.
type Row = (bool, Outcome, Outcome);

impl Whole {
    fn new() -> Self {
        let lab = few_shots();
        let out = lab.path("whole");
        lab.run("whole", PIPELINE, &Settings::default()).unwrap();
        let campaign = lab.campaign();
        let run = RunRecord::start("scene".into(), &[], [("around-the-corner", campaign.as_path())]);
        Shelf::open(&out).unwrap().write_run(&run.unwrap()).unwrap();
        let files = files(&out);
        let stage = |folder: &str| {
            let text = fs::read(out.join(".shelf").join(folder).join("stage.json")).unwrap();
            (folder.to_owned(), serde_json::from_slice(&text).unwrap())
        };
        let folders = files.keys().filter_map(|file| file.strip_prefix(".shelf/")?.strip_suffix("/stage.json"));
        let (stages, values, parts) = (folders.map(stage).collect(), values(&out).unwrap(), lab.parts("whole"));
        Self { lab, files, stages, values, parts }
    }

    /// Flips one bit of a copy named `work`.
    fn flip(&self, work: &str, file: &str, bit: u64) -> Row {
        let out = self.lab.path(work);
        copy(&self.lab.path("whole"), &out);
        flip(&out.join(file), bit);
        let name = Path::new(file).file_name().unwrap().to_str().unwrap();
        let is_detected = verified(&out, &[], name);
        let read = match values(&out) {
            // Tables are read by their views, whose files have names of their own.
            Err(error) => refused(&error, "read", if is(name, "parquet") { ".parquet" } else { name }),
            Ok(values) if values == self.values => Outcome::Harmless,
            Ok(_) => Outcome::Silent,
        };
        if is(file, "parquet") {
            take_consumers(&out, file.split('/').nth(1).unwrap_or_default(), &self.stages);
        }
        let run = match self.lab.run(work, PIPELINE, &Settings::default()) {
            Err(error) => refused(&broken(error), "run", name),
            // A table that nothing is made from is not read by a run; who reads it is refused.
            Ok(_) if self.made_alike(work, name) => Outcome::Harmless,
            Ok(_) => Outcome::Silent,
        };
        if !is_detected || read == Outcome::Silent || run == Outcome::Silent {
            eprintln!("{file} bit {bit}: found {is_detected}, read {read:?}, run {run:?}");
        }
        (is_detected, read, run)
    }

    /// Whether every part, that with the flip apart, has the bytes that it had.
    fn made_alike(&self, work: &str, flipped: &str) -> bool {
        let now = self.lab.parts(work);
        let others = self.parts.iter().filter(|(file, _)| !file.contains("/table-") && !file.ends_with(flipped));
        others.filter(|(file, _)| file.contains("/part-")).all(|(file, digest)| now.get(file) == Some(digest))
    }
}

/// The scene of the demo, with fewer shots: every table has rows, and a run takes half a second.
fn few_shots() -> Lab {
    let scene = SCENE.replace("\nshots = 200", "\nshots = 40").replace("response_shots = 2000", "response_shots = 400");
    assert_ne!(scene, SCENE);
    Lab::of(&scene, 1, Format::Trc)
}

fn results(flips: usize) {
    let whole = Whole::new();
    let mut draws = ChaCha8Rng::seed_from_u64(9);
    let mut drawn = Vec::new();
    for (name, weight) in KINDS {
        let of_kind: Vec<(&String, &u64)> = whole.files.iter().filter(|(file, _)| kind(file) == name).collect();
        for _ in 0..flips * weight / 500 {
            let (file, bytes) = of_kind[draws.random_range(0..of_kind.len())];
            drawn.push((name, file, draws.random_range(0..8 * bytes)));
        }
    }
    let threads = std::thread::available_parallelism().map_or(1, NonZero::get);
    let share = |thread: usize| -> Vec<(&str, Row)> {
        let mine = drawn.iter().skip(thread).step_by(threads);
        mine.map(|(name, file, bit)| (*name, whole.flip(&format!("work-{thread}"), file, *bit))).collect()
    };
    let rows: Vec<(&str, Row)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|thread| scope.spawn(move || share(thread))).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a flip is no defect")).collect()
    });
    println!("{} files of {} bytes in the result folder\n", whole.files.len(), whole.files.values().sum::<u64>());
    println!(
        "| files | flips | found by `verify` [95 %] | read: refused | harmless | silent | run: refused | harmless | silent |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, _) in KINDS {
        print(name, rows.iter().filter(|(of, _)| *of == name).map(|(_, row)| *row).collect());
    }
    print("all", rows.iter().map(|(_, row)| *row).collect());
}

fn refused(error: &str, who: &str, name: &str) -> Outcome {
    assert!(error.contains(name), "{who} does not name {name}: {error}");
    Outcome::Refused
}

/// An error's text; a panic is a defect.
fn broken(error: RunError) -> String {
    assert!(!matches!(error, RunError::Panic { .. }), "{error}");
    chain(error)
}

fn print(name: &str, rows: Vec<Row>) {
    let detection = Rate::of(rows.iter().map(|(is_detected, ..)| *is_detected));
    let outcomes = |of: fn(&Row) -> Outcome| {
        let count = |what: Outcome| rows.iter().filter(|row| of(row) == what).count().to_string();
        [Outcome::Refused, Outcome::Harmless, Outcome::Silent].map(count).join(" | ")
    };
    let (read, run) = (outcomes(|row| row.1), outcomes(|row| row.2));
    println!("| {name} | {} | {} = {detection} | {read} | {run} |", rows.len(), detection.hits);
}

/// Flips in raw files of a sealed campaign.
fn raw_files(flips: usize) {
    let lab = few_shots();
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
        keep_stamp(&campaign, file);
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
        keep_stamp(&campaign, file);
    }
    let (verify, run) = (Rate::of(verify), Rate::of(run));
    println!(
        "\n| raw files | flips | found by `verify --rehash` [95 %] | refused by a run that reads them [95 %] | wrong parts left behind |"
    );
    println!("|---|---|---|---|---|");
    println!("| {} | {flips} | {} = {verify} | {} = {run} | {silent} |", files.len(), verify.hits, run.hits);
}

/// Puts the present stamp of a raw file into the seal, since a disk that decays changes none.
fn keep_stamp(campaign: &Campaign, file: &Path) {
    let mut manifest = Manifest::load(&campaign.root).unwrap().unwrap();
    let path = file.strip_prefix(&campaign.root).unwrap();
    let recorded = manifest.get(path).unwrap().blake3;
    manifest.record(path, recorded, &fs::metadata(file).unwrap());
    manifest.save(&campaign.root).unwrap();
}

/// Flips in campaign.toml and in the table of captures of a sealed campaign. `numbers`: how many in each.
pub fn settings(numbers: &[usize]) {
    let flips = numbers.first().copied().unwrap_or(300);
    let lab = few_shots();
    table_of_captures(&lab);
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    seal(&campaign, &campaign.survey().unwrap(), false).unwrap();
    fs::write(lab.path("pipeline.toml"), PIPELINE).unwrap();
    let run = |out: &str| {
        let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", out, "--progress", "none"];
        Command::new(env!("CARGO_BIN_EXE_periscope")).args(run).current_dir(lab.path("")).output().unwrap()
    };
    assert!(run("out").status.success());
    println!(
        "\n| settings | flips | found by `verify` of the campaign [95 %] | of the results [95 %] | refused by `run` [95 %] |"
    );
    println!("|---|---|---|---|---|");
    let mut draws = ChaCha8Rng::seed_from_u64(11);
    for name in ["campaign.toml", "captures.csv"] {
        let file = lab.campaign().join(name);
        let bits = 8 * fs::metadata(&file).unwrap().len();
        let (mut of_campaign, mut of_results, mut refused) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..flips {
            let bit = draws.random_range(0..bits);
            flip(&file, bit);
            of_campaign.push(verified(&lab.campaign(), &[], name));
            of_results.push(verified(&lab.path("out"), &[], name));
            let ran = run("out");
            refused.push(ran.status.code() == Some(1) && String::from_utf8_lossy(&ran.stderr).contains(name));
            flip(&file, bit);
        }
        let [of_campaign, of_results, refused] =
            [of_campaign, of_results, refused].map(Rate::of).map(|rate| format!("{} = {rate}", rate.hits));
        println!("| {name} | {flips} | {of_campaign} | {of_results} | {refused} |");
    }
}

/// Adds a capture that a table names, so that the settings have one.
fn table_of_captures(lab: &Lab) {
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    let first = campaign.path_of(&campaign.survey().unwrap().exposures[0].file);
    fs::copy(first, lab.campaign().join("raw/dark.trc")).unwrap();
    fs::write(lab.campaign().join("captures.csv"), "file,sensor\nraw/dark.trc,s1\n").unwrap();
    let file = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(file, text + "\n[[captures]]\nrole = \"dark\"\ntable = \"captures.csv\"\n").unwrap();
}
