//! Messages at the end of a run: its tables, and what is missing from them.

mod decisions;
mod losses;

use std::process::ExitCode;

use anyhow::Result;
use periscope::pipeline::run::Outcome;
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;

use super::SOME_REJECTED;
pub use losses::print_rejects as tell_rejects;

/// Prints the tables to standard output, one per line, then warnings. Returns the exit code.
pub fn tell(spec: &Spec, outcome: &Outcome, shelf: &Shelf, is_strict: bool) -> Result<ExitCode> {
    let out = shelf.out().display();
    for step in &spec.steps {
        if let Some(record) = outcome.tables.get(&step.heading) {
            let rows: u64 = record.rows(&step.node.tables()[0].name);
            let made = if outcome.computed.contains(&step.heading) { "computed" } else { "reused" };
            println!("{:24} {rows:>10} rows  {made:8}  {out}/{}", step.heading, step.heading);
        }
    }
    println!("results: {out}; look at them with `periscope report {out}`");
    decisions::print(spec, outcome, shelf)?;
    let is_incomplete = losses::print(spec, outcome, shelf)?;
    Ok(match (is_incomplete, is_strict) {
        (false, _) => ExitCode::SUCCESS,
        (true, true) => ExitCode::FAILURE,
        (true, false) => ExitCode::from(SOME_REJECTED),
    })
}
