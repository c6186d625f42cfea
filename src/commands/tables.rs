//! `periscope tables`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::store::runs::{Ending, RunRecord, utc};
use periscope::store::{Shelf, TableRecord};

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
}

/// The command.
pub fn tables(args: &Tables) -> Result<ExitCode> {
    if args.prune {
        return prune(&args.out, args.dry_run);
    }
    let shelf = Shelf::look(&args.out)?;
    println!("{:28} {:12} {:>10} {:>12} {:>6}  {:16}  made", "table", "stage", "rows", "bytes", "parts", "lineage");
    for (view, record) in shelf.tables()? {
        let TableRecord { lineage, stage, parts } = &record;
        let Some(table) = shelf.table_of(&view) else {
            continue;
        };
        let made = shelf.made(&view).map(utc).unwrap_or_default();
        let (rows, bytes) = (record.rows(&table), record.bytes(&table));
        println!(
            "{view:28} {:12} {rows:>10} {bytes:>12} {:>6}  {:16}  {made}",
            stage.kind,
            parts.len(),
            lineage.short()
        );
    }
    if let Some(run) = shelf.runs()?.last() {
        println!("\nlast run: {}", in_words(run));
    }
    let unneeded = shelf.unneeded()?;
    let bytes: u64 = unneeded.iter().map(|unneeded| unneeded.bytes).sum();
    if bytes > 0 {
        let out = args.out.display();
        println!(
            "{bytes} bytes more are of results that no table shows; `periscope tables {out} --prune` removes them"
        );
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

fn prune(out: &Path, is_dry: bool) -> Result<ExitCode> {
    let shelf = if is_dry { Shelf::look(out)? } else { Shelf::look(out).and_then(|_| Shelf::open(out))? };
    let unneeded = shelf.unneeded()?;
    if !is_dry {
        shelf.remove(&unneeded)?;
    }
    let done = if is_dry { "would remove" } else { "removed" };
    for of_folder in &unneeded {
        let what = if of_folder.is_whole { "all" } else { "some" };
        println!(
            "{done} {what:4} of {:34} {:>6} parts {:>12} bytes",
            of_folder.folder, of_folder.parts, of_folder.bytes
        );
    }
    let bytes: u64 = unneeded.iter().map(|of_folder| of_folder.bytes).sum();
    println!("{done} {bytes} bytes of results that no table shows");
    Ok(ExitCode::SUCCESS)
}
