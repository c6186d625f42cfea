//! `periscope diff`: which table first differs, by how much, and why.

use std::process::{Command, Output};
use std::sync::LazyLock;

use periscope::history::comparison::{Comparison, TableComparison, Verdict, compare};
use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Onset, Trace};

use crate::lab::{ALL_VISIBLE, Lab, TINY, write_table};

/// One campaign, analysed twice in the same way and once with another threshold.
struct Analysed {
    lab: Lab,
    /// Between the second weakest onset and the third.
    threshold: f64,
}

static ANALYSED: LazyLock<Analysed> = LazyLock::new(|| {
    let lab = Lab::tiny();
    lab.rows_of_patches("a");
    lab.rows_of_patches("again");
    let mut snrs: Vec<f64> = lab.rows::<Onset>("a", "onsets").iter().map(|row| row.snr).collect();
    snrs.sort_by(f64::total_cmp);
    let threshold = (snrs[1] + snrs[2]) / 2.0;
    let set = [format!("onsets.threshold_sigma={threshold:?}")];
    lab.run_with("b", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    Analysed { lab, threshold }
});

fn lab() -> &'static Lab {
    &ANALYSED.lab
}

/// The parameter behind what differs.
fn change() -> String {
    format!("onsets: threshold_sigma 5.0 -> {:?}", ANALYSED.threshold)
}

fn compared(a: &str, b: &str, all: bool) -> Comparison {
    compare(&lab().path(a), &lab().path(b), all).unwrap()
}

fn table<'a>(comparison: &'a Comparison, name: &str) -> &'a TableComparison {
    comparison.tables.iter().find(|table| table.table == name).unwrap()
}

fn changes(table: &TableComparison) -> Vec<String> {
    table.causes.iter().map(|cause| format!("{}: {}", cause.at, cause.change)).collect()
}

fn periscope(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(lab().path("")).output().unwrap()
}

#[test]
fn the_same_analysis_twice_is_the_same() {
    let comparison = compared("a", "again", true);
    assert!(comparison.same && comparison.only_in_a.is_empty() && comparison.only_in_b.is_empty());
    assert!(comparison.tables.iter().all(|table| table.verdict == Verdict::Same));
    assert!(comparison.tables.iter().any(|table| table.table == "rejects"));
    let place = |name: &str| comparison.tables.iter().position(|table| table.table == name).unwrap();
    assert!(
        place("traces") < place("profiles") && place("onsets") < place("labels") && place("start") < place("patches")
    );
}

#[test]
fn the_first_table_that_differs_and_the_parameter_behind_it() {
    let comparison = compared("a", "b", false);
    let differing: Vec<&str> = comparison
        .tables
        .iter()
        .filter(|table| table.verdict == Verdict::Differs)
        .map(|table| table.table.as_str())
        .collect();
    assert_eq!((comparison.same, differing), (false, vec!["onsets"]));
    assert_eq!(table(&comparison, "stir").verdict, Verdict::Same);
    assert_eq!(table(&comparison, "patches").verdict, Verdict::NotCompared);
    let onsets = table(&comparison, "onsets");
    assert_eq!(changes(onsets), [change()]);
    let rows = onsets.rows.as_ref().unwrap();
    let (a, b): (Vec<Onset>, Vec<Onset>) = (lab().rows("a", "onsets"), lab().rows("b", "onsets"));
    assert_eq!((rows.in_a, rows.in_b), (a.len() as u64, b.len() as u64));
    let key = |row: &Onset| (row.lit, row.seen, row.rank);
    let lost = a.iter().filter(|row| b.iter().all(|other| key(other) != key(row))).count() as u64;
    let changed = a.iter().filter(|row| b.iter().any(|other| key(other) == key(row) && other != *row)).count() as u64;
    assert_eq!((rows.only_in_a, rows.only_in_b, rows.changed), (lost, 0, changed));
    assert!(lost == 2 && rows.only_in_a_such_as[0].starts_with("campaign tiny, sensor s1, lit "), "{rows:?}");

    let all = compared("a", "b", true);
    assert!(all.tables.iter().all(|table| table.verdict != Verdict::NotCompared));
    let patches = table(&all, "patches");
    assert_eq!((patches.verdict, changes(patches)), (Verdict::Differs, changes(onsets)));
}

#[test]
fn sizes_of_differences_are_those_of_the_values() {
    let folder = tempfile::tempdir().unwrap();
    let rows: Vec<Onset> = lab().rows("a", "onsets");
    let mut other = rows.clone();
    other[3].time_ps += 2.0 * other[3].time_sd_ps;
    other[5].time_ps -= 1.0 * other[5].time_sd_ps;
    other[5].flags.push("extended".into());
    other[6].earliest_ps = None;
    other[7].covariance[0] *= 1.5;
    other.remove(1);
    other.rotate_left(4); // order does not matter
    for (side, rows) in [("a", &rows), ("b", &other)] {
        std::fs::create_dir_all(folder.path().join(side).join("onsets")).unwrap();
        // In two files, cut at different places.
        let (first, second) = rows.split_at(if side == "a" { 5 } else { 9 });
        write_table(&folder.path().join(side).join("onsets/1.parquet"), first);
        write_table(&folder.path().join(side).join("onsets/2.parquet"), second);
    }
    let comparison = compare(&folder.path().join("a"), &folder.path().join("b"), false).unwrap();
    let onsets = table(&comparison, "onsets").rows.as_ref().unwrap();
    assert_eq!(
        (onsets.only_in_a, onsets.only_in_b, onsets.changed),
        (1, 0, 4 - u64::from(rows[6].earliest_ps.is_none()))
    );
    let column = |name: &str| onsets.columns.iter().find(|column| column.column == name).unwrap();
    let time = column("time_ps");
    let by = [2.0 * rows[3].time_sd_ps, rows[5].time_sd_ps];
    let rms = ((by[0].powi(2) + by[1].powi(2)) / 2.0).sqrt();
    assert_eq!((time.rows, time.unit.as_deref()), (2, Some("ps")));
    assert!(
        (time.rms.unwrap() - rms).abs() < 1e-9 * rms && (time.largest_in_sd.unwrap() - 2.0).abs() < 1e-6,
        "{time:?}"
    );
    assert!((time.rms_in_sd.unwrap() - 2.5_f64.sqrt()).abs() < 1e-6, "{time:?}");
    let at = format!("lit {}, seen {}, rank {}", rows[3].lit, rows[3].seen, rows[3].rank);
    assert!(by[0] < by[1] || time.largest_at.as_ref().unwrap().ends_with(&at), "{time:?}");
    assert_eq!((column("flags").rows, column("flags").largest), (1, None));
    let covariance = column("covariance");
    let by = covariance.largest.unwrap() / rows[7].covariance[0];
    assert!(covariance.rows == 1 && (by - 0.5).abs() < 1e-9, "{covariance:?}");
}

/// Rows that stand in quite another order, and more of them than are read at a time.
#[test]
fn large_tables_in_another_order() {
    let folder = tempfile::tempdir().unwrap();
    let one: Trace = lab().rows::<Trace>("a", "traces").swap_remove(0);
    let trace = |shot: i32| Trace { shot, gain_v: f64::from(shot), ..one.clone() };
    let rows: Vec<Trace> = (0..60_000).map(trace).collect();
    let mut other: Vec<Trace> = rows.iter().rev().cloned().collect();
    other[100].clipped = Some(-1);
    for (side, rows) in [("a", &rows), ("b", &other)] {
        std::fs::create_dir_all(folder.path().join(side).join("traces")).unwrap();
        write_table(&folder.path().join(side).join("traces/0.parquet"), rows);
    }
    let comparison = compare(&folder.path().join("a"), &folder.path().join("b"), false).unwrap();
    let traces = table(&comparison, "traces").rows.as_ref().unwrap();
    assert_eq!((traces.only_in_a, traces.only_in_b, traces.changed), (0, 0, 1));
    assert_eq!(traces.columns.iter().map(|column| column.column.as_str()).collect::<Vec<_>>(), ["clipped"]);
}

#[test]
fn raw_files_and_campaign_fields_behind_a_difference_are_named() {
    let lab = Lab::of(TINY, 1, Format::Trc);
    lab.rows_of_patches("before");
    let file = lab.campaign().join("raw/scene/s1_L1_P2_C1.trc");
    std::fs::copy(lab.campaign().join("raw/scene/s1_L2_P1_C1.trc"), &file).unwrap();
    std::fs::remove_file(lab.campaign().join("raw/scene/s1_L4_P3_C1.trc")).unwrap();
    let keys = lab.campaign().join("campaign.toml");
    let text = std::fs::read_to_string(&keys).unwrap();
    let line = text.lines().find(|line| line.starts_with("group_index")).unwrap();
    std::fs::write(&keys, text.replacen(line, "group_index = 1.0003", 1)).unwrap();
    lab.run("after", ALL_VISIBLE, &Settings::default()).unwrap();
    let comparison = compare(&lab.path("before"), &lab.path("after"), true).unwrap();
    assert_eq!(table(&comparison, "calibration_traces").verdict, Verdict::Same);
    let traces = changes(table(&comparison, "traces")).join("; ");
    assert!(
        traces.contains("tiny: raw files only in A: 2 (raw/scene/s1_L4_P3_C1.trc, raw/scene/s1_L4_P3_C2.trc)"),
        "{traces}"
    );
    assert!(traces.contains("tiny: raw files with other content: 1 (raw/scene/s1_L1_P2_C1.trc)"), "{traces}");
    let distances = changes(table(&comparison, "distances")).join("; ");
    assert!(distances.contains("campaign: tiny.group_index") && distances.contains("-> 1.0003"), "{distances}");
}

#[test]
fn the_truth_is_a_side_like_any_other() {
    let comparison = compare(&lab().campaign(), &lab().path("a"), true).unwrap();
    let onsets = table(&comparison, "onsets").rows.as_ref().unwrap();
    let time = onsets.columns.iter().find(|column| column.column == "time_ps").unwrap();
    assert!(time.rms_in_sd.is_some_and(|sds| sds > 0.3 && sds < 3.0), "{time:?}");
    assert!(comparison.only_in_a.contains(&"true_paths".to_owned()));
    let refused = compare(&lab().campaign().join("raw"), &lab().path("a"), false).unwrap_err().to_string();
    assert!(refused.contains("holds no tables"), "{refused}");
}

#[test]
fn exit_codes_and_text() {
    let same = periscope(&["diff", "a", "again"]);
    assert_eq!(same.status.code(), Some(0), "{same:?}");
    let other = periscope(&["diff", "a", "b"]);
    let text = String::from_utf8_lossy(&other.stdout);
    assert_eq!(other.status.code(), Some(3), "{text}");
    for words in ["onsets differs:", "only in A: ", &change(), "(--all)"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let json = periscope(&["diff", "a", "b", "--format", "json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(json["same"], false);
    assert_eq!(periscope(&["diff", "a", "nowhere"]).status.code(), Some(1));
    assert_eq!(periscope(&["diff", "a"]).status.code(), Some(2));
    let help = periscope(&["diff", "--help"]);
    assert!(String::from_utf8_lossy(&help.stdout).contains("3 different"));
}
