//! A stage's VERSION and its rows change together: sums of every numeric column of the tiny campaign's tables are
//! pinned in tests/it/pinned.txt. Sums and not digests, with room for the last digits, since kernels may round
//! otherwise on another kind of CPU. `PERISCOPE_UPDATE_PINS=1` rewrites the file, after VERSION was raised.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::Spec;
use periscope::stages::Node;
use periscope::store::Shelf;

use crate::lab::{ALL_VISIBLE, Lab};

/// Relative difference of sums that another CPU may make.
const ROUNDING: f64 = 1e-6;

/// Sum of a column's numbers, those in lists included; of magnitudes, since signs cancel.
fn sum(column: &dyn Array) -> Option<f64> {
    Some(match column.data_type() {
        DataType::Float64 => column.as_primitive::<Float64Type>().iter().flatten().map(f64::abs).sum(),
        DataType::Float32 => column.as_primitive::<Float32Type>().iter().flatten().map(|x| f64::from(x.abs())).sum(),
        DataType::Int64 => column.as_primitive::<Int64Type>().iter().flatten().map(|x| (x as f64).abs()).sum(),
        DataType::Int32 => column.as_primitive::<Int32Type>().iter().flatten().map(|x| f64::from(x).abs()).sum(),
        DataType::List(_) => sum(column.as_list::<i32>().values().as_ref())?,
        DataType::BinaryView => {
            column.as_binary_view().iter().flatten().flat_map(|codes| codes.iter().map(|code| f64::from(*code))).sum()
        }
        _ => return None,
    })
}

fn summary(heading: &str, kind: &str, version: u32, batches: &[RecordBatch]) -> String {
    let rows: usize = batches.iter().map(RecordBatch::num_rows).sum();
    let mut text = format!("{heading} {kind} version {version} rows {rows}");
    for (c, field) in
        batches.first().map(RecordBatch::schema).iter().flat_map(|schema| schema.fields().to_vec()).enumerate()
    {
        let sums: Option<f64> = batches.iter().map(|batch| sum(batch.column(c).as_ref())).sum();
        if let Some(sum) = sums {
            write!(text, " {}={sum:.12e}", field.name()).unwrap();
        }
    }
    text
}

/// Whether two lines say the same, numbers within rounding.
fn alike(a: &str, b: &str) -> bool {
    let words = |line: &str| line.split([' ', '=']).map(str::to_owned).collect::<Vec<_>>();
    let (a, b) = (words(a), words(b));
    a.len() == b.len()
        && a.iter().zip(&b).all(|(a, b)| match (a.parse::<f64>(), b.parse::<f64>()) {
            (Ok(x), Ok(y)) => (x - y).abs() <= ROUNDING * x.abs().max(y.abs()),
            _ => a == b,
        })
}

#[test]
fn rows_change_only_with_their_stages_version() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let shelf = Shelf::look(&lab.path("out")).unwrap();
    let line = |step: &periscope::pipeline::spec::Step| {
        let version = match &step.node {
            Node::Source(source) => source.version(),
            Node::Operator(operator) => operator.version(),
        };
        summary(&step.heading, step.node.kind(), version, &shelf.batches(&step.heading).unwrap())
    };
    let lines: Vec<String> = spec.steps.iter().map(line).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/pinned.txt");
    if std::env::var_os("PERISCOPE_UPDATE_PINS").is_some() {
        fs::write(&path, lines.join("\n") + "\n").unwrap();
    }
    let pinned = fs::read_to_string(&path).unwrap();
    let pinned: Vec<&str> = pinned.lines().collect();
    // The first table that differs is the cause; those that follow from it differ too.
    for (line, pinned) in lines.iter().zip(&pinned) {
        assert!(
            alike(line, pinned),
            "rows differ from those pinned for this version of the stage. If they are meant to, raise its VERSION and rewrite \
             with PERISCOPE_UPDATE_PINS=1\nnow    {line}\npinned {pinned}"
        );
    }
    assert_eq!(lines.len(), pinned.len());
}
