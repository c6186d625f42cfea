//! `periscope tables`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::store::runs::{Ending, RunRecord, utc};
use periscope::store::{Shelf, TableRecord};
use serde_json::json;

use super::output::{Format, Output, Rows, say};

/// Arguments of `tables`.
#[derive(Args)]
pub struct Tables {
    /// Result folder
    out: PathBuf,
    /// Remove results that no table shows: from earlier parameters, or of parts that have changed since
    #[arg(long)]
    prune: bool,
    /// With --prune: only print what would be removed
    #[arg(long, short = 'n', requires = "prune")]
    dry_run: bool,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn tables(args: &Tables) -> Result<ExitCode> {
    if args.prune {
        return prune(&args.out, args.dry_run, args.output.format);
    }
    let shelf = Shelf::look(&args.out)?;
    let is_table = args.output.format == Format::Table;
    let mut rows = Rows::new(&["table", "stage", "rows", "bytes", "parts", "lineage", "made"]);
    for (view, record) in shelf.tables()? {
        let TableRecord { lineage, stage, parts } = &record;
        let Some(table) = shelf.table_of(&view)? else {
            continue;
        };
        let lineage = if is_table { lineage.short() } else { lineage.to_string() };
        let (count, bytes, made) = (record.rows(&table), record.bytes(&table), shelf.made(&view)?.map(utc));
        rows.push([
            json!(view),
            json!(stage.kind),
            json!(count),
            json!(bytes),
            json!(parts.len()),
            json!(lineage),
            json!(made),
        ]);
    }
    rows.print(args.output.format)?;
    if !is_table {
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(run) = shelf.runs()?.last() {
        say!("\nlast run: {}", in_words(run))?;
    }
    let unneeded = shelf.unneeded()?;
    let bytes: u64 = unneeded.iter().map(|unneeded| unneeded.bytes).sum();
    if bytes > 0 {
        let out = args.out.display();
        say!("{bytes} bytes more are of results that no table shows; `periscope tables {out} --prune` removes them")?;
    }
    Ok(ExitCode::SUCCESS)
}

fn in_words(run: &RunRecord) -> String {
    let RunRecord { started, host, process, .. } = run;
    let when = run.ended.as_deref().map_or(String::new(), |ended| format!(" at {ended}"));
    let how = match (&run.ending, &run.failure) {
        (Some(Ending::Done), _) => format!("done{when}"),
        (Some(Ending::Interrupted), _) => format!("interrupted{when}; the same command goes on from there"),
        (Some(Ending::Failed), failure) => format!("failed{when}: {}", failure.as_deref().unwrap_or_default()),
        (None, _) => "under way, or killed".to_owned(),
    };
    format!("{started} by process {process} on {host}: {how}")
}

fn prune(out: &Path, is_dry: bool, format: Format) -> Result<ExitCode> {
    let shelf = if is_dry { Shelf::look(out)? } else { Shelf::look(out).and_then(|_| Shelf::open(out))? };
    let unneeded = shelf.unneeded()?;
    if !is_dry {
        shelf.remove(&unneeded)?;
    }
    let done = if is_dry { "would remove" } else { "removed" };
    let mut rows = Rows::new(&["action", "share", "folder", "parts", "bytes"]);
    for of_folder in &unneeded {
        let share = if of_folder.is_whole { "all" } else { "some" };
        let (parts, bytes) = (of_folder.parts, of_folder.bytes);
        rows.push([json!(done), json!(share), json!(of_folder.folder), json!(parts), json!(bytes)]);
    }
    rows.print(format)?;
    if format == Format::Table {
        let bytes: u64 = unneeded.iter().map(|of_folder| of_folder.bytes).sum();
        say!("{done} {bytes} bytes of results that no table shows")?;
    }
    Ok(ExitCode::SUCCESS)
}
