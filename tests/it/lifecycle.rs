//! The life of a run: killed, interrupted, two at once, too much rejected, pruned. `benches/reliability.rs` does the
//! same at length for docs/reliability.md.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use arrow_array::RecordBatch;
use periscope::pipeline::rejects::MaxRejects;
use periscope::pipeline::run::{RunError, Settings};
use periscope::store::runs::Ending;
use periscope::store::{Shelf, TableRecord, parquet};

use crate::lab::{ALL_VISIBLE, Lab, chain};
use crate::many_parts::{ManyParts, errors};

/// Six kills, spread over a run; after each the same command goes on. Then one interruption.
#[test]
fn a_killed_run_goes_on_to_the_same_bytes_and_makes_no_finished_part_again() {
    let lab = ManyParts::new();
    let start = Instant::now();
    let undisturbed = lab.run("reference");
    let took = start.elapsed();
    assert_eq!(undisturbed.status.code(), Some(0), "{}", errors(&undisturbed));
    let whole = lab.files("reference");
    for sixth in 0..6 {
        let out = format!("killed-{sixth}");
        // One that has ended before shows nothing, and harms nothing.
        let Some(killed) = lab.kill(&out, took.mul_f64((f64::from(sixth) + 0.5) / 7.0)) else {
            continue;
        };
        let next = lab.run(&out);
        assert_eq!(next.status.code(), Some(0), "{}", errors(&next));
        assert!(lab.files(&out) == whole, "killed while {} was made: other bytes", killed.under_way);
        assert_eq!(lab.written_again(&killed.finished, &out), 0, "killed while {} was made", killed.under_way);
        assert_eq!(lab.left_over(&out), Vec::<PathBuf>::new());
    }
    interrupted(&lab, &whole);
}

fn interrupted(lab: &ManyParts, whole: &BTreeMap<PathBuf, blake3::Hash>) {
    let child = lab.start("interrupted");
    // As soon as some parts of several are finished.
    let is_among_parts = || lab.finished("interrupted").keys().filter(|path| path.ends_with_table("stir")).count() >= 2;
    let start = Instant::now();
    while !is_among_parts() && start.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let text = errors(&output);
    assert_eq!(output.status.code(), Some(130), "{text}");
    let last = text.lines().last().unwrap();
    assert!(last.starts_with("interrupted: ") && last.contains(" parts of draft_stir"), "{text}");
    assert!(last.ends_with("are kept; the same command goes on from there"), "{text}");
    assert_eq!(lab.left_over("interrupted"), Vec::<PathBuf>::new());
    let shelf = Shelf::look(&lab.path("interrupted")).unwrap();
    assert_eq!(shelf.runs().unwrap()[0].ending, Some(Ending::Interrupted));
    // What it left is no rubbish.
    assert_eq!(shelf.unneeded().unwrap(), []);
    let finished = lab.finished("interrupted");
    let next = lab.run("interrupted");
    assert_eq!(next.status.code(), Some(0), "{}", errors(&next));
    assert!(lab.files("interrupted") == *whole);
    assert_eq!(lab.written_again(&finished, "interrupted"), 0);
}

/// Whether a file on the shelf is of this table.
trait OfTable {
    fn ends_with_table(&self, table: &str) -> bool;
}

impl OfTable for std::path::Path {
    fn ends_with_table(&self, table: &str) -> bool {
        self.to_string_lossy().ends_with(&format!(".{table}.parquet"))
    }
}

#[test]
fn a_second_run_learns_who_holds_the_folder_or_waits() {
    let lab = Lab::tiny();
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    let run = |wait: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
        command.args(["run", "p.toml", "--campaign", "campaign", "--out", "out"]).args(wait).current_dir(lab.path(""));
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let held = Shelf::open(&lab.path("out")).unwrap();
    let refused = run(&[]).wait_with_output().unwrap();
    let text = errors(&refused);
    assert_eq!(refused.status.code(), Some(1), "{text}");
    assert!(text.contains(&format!("(process {} on ", std::process::id())) && text.contains("--wait"), "{text}");
    let mut waiting = run(&["--wait"]);
    std::thread::sleep(Duration::from_millis(500));
    assert!(waiting.try_wait().unwrap().is_none(), "it does not wait");
    drop(held);
    let waited = waiting.wait_with_output().unwrap();
    assert_eq!(waited.status.code(), Some(0), "{}", errors(&waited));
    assert!(errors(&waited).contains("waiting: another run is writing to out"), "{}", errors(&waited));
    let runs = Shelf::look(&lab.path("out")).unwrap().runs().unwrap();
    assert!(runs.len() == 1 && runs[0].ending == Some(Ending::Done) && runs[0].tables.contains_key("patches"));
    assert!(
        runs[0].pipeline == lab.path("p.toml") && runs[0].campaigns.values().eq([&lab.campaign()]),
        "{:?}",
        runs[0]
    );
}

/// While runs switch the views between two thresholds, every read of a view is of one whole table.
#[test]
fn readers_see_whole_tables_while_runs_publish() {
    const VIEWS: [(&str, &str, &str); 2] =
        [("onsets", "onsets", "onsets"), ("patches.residuals", "patches", "residuals")];
    let lab = Lab::tiny();
    let run = |sigma: f64| {
        let set = [format!("onsets.threshold_sigma={sigma}")];
        lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap().tables
    };
    let whole = [5.0, 6.0].map(run);
    let is_over = AtomicBool::new(false);
    let seen = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let shelf = Shelf::look(&lab.path("out")).unwrap();
            let mut seen = [0; 2];
            while !is_over.load(Ordering::Relaxed) {
                for (view, heading, table) in VIEWS {
                    let files = shelf.files(view).unwrap();
                    let footers = files.iter().map(|file| parquet::footer(file).unwrap());
                    let lineages: Vec<String> = footers
                        .map(|(_, entries)| entries.into_iter().find(|(key, _)| key == "periscope.lineage").unwrap().1)
                        .collect();
                    let is_of = |tables: &BTreeMap<String, TableRecord>| {
                        lineages.iter().eq(tables[heading]
                            .parts
                            .iter()
                            .map(|part| part.lineage.to_string())
                            .collect::<Vec<_>>()
                            .iter())
                    };
                    let which = whole.iter().position(is_of).expect("the files are those of one whole table");
                    let rows: usize = shelf.batches(view).unwrap().iter().map(RecordBatch::num_rows).sum();
                    assert!(whole.iter().any(|tables| tables[heading].rows(table) == rows as u64), "{rows} rows");
                    seen[which] += 1;
                }
                assert_eq!(shelf.batches("rejects").unwrap().iter().map(RecordBatch::num_rows).sum::<usize>(), 0);
            }
            seen
        });
        // The reader ends also where a run fails.
        let runs = std::panic::catch_unwind(|| (0..30).for_each(|i| drop(run([5.0, 6.0][i % 2]))));
        is_over.store(true, Ordering::Relaxed);
        let seen = reader.join().unwrap();
        runs.map_or_else(|panic| std::panic::resume_unwind(panic), |()| seen)
    });
    assert!(seen.iter().all(|&reads| reads > 5), "{seen:?}");
}

#[test]
fn a_run_that_goes_wrong_everywhere_is_stopped_and_says_by_what() {
    let lab = Lab::tiny();
    for name in ["s1_L1_P2_C1.trc", "s1_L2_P3_C1.trc", "s1_L3_P1_C1.trc"] {
        let path = lab.campaign().join("raw/scene").join(name);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..200]).unwrap(); // within its head: no shot is left
    }
    let run = |limit: &str, out: &str| {
        let settings = Settings { max_rejects: Some(limit.parse::<MaxRejects>().unwrap()), ..Settings::default() };
        lab.run(out, ALL_VISIBLE, &settings)
    };
    // 17 records: 16 captures and one of the response.
    for (limit, out) in [("2", "out"), ("10%", "other")] {
        let error = run(limit, out).unwrap_err();
        assert!(matches!(&error, RunError::Rejects(_)), "{error}");
        let text = chain(error);
        assert!(text.contains("3 of 17 records were rejected") && text.contains("3 of them alike"), "{text}");
        assert!(text.contains("raw/scene/s1_L") && text.contains("copy it from the instrument again"), "{text}");
        assert!(!lab.path(out).join("patches").exists() && lab.path(out).join("rejects").exists());
    }
    // The same again, with nothing new to read; then with a limit that lets it pass.
    assert!(matches!(run("2", "out").unwrap_err(), RunError::Rejects(_)));
    assert_eq!(run("3", "out").unwrap().rejects, 3);
    assert!(matches!(run("2", "out").unwrap_err(), RunError::Rejects(_)), "a limit also counts where all is reused");
    assert_eq!(run("20%", "other").unwrap().rejects, 3);
}

#[test]
fn pruning_takes_what_no_view_shows_and_a_run_has_nothing_to_do_after_it() {
    let lab = Lab::tiny();
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    let periscope = |args: &[&str]| {
        let output =
            Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(lab.path("")).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let run = ["run", "p.toml", "--campaign", "campaign", "--out", "out", "--set", "traces.keep=false"];
    periscope(&run);
    let shelf = Shelf::look(&lab.path("out")).unwrap();
    assert_eq!(shelf.unneeded().unwrap(), []);
    let before = lab.parts("out");
    periscope(&[&run[..], &["--set", "onsets.threshold_sigma=8"]].concat());
    let tables = periscope(&["tables", "out"]);
    assert!(tables.contains("last run: ") && tables.contains(": done at ") && tables.contains("--prune"), "{tables}");
    let dry = periscope(&["tables", "out", "--prune", "--dry-run"]);
    assert!(dry.contains("would remove  all    detect-") && !dry.contains("average-"), "{dry}");
    let during = lab.parts("out");
    assert!(before.keys().all(|file| during.contains_key(file)), "a dry run removes nothing");
    let pruned = periscope(&["tables", "out", "--prune"]);
    let words = |text: &str| text.replace("would remove", "removed").split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(words(&pruned), words(&dry));
    let after = lab.parts("out");
    assert!(after.len() < during.len() && after.iter().all(|(file, digest)| during[file] == *digest));
    assert!(!periscope(&["tables", "out"]).contains("--prune"));
    let again = periscope(&[&run[..], &["--set", "onsets.threshold_sigma=8"]].concat());
    assert!(!again.contains("computed"), "{again}");
    // What was pruned is made again, to the same bytes.
    periscope(&run);
    let restored = lab.parts("out");
    assert!(before.iter().all(|(file, digest)| restored[file] == *digest));
}
