//! Compares two result folders table by table, in the order of the dataflow: which table is the first to differ, in
//! which rows, by how much, and what changed among its origins.
//!
//! Tables of equal lineage are equal. Others are compared by their rows, except parts with equal content. Rows are
//! paired by their key columns ([`key_of`]), in whatever order they are.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::HistoryError;
use super::causes::{Cause, causes};
use super::differences::{ColumnDifference, Differences, label};
use super::matching::{Match, match_rows};
use super::side::{Side, SideTable};
use crate::store::{FileRecord, scan};
use crate::tables::key_of;

/// Most rows of one side only that are named.
const MOST_KEYS: usize = 3;

/// Comparison of two folders.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Folder A, as the user gave it.
    pub a: String,
    /// Folder B, as the user gave it.
    pub b: String,
    /// Whether all tables that count are the same.
    pub same: bool,
    /// Tables of both, in the order of the dataflow.
    pub tables: Vec<TableComparison>,
    /// Tables that only A has.
    pub only_in_a: Vec<String>,
    /// Tables that only B has.
    pub only_in_b: Vec<String>,
}

/// Outcome for a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Equal lineage; for tables without lineage, equal rows.
    Same,
    /// Different lineage, but equal rows.
    SameRows,
    /// Different rows.
    Differs,
    /// Not compared, since an earlier table differs.
    NotCompared,
}

/// One table on both sides.
#[derive(Clone, Debug, Serialize)]
pub struct TableComparison {
    /// Its name.
    pub table: String,
    /// The outcome.
    pub verdict: Verdict,
    /// How its rows differ.
    pub rows: Option<RowsComparison>,
    /// What changed among its origins.
    pub causes: Vec<Cause>,
}

/// Differences between the rows of a table.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RowsComparison {
    /// Rows of A.
    pub in_a: u64,
    /// Rows of B.
    pub in_b: u64,
    /// Rows whose key only A has.
    pub only_in_a: u64,
    /// The first of them.
    pub only_in_a_such_as: Vec<String>,
    /// Rows whose key only B has.
    pub only_in_b: u64,
    /// The first of them.
    pub only_in_b_such_as: Vec<String>,
    /// Rows that both have, with different values.
    pub changed: u64,
    /// Columns that only one side has, or that differ in type: not compared.
    pub other_columns: Vec<String>,
    /// Columns with different values.
    pub columns: Vec<ColumnDifference>,
}

impl RowsComparison {
    fn is_same(&self) -> bool {
        self.only_in_a + self.only_in_b + self.changed == 0 && self.other_columns.is_empty()
    }
}

/// Compares two folders: up to the first table that differs, or all.
///
/// # Errors
/// When one is no folder of tables, or cannot be read; or when they have no table in common.
pub fn compare(a: &Path, b: &Path, all: bool) -> Result<Comparison, HistoryError> {
    let (a, b) = (Side::open(a)?, Side::open(b)?);
    let names = |side: &Side| side.tables.iter().map(|table| table.view.clone()).collect::<Vec<_>>();
    // The side with a dataflow defines the order.
    let first = if a.history.is_some() { &a } else { &b };
    let (in_both, _): (Vec<String>, Vec<String>) =
        names(first).into_iter().partition(|view| a.table(view).is_some() && b.table(view).is_some());
    if in_both.is_empty() {
        let (a, b) = (a.folder.display(), b.folder.display());
        return Err(HistoryError::Refused(format!("{a} and {b} have no table of the same name: nothing to compare")));
    }
    let only = |one: &Side| names(one).into_iter().filter(|view| !in_both.contains(view)).collect::<Vec<_>>();
    let (only_in_a, only_in_b) = (only(&a), only(&b));
    let mut tables: Vec<TableComparison> = Vec::new();
    for view in &in_both {
        let has_differed = tables.iter().any(|table| table.verdict == Verdict::Differs);
        if let (Some(in_a), Some(in_b)) = (a.table(view), b.table(view)) {
            tables.push(table(&a, in_a, &b, in_b, all || !has_differed)?);
        }
    }
    let differs = tables.iter().any(|table| table.verdict == Verdict::Differs);
    // A folder of tables has only some of the kinds.
    let is_complete = a.history.is_none() || b.history.is_none() || (only_in_a.is_empty() && only_in_b.is_empty());
    Ok(Comparison {
        a: a.folder.display().to_string(),
        b: b.folder.display().to_string(),
        same: !differs && is_complete,
        tables,
        only_in_a,
        only_in_b,
    })
}

fn table(a: &Side, in_a: &SideTable, b: &Side, in_b: &SideTable, look: bool) -> Result<TableComparison, HistoryError> {
    let mut compared =
        TableComparison { table: in_a.view.clone(), verdict: Verdict::Same, rows: None, causes: Vec::new() };
    let lineage = a.lineage(in_a).zip(b.lineage(in_b));
    if in_a.kind == in_b.kind && lineage.is_some_and(|(a, b)| a == b) {
        return Ok(compared);
    }
    if !look {
        compared.verdict = Verdict::NotCompared;
        return Ok(compared);
    }
    let rows = rows(in_a, in_b)?;
    compared.verdict = match (rows.is_same(), lineage.is_some()) {
        (true, true) => Verdict::SameRows,
        (true, false) => Verdict::Same,
        (false, _) => Verdict::Differs,
    };
    compared.rows = Some(rows);
    if let (Some(history_a), Some(history_b), Some(of_a), Some(of_b)) = (&a.history, &b.history, &in_a.node, &in_b.node)
    {
        compared.causes = causes((history_a, of_a), (history_b, of_b))?;
    }
    Ok(compared)
}

fn rows(in_a: &SideTable, in_b: &SideTable) -> Result<RowsComparison, HistoryError> {
    let key = key_of(&in_a.kind).filter(|_| in_a.kind == in_b.kind).ok_or_else(|| {
        HistoryError::Refused(format!(
            "`{}` is a table `{}` in A and a table `{}` in B: rows of different kinds do not compare",
            in_a.view, in_a.kind, in_b.kind
        ))
    })?;
    let mut compared = RowsComparison { in_a: count(in_a)?, in_b: count(in_b)?, ..RowsComparison::default() };
    if let (Some((a, _)), Some((b, _))) = (in_a.files.first(), in_b.files.first()) {
        compared.other_columns = other_columns(a, b, key, &in_a.view)?;
    }
    let (a, b) = other_parts(&in_a.files, &in_b.files);
    let mut differences = Differences::new(key);
    let names: Vec<String> = key.iter().map(|name| (*name).to_owned()).collect();
    match_rows(a, b, key, |outcome| {
        let first = |batch| {
            (0..MOST_KEYS.min(arrow_array::RecordBatch::num_rows(batch))).map(|row| label(batch, &names, row)).collect()
        };
        match outcome {
            Match::Pairs { a, b, pairs } => differences.add(a, b, pairs)?,
            Match::OnlyA(batch) => {
                compared.only_in_a = batch.num_rows() as u64;
                compared.only_in_a_such_as = first(batch);
            }
            Match::OnlyB(batch) => {
                compared.only_in_b = batch.num_rows() as u64;
                compared.only_in_b_such_as = first(batch);
            }
        }
        Ok(())
    })?;
    compared.changed = differences.changed;
    compared.columns = differences.finish();
    Ok(compared)
}

fn count(table: &SideTable) -> Result<u64, HistoryError> {
    let rows = |(file, record): &(PathBuf, Option<FileRecord>)| match record {
        Some(record) => Ok(record.rows),
        None => Ok(scan::rows(file)?),
    };
    table.files.iter().map(rows).sum()
}

/// Files whose content the other side lacks.
fn other_parts(
    a: &[(PathBuf, Option<FileRecord>)],
    b: &[(PathBuf, Option<FileRecord>)],
) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let digest = |record: &Option<FileRecord>| record.as_ref().map(|record| record.digest);
    let mut b: Vec<&(PathBuf, Option<FileRecord>)> = b.iter().collect();
    let mut only_a = Vec::new();
    for (file, record) in a {
        match b.iter().position(|(_, other)| record.is_some() && digest(other) == digest(record)) {
            Some(equal) => drop(b.remove(equal)),
            None => only_a.push(file.clone()),
        }
    }
    (only_a, b.into_iter().map(|(file, _)| file.clone()).collect())
}

/// Columns that only one side has, or that differ in type. Key columns must agree.
fn other_columns(a: &Path, b: &Path, key: &[&str], view: &str) -> Result<Vec<String>, HistoryError> {
    let (schema_a, schema_b) = (scan::schema(a)?, scan::schema(b)?);
    let mut other = Vec::new();
    for (schema, opposite, side) in [(&schema_a, &schema_b, "A"), (&schema_b, &schema_a, "B")] {
        for field in schema.fields() {
            match opposite.field_with_name(field.name()) {
                Err(_) => other.push(format!("{} (only in {side})", field.name())),
                Ok(same) if same.data_type() != field.data_type() && side == "A" => {
                    other.push(format!("{} (of another type)", field.name()));
                }
                Ok(_) => {}
            }
        }
    }
    match key.iter().find(|name| other.iter().any(|column| column.split(' ').next() == Some(**name))) {
        None => Ok(other),
        Some(name) => Err(HistoryError::Refused(format!(
            "`{view}`: column `{name}`, which names its rows, is not the same on both sides: the tables are of different versions"
        ))),
    }
}
