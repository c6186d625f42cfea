//! The command line as a new user meets it: what is printed, and exit codes.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::lab::{ALL_VISIBLE, Lab};
#[cfg(not(feature = "query"))]
use crate::python::printed;

fn periscope(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap()
}

fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn err(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[test]
fn the_demo_prints_found_and_true_positions_and_names_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let demo = periscope(folder.path(), &["demo"]);
    assert_eq!(demo.status.code(), Some(0), "{}", err(&demo));
    let text = out(&demo);
    let patches = text.lines().filter(|line| line.contains(" mm ") && line.contains("  (")).count();
    assert_eq!(patches, 11, "{text}");
    for word in [
        "found",
        "true",
        "sd",
        "visible: rms error",
        "hidden: rms error",
        "periscope-demo/out/patches",
        "periscope-demo/out/report.html",
        "periscope run",
    ] {
        assert!(text.contains(word), "{word} is not in:\n{text}");
    }
    // The command that it prints works, and has nothing left to do.
    let again: Vec<&str> =
        text.lines().find(|line| line.contains("periscope run")).unwrap().split_whitespace().skip(1).collect();
    let again = periscope(folder.path(), &again);
    assert_eq!(again.status.code(), Some(0), "{}", err(&again));
    assert!(!out(&again).contains("computed") && out(&again).contains("reused"), "{}", out(&again));
    let visible = periscope(folder.path(), &["demo", "all-visible"]);
    let visible = out(&visible);
    assert!(
        visible.contains(" 12 visible") && visible.contains("the paper's method") && !visible.contains("hidden:"),
        "{visible}"
    );
    let mirror = out(&periscope(folder.path(), &["demo", "mirror"]));
    assert!(mirror.contains("  3 mirror") && mirror.contains("mirror: rms error"), "{mirror}");
    let other = periscope(folder.path(), &["demo", "all-visble"]);
    assert!(other.status.code() == Some(1) && err(&other).contains("all-visible"), "{}", err(&other));
    fs::create_dir(folder.path().join("mine")).unwrap();
    fs::write(folder.path().join("mine/thesis.tex"), "").unwrap();
    let refused = periscope(folder.path(), &["demo", "--out", "mine"]);
    assert!(refused.status.code() == Some(1) && err(&refused).contains("choose another folder"), "{}", err(&refused));
    assert!(folder.path().join("mine/thesis.tex").exists());
}

#[test]
fn help_and_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    let help = out(&periscope(folder.path(), &["--help"]));
    for command in [
        "demo",
        "run",
        "plan",
        "inspect",
        "check",
        "tables",
        "query",
        "explain",
        "diff",
        "seal",
        "simulate",
        "schema",
        "completions",
        "man",
    ] {
        assert!(help.contains(&format!("\n  {command}")), "{command} is not in:\n{help}");
    }
    assert_eq!(periscope(folder.path(), &[]).status.code(), Some(2));
    let wrong = periscope(folder.path(), &["run", "p.toml", "--campain", "x"]);
    assert!(wrong.status.code() == Some(2) && err(&wrong).contains("--campaign"), "{}", err(&wrong));
    let missing = periscope(folder.path(), &["run", "p.toml", "--campaign", "x", "--out", "o"]);
    assert!(missing.status.code() == Some(1) && err(&missing).contains("x/campaign.toml"), "{}", err(&missing));
}

#[test]
fn inspect_says_what_is_in_a_file() {
    let lab = Lab::tiny();
    let file = "campaign/raw/scene/s1_L1_P2_C1.trc";
    let json = periscope(&lab.path(""), &["inspect", "--format", "json", file]);
    let lines: Vec<Value> = serde_json::from_str(&out(&json)).unwrap();
    assert_eq!(lines.len(), 24);
    let keys = [
        "file",
        "format",
        "kind",
        "instrument",
        "channel",
        "segment",
        "samples",
        "dt_s",
        "t0_s",
        "unit",
        "gain",
        "offset",
        "acquired_at",
        "clipped",
        "first",
        "last",
        "mean",
        "min",
        "max",
        "sha256_f32le",
        "remarks",
    ];
    assert!(keys.iter().all(|key| lines[0].get(key).is_some()), "{}", lines[0]);
    assert!(
        lines[3]["segment"] == 3
            && lines[0]["samples"] == 320
            && lines[0]["unit"] == "V"
            && lines[0]["channel"] == "C1",
        "{}",
        lines[3]
    );
    fs::write(lab.path("bad.trc"), "WAVEDESC").unwrap();
    let mixed = periscope(&lab.path(""), &["inspect", "bad.trc", file]);
    assert!(
        mixed.status.code() == Some(1) && err(&mixed).contains("bad.trc") && out(&mixed).lines().count() == 2,
        "{}{}",
        out(&mixed),
        err(&mixed)
    );
    assert!(
        out(&mixed).starts_with("file ") && out(&mixed).contains("C1               24      320  50 ps"),
        "{}",
        out(&mixed)
    );
}

/// Samples leave a file as text or as an array, with a plot to look at them first; what surrounds them is told.
#[test]
fn inspect_gives_samples_out() {
    let lab = Lab::tiny();
    let (here, file) = (lab.path(""), "campaign/raw/scene/s1_L1_P2_C1.trc");
    let inspect = |args: &[&str]| periscope(&here, &[&["inspect", file], args].concat());
    let plotted = out(&inspect(&["--plot", "--segment", "3"]));
    assert!(plotted.lines().count() == 10 && plotted.contains('\u{2588}'), "{plotted}");
    out(&inspect(&["--npy", "all.npy"]));
    let array = periscope(&here, &["inspect", "all.npy", "--format", "json"]);
    let rows: Vec<Value> = serde_json::from_str(&out(&array)).unwrap();
    let json: Vec<Value> = serde_json::from_str(&out(&inspect(&["--format", "json"]))).unwrap();
    assert_eq!(rows.len(), 24);
    assert!(rows.iter().zip(&json).all(|(row, json)| row["sha256_f32le"] == json["sha256_f32le"]));
    let several = inspect(&["--csv", "one.csv"]);
    assert!(err(&several).contains("choose one with --channel (C1) and --segment"), "{}", err(&several));
    out(&inspect(&["--csv", "one.csv", "--channel", "C1", "--segment", "3"]));
    let one: Vec<Value> =
        serde_json::from_str(&out(&periscope(&here, &["inspect", "one.csv", "--format", "json"]))).unwrap();
    assert_eq!((&one[0]["sha256_f32le"], &one[0]["unit"]), (&json[3]["sha256_f32le"], &json[3]["unit"]));
    assert!((one[0]["t0_s"].as_f64().unwrap() - json[3]["t0_s"].as_f64().unwrap()).abs() < 1e-18);
    assert!(err(&inspect(&["--channel", "C9"])).contains("its channels are C1"));
    let mut longer = fs::read(lab.path(file)).unwrap();
    longer.extend([7; 100]);
    fs::write(lab.path("longer.trc"), longer).unwrap();
    let told = out(&periscope(&here, &["inspect", "longer.trc"]));
    assert!(told.contains("remark: byte") && told.contains("100 bytes at the end of the file"), "{told}");
}

/// A named pipe has no end to wait for.
#[cfg(unix)]
#[test]
fn inspect_refuses_a_pipe_at_once() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Command::new("mkfifo").arg(folder.path().join("a.trc")).status().unwrap().success());
    let refused = periscope(folder.path(), &["inspect", "a.trc"]);
    assert!(refused.status.code() == Some(1) && err(&refused).contains("is a pipe or a device"), "{}", err(&refused));
}

#[test]
fn run_plan_tables_seal_and_schema() {
    let lab = Lab::tiny();
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    let here = lab.path("");
    let args = |command: &'static str| [command, "p.toml", "--campaign", "campaign", "--out", "out"];
    let before = out(&periscope(&here, &args("plan")));
    // The campaign has neither fiducials nor blocked captures: nothing is to be read of them.
    let mut computed = before.lines().skip(1).filter(|line| !line.contains(" session_"));
    assert!(computed.all(|line| line.starts_with("compute")), "{before}");
    assert!(!here.join("out").exists(), "plan makes nothing");
    let run = periscope(&here, &args("run"));
    assert_eq!(run.status.code(), Some(0), "{}", err(&run));
    let after = out(&periscope(&here, &args("plan")));
    assert!(after.lines().skip(1).all(|line| line.starts_with("reuse")), "{after}");
    let tables = out(&periscope(&here, &["tables", "out"]));
    assert!(tables.contains("patches.residuals") && tables.contains("refine"), "{tables}");
    let seal = periscope(&here, &["seal", "campaign"]);
    assert!(seal.status.code() == Some(0) && out(&seal).contains("34 joined"), "{}{}", out(&seal), err(&seal));
    let schema = out(&periscope(&here, &["schema", "onsets"]));
    assert!(schema.contains("time_ps f64 [ps]"), "{schema}");
    // A bad file: done, but with exit code 3, which --strict makes 1.
    fs::write(here.join("campaign/raw/scene/s1_L1_P2_C1.trc"), "broken").unwrap();
    fs::remove_file(here.join("campaign/manifest.json")).unwrap();
    let strict = periscope(&here, &["run", "p.toml", "--campaign", "campaign", "--out", "other"]);
    assert!(
        strict.status.code() == Some(3) && err(&strict).contains("other/rejects"),
        "{:?} {}",
        strict.status,
        err(&strict)
    );
    let strict = periscope(&here, &["run", "p.toml", "--campaign", "campaign", "--out", "other", "--strict"]);
    assert_eq!(strict.status.code(), Some(1));
}

/// The keys that docs/guide/running.md lists.
/// Run some times: a pass whose threads stop one another would be made again, now and then.
#[test]
fn progress_as_json_says_what_every_pass_reads_and_makes() {
    let lab = Lab::tiny();
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    // Of the scene every byte is read once, of its onsets every row; each pass that begins ends, with all read.
    let bytes: u64 =
        fs::read_dir(lab.path("campaign/raw/scene")).unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    let keys = |event: &Value| event.as_object().unwrap().keys().map(String::as_str).collect::<Vec<_>>().join(" ");
    for round in 0..20 {
        let out = format!("out{round}");
        let run = ["run", "p.toml", "--campaign", "campaign", "--out", &out, "--progress", "json"];
        let text = err(&periscope(&lab.path(""), &run));
        let events: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        // A pass that takes long, as on a busy machine, also says how far it is.
        let on_its_way = |event: &&Value| event["event"] != "read";
        let (began, ended): (Vec<&Value>, Vec<&Value>) =
            events.iter().filter(on_its_way).partition(|event| event["event"] == "pass");
        assert!(began.iter().all(|pass| keys(pass) == "event of tables unit wanted whole"), "{text}");
        assert!(ended.iter().all(|done| keys(done) == "event left_s of read rejected seconds tables unit"), "{text}");
        assert!(began.iter().any(|pass| pass["unit"] == "bytes" && pass["of"] == bytes), "{bytes} {text}");
        assert!(
            began.iter().any(|pass| pass["unit"] == "rows" && pass["of"] == 16 && pass["tables"][0] == "labels"),
            "{text}"
        );
        assert_eq!(began.len(), ended.len(), "{text}");
        for (pass, done) in began.iter().zip(&ended) {
            let is_read = done["read"] == pass["of"] && done["of"] == pass["of"];
            assert!(pass["tables"] == done["tables"] && is_read, "{text}");
        }
        assert!(began.windows(2).all(|two| two[0]["whole"].as_u64() < two[1]["whole"].as_u64()), "{text}");
    }
}

#[test]
fn simulate_writes_a_campaign_that_run_solves_in_either_format() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/scenes/tiny.toml");
    let pipeline = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/all-visible.toml");
    for format in ["trc", "npy"] {
        let simulated = periscope(
            folder.path(),
            &["simulate", scene.to_str().unwrap(), "--out", format, "--format", format, "--seed", "5"],
        );
        assert!(simulated.status.code() == Some(0) && out(&simulated).contains("16 captures"), "{}", err(&simulated));
        let results = format!("{format}-out");
        let run =
            periscope(folder.path(), &["run", pipeline.to_str().unwrap(), "--campaign", format, "--out", &results]);
        assert_eq!(run.status.code(), Some(0), "{}", err(&run));
    }
    let used = periscope(folder.path(), &["simulate", scene.to_str().unwrap(), "--out", "trc"]);
    assert!(used.status.code() == Some(1) && err(&used).contains("not empty"), "{}", err(&used));
    fs::write(folder.path().join("bad.toml"), fs::read_to_string(&scene).unwrap().replacen("jitter_ps", "jiter_ps", 1))
        .unwrap();
    let bad = periscope(folder.path(), &["simulate", "bad.toml", "--out", "x"]);
    assert!(err(&bad).contains("did you mean `jitter_ps`?") && err(&bad).contains("line"), "{}", err(&bad));
}

#[cfg(not(feature = "query"))]
#[test]
fn a_lean_build_says_how_to_query() {
    let lab = Lab::tiny();
    lab.rows_of_patches("out");
    let query = periscope(&lab.path(""), &["query", "out", "SELECT patch, x_m FROM patches"]);
    assert_eq!(query.status.code(), Some(1));
    assert!(err(&query).contains("--features query") && err(&query).contains("patches/*.parquet"), "{}", err(&query));
    // What it hands over for DuckDB is a question that DuckDB answers.
    let sql = "SELECT count(*) AS n FROM patches.residuals r JOIN labels l ON r.lit = l.lit AND r.seen = l.seen";
    let query = err(&periscope(&lab.path(""), &["query", "out", sql]));
    let (_, question) = query.split_once("ask DuckDB:\n").unwrap();
    let ask = format!("import duckdb\nprint(duckdb.sql(\"\"\"{question}\"\"\").fetchall())");
    if let Some(answer) = printed(&lab.path(""), &["-c", &ask]) {
        assert_eq!(answer.trim(), "[(16,)]");
    }
    let query = periscope(&lab.path(""), &["query", "out", "SELECT 1"]);
    assert!(err(&query).contains("names no table of out; it has calibration"), "{}", err(&query));
}

/// The campaign that the README shows is one that is read.
#[test]
fn the_readmes_campaign_is_valid() {
    let readme = include_str!("../../README.md");
    let text = readme.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    let campaign = periscope::campaign::Campaign::parse(Path::new("."), text).unwrap();
    assert_eq!((campaign.captures.len(), campaign.sensors.len()), (2, 1));
}
