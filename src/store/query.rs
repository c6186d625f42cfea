//! SQL over the tables of a result folder; the only file that uses Polars, with its folder `query/`.
//!
//! Polars' streaming engine answers, so that a query over raw traces does not load all of them into memory.

mod answer_text;

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
    /// For the terminal, with the columns that fit into this many characters; `None`: all.
    Table(Option<usize>),
    /// Comma-separated values; lists as JSON, bytes as hexadecimal digits.
    Csv,
    /// One JSON object per line; bytes as hexadecimal digits.
    Json,
    /// Parquet.
    Parquet,
}

/// Why a query failed.
#[derive(Debug, Error)]
pub enum QueryError {
    /// The result folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A table that does not exist.
    #[error("no table `{name}`")]
    NoTable {
        /// Requested name.
        name: String,
        /// Existing tables.
        available: Vec<String>,
    },
    /// A column that does not exist.
    #[error("no column `{name}` in {}", tables.join(", "))]
    NoColumn {
        /// Requested name.
        name: String,
        /// The tables that the query names.
        tables: Vec<String>,
        /// Their columns.
        available: Vec<String>,
    },
    /// Polars rejected the query.
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

/// Answers an SQL query, in which every view of the folder is a table with its name.
///
/// # Errors
/// When the query is rejected, or a table cannot be read.
pub fn answer(shelf: &Shelf, sql: &str, form: Form, out: &mut impl Write) -> Result<(), QueryError> {
    let views = shelf.names()?;
    let sql = quoted(sql, &views);
    let context = SQLContext::new();
    let mut used_views = Vec::new();
    for view in &views {
        let frame = frame(shelf, view, mentions(&sql, view))?;
        if mentions(&sql, view) {
            used_views.push((view.clone(), frame.clone()));
        }
        context.register(view, frame);
    }
    let ask = |mut context: SQLContext| context.execute(&sql)?.collect_with_engine(Engine::Streaming);
    let answer = ask(context).map_err(|error| explain(&error, &views, used_views))?.unwrap_single();
    match form {
        Form::Table(width) => answer_text::table(&answer, width, out)?,
        Form::Csv => answer_text::csv(&answer, out)?,
        Form::Json => {
            let mut plain = answer_text::without_bytes(answer)?;
            JsonWriter::new(out).with_json_format(JsonFormat::JsonLines).finish(&mut plain)?;
        }
        Form::Parquet => {
            ParquetWriter::new(out).finish(&mut answer.clone())?;
        }
    }
    Ok(())
}

/// A view, which Polars reads when the query needs it. Polars verifies no page checksums, so the files of views in the
/// query are checked against their records first.
fn frame(shelf: &Shelf, view: &str, is_asked_for: bool) -> Result<LazyFrame, QueryError> {
    let files = shelf.recorded(view)?;
    if files.is_empty() {
        return Ok(empty(shelf, view)?.lazy());
    }
    if is_asked_for {
        files.iter().try_for_each(|(file, record)| check(file, record))?;
    }
    let paths = files.iter().map(|(file, _)| PlRefPath::new(file.to_string_lossy())).collect();
    // `glob` is off: the paths are literal, whatever characters the folder's name has.
    let args = ScanArgsParquet { glob: false, ..ScanArgsParquet::default() };
    Ok(LazyFrame::scan_parquet_files(paths, args)?)
}

/// A table without parts: the campaign has nothing for it.
fn empty(shelf: &Shelf, view: &str) -> Result<DataFrame, QueryError> {
    let kind = shelf.table_of(view)?.unwrap_or_default();
    let schema = crate::tables::all().into_iter().find(|(table, _)| *table == kind).map(|(_, schema)| schema);
    let schema = schema.ok_or_else(|| QueryError::Refused(format!("table `{view}` is empty")))?;
    let bytes = ArrowWriter::try_new(Vec::new(), schema, None).and_then(ArrowWriter::into_inner);
    Ok(ParquetReader::new(std::io::Cursor::new(bytes.at("write", shelf.out())?)).finish()?)
}

/// The mistake behind a rejected query, where it is a name.
fn explain(error: &PolarsError, views: &[String], used_views: Vec<(String, LazyFrame)>) -> QueryError {
    let text = error.to_string();
    let after = |start: &str, end: char| {
        let (_, rest) = text.split_once(start)?;
        rest.split_once(end).map(|(name, _)| name.to_owned())
    };
    if let Some(name) = after("relation '", '\'') {
        return QueryError::NoTable { name, available: views.to_vec() };
    }
    if let Some(name) = after("unable to find column \"", '"').or_else(|| after("no column named '", '\'')) {
        let (tables, frames): (Vec<String>, Vec<LazyFrame>) = used_views.into_iter().unzip();
        // A table whose columns cannot be read suggests none.
        let columns = frames.into_iter().filter_map(|mut frame| frame.collect_schema().ok());
        let available = columns.flat_map(|schema| schema.iter_names().map(ToString::to_string).collect::<Vec<_>>());
        return QueryError::NoColumn { name, tables, available: available.collect() };
    }
    QueryError::Refused(text)
}
