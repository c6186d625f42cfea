//! `periscope schema`.

use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::campaign::suggest;
use periscope::tables::{self, contract};

/// Arguments of `schema`.
#[derive(Args)]
pub struct Schema {
    /// Table; without it, all of them
    table: Option<String>,
}

/// The command.
pub fn schema(args: &Schema) -> Result<ExitCode> {
    let all = tables::all();
    if let Some(table) = args.table.as_deref().filter(|table| all.iter().all(|(name, _)| name != table)) {
        bail!("unknown table `{table}`; {}", suggest::hint(table, all.iter().map(|(name, _)| *name)));
    }
    for (name, schema) in all.iter().filter(|(name, _)| args.table.as_deref().is_none_or(|table| table == *name)) {
        println!("{}", contract::text(name, schema));
    }
    Ok(ExitCode::SUCCESS)
}
