//! A run that leaves its record: what was asked, what became of it.

use std::collections::BTreeMap;
use std::fmt::Display;

use super::plan::Plan;
use super::run::Outcome;
use crate::cancel::{Cancel, Cancelled};
use crate::store::runs::{Ending, RunRecord};
use crate::store::{Digest, Shelf, StoreError};

/// Computes with the record of the run on the shelf from the start on, and how it ended at the end. `compute` collects
/// the lineages of whole tables ([`lineages`]), also where it fails.
///
/// # Errors
/// Those of `compute`; else that the record cannot be written.
pub fn recorded<E: Display + From<StoreError> + From<Cancelled>>(
    shelf: &Shelf,
    record: &mut RunRecord,
    compute: impl FnOnce(&mut BTreeMap<String, Digest>) -> Result<Outcome, E>,
    is_interruption: impl FnOnce(&E) -> bool,
) -> Result<Outcome, E> {
    shelf.write_run(record)?;
    let outcome = Cancel::catch(|| compute(&mut record.tables)).map_err(E::from).flatten();
    let ending = match &outcome {
        Ok(outcome) => {
            record.rejects = outcome.rejects;
            record.left_out = outcome.left_out.iter().map(ToString::to_string).collect();
            record.passes.clone_from(&outcome.passes);
            Ending::Done
        }
        Err(error) if is_interruption(error) => Ending::Interrupted,
        Err(error) => {
            record.failure = Some(format!("{error:#}"));
            Ending::Failed
        }
    };
    record.end(ending);
    let written = shelf.targets().and_then(|views| {
        record.views = views;
        shelf.write_run(record)
    });
    let outcome = outcome?;
    written?;
    Ok(outcome)
}

/// Lineages of the whole tables that a plan wants, by their headings.
pub fn lineages(plan: &Plan<'_>) -> BTreeMap<String, Digest> {
    let steps = plan.spec.steps.iter().zip(&plan.tables);
    let kept = steps.filter(|(step, table)| step.keep && table.wanted && table.complete());
    kept.filter_map(|(step, table)| Some((step.heading.clone(), table.lineage()?))).collect()
}
