//! `periscope tables`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::store::{Shelf, TableRecord, runs::utc};

/// Arguments of `tables`.
#[derive(Args)]
pub struct Tables {
    /// Result folder
    out: PathBuf,
}

/// The command.
pub fn tables(args: &Tables) -> Result<ExitCode> {
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
    Ok(ExitCode::SUCCESS)
}
