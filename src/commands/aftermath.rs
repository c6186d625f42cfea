//! Messages at the end of a run: its tables, and what is missing from them.

mod decisions;
mod losses;

use std::process::ExitCode;

use anyhow::Result;
use periscope::pipeline::run::Outcome;
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use serde_json::json;

use super::SOME_REJECTED;
use super::output::{Format, Rows, say};
pub use losses::print_left_out as tell_left_out;
pub use losses::print_rejects as tell_rejects;

/// Prints the tables to standard output, a row each, then warnings. Returns whether something was left out or rejected,
/// or a result is empty.
pub fn tell(spec: &Spec, outcome: &Outcome, shelf: &Shelf, format: Format) -> Result<bool> {
    let out = shelf.out().display();
    let mut tables = Rows::new(&["table", "rows", "made", "folder"]);
    for step in &spec.steps {
        if let Some(record) = outcome.tables.get(&step.heading) {
            let rows: u64 = record.rows(&step.node.tables()[0].name);
            let made = if outcome.computed.contains(&step.heading) { "computed" } else { "reused" };
            tables.push([json!(step.heading), json!(rows), json!(made), json!(format!("{out}/{}", step.heading))]);
        }
    }
    let mut printed = tables.print(format);
    if format == Format::Table {
        printed = printed.and_then(|()| say!("results: {out}; `periscope report {out}` draws them"));
        printed = printed.and_then(|()| decisions::print(spec, outcome, shelf));
    }
    // Warnings come also where nothing reads standard output.
    let is_incomplete = losses::print(spec, outcome, shelf)?;
    printed?;
    Ok(is_incomplete)
}

/// The exit code of a run that ended.
pub fn exit_code(is_incomplete: bool, is_strict: bool) -> ExitCode {
    match (is_incomplete, is_strict) {
        (false, _) => ExitCode::SUCCESS,
        (true, true) => ExitCode::FAILURE,
        (true, false) => ExitCode::from(SOME_REJECTED),
    }
}
