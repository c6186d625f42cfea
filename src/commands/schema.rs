//! `periscope schema`.

use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::campaign::suggest;
use periscope::tables;
use periscope::tables::contract::{self, Column};
use serde_json::json;

use super::output::{Format, Output, Rows, print};

/// Arguments of `schema`.
#[derive(Args)]
pub struct Schema {
    /// Table; without it, all of them
    table: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn schema(args: &Schema) -> Result<ExitCode> {
    let all = tables::all();
    if let Some(table) = args.table.as_deref().filter(|table| all.iter().all(|(name, _)| name != table)) {
        bail!("unknown table `{table}`; {}", suggest::hint(table, all.iter().map(|(name, _)| *name)));
    }
    let shown = all.iter().filter(|(name, _)| args.table.as_deref().is_none_or(|table| table == *name));
    if args.output.format == Format::Table {
        print(shown.map(|(name, schema)| contract::text(name, schema) + "\n").collect::<String>())?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut rows = Rows::new(&["table", "column", "type", "may_be_null", "unit", "meaning"]);
    for (name, schema) in shown {
        for column in contract::columns(schema) {
            let Column { name: column, type_name, may_be_null, unit, meaning } = column;
            rows.push([json!(name), json!(column), json!(type_name), json!(may_be_null), json!(unit), json!(meaning)]);
        }
    }
    rows.print(args.output.format)?;
    Ok(ExitCode::SUCCESS)
}
