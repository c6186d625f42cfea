//! How long `verify` takes for tables of many parts.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::time::Instant;

use periscope::store::lineage::{self, table_recipe};
use periscope::store::runs::{Ending, RunRecord};
use periscope::store::{Digest, PartRecord, Shelf, StageId};
use periscope::tables::{Onset, Row};
use serde_json::json;

use crate::lab::point_onset;

/// `numbers`: how many parts, half of them made from the others.
pub fn study(numbers: &[usize]) {
    let counts = if numbers.is_empty() { &[1000, 10_000, 100_000] } else { numbers };
    println!("| parts | files on the shelf | `verify` (s), three times |\n|---|---|---|");
    for &count in counts {
        let folder = tempfile::tempdir().expect("a folder for the results");
        let out = folder.path().join("out");
        make(&out, count / 2);
        let seconds: Vec<String> = (0..3)
            .map(|_| {
                let start = Instant::now();
                let verify = Command::new(env!("CARGO_BIN_EXE_periscope")).arg("verify").arg(&out).output();
                let said = verify.expect("the program was built");
                assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stdout));
                format!("{:.2}", start.elapsed().as_secs_f64())
            })
            .collect();
        println!("| {count} | {} | {} |", 3 * count, seconds.join(", "));
    }
}

/// Two tables of this many parts of one row each, the second made from the first.
fn make(out: &std::path::Path, parts: usize) {
    let shelf = Shelf::open(out).expect("an empty folder");
    let mut run = RunRecord::start(PathBuf::from("parts"), &[], []).expect("a current folder");
    let source = stage("ingest", BTreeMap::new());
    let of_source: Vec<Digest> = (0..parts).map(|n| lineage::part(&source.recipe(), &number(n), &[])).collect();
    let derived = stage("average", BTreeMap::from([("from".to_owned(), table_recipe("onsets", &source.recipe()))]));
    let of_derived: Vec<Digest> = of_source.iter().map(|input| lineage::part(&derived.recipe(), input, &[])).collect();
    for (stage, lineages, view) in [(&source, of_source, "first"), (&derived, of_derived, "second")] {
        let parts: Vec<PartRecord> =
            lineages.into_iter().enumerate().map(|(n, lineage)| part(&shelf, stage, n, lineage)).collect();
        shelf.publish(stage, parts, &[("onsets".to_owned(), view.to_owned())]).expect("a table");
    }
    shelf.publish_rejects(&[]).expect("a table");
    run.views = shelf.targets().expect("the views");
    run.end(Ending::Done);
    shelf.write_run(&run).expect("a record");
}

fn stage(kind: &str, inputs: BTreeMap<String, Digest>) -> StageId {
    StageId {
        kind: kind.to_owned(),
        version: 1,
        params: json!({}),
        fields: json!({}),
        schemas: number(0),
        arithmetic: "any".to_owned(),
        inputs,
    }
}

fn number(n: usize) -> Digest {
    Digest::of(&json!(n))
}

fn part(shelf: &Shelf, stage: &StageId, n: usize, lineage: Digest) -> PartRecord {
    let mut writer = shelf.begin(stage, &[("onsets".to_owned(), Onset::schema())]).expect("a part");
    let row = point_onset("many", [n as i32 + 1, 1], 1, [n as f64, 1.0]);
    writer.write(0, &Onset::to_batch(&[row])).expect("a row");
    writer.commit(lineage).expect("a part")
}
