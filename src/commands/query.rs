//! `periscope query`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, ValueEnum};
use periscope::store::Shelf;

/// Arguments of `query`.
#[derive(Args)]
pub struct Query {
    /// Result folder
    out: PathBuf,
    /// Query in SQL; each table has its own name, such as SELECT * FROM patches
    #[arg(allow_hyphen_values = true)]
    sql: String,
    /// Form of the answer
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
}

/// Form of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For the terminal: all rows, and the columns that fit
    Table,
    /// Comma-separated values; lists as JSON, bytes as hexadecimal digits
    Csv,
    /// JSON, one object per line
    Json,
    /// Parquet, to standard output
    Parquet,
}

/// The command.
#[cfg(feature = "query")]
pub fn query(args: &Query) -> Result<ExitCode> {
    use periscope::store::query::{Form, answer};
    let form = match args.format {
        Format::Table => Form::Table(terminal_width()),
        Format::Csv => Form::Csv,
        Format::Json => Form::Json,
        Format::Parquet => Form::Parquet,
    };
    let shelf = Shelf::look(&args.out)?;
    answer(&shelf, &args.sql, form, &mut std::io::stdout().lock()).map_err(with_advice)?;
    Ok(ExitCode::SUCCESS)
}

/// Characters per line, if the output is a terminal.
#[cfg(feature = "query")]
fn terminal_width() -> Option<usize> {
    rustix::termios::tcgetwinsize(std::io::stdout()).ok().map(|size| size.ws_col.into()).filter(|letters| *letters > 0)
}

/// An error with advice.
#[cfg(feature = "query")]
fn with_advice(error: periscope::store::query::QueryError) -> anyhow::Error {
    use periscope::campaign::suggest::hint;
    use periscope::store::query::QueryError;
    let advice = match &error {
        QueryError::NoTable { name, available } | QueryError::NoColumn { name, available, .. } => {
            hint(name, available.iter().map(String::as_str))
        }
        QueryError::Refused(_) => "`periscope schema` shows the columns, `periscope tables` the tables".to_owned(),
        QueryError::Store(_) | QueryError::Io(_) => String::new(),
    };
    match error {
        QueryError::Store(error) => error.into(),
        QueryError::Io(error) => super::output::failure(error),
        error => anyhow::anyhow!("{error}; {advice}"),
    }
}

/// The command in a build without Polars: explains how to get it, and how to use DuckDB instead.
#[cfg(not(feature = "query"))]
pub fn query(args: &Query) -> Result<ExitCode> {
    use periscope::store::sql_names::{mentions, quoted};
    let shelf = Shelf::look(&args.out)?;
    let views = shelf.names()?;
    let sql = quoted(&args.sql, &views);
    let out = args.out.display().to_string().replace('\'', "''");
    let table = |view: &&String| format!("\"{view}\" AS (FROM '{out}/{view}/*.parquet')");
    let with: Vec<String> = views.iter().filter(|view| mentions(&sql, view)).map(|view| table(&view)).collect();
    if with.is_empty() {
        anyhow::bail!("the question names no table of {}; it has {}", args.out.display(), views.join(", "));
    }
    anyhow::bail!(
        "this build is lean and has no SQL engine (asked for: {:?}); get one with `cargo install --path . --features query`, or ask DuckDB:\nWITH {}\n{sql}",
        args.format,
        with.join(", ")
    );
}
