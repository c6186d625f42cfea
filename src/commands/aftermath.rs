//! Messages at the end of a run: what it rejected and why, and tables without rows.

use std::collections::BTreeSet;
use std::process::ExitCode;

use anyhow::Result;
use periscope::pipeline::rejects::{kinds, rows, words};
use periscope::pipeline::run::Outcome;
use periscope::pipeline::spec::{Spec, Step};
use periscope::store::Shelf;

use super::SOME_REJECTED;

/// Number of reasons shown; the table has all.
const SHOWN: usize = 5;

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
    tell_empty(spec, outcome);
    if outcome.rejects > 0 {
        tell_rejects(shelf)?;
        return Ok(if is_strict { ExitCode::FAILURE } else { ExitCode::from(SOME_REJECTED) });
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints the most common reasons for rejections, each with an example.
pub fn tell_rejects(shelf: &Shelf) -> Result<()> {
    let rows = rows(shelf)?;
    if rows.is_empty() {
        return Ok(());
    }
    let kinds = kinds(&rows);
    let all = shelf.out().join("rejects");
    eprintln!("warning: {} records were rejected; {} has all", rows.len(), all.display());
    for (count, row) in kinds.iter().take(SHOWN) {
        let times = if *count > 1 { format!("{count} like ") } else { String::new() };
        eprintln!("  {times}{}", words(row));
    }
    if kinds.len() > SHOWN {
        eprintln!("  and {} kinds more", kinds.len() - SHOWN);
    }
    Ok(())
}

/// Names empty results, and where their rows were lost.
fn tell_empty(spec: &Spec, outcome: &Outcome) {
    let rows = |step: &Step| Some(outcome.tables.get(&step.heading)?.rows(&step.node.tables()[0].name));
    let from = |step: &Step| spec.steps.get(spec.table(step.from.as_deref()?)?.0);
    let inputs: BTreeSet<usize> = spec
        .steps
        .iter()
        .flat_map(|step| step.from.iter().chain(step.with.values()))
        .filter_map(|input| Some(spec.table(input)?.0))
        .collect();
    let results = spec.steps.iter().enumerate().filter(|(i, _)| !inputs.contains(i)).map(|(_, step)| step);
    let mut lost: Vec<(&Step, Vec<String>)> = Vec::new();
    for result in results.filter(|step| rows(step) == Some(0)) {
        let mut at = result;
        while let Some(input) = from(at).filter(|input| rows(input) == Some(0)) {
            at = input;
        }
        let named = format!("`{}`", result.heading);
        match lost.iter_mut().find(|(other, _)| other.heading == at.heading) {
            Some((_, results)) => results.push(named),
            None => lost.push((at, vec![named])),
        }
    }
    for (at, results) in lost {
        let had = from(at).and_then(|input| Some((input, rows(input)?)));
        let had = had.map_or("none of the captures that it takes could be read".to_owned(), |(input, rows)| {
            format!("`{}` has {rows}", input.heading)
        });
        // A result that was lost in its own stage is named only once.
        let own = results == [format!("`{}`", at.heading)];
        let at = if own { String::new() } else { format!("`{}` has no rows, ", at.heading) };
        eprintln!("warning: {} came out empty: {at}{had}", results.join(", "));
    }
}
