//! What a run did not use, rejected or lost: a warning for each reason, with an example, and what to do.

use std::collections::BTreeSet;

use anyhow::Result;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::rejects::{kinds, rows, words};
use periscope::pipeline::run::Outcome;
use periscope::pipeline::spec::{Spec, Step};
use periscope::store::Shelf;

use super::super::output::{count, note};

/// Number of reasons shown; the table has all.
const SHOWN: usize = 5;
/// Stages that may answer that there is nothing: patches need not lie on a plane, a wall need not show anything.
const MAY_BE_EMPTY: [&str; 4] = ["surface", "image", "shape", "mesh"];

/// Prints what the plan does not use of its campaigns, with the fix of each.
pub fn print_left_out(plan: &Plan<'_>) {
    for left_out in plan.left_out() {
        let campaign = left_out.campaign.display();
        note!("warning: {left_out}");
        note!("  {} `periscope check --campaign {campaign}` lists all.", left_out.cause.fix());
    }
}

/// Prints what was lost on the way to the results. Returns whether they lack anything, also by what was left out, which
/// was printed as the run began.
pub fn print(spec: &Spec, outcome: &Outcome, shelf: &Shelf) -> Result<bool> {
    if outcome.rejects > 0 {
        print_rejects(shelf)?;
    }
    let empty = print_empty(spec, outcome);
    Ok(empty || outcome.rejects > 0 || !outcome.left_out.is_empty())
}

/// Prints the most common reasons for rejections, each with an example.
pub fn print_rejects(shelf: &Shelf) -> Result<()> {
    let rows = rows(shelf)?;
    if rows.is_empty() {
        return Ok(());
    }
    let kinds = kinds(&rows);
    let all = shelf.out().join("rejects");
    let counted = count(rows.len(), "record was", "records were");
    note!("warning: {counted} rejected; {} lists all", all.display());
    for (count, row) in kinds.iter().take(SHOWN) {
        let times = if *count > 1 { format!("{count} such as ") } else { String::new() };
        note!("  {times}{}", words(row));
    }
    if kinds.len() > SHOWN {
        note!("  and {}", count(kinds.len() - SHOWN, "other kind", "other kinds"));
    }
    Ok(())
}

/// Names empty results, and where their rows were lost. Returns whether there are any.
fn print_empty(spec: &Spec, outcome: &Outcome) -> bool {
    let rows = |step: &Step| Some(outcome.tables.get(&step.heading)?.rows(&step.node.tables()[0].name));
    let from = |step: &Step| spec.steps.get(spec.table(step.from.as_deref()?)?.0);
    // With --until, a table is a result though the pipeline has more stages behind it.
    let made = || spec.steps.iter().enumerate().filter(|(_, step)| outcome.tables.contains_key(&step.heading));
    let inputs: BTreeSet<usize> = made()
        .flat_map(|(_, step)| step.from.iter().chain(step.with.values()))
        .filter_map(|input| Some(spec.table(input)?.0))
        .collect();
    let results = made().filter(|(i, _)| !inputs.contains(i)).map(|(_, step)| step);
    let mut lost: Vec<(&Step, Vec<String>)> = Vec::new();
    for result in results.filter(|step| rows(step) == Some(0)) {
        let mut at = result;
        while let Some(input) = from(at).filter(|input| rows(input) == Some(0)) {
            at = input;
        }
        if MAY_BE_EMPTY.contains(&at.node.kind()) {
            continue;
        }
        let named = format!("`{}`", result.heading);
        match lost.iter_mut().find(|(other, _)| other.heading == at.heading) {
            Some((_, results)) => results.push(named),
            None => lost.push((at, vec![named])),
        }
    }
    for (at, results) in &lost {
        let had = from(at).and_then(|input| Some((input, rows(input)?)));
        let had = had.map_or("none of the captures that it takes could be read".to_owned(), |(input, rows)| {
            format!("`{}` has {rows}", input.heading)
        });
        // A result that was lost in its own stage is named only once.
        let own = *results == [format!("`{}`", at.heading)];
        let at = if own { String::new() } else { format!("`{}` has no rows, ", at.heading) };
        note!("warning: {} {} empty: {at}{had}", results.join(", "), if results.len() == 1 { "is" } else { "are" });
    }
    !lost.is_empty()
}
