//! `periscope diff`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::history::comparison::{Comparison, RowsComparison, TableComparison, Verdict, compare};
use serde_json::{Value, json};

use super::output::{Format, Output, Rows, count, json, print, print_text};

/// Most tables on one line; the JSON has all.
const NAMED: usize = 12;
/// The folders differ.
const DIFFERENT: u8 = 3;

/// The fields of a column that differs.
const COLUMNS: [&str; 10] = [
    "column",
    "unit",
    "rows",
    "one_sided",
    "other_length",
    "largest",
    "rms",
    "largest_at",
    "largest_in_sd",
    "rms_in_sd",
];

const EXIT_CODES: &str = "Exit codes: 0 the same; 3 different; 1 failed; 2 wrong usage.";
/// The fields of the JSON object.
const JSON_HELP: &str = "\
Rows as CSV: a row per table, and per column of it that differs.
Keys of the JSON object (differences are B - A; null: there is none)
  a, b, same             the folders, and whether all their tables are the same
  tables                 those of both, in the order of the dataflow: table, rows, causes, and
                         verdict: same, same_rows (made otherwise), differs, not_compared
  rows                   in_a, in_b; by their key columns only_in_a, only_in_a_such_as,
                         only_in_b, only_in_b_such_as; changed, columns, other_columns
                         (not compared)
  columns                column, unit, rows (that differ), one_sided, other_length, largest,
                         rms (over values that differ), largest_at, largest_in_sd, rms_in_sd
  causes                 at (a table, or the campaign of raw files), change
  only_in_a, only_in_b   tables of one side alone";

/// Arguments of `diff`.
#[derive(Args)]
#[command(after_help = EXIT_CODES, after_long_help = format!("{EXIT_CODES}\n\n{JSON_HELP}"))]
pub struct Diff {
    /// Result folder, or the truth/ of a simulated campaign
    #[arg(value_name = "OUT_A")]
    a: PathBuf,
    /// Result folder, or the truth/ of a simulated campaign
    #[arg(value_name = "OUT_B")]
    b: PathBuf,
    /// Compare all tables, not only up to the first one of the dataflow that differs
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn diff(args: &Diff) -> Result<ExitCode> {
    let comparison = compare(&args.a, &args.b, args.all)?;
    match args.output.format {
        Format::Table => print_text(&text(&comparison))?,
        Format::Json => print(json(&comparison)?)?,
        Format::Csv => rows(&comparison)?.print(Format::Csv)?,
    }
    Ok(if comparison.same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERENT) })
}

/// A row per table, or per column of it that differs.
fn rows(comparison: &Comparison) -> Result<Rows> {
    let mut rows = Rows::new(&[&["table", "verdict"][..], &COLUMNS].concat());
    for table in &comparison.tables {
        let verdict = [json!(table.table), json!(table.verdict)];
        let columns = table.rows.iter().flat_map(|rows| &rows.columns).collect::<Vec<_>>();
        if columns.is_empty() {
            rows.push(verdict.iter().cloned().chain(COLUMNS.map(|_| Value::Null)));
        }
        for column in columns {
            let column = serde_json::to_value(column)?;
            rows.push(verdict.iter().cloned().chain(COLUMNS.map(|name| column[name].clone())));
        }
    }
    for (tables, verdict) in [(&comparison.only_in_a, "only_in_a"), (&comparison.only_in_b, "only_in_b")] {
        for table in tables {
            rows.push([json!(table), json!(verdict)].into_iter().chain(COLUMNS.map(|_| Value::Null)));
        }
    }
    Ok(rows)
}

fn text(comparison: &Comparison) -> String {
    let mut lines = vec![format!("A {}\nB {}", comparison.a, comparison.b)];
    let of = |verdict: Verdict| {
        let names = comparison.tables.iter().filter(move |table| table.verdict == verdict);
        names.map(|table| table.table.as_str()).collect::<Vec<_>>()
    };
    let mut listed = |what: &str, names: &[&str]| {
        if !names.is_empty() {
            let more = if names.len() > NAMED { format!(" and {} more", names.len() - NAMED) } else { String::new() };
            lines.push(format!("{what}: {}{more}", names[..names.len().min(NAMED)].join(", ")));
        }
    };
    listed("same", &of(Verdict::Same));
    listed("same rows from other inputs", &of(Verdict::SameRows));
    listed("only in A", &names(&comparison.only_in_a));
    listed("only in B", &names(&comparison.only_in_b));
    let made_otherwise = comparison.tables.iter().find(|table| table.verdict == Verdict::SameRows);
    lines.extend(made_otherwise.map(causes).into_iter().flatten());
    for table in comparison.tables.iter().filter(|table| table.verdict == Verdict::Differs) {
        lines.extend(of_table(table));
    }
    let rest = of(Verdict::NotCompared);
    if !rest.is_empty() {
        lines.push(format!("\nnot compared, after the first that differs: {} (--all)", rest.join(", ")));
    }
    lines.join("\n") + "\n"
}

fn names(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}

fn of_table(table: &TableComparison) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(rows) = &table.rows {
        lines.push(format!("\n{} differs: {} in A, {} in B", table.table, count(rows.in_a, "row", "rows"), rows.in_b));
        lines.extend(of_rows(rows));
    }
    lines.extend(causes(table));
    lines
}

fn causes(table: &TableComparison) -> Vec<String> {
    let listed = table.causes.iter().map(|cause| format!("    {}: {}", cause.at, cause.change));
    let heading = if table.causes.is_empty() { None } else { Some("  causes".to_owned()) };
    heading.into_iter().chain(listed).collect()
}

fn of_rows(rows: &RowsComparison) -> Vec<String> {
    let mut lines = Vec::new();
    for (side, count, examples) in
        [("A", rows.only_in_a, &rows.only_in_a_such_as), ("B", rows.only_in_b, &rows.only_in_b_such_as)]
    {
        if count > 0 {
            let more = if count > examples.len() as u64 { "; ..." } else { "" };
            lines.push(format!("  only in {side}: {count} ({}{more})", examples.join("; ")));
        }
    }
    if !rows.other_columns.is_empty() {
        lines.push(format!("  columns not compared: {}", rows.other_columns.join(", ")));
    }
    if rows.changed > 0 {
        let both = rows.in_a - rows.only_in_a;
        lines.push(format!("  in both with other values: {} of {both}", rows.changed));
        lines.push(format!(
            "    {:24} {:>8} {:>12} {:>12} {:5} {:>10} {:>10}  largest at",
            "column", "rows", "largest", "rms", "unit", "largest/sd", "rms/sd"
        ));
    }
    let number = |value: Option<f64>| value.map_or("-".to_owned(), short);
    for column in &rows.columns {
        let counted = |count: u64, what: &str| if count > 0 { format!(" ({count} {what})") } else { String::new() };
        let notes = counted(column.one_sided, "on one side only") + &counted(column.other_length, "of other length");
        let line = format!(
            "    {:24} {:>8} {:>12} {:>12} {:5} {:>10} {:>10}  {}{notes}",
            column.column,
            column.rows,
            number(column.largest),
            number(column.rms),
            column.unit.as_deref().unwrap_or_default(),
            number(column.largest_in_sd),
            number(column.rms_in_sd),
            column.largest_at.as_deref().unwrap_or_default()
        );
        lines.push(line.trim_end().to_owned());
    }
    lines
}

/// A number with few digits.
fn short(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e6 {
        format!("{value}")
    } else if !(1e-3..1e6).contains(&value.abs()) {
        format!("{value:.3e}")
    } else {
        format!("{value:.4}")
    }
}
