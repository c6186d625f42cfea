//! SQL over the tables of a result folder, by Polars: its one address.
//!
//! The streaming engine answers, so that a question over raw traces needs no memory for all of them.

mod written;

use std::io::Write;

use ::parquet::arrow::ArrowWriter;
use polars::prelude::{
    DataFrame, Engine, IntoLazy, JsonFormat, JsonWriter, LazyFrame, ParquetReader, ParquetWriter, PlRefPath,
    PolarsError, ScanArgsParquet, SerReader, SerWriter,
};
use polars::sql::SQLContext;
use thiserror::Error;

use super::damage::check;
use super::failure::{At, StoreError};
use super::shelf::Shelf;
use super::sql_names::{mentions, quoted};

/// Form of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// For the eye, with the columns that fit into so many letters; `None`: all.
    Table(Option<usize>),
    /// Comma-separated values; lists as JSON, bytes as hexadecimal digits.
    Csv,
    /// A JSON object a line; bytes as hexadecimal digits.
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
    /// A table that is not there.
    #[error("no table `{name}`")]
    NoTable {
        /// As asked for.
        name: String,
        /// Those that are there.
        known: Vec<String>,
    },
    /// A column that is not there.
    #[error("no column `{name}` in {}", tables.join(", "))]
    NoColumn {
        /// As asked for.
        name: String,
        /// The tables that the question names.
        tables: Vec<String>,
        /// Their columns.
        known: Vec<String>,
    },
    /// Polars refused the question.
    #[error("{0}")]
    Refused(String),
    /// The answer could not be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl From<PolarsError> for QueryError {
    fn from(error: PolarsError) -> Self {
        match error {
            PolarsError::IO { error, .. } => Self::Io(std::io::Error::new(error.kind(), error)),
            error => Self::Refused(error.to_string()),
        }
    }
}

/// Answers a question in SQL, in which every view of the folder is a table of its own name.
///
/// # Errors
/// When the question is refused, or a table cannot be read.
pub fn answer(shelf: &Shelf, sql: &str, form: Form, out: &mut impl Write) -> Result<(), QueryError> {
    let views = shelf.names()?;
    let sql = quoted(sql, &views);
    let context = SQLContext::new();
    let mut named = Vec::new();
    for view in &views {
        let frame = frame(shelf, view, mentions(&sql, view))?;
        if mentions(&sql, view) {
            named.push((view.clone(), frame.clone()));
        }
        context.register(view, frame);
    }
    let ask = |mut context: SQLContext| context.execute(&sql)?.collect_with_engine(Engine::Streaming);
    let answer = ask(context).map_err(|error| explained(&error, &views, named))?.unwrap_single();
    match form {
        Form::Table(width) => written::table(&answer, width, out)?,
        Form::Csv => written::csv(&answer, out)?,
        Form::Json => {
            let mut plain = written::without_bytes(answer)?;
            JsonWriter::new(out).with_json_format(JsonFormat::JsonLines).finish(&mut plain)?;
        }
        Form::Parquet => {
            ParquetWriter::new(out).finish(&mut answer.clone())?;
        }
    }
    Ok(())
}

/// A view, to be read when it is asked for. Polars holds no page against its checksum, so the files that are asked for are held against their records
/// first.
fn frame(shelf: &Shelf, view: &str, is_asked_for: bool) -> Result<LazyFrame, QueryError> {
    let files = shelf.recorded(view)?;
    if files.is_empty() {
        return Ok(empty(shelf, view)?.lazy());
    }
    if is_asked_for {
        files.iter().try_for_each(|(file, record)| check(file, record))?;
    }
    let paths = files.iter().map(|(file, _)| PlRefPath::new(file.to_string_lossy())).collect();
    // The names are those of the files themselves, whatever letters the folder's name has.
    let args = ScanArgsParquet { glob: false, ..ScanArgsParquet::default() };
    Ok(LazyFrame::scan_parquet_files(paths, args)?)
}

/// A table that no part has been made of: nothing in the campaign concerns it.
fn empty(shelf: &Shelf, view: &str) -> Result<DataFrame, QueryError> {
    let kind = shelf.table_of(view).unwrap_or_default();
    let schema = crate::tables::all().into_iter().find(|(table, _)| *table == kind).map(|(_, schema)| schema);
    let schema = schema.ok_or_else(|| QueryError::Refused(format!("table `{view}` is empty")))?;
    let bytes = ArrowWriter::try_new(Vec::new(), schema, None).and_then(ArrowWriter::into_inner);
    Ok(ParquetReader::new(std::io::Cursor::new(bytes.at("write", shelf.out())?)).finish()?)
}

/// A refusal as the mistake behind it, where that is a name.
fn explained(error: &PolarsError, views: &[String], named: Vec<(String, LazyFrame)>) -> QueryError {
    let text = error.to_string();
    let after = |start: &str, end: char| {
        let (_, rest) = text.split_once(start)?;
        rest.split_once(end).map(|(name, _)| name.to_owned())
    };
    if let Some(name) = after("relation '", '\'') {
        return QueryError::NoTable { name, known: views.to_vec() };
    }
    if let Some(name) = after("unable to find column \"", '"').or_else(|| after("no column named '", '\'')) {
        let (tables, frames): (Vec<String>, Vec<LazyFrame>) = named.into_iter().unzip();
        // A table whose columns cannot be read has none to suggest.
        let columns = frames.into_iter().filter_map(|mut frame| frame.collect_schema().ok());
        let known = columns.flat_map(|schema| schema.iter_names().map(ToString::to_string).collect::<Vec<_>>());
        return QueryError::NoColumn { name, tables, known: known.collect() };
    }
    QueryError::Refused(text)
}
