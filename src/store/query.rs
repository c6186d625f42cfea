//! SQL over the tables of a result folder, by Polars: its one address.

use std::io::Write;

use polars::prelude::{
    CsvWriter, JsonFormat, JsonWriter, LazyFrame, ParquetWriter, PlRefPath, PolarsError, ScanArgsParquet, SerWriter,
};
use polars::sql::SQLContext;
use thiserror::Error;

use super::damage::check;
use super::failure::StoreError;
use super::shelf::Shelf;

/// Form of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// For the eye.
    Table,
    /// Comma-separated values.
    Csv,
    /// A JSON object a line.
    Json,
    /// Parquet.
    Parquet,
}

/// Why a question has no answer.
#[derive(Debug, Error)]
pub enum QueryError {
    /// The result folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Polars refused the question.
    #[error("{0}; `periscope schema` shows the columns, `periscope tables` the tables")]
    Polars(#[from] PolarsError),
    /// The answer could not be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// Answers a question in SQL, in which every view of the folder is a table of its own name.
///
/// # Errors
/// When the question is refused, or a table cannot be read.
pub fn answer(shelf: &Shelf, sql: &str, form: Form, out: &mut impl Write) -> Result<(), QueryError> {
    let mut context = SQLContext::new();
    let mut views: Vec<String> = shelf.tables()?.into_iter().map(|(view, _)| view).collect();
    views.push("rejects".to_owned());
    for view in views {
        // Polars holds no page against its checksum, so the files that are asked for are held against their records first.
        if sql.contains(&view) {
            shelf.recorded(&view)?.iter().try_for_each(|(file, record)| check(file, record))?;
        }
        let pattern = shelf.out().join(&view).join("*.parquet");
        let frame = LazyFrame::scan_parquet(PlRefPath::new(pattern.to_string_lossy()), ScanArgsParquet::default())?;
        context.register(&view, frame);
    }
    let mut answer = context.execute(sql)?.collect()?;
    match form {
        Form::Table => writeln!(out, "{answer}")?,
        Form::Csv => CsvWriter::new(out).finish(&mut answer)?,
        Form::Json => JsonWriter::new(out).with_json_format(JsonFormat::JsonLines).finish(&mut answer)?,
        Form::Parquet => {
            ParquetWriter::new(out).finish(&mut answer)?;
        }
    }
    Ok(())
}
