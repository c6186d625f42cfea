//! The decisions of a run, in a few lines.

use anyhow::Result;
use periscope::pipeline::run::Outcome;
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use periscope::tables::{Decision, Row};

use super::super::output::say;

/// Prints each decision of the last stage that has some, with what speaks for it.
pub fn print(spec: &Spec, outcome: &Outcome, shelf: &Shelf) -> Result<()> {
    let is_done = |heading: &str| outcome.tables.contains_key(heading);
    let mut steps = spec.steps.iter().rev().filter(|step| step.keep && is_done(&step.heading));
    let Some(step) = steps.find(|step| step.node.tables()[0].name == Decision::TABLE) else { return Ok(()) };
    say!(
        "\nDecisions behind the result ({}/{} also has the second-best choices, and what would change each decision):",
        shelf.out().display(),
        step.heading
    )?;
    for batch in shelf.batches(&step.heading)? {
        for row in Decision::rows(&batch)? {
            say!("  {:24} {}: {}", &*row.what, row.chosen, row.evidence)?;
        }
    }
    Ok(())
}
