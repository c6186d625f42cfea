//! A table of captures: a CSV file with one row per record, for what a pattern cannot express.
//!
//! ```text
//! file,segment,role,lit,seen,dt_ps,samples
//! raw/a.trc,0,scene,1,2,,
//! raw/a.trc,1,scene,1,3,,
//! raw/r.npy,,response,,,50,"[0, 500]"
//! ```
//! A row is a rule of its own for one file: it inherits the keys of the rule that names the table; its own cells
//! replace them. Columns are `file`, `segment`, `reference_channel`, `reference_file`, and the keys of a rule. Cells
//! are written as in campaign.toml, text without quotes. An empty cell means: as in the rule, else as in the file. Not
//! read: Parquet.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use super::keys::CaptureRule;
use super::pattern::check_path;
use super::suggest::hint;

/// Columns whose cells are text, whatever they look like.
const TEXT: [&str; 10] = [
    "file",
    "reference_channel",
    "reference_file",
    "role",
    "sensor",
    "channel",
    "range",
    "unit",
    "time_unit",
    "variable",
];

/// Columns whose cells are numbers, or lists in brackets.
const VALUES: [&str; 21] = [
    "segment",
    "lit",
    "seen",
    "shot",
    "segments",
    "averaged_shots",
    "attenuation_od",
    "power_w",
    "path_m",
    "path_sd_m",
    "bounces",
    "dt_ps",
    "nominal_rate_hz",
    "gain_v",
    "offset_v",
    "t0_ps",
    "samples",
    "axes",
    "bin_ps",
    "marker",
    "pixels",
];

/// What is wrong in a table of captures.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}{}: {problem}", table.display(), row.map_or(String::new(), |row| format!(", row {row}")))]
pub struct TableError {
    /// The table, relative to the campaign folder.
    pub table: PathBuf,
    /// The row as a spreadsheet counts: the heading is row 1.
    pub row: Option<u64>,
    /// What is wrong, and how to fix it.
    pub problem: String,
}

/// A row: a rule for one file.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The row as a spreadsheet counts: the heading is row 1.
    pub number: u64,
    /// The file, relative to the campaign folder.
    pub file: String,
    /// The segment of the file; absent: all of them.
    pub segment: Option<u32>,
    /// The keys of the rule, replaced by those of the row.
    pub rule: CaptureRule,
}

/// Reads the table of `rule`.
///
/// # Errors
/// When the table cannot be read or is Parquet, has an unknown column or no column `file`, or a cell has an impossible
/// value.
pub fn read(root: &Path, table: &Path, rule: &CaptureRule) -> Result<Vec<Row>, TableError> {
    let fail = |row: Option<u64>, problem: String| TableError { table: table.to_owned(), row, problem };
    if table.extension().is_some_and(|end| end.eq_ignore_ascii_case("parquet")) {
        let problem = "convert to CSV; Parquet capture tables are not read yet";
        return Err(fail(None, problem.into()));
    }
    let unreadable = |error: csv::Error| {
        let row = error.position().map(csv::Position::line);
        fail(row, format!("cannot be read as CSV with a comma between cells: {error}"))
    };
    if !root.join(table).is_file() {
        return Err(fail(None, "is not there; `table` is a CSV file, seen from the campaign folder".to_owned()));
    }
    let inherited = Table::try_from(rule).map_err(|error| fail(None, error.to_string()))?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(root.join(table)).map_err(unreadable)?;
    let columns = reader.headers().map_err(unreadable)?.clone();
    check_columns(&columns).map_err(|problem| fail(Some(1), problem))?;
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        let number = record.position().map_or(0, csv::Position::line);
        let row = row(number, inherited.clone(), columns.iter().zip(&record))
            .map_err(|problem| fail(Some(number), problem))?;
        rows.push(row);
    }
    Ok(rows)
}

fn check_columns(columns: &csv::StringRecord) -> Result<(), String> {
    let names = || TEXT.into_iter().chain(VALUES);
    for (index, column) in columns.iter().enumerate() {
        if !names().any(|name| name == column) {
            return Err(format!("unknown column `{column}`; {}", hint(column, names())));
        }
        if columns.iter().take(index).any(|before| before == column) {
            return Err(format!("two columns `{column}`; take one out"));
        }
    }
    if !columns.iter().any(|column| column == "file") {
        return Err("no column `file`; add one with the path of each record's file".into());
    }
    Ok(())
}

/// Replaces keys of the rule by the cells of a row.
fn row<'a>(number: u64, mut keys: Table, cells: impl Iterator<Item = (&'a str, &'a str)>) -> Result<Row, String> {
    let (mut file, mut segment) = (None, None);
    for (column, cell) in cells.filter(|(_, cell)| !cell.is_empty()) {
        match column {
            "file" => file = Some(cell.to_owned()),
            "segment" => {
                segment = Some(cell.parse().map_err(|_| {
                    format!(
                        "segment `{cell}` is not a whole number from 0; correct it, or leave it empty for all segments"
                    )
                })?)
            }
            "reference_channel" => reference(&mut keys, "channel", cell),
            "reference_file" => reference(&mut keys, "files", cell),
            _ if TEXT.contains(&column) => {
                keys.insert(column.to_owned(), Value::String(cell.to_owned()));
            }
            _ => {
                keys.insert(column.to_owned(), value(column, cell)?);
            }
        }
    }
    let file = file.ok_or("the cell of column `file` is empty; name the file, or take the row out")?;
    check_path(&file).map_err(|problem| format!("file `{file}` {problem}"))?;
    let rule =
        Value::Table(keys).try_into().map_err(|error: toml::de::Error| error.to_string().trim().replace('\n', " "))?;
    Ok(Row { number, file, segment, rule })
}

/// Replaces the reference of the rule by that of the row, even if that is of the other kind.
fn reference(keys: &mut Table, key: &str, cell: &str) {
    let mut reference = Table::new();
    reference.insert(key.to_owned(), Value::String(cell.to_owned()));
    keys.insert("reference".to_owned(), Value::Table(reference));
}

fn value(column: &str, cell: &str) -> Result<Value, String> {
    if let Ok(number) = cell.parse() {
        return Ok(Value::Integer(number));
    }
    if let Ok(number) = cell.parse() {
        return Ok(Value::Float(number));
    }
    if !cell.starts_with('[') {
        return Ok(Value::String(cell.to_owned()));
    }
    format!("{column} = {cell}")
        .parse::<Table>()
        .ok()
        .and_then(|mut table| table.remove(column))
        .ok_or_else(|| format!("{column} `{cell}` is no list; write it as in campaign.toml, such as \"[0, 500]\""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::keys::{Axis, Reference, Role};

    fn rule() -> CaptureRule {
        CaptureRule {
            table: Some("captures.csv".into()),
            role: Some(Role::Scene),
            dt_ps: Some(50.0),
            segments: vec![Axis::Shot],
            ..CaptureRule::default()
        }
    }

    fn read_text(text: &str) -> Result<Vec<Row>, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("captures.csv"), text).unwrap();
        read(folder.path(), Path::new("captures.csv"), &rule()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_row_is_the_rule_with_its_cells_laid_over() {
        let text = "file, segment, role, lit, seen, sensor, dt_ps, samples, segments, reference_file\n\
                    raw/a.trc,3,,007,12,1,,\"[0, 500]\",,raw/ref.trc\n\
                    raw/r.npy,,response,,,s1,2.5e1,,\"['lit', 'shot']\",\n";
        let rows = read_text(text).unwrap();
        let first = CaptureRule {
            lit: Some(7),
            seen: Some(12),
            sensor: Some("1".into()),
            samples: Some([0, 500]),
            reference: Some(Reference { channel: None, files: Some("raw/ref.trc".into()) }),
            ..rule()
        };
        let second = CaptureRule {
            role: Some(Role::Response),
            sensor: Some("s1".into()),
            dt_ps: Some(25.0),
            segments: vec![Axis::Lit, Axis::Shot],
            ..rule()
        };
        assert_eq!(rows[0].rule, first);
        assert_eq!((rows[0].number, rows[0].segment), (2, Some(3)));
        assert_eq!(rows[1].rule, second);
        assert_eq!((rows[1].number, rows[1].segment), (3, None));
    }

    #[test]
    fn faults_name_row_and_fix() {
        for (text, parts) in [
            ("file,lti\na,1\n", ["captures.csv, row 1", "did you mean `lit`?"]),
            ("file,lit,lit\na,1,2\n", ["row 1", "two columns `lit`"]),
            ("lit\n1\n", ["row 1", "no column `file`"]),
            ("file,lit\na,1\nb,x\n", ["row 3", "`lit`"]),
            ("file,segment\na,-1\n", ["row 2", "whole number from 0"]),
            ("file,lit\n,1\n", ["row 2", "name the file"]),
            ("file\n../a\n", ["row 2", "relative to the campaign folder"]),
            ("file,lit\na,1,2\n", ["row 2", "comma between cells"]),
            ("file,role\na,sceen\n", ["row 2", "`scene`"]),
            ("file,samples\na,\"[0, \"\n", ["row 2", "[0, 500]"]),
        ] {
            let error = read_text(text).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
    }

    #[test]
    fn parquet_and_absent_tables_are_refused() {
        let error = |name: &str| {
            let folder = tempfile::tempdir().unwrap();
            read(folder.path(), Path::new(name), &rule()).unwrap_err().to_string()
        };
        assert!(error("t.parquet").contains("convert to CSV"));
        assert!(error("none.csv").starts_with("none.csv: is not there"));
    }
}
