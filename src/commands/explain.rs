//! `periscope explain`.

mod text;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, ValueEnum};
use periscope::history::explanation::{Explanation, explain as explained};
use periscope::history::target::Target;
use periscope::store::Shelf;

use super::output::{Format, Rows, json, print, print_text};

/// The fields of the JSON object.
const JSON_HELP: &str = "\
Rows as CSV are those of `onsets`. Keys of the JSON object (times in ps, voltages in V, lengths in m; null: unknown)
  target             the row that the call names
  table, table_kind  the table that it stands in, and its kind as in `periscope schema`
  stage              the stage that made it
  row                the row by its columns, as `periscope schema` lists them
  tables             all that it goes back to: table, stage, lineage (null: not kept), from, with
  onsets             campaign, sensor, lit, seen, rank, part, path, time_ps, time_sd_ps, turns,
                     residual_ps, pull (residual in standard deviations), used, probability,
                     snr, flags
  captures           campaign, sensor, lit, seen, shots, rejected, noise_v, jitter_ps, chi2_dof,
                     acquired_at, raw
  sensors            calibration and session: table, campaign, sensor, range, shots, latency_ps,
                     latency_sd_ps, delay_ps, delay_sd_ps, raw
  raw (in both)      campaign, file, channel, segments (null: all), exposures, is_reference
  beside             side tables that the same stage wrote
  remarks            what to know about the answer
  queries            about, sql";

/// The columns of onsets.
const ONSET_COLUMNS: [&str; 14] = [
    "campaign",
    "sensor",
    "lit",
    "seen",
    "rank",
    "path",
    "time_ps",
    "time_sd_ps",
    "turns",
    "residual_ps",
    "pull",
    "used",
    "probability",
    "snr",
];

/// Arguments of `explain`.
#[derive(Args)]
#[command(after_long_help = JSON_HELP)]
pub struct Explain {
    /// Result folder
    out: PathBuf,
    /// Row: patch=3, distance=3,4, onset=SENSOR,LIT,SEEN,RANK (SENSOR may be left out if there is one), or
    /// echo=RUN,PULSE,ECHO
    #[arg(value_name = "ROW")]
    target: Target,
    /// Table, if several have such rows (default: the last one of the dataflow)
    #[arg(long, value_name = "HEADING")]
    table: Option<String>,
    /// Campaign folder, if it has moved since the last run; may be given several times
    #[arg(long, value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Form of the answer
    #[arg(long, value_enum, default_value = "table")]
    format: Form,
    /// List every onset and capture with its raw files, even if there are many
    #[arg(long)]
    all: bool,
}

/// Form of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// Text for the terminal
    Table,
    /// One JSON object
    Json,
    /// Its onsets as comma-separated values with a header (RFC 4180)
    Csv,
    /// The SQL alone, for DuckDB
    Sql,
}

/// The command.
pub fn explain(args: &Explain) -> Result<ExitCode> {
    let shelf = Shelf::look(&args.out)?;
    let explanation = explained(&shelf, &args.target, args.table.as_deref(), &args.campaign)?;
    match args.format {
        Form::Table => print_text(&text::text(&explanation, args.all))?,
        Form::Json => print(json(&explanation)?)?,
        Form::Csv => Rows::of(&ONSET_COLUMNS, &explanation.onsets)?.print(Format::Csv)?,
        Form::Sql => print_text(&sql(&explanation))?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The queries as one executable text.
fn sql(explanation: &Explanation) -> String {
    let statements = explanation.queries.iter().map(|query| format!("-- {}\n{};\n", query.about, query.sql));
    statements.collect::<Vec<_>>().join("\n")
}
