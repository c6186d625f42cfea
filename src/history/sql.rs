//! The queries of an explanation in SQL over the Parquet files: for DuckDB, or any engine with `read_parquet` and
//! `array_contains`.

use serde::Serialize;

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use crate::store::Shelf;

/// Columns that identify a capture.
const CAPTURE: &str = "campaign, sensor, lit, seen";

/// One query.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Query {
    /// Its subject.
    pub about: &'static str,
    /// The query, without a semicolon at its end.
    pub sql: String,
}

/// Rows of a table that hold the key of each contributing onset.
pub struct Selection {
    /// A table with the columns campaign, sensor, lit, seen, rank.
    pub table: Table,
    /// Which rows of it, in SQL.
    pub condition: String,
}

/// Writes queries over the tables of one result folder.
pub struct Questions<'a> {
    pub shelf: &'a Shelf,
    pub ancestry: &'a Ancestry,
}

impl Questions<'_> {
    /// The files of a table, if it has any.
    fn files(&self, table: &Table) -> Result<Option<String>, HistoryError> {
        if self.ancestry.files(table)?.is_empty() {
            return Ok(None);
        }
        let folder = self.ancestry.folder(self.shelf, table);
        Ok(folder.map(|folder| {
            let pattern = format!("{}/*.parquet", literal(&folder.to_string_lossy()));
            format!("read_parquet({})", quoted(&pattern))
        }))
    }

    /// Some rows of a table.
    pub fn rows(&self, about: &'static str, table: &Table, condition: &str) -> Result<Option<Query>, HistoryError> {
        let sql = |files: String| Query { about, sql: format!("SELECT * FROM {files} WHERE {condition}") };
        Ok(self.files(table)?.map(sql))
    }

    /// Onsets, with their rows in `onsets` and `labels`.
    pub fn onsets(
        &self,
        selection: &Selection,
        labels: Option<&Table>,
        onsets: Option<&Table>,
    ) -> Result<Option<Query>, HistoryError> {
        let Some(files) = self.files(&selection.table)? else { return Ok(None) };
        let is_other = |table: &&Table| **table != selection.table;
        let labels = labels.filter(is_other).map(|table| self.files(table)).transpose()?.flatten();
        let onsets = onsets.filter(is_other).map(|table| self.files(table)).transpose()?.flatten();
        let mut columns = vec!["p.*"];
        let mut joins: Vec<String> = Vec::new();
        let on =
            "p.campaign = x.campaign AND p.sensor = x.sensor AND p.lit = x.lit AND p.seen = x.seen AND p.rank = x.rank";
        let labels = labels.map(|files| format!("(SELECT * FROM {files} WHERE alternative = 0)"));
        for (files, name, added) in [
            (onsets, "o", ["o.time_ps AS onset_ps", "o.time_sd_ps AS onset_sd_ps", "o.snr", "o.flags"].as_slice()),
            (labels, "l", ["l.turns", "l.probability"].as_slice()),
        ] {
            if let Some(files) = files {
                columns.extend(added);
                let on = on.replace("x.", &format!("{name}."));
                joins.push(format!("\nLEFT JOIN {files} AS {name} ON {on}"));
            }
        }
        let (columns, condition) = (columns.join(", "), &selection.condition);
        let sql = format!("SELECT {columns}\nFROM (SELECT * FROM {files} WHERE {condition}) AS p{}", joins.concat());
        Ok(Some(Query { about: "its onsets", sql }))
    }

    /// Columns of a table of captures or records for the captures of onsets; includes reciprocal ones where both were
    /// explained together. Without a selection, for all captures of the scene.
    pub fn captures(
        &self,
        about: &'static str,
        table: &Table,
        columns: &str,
        selection: Option<&Selection>,
        with_reciprocal: bool,
    ) -> Result<Option<Query>, HistoryError> {
        let Some(files) = self.files(table)? else { return Ok(None) };
        let Some(selection) = selection else {
            let sql = format!("SELECT {CAPTURE}, {columns} FROM {files} WHERE role = 'scene'");
            return Ok(Some(Query { about, sql }));
        };
        let Some(of) = self.files(&selection.table)? else { return Ok(None) };
        let mut keys = format!("SELECT {CAPTURE} FROM {of} WHERE {}", selection.condition);
        if with_reciprocal {
            let swapped = "campaign, sensor, seen AS lit, lit AS seen";
            keys = format!("{keys} UNION SELECT {swapped} FROM {of} WHERE {}", selection.condition);
        }
        let listed = |names: &str| names.split(", ").map(|name| format!("t.{name}")).collect::<Vec<_>>().join(", ");
        let on = "t.campaign = c.campaign AND t.sensor = c.sensor AND t.lit = c.lit AND t.seen = c.seen";
        let sql = format!(
            "SELECT {}, {}\nFROM (SELECT DISTINCT * FROM ({keys}) AS k) AS c\nJOIN {files} AS t ON {on}\nWHERE t.role = 'scene'",
            listed(CAPTURE),
            listed(columns)
        );
        Ok(Some(Query { about, sql }))
    }
}

/// A path within a pattern of files: what DuckDB takes for a wildcard stands for itself. It has no escape for a
/// backslash, and finds no file then.
fn literal(path: &str) -> String {
    let class = |c: char| if matches!(c, '*' | '?' | '[') { format!("[{c}]") } else { c.to_string() };
    path.chars().map(class).collect()
}

/// A text as an SQL literal.
pub fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}
