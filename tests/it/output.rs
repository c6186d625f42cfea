//! What programs read: `--format json` and `csv` of every command that prints rows, and pipes that are closed early.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::{LazyLock, Mutex, PoisonError};

use serde_json::Value;

use crate::lab::Lab;

/// A campaign with results `a`, and `b` with another threshold.
static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let lab = Lab::tiny();
    std::fs::write(lab.path("scene.toml"), crate::lab::TINY).unwrap();
    for (out, set) in [("a", "onsets.threshold_sigma=5"), ("b", "onsets.threshold_sigma=9")] {
        let run = periscope(&lab, &["run", "all-visible", "--campaign", "campaign", "--out", out, "--set", set]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
    }
    lab
});

/// Held by tests whose commands write into the results: one at a time may.
static WRITES: Mutex<()> = Mutex::new(());

const FILE: &str = "campaign/raw/scene/s1_L1_P2_C1.trc";

/// Commands that print rows: arguments, whether their JSON is an array, and some of their columns.
const COMMANDS: [(&str, bool, &str); 14] = [
    ("pipelines", true, "pipeline,scene"),
    ("pipelines scene", false, "pipeline,scene,text"),
    ("plan all-visible --campaign campaign --out a", true, "action,table,stage,why"),
    (
        "plan all-visible --campaign campaign --out farm --shards 2",
        true,
        "key,captures,parts,bytes,piece,pieces,shots,inputs",
    ),
    ("run all-visible --campaign campaign --out a", true, "table,rows,made,folder"),
    ("tables a", true, "table,stage,rows,bytes,parts,lineage,made"),
    ("tables a --prune --dry-run", true, "action,share,folder,parts,bytes"),
    ("schema onsets", true, "table,column,type,may_be_null,unit,meaning"),
    ("inspect campaign/raw/scene/s1_L1_P2_C1.trc", true, "file,format,kind,instrument,channel,segment,samples,dt_s"),
    ("check --campaign campaign", false, "sensor,what,verdict,value,sd,expected,tolerance,unit,text"),
    ("explain a patch=3", false, "campaign,sensor,lit,seen,rank,path,time_ps,time_sd_ps"),
    ("diff a b", false, "table,verdict,column,unit,rows"),
    ("verify a", false, "file,tables,what,damage,fix"),
    ("design scene.toml", false, "patch,kind,sd_m,chance,onsets"),
];

fn command(lab: &Lab, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
    command.args(args).current_dir(lab.path("")).stdin(Stdio::null());
    command
}

fn periscope(lab: &Lab, args: &[&str]) -> Output {
    command(lab, args).output().unwrap()
}

fn formatted(args: &str, format: &str) -> (Option<i32>, String) {
    let output = periscope(&LAB, &args.split(' ').chain(["--format", format]).collect::<Vec<_>>());
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}

#[test]
fn errors_have_colours_where_a_terminal_wants_them() {
    let _held = WRITES.lock().unwrap_or_else(PoisonError::into_inner);
    let error = |variables: &[(&str, &str)]| {
        let mut command = command(&LAB, &["tables", "nowhere"]);
        command.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE").envs(variables.iter().copied());
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    let (plain, coloured) = (error(&[]), error(&[("CLICOLOR_FORCE", "1")]));
    assert!(plain.starts_with("error: "), "{plain}");
    assert!(coloured.starts_with("\u{1b}[") && coloured.contains("error:\u{1b}[0m "), "{coloured:?}");
    assert_eq!(error(&[("NO_COLOR", "1")]), plain);
}

#[test]
fn every_command_that_prints_rows_prints_json_and_csv() {
    let _held = WRITES.lock().unwrap_or_else(PoisonError::into_inner);
    for (args, is_array, columns) in COMMANDS {
        let ((code, json), (csv_code, csv)) = (formatted(args, "json"), formatted(args, "csv"));
        assert!(code == csv_code && matches!(code, Some(0 | 3)), "{args}: {code:?} {csv_code:?}");
        let json: Value = serde_json::from_str(&json).unwrap_or_else(|error| panic!("{args}: {error}: {json}"));
        assert_eq!(json.is_array(), is_array, "{args}");
        assert!(csv.starts_with(columns), "{args}: {csv}");
        assert_eq!(csv.matches('\n').count(), csv.matches("\r\n").count() + quoted_ends(&csv), "{args}: {csv}");
        let mut reader = csv::ReaderBuilder::new().from_reader(csv.as_bytes());
        let headers: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        if let Some(array) = json.as_array() {
            // A plan of shards is made anew each time, and its shards are gone from the second.
            assert_eq!(array.len(), rows.len(), "{args}");
            let keys =
                |row: &Value| row.as_object().unwrap().keys().cloned().collect::<std::collections::BTreeSet<_>>();
            assert!(array.iter().all(|row| keys(row) == headers.iter().cloned().collect()), "{args}: {headers:?}");
        }
    }
}

/// Line ends within quoted fields.
fn quoted_ends(csv: &str) -> usize {
    let quoted = csv.split('"').skip(1).step_by(2);
    quoted.map(|text| text.matches('\n').count()).sum()
}

#[test]
fn the_text_for_people_is_unchanged_by_the_flag_and_numbers_stand_at_the_right() {
    let tables = formatted("tables a", "table").1;
    assert_eq!(tables, String::from_utf8(periscope(&LAB, &["tables", "a"]).stdout).unwrap());
    let line = |name: &str| tables.lines().find(|line| line.starts_with(name)).unwrap();
    assert!(line("patches ").contains("  4  ") && tables.contains("last run:"), "{tables}");
    let (header, patches) = (line("table"), line("onsets "));
    let end = header.find("rows").unwrap() + "rows".len();
    assert!(patches[..end].ends_with("16"), "{tables}");
}

#[test]
fn the_flag_that_is_gone_names_the_new_one() {
    for args in ["inspect --json x", "plan --campaign campaign --json", "diff a b --json", "tables a --json"] {
        let output = periscope(&LAB, &args.split(' ').collect::<Vec<_>>());
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && text.contains("`--format json`"), "{args}: {text}");
    }
}

/// Every command that prints much: its reader goes after the first line, or before it.
#[test]
fn closed_pipes_end_commands_quietly() {
    let _held = WRITES.lock().unwrap_or_else(PoisonError::into_inner);
    let more =
        ["--help", "run --help", "completions bash", "schema", "plan all-visible --resolved", "demo all-visible"];
    for args in more.into_iter().chain(COMMANDS.map(|(args, ..)| args)) {
        for reads in [true, false] {
            let (reader, writer) = std::io::pipe().unwrap();
            let mut reader = Some(BufReader::with_capacity(16, reader)).filter(|_| reads);
            let mut command = command(&LAB, &args.split(' ').collect::<Vec<_>>());
            let child = command.stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
            drop(command); // and with it our own end of the pipe
            if let Some(reader) = &mut reader {
                reader.read_line(&mut String::new()).unwrap();
            }
            drop(reader);
            let output = child.wait_with_output().unwrap();
            let errors = String::from_utf8(output.stderr).unwrap();
            // What was printed before the pipe was closed may have been all.
            let code = output.status.code().expect("an exit code");
            assert!(code == 141 || (reads && matches!(code, 0 | 3)), "{args}: {code}: {errors}");
            assert!(!errors.contains("panicked") && !errors.contains("error"), "{args}: {errors}");
        }
    }
    // `check` measures in a temporary folder, which it removes all the same.
    let left = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with("periscope-check-");
    let temporary = LAB.path("temporary");
    std::fs::create_dir_all(&temporary).unwrap();
    let (_, writer) = std::io::pipe().unwrap();
    let mut check = command(&LAB, &["check", "--campaign", "campaign"]);
    let status = check.env("TMPDIR", &temporary).stdout(writer).stderr(Stdio::null()).status().unwrap();
    assert_eq!(status.code(), Some(141));
    assert!(!std::fs::read_dir(&temporary).unwrap().flatten().any(left));
}

/// Nothing reads the messages: the command does its work, and its exit code is its own.
#[test]
fn a_closed_standard_error_changes_nothing() {
    let out = "quiet";
    for (args, code) in [
        (format!("run all-visible --campaign campaign --out {out} --progress lines"), 0),
        (format!("run all-visible --campaign campaign --out {out}-json --progress json"), 0),
        (format!("run all-visible --campaign campaign --out {out}-bar --progress bar"), 0),
        ("tables nowhere".to_owned(), 1),
        ("tables --nothing".to_owned(), 2),
        (format!("inspect {FILE} nowhere.trc"), 1),
    ] {
        let mut child = command(&LAB, &args.split(' ').collect::<Vec<_>>());
        let mut child = child.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stderr.take());
        assert_eq!(child.wait().unwrap().code(), Some(code), "{args}");
    }
    assert!(LAB.path(out).join("patches").exists());
}

/// A disk that is full is an error, not a panic.
#[test]
fn output_that_cannot_be_written_is_an_error() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let stdout = std::fs::OpenOptions::new().write(true).open(full).unwrap();
    let output = command(&LAB, &["schema"]).stdout(stdout).output().unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(1) && errors.starts_with("error: cannot write to standard output"),
        "{errors}"
    );
}

/// A trace has a track for each stage, in whose spans no two overlap unless one holds the other, and changes no result.
#[test]
fn a_trace_says_what_each_stage_does_when() {
    let run = periscope(
        &LAB,
        &["run", "all-visible", "--campaign", "campaign", "--out", "traced", "--trace", "trace.json", "--threads", "2"],
    );
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let same = periscope(&LAB, &["diff", "a", "traced"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
    let events: Vec<Value> = serde_json::from_slice(&std::fs::read(LAB.path("trace.json")).unwrap()).unwrap();
    let named = events.iter().filter(|event| event["name"] == "thread_name");
    let tracks: Vec<(u64, &str)> =
        named.map(|event| (event["tid"].as_u64().unwrap(), event["args"]["name"].as_str().unwrap())).collect();
    for track in ["passes", "reader", "profiles", "stir", "onsets", "labels", "patches"] {
        assert!(tracks.iter().any(|(_, name)| *name == track), "{track} is not among {tracks:?}");
    }
    for (track, name) in tracks {
        let of_track = events.iter().filter(|event| event["tid"] == track && event["ph"] == "X");
        let ends = |event: &Value| {
            let from = event["ts"].as_f64().unwrap();
            (from, from + event["dur"].as_f64().unwrap())
        };
        let mut spans: Vec<(f64, f64)> = of_track.map(ends).collect();
        assert!(!spans.is_empty(), "{name} does nothing");
        spans.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
        for pair in spans.windows(2) {
            let [(_, end), (next, next_end)] = [pair[0], pair[1]];
            assert!(next >= end - 1e-3 || next_end <= end + 1e-3, "spans of {name} overlap: {pair:?}");
        }
    }
    let missing = periscope(
        &LAB,
        &["run", "all-visible", "--campaign", "campaign", "--out", "none", "--trace", "no-such-folder/trace.json"],
    );
    let said = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(missing.status.code() != Some(0) && said.contains("no-such-folder/trace.json"), "{said}");
}
