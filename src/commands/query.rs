//! `periscope query`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, ValueEnum};

/// Arguments of `query`.
#[derive(Args)]
pub struct Query {
    /// Result folder
    out: PathBuf,
    /// Question in SQL; each table has its own name, such as SELECT * FROM patches
    sql: String,
    /// Form of the answer
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
}

/// Form of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For the eye
    Table,
    /// Comma-separated values
    Csv,
    /// JSON, an object a line
    Json,
    /// Parquet, to standard output
    Parquet,
}

/// The command.
#[cfg(feature = "query")]
pub fn query(args: &Query) -> Result<ExitCode> {
    use periscope::store::query::{Form, answer};
    let form = match args.format {
        Format::Table => Form::Table,
        Format::Csv => Form::Csv,
        Format::Json => Form::Json,
        Format::Parquet => Form::Parquet,
    };
    let shelf = periscope::store::Shelf::look(&args.out)?;
    answer(&shelf, &args.sql, form, &mut std::io::stdout().lock())?;
    Ok(ExitCode::SUCCESS)
}

/// The command in a build without Polars: says how to get it, and how to ask DuckDB the same.
#[cfg(not(feature = "query"))]
pub fn query(args: &Query) -> Result<ExitCode> {
    let shelf = periscope::store::Shelf::look(&args.out)?;
    let views: Vec<String> = shelf.tables()?.into_iter().map(|(view, _)| view).collect();
    let with: Vec<String> = views
        .iter()
        .filter(|view| args.sql.contains(view.as_str()))
        .map(|view| format!("\"{view}\" AS (SELECT * FROM '{}/{view}/*.parquet')", args.out.display()))
        .collect();
    let with = if with.is_empty() { String::new() } else { format!("WITH {} ", with.join(", ")) };
    anyhow::bail!(
        "this build is lean and has no SQL engine (asked for: {:?}); get one with `cargo install --path . --features query`, or ask DuckDB:\n{with}{}",
        args.format,
        args.sql
    );
}
