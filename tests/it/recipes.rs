//! The recipes of queries/ and the examples of docs/tables.md: DuckDB and Polars run them unchanged, and the results
//! must equal the rows here.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::signal::codes::Codes;
use periscope::simulate::{self, Format, Scene};
use periscope::store::Shelf;
use periscope::tables::{Distance, Label, Onset, Patch, Profile, Reject, Residual, Row, Trace};
use serde_json::Value;

use crate::lab::{ALL_VISIBLE, TINY};
use crate::python::{printed, python};

/// Two days of one scene; a third on which patch 4 has moved by 2 cm and two files are truncated; and a campaign
/// without any alignment.
static LAB: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let lab = tempfile::tempdir().unwrap();
    let folder = lab.path();
    let monday = campaign(folder, "monday", 1, TINY, Format::Trc);
    let tuesday = campaign(folder, "tuesday", 2, TINY, Format::Trc);
    let elsewhere = TINY.replacen("[0.62, -0.35, 0.7]", "[0.62, -0.35, 0.72]", 1);
    let wednesday = campaign(folder, "wednesday", 3, &elsewhere, Format::Trc);
    for file in ["s1_L1_P2_C1.trc", "s1_L2_P3_C1.trc"] {
        let file = wednesday.join("raw/scene").join(file);
        let bytes = fs::read(&file).unwrap();
        fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    }
    let unaligned: String = TINY
        .lines()
        .filter(|line| !line.starts_with("reference") && !line.starts_with("bad_shots"))
        .map(|line| line.replace("jitter_ps = 80.0", "jitter_ps = 0.0") + "\n")
        .collect();
    let unaligned = campaign(folder, "unaligned", 4, &unaligned, Format::Npy);
    analyse(&folder.join("results"), std::slice::from_ref(&monday), "indexed");
    analyse(&folder.join("archive"), std::slice::from_ref(&monday), "zstd");
    analyse(&folder.join("moved"), std::slice::from_ref(&wednesday), "indexed");
    analyse(&folder.join("days"), &[monday, tuesday], "indexed");
    analyse(&folder.join("by-hand"), std::slice::from_ref(&unaligned), "none");
    analyse(&folder.join("by-index"), &[unaligned], "indexed");
    lab
});

fn campaign(folder: &Path, name: &str, seed: u64, scene: &str, format: Format) -> PathBuf {
    let text = scene.replacen("name = \"tiny\"", &format!("name = \"{name}\""), 1);
    let scene = Scene::parse(Path::new("scene.toml"), &text).unwrap();
    let root = folder.join(name);
    simulate::simulate(&scene, seed, &root, format).unwrap();
    root
}

fn analyse(out: &Path, roots: &[PathBuf], codes: &str) {
    let spec = Spec::parse("test", ALL_VISIBLE, &[format!("traces.codes='{codes}'")]).unwrap();
    let campaigns: Vec<Campaign> = roots.iter().map(|root| Campaign::load(root).unwrap()).collect();
    let shelf = Shelf::open(out).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
}

fn rows<R: Row>(out: &str, view: &str) -> Vec<R> {
    let batches = Shelf::look(&LAB.path().join(out)).unwrap().batches(view).unwrap();
    batches.iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

/// How Python is asked for the answer of a recipe.
fn question(recipe: &str, extension: &str, values: &[&str]) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = [root.join("tests/it/recipes.py"), root.join(format!("queries/{recipe}.{extension}"))];
    let files = files.map(|file| file.display().to_string());
    files.into_iter().chain(values.iter().map(ToString::to_string)).collect()
}

fn answer(recipe: &str, extension: &str, values: &[&str]) -> Option<Vec<Value>> {
    let question = question(recipe, extension, values);
    let text = printed(LAB.path(), &question.iter().map(String::as_str).collect::<Vec<_>>())?;
    Some(serde_json::from_str(&text).unwrap())
}

/// The answer of a recipe, by DuckDB and by Polars, which must agree; `None` where there is no Python.
fn ask(recipe: &str, values: &[&str]) -> Option<Vec<Value>> {
    let (duckdb, polars) = (answer(recipe, "sql", values)?, answer(recipe, "py", values)?);
    are_alike(recipe, &duckdb, &polars);
    Some(duckdb)
}

/// Holds two answers against each other: sums of numbers depend on the order.
fn are_alike(recipe: &str, one: &[Value], other: &[Value]) {
    assert_eq!(one.len(), other.len(), "{recipe}");
    for (one, other) in one.iter().zip(other) {
        let (columns, others) = (one.as_object().unwrap(), other.as_object().unwrap());
        assert_eq!(columns.keys().collect::<BTreeSet<_>>(), others.keys().collect::<BTreeSet<_>>());
        for (column, value) in columns {
            let alike = match (value.as_f64(), others[column].as_f64()) {
                (Some(a), Some(b)) => is_close(a, b),
                _ => *value == others[column],
            };
            assert!(alike, "{recipe}, {column}: {one} {other}");
        }
    }
}

fn is_close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs()).max(1e-3)
}

fn number(row: &Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("{column} of {row}"))
}

fn integer(row: &Value, column: &str) -> i32 {
    row[column].as_i64().unwrap_or_else(|| panic!("{column} of {row}")) as i32
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    f64::midpoint(values[(values.len() - 1) / 2], values[values.len() / 2])
}

#[test]
fn codes_become_the_volts_that_were_recorded() {
    let Some(answer) = ask("volts", &["results=archive", "lit=3", "seen=1"]) else { return };
    let mut traces: Vec<Trace> = rows("archive", "traces");
    traces.retain(|row| (row.lit, row.seen) == (3, 1));
    traces.sort_by_key(|row| (row.shot, row.is_reference));
    let mut expected = Vec::new();
    for row in &traces {
        for (i, code) in
            Codes::of(&row.code_type, row.codes.as_ref().unwrap()).unwrap().to_f64().into_iter().enumerate()
        {
            expected.push((row.shot, i as i32, row.t0_ps + i as f64 * row.dt_ps, row.gain_v * code + row.offset_v));
        }
    }
    assert_eq!(answer.len(), 24 * 2 * 320);
    for (row, (shot, sample, time_ps, volts)) in answer.iter().zip(expected) {
        assert_eq!((integer(row, "shot"), integer(row, "sample")), (shot, sample));
        assert!(is_close(number(row, "time_ps"), time_ps) && is_close(number(row, "volts"), volts), "{row} {volts}");
    }
}

#[test]
fn recipes_read_raw_files_where_traces_are_an_index_or_say_what_they_need() {
    let values = |results: &'static str| [results, "lit=3", "seen=1"];
    for (recipe, index, archive, campaign) in [
        ("volts", "results=results", "results=archive", "campaign=monday"),
        ("average", "results=by-index", "results=by-hand", "campaign=unaligned"),
    ] {
        let from_raw = answer(recipe, "py", &[&values(index)[..], &[campaign]].concat());
        let Some(from_raw) = from_raw else { return };
        assert!(!from_raw.is_empty());
        are_alike(recipe, &from_raw, &answer(recipe, "py", &values(archive)).unwrap());
        for extension in ["py", "sql"] {
            let question = question(recipe, extension, &values(index));
            let output = python(LAB.path(), &question.iter().map(String::as_str).collect::<Vec<_>>()).unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(
                !output.status.success() && said.contains("the samples lie in raw/"),
                "{recipe}.{extension}: {said}"
            );
            assert!(said.contains("codes = \"zstd\""), "{recipe}.{extension}: {said}");
        }
    }
}

#[test]
fn an_average_by_hand_is_the_profile() {
    let Some(answer) = ask("average", &["results=by-hand", "lit=2", "seen=4"]) else { return };
    let profiles: Vec<Profile> = rows("by-hand", "profiles");
    let profile = profiles.iter().find(|row| (row.lit, row.seen) == (2, 4)).unwrap();
    assert_eq!((profile.shots, profile.rejected, answer.len()), (24, 0, profile.samples()));
    for (i, (row, mean_v)) in answer.iter().zip(profile.mean_v().iter()).enumerate() {
        assert!((number(row, "by_hand_v") - f64::from(*mean_v)).abs() < 1e-7, "{row} {mean_v}");
        assert!((number(row, "time_ps") - profile.t0_ps - i as f64 * profile.dt_ps).abs() < 1e-6, "{row}");
        assert!(number(row, "profile_v") == f64::from(*mean_v) && integer(row, "shots") == 24);
    }
}

#[test]
fn onsets_are_counted_by_bounce() {
    let Some(answer) = ask("onsets", &["results=days"]) else { return };
    let labels: Vec<Label> = rows("days", "labels");
    let onsets: Vec<Onset> = rows("days", "onsets");
    // Two days, first and second bounces.
    assert_eq!(answer.len(), 4);
    for row in &answer {
        let of_kind = labels.iter().filter(|label| {
            label.alternative == 0 && row["campaign"] == *label.campaign && integer(row, "bounces") == label.bounces
        });
        let key = |campaign: &str, lit: i32, seen: i32, rank: i32| (campaign.to_owned(), lit, seen, rank);
        let keys: BTreeSet<_> = of_kind.map(|row| key(&row.campaign, row.lit, row.seen, row.rank)).collect();
        let of_kind = onsets.iter().filter(|row| keys.contains(&key(&row.campaign, row.lit, row.seen, row.rank)));
        let (sds, snrs): (Vec<f64>, Vec<f64>) = of_kind.map(|row| (row.time_sd_ps, row.snr)).unzip();
        assert_eq!(integer(row, "onsets") as usize, sds.len());
        assert!(is_close(number(row, "worst_sd_ps"), sds.iter().copied().fold(0.0, f64::max)));
        assert!(is_close(number(row, "least_snr"), snrs.iter().copied().fold(f64::INFINITY, f64::min)));
        assert!(
            is_close(number(row, "median_sd_ps"), median(sds)) && is_close(number(row, "median_snr"), median(snrs))
        );
    }
}

#[test]
fn the_shots_of_a_patch_are_those_behind_its_onsets() {
    let Some(answer) = ask("shots-of-patch", &["results=results", "patch=2"]) else { return };
    let residuals: Vec<Residual> = rows("results", "patches.residuals");
    let used = residuals.iter().filter(|row| row.used && row.path.contains(&2));
    let pairs: BTreeSet<(i32, i32)> = used.map(|row| (row.lit, row.seen)).collect();
    let traces: Vec<Trace> = rows("results", "traces");
    let behind = traces.iter().filter(|row| pairs.contains(&(row.lit, row.seen)));
    let expected: BTreeSet<(String, Option<i32>)> = behind.map(|row| (row.file.to_string(), row.segment)).collect();
    let shots: BTreeSet<(String, Option<i32>)> =
        answer.iter().map(|row| (row["file"].as_str().unwrap().to_owned(), Some(integer(row, "segment")))).collect();
    assert_eq!((answer.len(), &shots), (expected.len(), &expected));
    assert_eq!(shots.len(), 7 * 2 * 24, "seven captures see or light patch 2");
}

#[test]
fn residuals_are_gathered_by_sensor_and_day() {
    let Some(answer) = ask("residuals", &["results=days"]) else { return };
    let residuals: Vec<Residual> = rows("days", "patches.residuals");
    let profiles: Vec<Profile> = rows("days", "profiles");
    assert_eq!(answer.len(), 2);
    for row in &answer {
        let campaign = row["campaign"].as_str().unwrap();
        let of_day: Vec<&Residual> = residuals.iter().filter(|row| &*row.campaign == campaign).collect();
        let count = of_day.len() as f64;
        let mean_ps = of_day.iter().map(|row| row.residual_ps).sum::<f64>() / count;
        let square = of_day.iter().map(|row| (row.residual_ps - mean_ps).powi(2)).sum::<f64>();
        let mean_sd_ps = (square / (count - 1.0) / count).sqrt();
        let spread = (of_day.iter().map(|row| row.standardised.powi(2)).sum::<f64>() / count).sqrt();
        let suspects = of_day.iter().filter(|row| row.suspect || !row.used).count();
        let acquired = profiles.iter().find(|row| &*row.campaign == campaign).and_then(|row| row.acquired_at.clone());
        assert_eq!(integer(row, "onsets"), 16);
        assert_eq!(row["day"], acquired.unwrap()[..10]);
        assert!(is_close(number(row, "mean_ps"), mean_ps) && is_close(number(row, "spread"), spread), "{row}");
        assert!(is_close(number(row, "mean_in_sd"), mean_ps / mean_sd_ps), "{row}");
        assert_eq!(integer(row, "suspects") as usize, suspects);
    }
}

#[test]
fn rejects_are_counted_by_reason() {
    let Some(answer) = ask("rejects", &["results=moved"]) else { return };
    let rejects: Vec<Reject> = rows("moved", "rejects");
    assert_eq!(answer.iter().map(|row| integer(row, "records")).sum::<i32>() as usize, rejects.len());
    let cut = answer.iter().find(|row| row["kind"].as_str().unwrap().starts_with("is cut short")).unwrap();
    assert_eq!((integer(cut, "records"), cut["stage"].as_str()), (2, Some("traces")));
    assert_eq!(cut["first_file"], "raw/scene/s1_L1_P2_C1.trc");
    assert!(rejects.iter().any(|row| *row.reason == *cut["example"].as_str().unwrap()));
}

#[test]
fn the_same_onset_is_compared_between_days() {
    let Some(answer) = ask("days", &["results=days", "one=monday", "other=tuesday"]) else { return };
    let onsets: Vec<Onset> = rows("days", "onsets");
    assert_eq!(answer.len(), 16);
    let mut square = 0.0;
    for row in &answer {
        let of = |day: &str| {
            let key = (integer(row, "lit"), integer(row, "seen"), integer(row, "rank"));
            onsets.iter().find(|onset| &*onset.campaign == day && (onset.lit, onset.seen, onset.rank) == key).unwrap()
        };
        let (monday, tuesday) = (of("monday"), of("tuesday"));
        let later_ps = tuesday.time_ps - monday.time_ps;
        let sd_ps =
            [monday, tuesday].iter().map(|day| day.time_sd_ps.powi(2) + day.jitter_ps.powi(2)).sum::<f64>().sqrt();
        assert!(is_close(number(row, "later_ps"), later_ps) && is_close(number(row, "sd_ps"), sd_ps), "{row}");
        assert!(is_close(number(row, "in_sd"), later_ps / sd_ps), "{row}");
        square += (later_ps / sd_ps).powi(2);
    }
    // One scene: the days differ by their errors alone. Chi-square of 16 lies below 48 but for one draw in 20 000.
    assert!(square < 48.0, "{square}");
}

#[test]
fn patches_are_held_against_points_from_elsewhere() {
    let patches: Vec<Patch> = rows("results", "patches");
    let mut points = "name,x_m,y_m,z_m\n".to_owned();
    // 5 mm off each, in another direction.
    let directions = [[0.003, -0.004, 0.0], [0.0, 0.003, 0.004], [-0.004, 0.0, 0.003], [0.0, 0.0, 0.005]];
    for (patch, [x, y, z]) in patches.iter().zip(directions) {
        writeln!(points, "point {},{},{},{}", patch.patch, patch.x_m + x, patch.y_m + y, patch.z_m + z).unwrap();
    }
    fs::write(LAB.path().join("points.csv"), points).unwrap();
    let Some(answer) = ask("near", &["results=results", "points=points.csv"]) else { return };
    assert_eq!(answer.len(), 4);
    for ((row, patch), [x, y, z]) in answer.iter().zip(&patches).zip(directions) {
        assert_eq!(row["point"], format!("point {}", patch.patch));
        assert!((number(row, "distance_m") - 0.005).abs() < 1e-12, "{row}");
        let cov = |value: Option<f64>| value.unwrap();
        let along = x * x * cov(patch.cov_xx_m2)
            + y * y * cov(patch.cov_yy_m2)
            + z * z * cov(patch.cov_zz_m2)
            + 2.0 * (x * y * cov(patch.cov_xy_m2) + x * z * cov(patch.cov_xz_m2) + y * z * cov(patch.cov_yz_m2));
        assert!((number(row, "sd_m") - along.sqrt() / 0.005).abs() < 1e-6 * number(row, "sd_m"), "{row}");
    }
}

#[test]
fn the_patch_that_moved_is_found() {
    let Some(answer) = ask("moved", &["results=moved", "earlier=results"]) else { return };
    assert_eq!(integer(&answer[0], "patch"), 4);
    assert_eq!(integer(&answer[0], "changed"), integer(&answer[0], "distances"), "{answer:#?}");
    assert!(answer[1..].iter().all(|row| integer(row, "changed") <= 1), "{answer:#?}");
    let (now, before): (Vec<Distance>, Vec<Distance>) = (rows("moved", "distances"), rows("results", "distances"));
    let change = |row: &Distance| {
        let before = before.iter().find(|other| (other.a, other.b) == (row.a, row.b))?;
        (row.a == 4 || row.b == 4).then(|| (row.distance_m - before.distance_m).abs())
    };
    let most_m = now.iter().filter_map(change).fold(0.0, f64::max);
    assert!(is_close(number(&answer[0], "most_m"), most_m) && most_m > 0.01, "{most_m}");
}

#[test]
fn a_script_is_run_as_its_head_says() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("queries/moved.py").display().to_string();
    let Some(text) = printed(LAB.path(), &[&script, "moved", "results"]) else { return };
    assert!(text.contains("rms_in_sd"), "{text}");
}

/// Every block of the page runs as it stands, next to a folder `results`, and prints something or checks itself.
#[test]
fn the_examples_of_the_page_run() {
    let page = include_str!("../../docs/tables.md");
    let mut blocks = 0;
    for block in page.split("```").skip(1).step_by(2) {
        let (language, code) = block.split_once('\n').unwrap();
        let code = match language {
            "python" => code.to_owned(),
            "sql" => format!("import duckdb\nprint(duckdb.sql(\"\"\"{code}\"\"\"))"),
            other => panic!("a block of {other}, which nothing runs"),
        };
        let Some(text) = printed(LAB.path(), &["-c", &code]) else { return };
        assert!(!text.trim().is_empty() || code.contains("assert "), "{code}");
        blocks += 1;
    }
    assert!(blocks > 10, "{blocks} blocks");
}

/// Ellipsoids of the viewer have the covariances of the table: their axes, turned, give these again.
#[test]
fn a_viewer_is_given_what_the_tables_hold() {
    let code = "
import json, runpy, sys
import numpy as np
viewer = runpy.run_path(sys.argv[1])
for path, archetype, values in viewer['things']('results'):
    centres, axes_m2 = values.get('positions', values.get('centers')), None
    if archetype == 'Ellipsoids3D':
        turned = []
        for (x, y, z, w), half in zip(values['quaternions'], values['half_sizes']):
            turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                             [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                             [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
            turned.append((turn @ np.diag((half / 2) ** 2) @ turn.T).ravel().tolist())
        axes_m2 = turned
    print(json.dumps([path, archetype, None if centres is None else len(centres), axes_m2]))
nodes = viewer['pl'].DataFrame({'grid_row': [0, 0, 1, 1, 2], 'grid_column': [0, 1, 0, 1, 1]})
print(json.dumps(viewer['triangles'](nodes)))
";
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("queries/rerun-viewer.py");
    let Some(text) = printed(LAB.path(), &["-c", code, &script.display().to_string()]) else { return };
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let patches: Vec<Patch> = rows("results", "patches");
    let best: Vec<&Patch> = patches.iter().filter(|patch| patch.alternative == 0).collect();
    let of = |archetype: &str| -> Vec<&Value> { lines.iter().filter(|line| line[1] == archetype).collect() };
    let shown: u64 = of("Points3D").iter().map(|line| line[2].as_u64().unwrap()).sum();
    assert!(shown as usize == best.len() && !best.is_empty(), "{lines:?}");
    let covariances: Vec<&Value> = of("Ellipsoids3D").iter().flat_map(|line| line[3].as_array().unwrap()).collect();
    let known: Vec<&&Patch> =
        best.iter().filter(|patch| patch.cov_xx_m2.is_some_and(|variance| variance > 0.0)).collect();
    assert!(covariances.len() == known.len() && !known.is_empty(), "{lines:?}");
    for (covariance, patch) in covariances.iter().zip(known) {
        let expected = [patch.cov_xx_m2, patch.cov_xy_m2, patch.cov_xz_m2].map(Option::unwrap);
        for (value, expected) in covariance.as_array().unwrap().iter().zip(expected) {
            assert!((value.as_f64().unwrap() - expected).abs() < 1e-12, "{covariance} {patch:?}");
        }
    }
    // Four nodes are two triangles, three are one.
    assert_eq!(lines.last().unwrap(), &serde_json::json!([[0, 1, 3], [0, 3, 2], [2, 3, 4]]));
}
