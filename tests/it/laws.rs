//! The laws of ARCHITECTURE.md that no other file of these tests keeps.

use std::collections::BTreeSet;
use std::fs;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray;
use arrow_array::types::Int32Type;
use arrow_schema::DataType;
use periscope::pipeline::run::{RunError, Settings};
use periscope::stages::{self, Node, stage::Grain};
use periscope::store::Shelf;
use periscope::tables::{self, Covariance, Distance, Label, Onset, Patch, PatchCovariance};

use crate::lab::{ALL_VISIBLE, AVERAGES, Lab, with_threads};

/// (lit, seen) of each row, in order.
fn captures(batches: &[RecordBatch]) -> Vec<(i32, i32)> {
    let column = |batch: &RecordBatch, name: &str| {
        batch.column_by_name(name).unwrap().as_primitive::<Int32Type>().values().to_vec()
    };
    batches.iter().flat_map(|batch| column(batch, "lit").into_iter().zip(column(batch, "seen"))).collect()
}

/// Law 1, on a campaign of several parts.
#[test]
fn captures_are_contiguous_and_lie_in_one_part() {
    let lab = Lab::bulk(16);
    lab.run("out", AVERAGES, &Settings { batch_bytes: 1 << 20, ..Settings::default() }).unwrap();
    let shelf = Shelf::look(&lab.path("out")).unwrap();
    for view in ["traces", "profiles"] {
        let files = shelf.files(view).unwrap();
        assert!(files.len() > 2, "{view} has {} parts", files.len());
        let mut closed: BTreeSet<(i32, i32)> = BTreeSet::new();
        let mut pairs_of_parts: Vec<BTreeSet<(i32, i32)>> = Vec::new();
        for file in files {
            let batches: Vec<RecordBatch> =
                periscope::store::parquet::read(&file, 4096).unwrap().map(Result::unwrap).collect();
            let rows = captures(&batches);
            for run in rows.chunk_by(|a, b| a == b) {
                assert!(closed.insert(run[0]), "{view}: capture {:?} comes twice", run[0]);
            }
            pairs_of_parts.push(rows.iter().map(|(lit, seen)| (*lit.min(seen), *lit.max(seen))).collect());
        }
        assert!(
            pairs_of_parts.windows(2).all(|parts| parts[0].is_disjoint(&parts[1])),
            "{view}: a reciprocal pair straddles two parts"
        );
        assert_eq!(closed.len(), 16);
    }
}

/// Law 2, for a campaign that grows: parts that stood stand.
#[test]
fn a_campaign_that_grows_recomputes_only_the_part_where_it_grew() {
    let lab = Lab::bulk(16);
    lab.run("out", AVERAGES, &Settings::default()).unwrap();
    let before = lab.parts("out");
    lab.add_bulk_capture(17, 17);
    let outcome = lab.run("out", AVERAGES, &Settings::default()).unwrap();
    assert_eq!(outcome.tables["profiles"].rows("profiles"), 17);
    let after = lab.parts("out");
    assert!(
        before.iter().all(|(file, digest)| file.contains("/table-") || after[file] == *digest),
        "a part that stood was rewritten"
    );
    let profile_parts = |parts: &std::collections::BTreeMap<String, blake3::Hash>| {
        parts.keys().filter(|file| file.ends_with(".profiles.parquet")).count()
    };
    assert!(profile_parts(&after) <= profile_parts(&before) + 2, "more than the part where it grew was computed");
}

/// Law 3.
#[test]
fn the_narrowest_channels_do_not_deadlock() {
    let lab = Lab::tiny();
    with_threads(1, || {
        let narrow = Settings { channel_batches: 1, batch_bytes: 1, replay_rows: 1, ..Settings::default() };
        let narrow = Settings { memory_bytes: narrow.least_memory(), ..narrow };
        let outcome = lab.run("out", ALL_VISIBLE, &narrow).unwrap();
        assert_eq!(outcome.tables["patches"].rows("patches"), 4);
    });
}

/// Law 4.
#[test]
fn a_stored_table_stands_in_for_its_stage() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let from_onsets = ALL_VISIBLE.split_once("[labels]").unwrap().1.replace(", calibration = \"calibration\"", "");
    let folder = lab.path("out/onsets");
    let import = format!(
        "[onsets]\nstage = \"import\"\nparams = {{ table = \"onsets\", path = {folder:?} }}\n[labels]{from_onsets}"
    );
    lab.run("second", &import, &Settings::default()).unwrap();
    assert_eq!(lab.rows::<Onset>("second", "onsets"), lab.rows::<Onset>("out", "onsets"));
    assert_eq!(lab.rows::<Distance>("second", "distances"), lab.rows::<Distance>("out", "distances"));
    assert_eq!(lab.rows::<Patch>("second", "start"), lab.rows::<Patch>("out", "start"));
}

/// Law 7.
#[test]
fn stages_that_gather_take_no_samples() {
    for kind in stages::KINDS {
        let params = if kind == "import" { "table = 'onsets'\npath = 'x'" } else { "" };
        let Node::Operator(operator) = stages::parse(kind, params.parse().unwrap()).unwrap() else {
            continue;
        };
        if operator.grain() != Grain::All {
            continue;
        }
        let schema = tables::schema_of(operator.input()).unwrap();
        let samples = |data_type: &DataType| match data_type {
            DataType::BinaryView => true,
            DataType::List(item) => item.data_type() == &DataType::Float32,
            _ => false,
        };
        assert!(!schema.fields().iter().any(|field| samples(field.data_type())), "stage {kind} gathers samples");
    }
}

/// Law 8.
#[test]
fn too_little_memory_is_refused() {
    let lab = Lab::tiny();
    let error = lab.run("out", ALL_VISIBLE, &Settings { memory_bytes: 1 << 20, ..Settings::default() }).unwrap_err();
    assert!(matches!(error, RunError::Memory { given: 1_048_576, .. }), "{error}");
    assert!(!lab.path("out/profiles").exists());
}

/// Law 11: shared errors are there, and have the size that the formulas give.
#[test]
fn uncertainty_travels() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let onsets: Vec<Onset> = lab.rows("out", "onsets");
    assert!(onsets.iter().all(|onset| onset.jitter_ps > 0.0
        && (onset.covariance[onset.rank as usize - 1] - onset.time_sd_ps.powi(2)).abs() < 1e-9));
    let labels: Vec<Label> = lab.rows("out", "labels");
    assert!(
        labels
            .iter()
            .zip(&onsets)
            .all(|(label, onset)| { (label.time_sd_ps - onset.time_sd_ps.hypot(onset.jitter_ps)).abs() < 1e-12 })
    );
    let distances: Vec<Distance> = lab.rows("out", "distances");
    let covariances: Vec<Covariance> = lab.rows("out", "distances.covariances");
    let sd_m = distances.iter().find(|distance| (distance.a, distance.b) == (0, 1)).unwrap().sd_m;
    let shared = covariances.iter().find(|row| (row.a1, row.b1, row.a2, row.b2) == (0, 1, 1, 2)).unwrap();
    // d_01 = cO_1 / 2 and d_12 = cO_12 - cO_1 / 2 - cO_2 / 2 share O_1: covariance -var(cO_1) / 4 = -var(d_01).
    assert!((shared.cov_m2 / -(sd_m * sd_m) - 1.0).abs() < 1e-9, "{} {}", shared.cov_m2, sd_m * sd_m);
    let pairs: Vec<PatchCovariance> = lab.rows("out", "patches.patch_covariances");
    assert_eq!(pairs.len(), 6);
    assert!(pairs.iter().any(|pair| pair.cov_xx_m2.abs() > 0.0));
    let delays = lab.rows::<tables::Delay>("out", "patches.delays");
    assert!(delays.len() == 1 && delays[0].sd_ps > 0.0 && delays[0].sd_ps <= delays[0].prior_sd_ps);
    assert!(fs::exists(lab.path("out/patches.residuals")).unwrap());
}
