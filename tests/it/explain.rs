//! `periscope explain`: from a row back to the raw exposures, and no others.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::LazyLock;

use periscope::campaign::Campaign;
use periscope::history::explanation::{Explanation, explain};
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::simulate::{self, Format, Scene};
use periscope::store::{Shelf, runs::RunRecord};
use periscope::tables::{Label, Residual, Trace};

use crate::lab::{ALL_VISIBLE, Lab, TINY};
use crate::python::printed;

/// One campaign, analysed with and without its traces kept.
static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let unkept = ["traces.keep=false", "calibration_traces.keep=false"].map(str::to_owned);
    lab.run_with("unkept", ALL_VISIBLE, &unkept, &Settings::default()).unwrap();
    lab
});

fn explained(out: &str, target: &str, table: Option<&str>) -> Explanation {
    let shelf = Shelf::look(&LAB.path(out)).unwrap();
    explain(&shelf, &target.parse().unwrap(), table, &[LAB.campaign()]).unwrap()
}

fn refused(target: &str, table: Option<&str>) -> String {
    let shelf = Shelf::look(&LAB.path("out")).unwrap();
    explain(&shelf, &target.parse().unwrap(), table, &[]).unwrap_err().to_string()
}

/// Raw files of the captures, with the segments of each; `None` where the explanation says: all.
fn raw(explanation: &Explanation) -> BTreeMap<(String, bool), Option<Vec<i32>>> {
    let records = explanation.captures.iter().flat_map(|capture| &capture.raw);
    records.map(|records| ((records.file.clone(), records.is_reference), records.segments.clone())).collect()
}

fn periscope(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(LAB.path("")).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What stands behind patch 3, from the whole tables: the definition.
fn behind_patch_3() -> (BTreeSet<(i32, i32, i32)>, BTreeMap<(String, bool), Option<Vec<i32>>>) {
    let residuals: Vec<Residual> = LAB.rows("out", "patches.residuals");
    let over: Vec<&Residual> = residuals.iter().filter(|row| row.path.contains(&3)).collect();
    let pairs: BTreeSet<(i32, i32)> = over.iter().map(|row| (row.lit, row.seen)).collect();
    let mut raw: BTreeMap<(String, bool), Option<Vec<i32>>> = BTreeMap::new();
    let traces: Vec<Trace> = LAB.rows("out", "traces");
    for trace in traces.iter().filter(|trace| pairs.contains(&(trace.lit, trace.seen))) {
        let segments = raw.entry((trace.file.to_string(), trace.is_reference)).or_default();
        segments.get_or_insert_default().extend(trace.segment);
    }
    (over.iter().map(|row| (row.lit, row.seen, row.rank)).collect(), raw)
}

#[test]
fn behind_a_patch_stand_the_exposures_of_its_onsets_and_no_others() {
    let patch = explained("out", "patch=3", None);
    assert_eq!((&*patch.table, &*patch.stage), ("patches", "refine"));
    let (onsets, files) = behind_patch_3();
    let keys: Vec<(i32, i32, i32)> = patch.onsets.iter().map(|onset| (onset.lit, onset.seen, onset.rank)).collect();
    assert_eq!((keys.len(), keys.into_iter().collect::<BTreeSet<_>>()), (onsets.len(), onsets));
    assert_eq!(raw(&patch), files);
    assert!(files.len() > 8 && files.len() < 32, "{} of 32 files were meant", files.len());
    let rests_on = patch.onsets.iter().filter(|onset| onset.used == Some(true)).count() as u64;
    assert_eq!(patch.row["onsets"], rests_on);
    for onset in &patch.onsets {
        assert!(onset.time_sd_ps > Some(0.0) && onset.probability > Some(0.5) && onset.snr > Some(5.0), "{onset:?}");
        assert!(onset.pull.is_some() && onset.path.as_ref().unwrap().contains(&3), "{onset:?}");
    }
    for capture in &patch.captures {
        assert_eq!(capture.shots.unwrap() + capture.rejected.unwrap(), 24, "{capture:?}");
        assert_eq!(capture.raw.iter().map(|records| records.exposures).collect::<Vec<_>>(), [Some(24); 2]);
    }
    let [sensor] = patch.sensors.as_slice() else { panic!("{:?}", patch.sensors) };
    assert!((sensor.latency_ps.unwrap() - 900.0).abs() < 5.0 && sensor.delay_ps.is_some(), "{sensor:?}");
    assert!(sensor.raw.iter().all(|records| records.file.starts_with("raw/response/")), "{sensor:?}");
    let tables: Vec<&str> = patch.tables.iter().map(|table| table.table.as_str()).collect();
    assert!(tables.ends_with(&["onsets", "labels", "distances", "start", "patches"]), "{tables:?}");
    assert!(patch.beside.contains(&"patches.suspects".to_owned()), "{:?}", patch.beside);
}

#[test]
fn tables_without_residuals_go_by_their_labels() {
    for table in ["start", "paper"] {
        let patch = explained("out", "patch=3", Some(table));
        assert_eq!(patch.onsets.len(), behind_patch_3().0.len(), "{table}");
    }
    let distance = explained("out", "distance=4,3", None);
    let paths: BTreeSet<Vec<i32>> = distance.onsets.iter().filter_map(|onset| onset.path.clone()).collect();
    assert_eq!(paths, BTreeSet::from([vec![3], vec![4], vec![3, 4], vec![4, 3]]));
    assert_eq!(distance.captures.len(), 4);
    let own = explained("out", "distance=0,3", None);
    assert_eq!(own.onsets.iter().filter_map(|onset| onset.path.clone()).collect::<Vec<_>>(), [[3]]);
}

#[test]
fn behind_an_onset_stands_its_own_capture() {
    let labels: Vec<Label> = LAB.rows("out", "labels");
    let second = labels.iter().find(|row| row.path.as_deref() == Some([3, 4].as_slice())).unwrap();
    for name in ["", "s1,", "tiny,s1,"] {
        let onset = explained("out", &format!("onset={name}3,4,{}", second.rank), None);
        let [one] = onset.onsets.as_slice() else { panic!("{:?}", onset.onsets) };
        assert_eq!(one.path.as_deref(), Some([3, 4].as_slice()));
        assert!(one.residual_ps.is_some() && one.probability.is_some(), "{one:?}");
        assert!(raw(&onset).keys().all(|(file, _)| file.contains("L3_P4")), "{:?}", raw(&onset));
    }
    // Profiles that are explained together stand behind each other's onsets.
    let joint = ["stir.joint=true".to_owned()];
    LAB.run_with("joint", ALL_VISIBLE, &joint, &Settings::default()).unwrap();
    let onset = explained("joint", "onset=3,4,1", None);
    assert_eq!(onset.captures.iter().map(|capture| (capture.lit, capture.seen)).collect::<Vec<_>>(), [(3, 4), (4, 3)]);
}

#[test]
fn without_kept_traces_the_campaign_itself_is_asked() {
    let (_, files) = behind_patch_3();
    let whole: BTreeSet<&(String, bool)> = files.keys().collect();
    let patch = explained("unkept", "patch=3", None);
    let records = raw(&patch);
    assert_eq!(records.keys().collect::<BTreeSet<_>>(), whole);
    assert!(records.values().all(Option::is_none), "the files' segments are not known, all of them count: {records:?}");
    assert!(patch.sensors[0].raw.iter().any(|records| records.file.starts_with("raw/response/")));
    assert!(!patch.remarks.iter().any(|remark| remark.contains("raw files")), "{:?}", patch.remarks);
    assert!(patch.queries.iter().all(|query| query.about != "the raw records"));

    // The newest run says where the campaign is. A folder that is gone gives a remark, and the rest stands.
    let shelf = Shelf::look(&LAB.path("unkept")).unwrap();
    let without = |remark: &str| {
        let patch = explain(&shelf, &"patch=3".parse().unwrap(), None, &[]).unwrap();
        assert!(patch.remarks.iter().any(|text| text.contains(remark)), "{remark}: {:?}", patch.remarks);
        assert!(patch.captures.iter().all(|capture| capture.raw.is_empty() && capture.shots.is_some()));
    };
    let runs = LAB.path("unkept/.shelf/runs");
    let record = |started: &str, folder: &Path| {
        let campaigns = BTreeMap::from([("tiny".to_owned(), folder.to_owned())]);
        shelf.write_run(&run_record(started, campaigns)).unwrap();
    };
    let _ = fs::remove_dir_all(&runs);
    without("no run record says where campaign `tiny` is; say where it is with --campaign DIR");
    record("2026-01-02T03:04:05Z", &LAB.path("gone"));
    without("gone, is not there");
    record("2026-01-03T03:04:05Z", &LAB.campaign());
    let patch = explain(&shelf, &"patch=3".parse().unwrap(), None, &[]).unwrap();
    assert_eq!(raw(&patch), records);

    // Another file in the place of one that was read gives a remark.
    let other = tempfile::tempdir().unwrap();
    let scene = Scene::parse(Path::new("tiny.toml"), TINY).unwrap();
    simulate::simulate(&scene, 2, other.path(), Format::Trc).unwrap();
    let patch = explain(&shelf, &"patch=3".parse().unwrap(), None, &[other.path().to_owned()]).unwrap();
    assert!(patch.remarks.iter().any(|text| text.contains("raw files are not")), "{:?}", patch.remarks);
}

fn run_record(started: &str, campaigns: BTreeMap<String, std::path::PathBuf>) -> RunRecord {
    RunRecord {
        periscope: "0.1.0".to_owned(),
        pipeline: "all-visible.toml".into(),
        set: Vec::new(),
        campaigns,
        host: "bench".to_owned(),
        process: 1,
        started: started.to_owned(),
        ..RunRecord::default()
    }
}

#[test]
fn two_campaigns_are_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    let mut campaigns = Vec::new();
    for (day, seed) in [("monday", 1), ("tuesday", 2)] {
        let scene = TINY.replacen("name = \"tiny\"", &format!("name = \"{day}\""), 1);
        simulate::simulate(&Scene::parse(Path::new(day), &scene).unwrap(), seed, &folder.path().join(day), Format::Trc)
            .unwrap();
        campaigns.push(Campaign::load(&folder.path().join(day)).unwrap());
    }
    let shelf = Shelf::open(&folder.path().join("out")).unwrap();
    let spec = Spec::parse("test", ALL_VISIBLE, &["traces.keep=false".to_owned()]).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
    let folders: Vec<_> = ["tuesday", "monday"].map(|day| folder.path().join(day)).into();
    let patch = explain(&shelf, &"patch=3".parse().unwrap(), None, &folders).unwrap();
    for day in ["monday", "tuesday"] {
        let of_day = patch.captures.iter().filter(|capture| &*capture.campaign == day);
        let files = of_day.flat_map(|capture| &capture.raw).inspect(|records| assert_eq!(records.campaign, day));
        assert_eq!(files.count(), behind_patch_3().1.len(), "{day}");
    }
    assert!(!patch.remarks.iter().any(|remark| remark.contains("raw files")), "{:?}", patch.remarks);
    let several = explain(&shelf, &"onset=3,4,1".parse().unwrap(), None, &folders).unwrap_err().to_string();
    assert!(several.contains("onset=monday,s1,3,4,1, onset=tuesday,s1,3,4,1"), "{several}");
    let one = explain(&shelf, &"onset=tuesday,s1,3,4,1".parse().unwrap(), None, &folders).unwrap();
    assert!(one.captures.len() == 1 && one.captures[0].raw.iter().all(|records| records.campaign == "tuesday"));
}

/// A table that is older than its inputs' views goes back to those that it was made from.
#[test]
fn a_campaign_that_grew_since_does_not_change_what_stood_behind() {
    let lab = Lab::tiny();
    let late = ["C1", "C2"].map(|channel| lab.campaign().join(format!("raw/scene/s1_L4_P3_{channel}.trc")));
    late.iter().for_each(|file| fs::rename(file, file.with_extension("later")).unwrap());
    lab.rows_of_patches("out");
    late.iter().for_each(|file| fs::rename(file.with_extension("later"), file).unwrap());
    let spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let campaigns = [Campaign::load(&lab.campaign()).unwrap()];
    let shelf = Shelf::open(&lab.path("out")).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, Some("onsets")).unwrap();
    run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();

    let patch = explain(&shelf, &"patch=4".parse().unwrap(), None, &[]).unwrap();
    let records = raw(&patch);
    assert!(records.len() == 12 && records.keys().all(|(file, _)| !file.contains("L4_P3")), "{records:?}");
    assert!(!patch.remarks.iter().any(|remark| remark.contains("not on the shelf")), "{:?}", patch.remarks);
    assert!(patch.queries.iter().any(|query| query.sql.contains("/.shelf/")), "{:?}", patch.queries);
    let onset = explain(&shelf, &"onset=4,3,1".parse().unwrap(), None, &[]).unwrap();
    assert!(
        onset.captures.len() == 1 && onset.onsets[0].path.is_none(),
        "nothing has labelled it yet: {:?}",
        onset.onsets
    );
}

#[test]
fn what_is_not_there_is_reported_with_the_nearest() {
    for (target, table, text) in [
        ("patch=33", None, "`patches` has no patch 33; it has 1, 2, 3, 4"),
        (
            "distance=3,9",
            None,
            "`distances` has no distance of 3 and 9; of 3 it has those to 0, 1, 2, 4; of 9 it has those to none",
        ),
        ("onset=s2,3,4,1", None, "`onsets` has no sensor s2; did you mean `s1`?"),
        ("onset=3,4,9", None, "`onsets` has no onset 9 of lit 3, seen 4; that profile has ranks 1"),
        ("patch=3", Some("patchs"), "did you mean `patches`?"),
        ("patch=3", Some("onsets"), "known: "),
    ] {
        let error = refused(target, table);
        assert!(error.contains(text), "{target}: {error}");
    }
    let wrong = periscope(&["explain", "out", "pach=3"]);
    assert!(wrong.status.code() == Some(2) && text(&wrong.stderr).contains("did you mean `patch`?"));
    let nowhere = periscope(&["explain", "campaign", "patch=3"]);
    assert!(nowhere.status.code() == Some(1) && text(&nowhere.stderr).contains("campaign"), "{nowhere:?}");
}

#[test]
fn text_json_and_sql_say_the_same() {
    let (onsets, files) = behind_patch_3();
    let plain = text(&periscope(&["explain", "out", "patch=3", "--all"]).stdout);
    assert!(plain.starts_with("patch 3 in `patches` (refine): visible, ("), "{plain}");
    assert!(
        plain.contains("traces -> profiles -> stir -> onsets -> labels -> patches; with calibration, start, session"),
        "{plain}"
    );
    assert!(files.keys().all(|(file, _)| plain.contains(file)), "{plain}");
    assert!(plain.contains("segments 0-23") && plain.lines().count() < 60, "{plain}");
    let short = text(&periscope(&["explain", "out", "patch=3"]).stdout);
    assert!(short.lines().count() <= 20 && short.len() < plain.len() && !short.contains("SELECT"), "{short}");
    for line in [
        format!("3 of {} onsets, with the largest residuals", onsets.len()),
        format!("{} files raw/scene/", files.len()),
        "--all lists every onset and capture; --format sql prints the queries".to_owned(),
    ] {
        assert!(short.contains(&line), "{line} is not in:\n{short}");
    }
    let json = periscope(&["explain", "out", "patch=3", "--format", "json"]).stdout;
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(json["onsets"].as_array().unwrap().len(), onsets.len());
    let sql = text(&periscope(&["explain", "out", "patch=3", "--format", "sql"]).stdout);
    let statements: Vec<&str> = sql.split(";\n").map(str::trim).filter(|statement| !statement.is_empty()).collect();
    assert_eq!(statements.len(), json["queries"].as_array().unwrap().len());
    assert!(
        statements.iter().all(|statement| statement.starts_with("-- ") && statement.contains("read_parquet('out/"))
    );
}

/// The questions behind patch 3 in a result folder, and how many rows the explanation gives to each.
fn questions(out: &str) -> Vec<(String, usize)> {
    let (onsets, files) = behind_patch_3();
    let exposures: usize = files.values().flatten().map(Vec::len).sum();
    let expected = [1, onsets.len(), files.len() / 2, exposures];
    let sql = text(&periscope(&["explain", out, "patch=3", "--format", "sql"]).stdout);
    let statements = sql.split(";\n").filter(|statement| !statement.trim().is_empty()).map(str::to_owned);
    statements.zip(expected).collect()
}

#[test]
fn duckdb_answers_the_sql() {
    duckdb_answers("out");
}

/// Names that DuckDB takes for patterns, beside folders that two of them would match.
#[test]
fn duckdb_reads_the_folder_that_is_meant_whatever_its_name() {
    let names = ["of[1]", "it's *", "why?"];
    for name in names.into_iter().chain(["it's all", "whyt"]) {
        let copied = Command::new("cp").arg("-a").args([LAB.path("out"), LAB.path(name)]).status();
        assert!(copied.unwrap().success());
    }
    names.into_iter().for_each(duckdb_answers);
}

fn duckdb_answers(out: &str) {
    for (statement, rows) in questions(out) {
        let ask = format!("import duckdb\nprint(len(duckdb.sql(\"\"\"{statement}\"\"\").fetchall()))");
        let Some(answer) = printed(&LAB.path(""), &["-c", &ask]) else { return };
        assert_eq!(answer.trim(), rows.to_string(), "{statement}");
    }
}

#[cfg(feature = "query")]
#[test]
fn query_answers_the_sql() {
    for (statement, rows) in questions("out") {
        let statement = statement.as_str();
        let answer = periscope(&["query", "out", statement, "--format", "json"]);
        assert_eq!(answer.status.code(), Some(0), "{statement}: {}", text(&answer.stderr));
        assert_eq!(text(&answer.stdout).lines().count(), rows, "{statement}");
    }
}
