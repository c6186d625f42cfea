//! The run: pass after pass until every wanted table is whole, and the views that show them.

use std::collections::BTreeMap;

use super::pass::{self, Pass};
use super::plan::Plan;
use super::progress::Progress;
pub use super::settings::{RunError, Settings};
use crate::store::{Digest, StoreError, TableRecord};

/// What a run did.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Whole tables by view name, those reused included.
    pub tables: BTreeMap<String, TableRecord>,
    /// Headings that were computed.
    pub computed: Vec<String>,
    /// Rows set aside, in all wanted tables.
    pub rejects: u64,
}

/// Runs what the plan wants and does not have. Not to be called from one of rayon's own threads: stages would wait for workers that wait for them.
///
/// # Errors
/// The first failure; parts that were finished before it are kept.
pub fn run(plan: &mut Plan<'_>, settings: &Settings, progress: &Progress) -> Result<Outcome, RunError> {
    let least = settings.least_memory();
    if settings.memory_bytes < least {
        return Err(RunError::Memory { given: settings.memory_bytes, least });
    }
    let mut outcome = Outcome::default();
    let mut content: BTreeMap<(usize, usize), Digest> = BTreeMap::new();
    while let Some(pass) = next_pass(plan) {
        let headings = pass.steps.iter().map(|&step| plan.spec.steps[step].heading.as_str());
        let source = plan.sources.get(&pass.root).filter(|_| pass.steps.contains(&pass.root));
        let bytes = source.map_or(0, |source| pass.parts.iter().map(|&part| source.parts()[part].bytes).sum());
        progress.pass(&headings.clone().collect::<Vec<_>>(), bytes);
        outcome.computed.extend(headings.map(str::to_owned));
        let result = pass::run(plan, &pass, settings, progress);
        if let Some(source) = plan.sources.get(&pass.root).filter(|_| pass.steps.contains(&pass.root)) {
            source
                .close()
                .map_err(|source| RunError::Stage { heading: plan.spec.steps[pass.root].heading.clone(), source })?;
        }
        content.extend(result?.content);
        plan.refresh(&content)?;
        publish(plan, &pass.steps, &mut outcome)?;
    }
    let wanted: Vec<usize> =
        (0..plan.tables.len()).filter(|&i| plan.tables[i].wanted && plan.tables[i].complete()).collect();
    publish(plan, &wanted, &mut outcome)?;
    let rejects: Vec<_> = behind(plan)
        .into_iter()
        .map(|i| (plan.spec.steps[i].heading.as_str(), &plan.tables[i].id, plan.tables[i].present.as_slice()))
        .collect();
    outcome.rejects = plan.shelf.publish_rejects(&rejects)?;
    Ok(outcome)
}

/// The wanted tables and all that they are made from, also where that is not kept: what was set aside on the way is part of the outcome.
fn behind(plan: &Plan<'_>) -> Vec<usize> {
    let mut behind: Vec<bool> = plan.tables.iter().map(|table| table.wanted).collect();
    for i in (0..behind.len()).rev().filter(|&i| plan.tables[i].complete()) {
        if behind[i] {
            plan.from(i).into_iter().chain(plan.beside_steps(i)).for_each(|input| behind[input] = true);
        }
    }
    (0..behind.len()).filter(|&i| behind[i] && plan.tables[i].complete()).collect()
}

fn publish(plan: &Plan<'_>, steps: &[usize], outcome: &mut Outcome) -> Result<(), StoreError> {
    for &i in steps {
        let (step, table) = (&plan.spec.steps[i], &plan.tables[i]);
        if !step.keep || !table.complete() {
            continue;
        }
        let names = step.node.tables();
        let views: Vec<(String, String)> = names
            .into_iter()
            .enumerate()
            .map(|(n, table)| {
                let view = if n == 0 { step.heading.clone() } else { format!("{}.{}", step.heading, table.name) };
                (table.name, view)
            })
            .collect();
        let parts = table.present.iter().flatten().cloned().collect();
        let record = plan.shelf.publish(&table.id, parts, &views)?;
        outcome.tables.insert(step.heading.clone(), record);
    }
    Ok(())
}

/// The next tree of steps that can run: all tables beside them are finished, and their root can be read.
fn next_pass(plan: &Plan<'_>) -> Option<Pass> {
    let missing: Vec<usize> = (0..plan.tables.len()).filter(|&i| plan.tables[i].wanted && !done(plan, i)).collect();
    let first = *missing.iter().find(|&&i| ready(plan, i))?;
    let mut root = first;
    while let Some(from) = plan.from(root) {
        root = from;
        if plan.replayable(root) {
            break;
        }
    }
    // Steps below the root that are missing; the root itself where it is a source.
    let mut steps = Vec::new();
    for i in root..plan.tables.len() {
        let below = plan.from(i).is_some_and(|from| (from == root && plan.replayable(root)) || steps.contains(&from));
        let through = i == root && !plan.replayable(root);
        // A stage that gathers waits for its input to be on the shelf, so that finished parts need not stream again.
        let gathers = !plan.streams(i) && plan.from(i).is_some_and(|from| plan.spec.steps[from].keep && from != root);
        let needed = missing.contains(&i) || (!plan.spec.steps[i].keep && plan.tables[i].wanted);
        if (below || through) && needed && !gathers && ready(plan, i) {
            steps.push(i);
        }
    }
    let count = plan.sources.get(&root).map_or(plan.tables[root].present.len(), |source| source.parts().len());
    let all = steps.iter().any(|&i| !plan.streams(i));
    let lacking =
        |part: usize| all || steps.iter().any(|&i| plan.tables[i].present.get(part).is_none_or(Option::is_none));
    Some(Pass { root, parts: (0..count).filter(|&part| lacking(part)).collect(), steps })
}

/// Whether nothing more is to be done for a step: its table stands, or it is only passed through.
fn done(plan: &Plan<'_>, i: usize) -> bool {
    plan.tables[i].complete() && (plan.spec.steps[i].keep || !consumers_miss(plan, i))
}

/// Whether a consumer of an unkept step still lacks something.
fn consumers_miss(plan: &Plan<'_>, i: usize) -> bool {
    (0..plan.tables.len()).any(|c| plan.tables[c].wanted && plan.from(c) == Some(i) && !plan.tables[c].complete())
}

/// Whether the tables beside a step, and those beside every step between it and a table that can be read, are finished.
fn ready(plan: &Plan<'_>, i: usize) -> bool {
    let beside = plan.beside_steps(i).all(|step| plan.tables[step].complete());
    let above = match plan.from(i) {
        None => true,
        Some(from) => plan.replayable(from) || ready(plan, from),
    };
    beside && above
}
