//! The run: pass after pass until every wanted table is whole, and the views that show them.

use std::collections::BTreeMap;
use std::time::Instant;

use super::cut::next_pass;
use super::pass::{self, Ended, Pass};
use super::plan::Plan;
use super::progress::{Amount, Progress};
use super::rejects::TooMany;
use super::responses;
pub use super::settings::{RunError, Settings};
use super::timeline::Timeline;
use crate::campaign::LeftOut;
use crate::stages::Node;
use crate::store::runs::PassRecord;
use crate::store::{Digest, StageId, StoreError, TableRecord};
use crate::tables::{Reject, Row};

/// What a run did.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Whole tables by view name, those reused included.
    pub tables: BTreeMap<String, TableRecord>,
    /// Headings that were computed.
    pub computed: Vec<String>,
    /// Rejected rows, in all wanted tables.
    pub rejects: u64,
    /// What the campaigns have and no table is made from.
    pub left_out: Vec<LeftOut>,
    /// Passes that it took.
    pub passes: Vec<PassRecord>,
    /// Everything that its tables are made from, themselves included: stages, with the lineages of their parts.
    pub behind: Vec<(StageId, Vec<Digest>)>,
}

/// Runs what the plan wants and does not have. Not to be called from one of rayon's own threads: stages would wait for
/// workers that wait for them.
///
/// # Errors
/// A response that the campaigns lack, before a record is read; else the first failure, or that the run was stopped:
/// parts that were finished before it are kept.
pub fn run(plan: &mut Plan<'_>, settings: &Settings, progress: &Progress) -> Result<Outcome, RunError> {
    settings.check()?;
    responses::require(plan)?;
    let mut outcome = Outcome::default();
    let most_rejects = settings.max_rejects.map_or(u64::MAX, |limit| limit.most(records(plan)));
    let ended = passes(plan, settings, most_rejects, progress, &mut outcome);
    // Also of a run that failed: what was rejected before is often the cause.
    let tables: Vec<_> = telling(plan)
        .into_iter()
        .map(|i| (plan.spec.steps[i].heading.as_str(), &plan.tables[i].id, plan.tables[i].present.as_slice()))
        .collect();
    let rejects = plan.shelf.publish_rejects(&tables);
    // What stopped it comes first: on a full disk, say, this fails too.
    ended?;
    outcome.rejects = rejects?;
    outcome.left_out = plan.left_out();
    let lineages = |i: usize| plan.tables[i].present.iter().flatten().map(|part| part.lineage).collect();
    outcome.behind = behind(plan).into_iter().map(|i| (plan.tables[i].id.clone(), lineages(i))).collect();
    if outcome.rejects > most_rejects {
        return Err(RunError::Rejects(TooMany::of(plan.shelf, outcome.rejects, most_rejects, records(plan))?));
    }
    Ok(outcome)
}

/// One pass after the other, until all that is wanted is there, or too much was rejected.
fn passes(
    plan: &mut Plan<'_>,
    settings: &Settings,
    most_rejects: u64,
    progress: &Progress,
    outcome: &mut Outcome,
) -> Result<(), RunError> {
    let mut content: BTreeMap<(usize, usize), Digest> = BTreeMap::new();
    while let Some(pass) = next_pass(plan).filter(|_| rejects(plan) <= most_rejects) {
        let headings: Vec<&str> = pass.steps.iter().map(|&step| plan.spec.steps[step].heading.as_str()).collect();
        let (whole, wanted) = whole(plan);
        let amount = amount(plan, &pass);
        progress.pass(&headings, amount, whole, wanted);
        let tables: Vec<String> = headings.iter().map(|heading| (*heading).to_owned()).collect();
        let started = Instant::now();
        for (heading, &step) in headings.into_iter().zip(&pass.steps) {
            // An index whose parts stand is not made anew where its source is read again.
            let makes = !plan.spec.steps[step].keep || step != pass.root;
            if !makes && !pass.parts.iter().any(|&part| plan.lacks(step, part)) {
                continue;
            }
            // A table whose parts lack different steps takes several passes.
            if !outcome.computed.iter().any(|computed| computed == heading) {
                outcome.computed.push(heading.to_owned());
            }
        }
        let allowed = most_rejects - rejects(plan);
        let timeline = settings.timeline.as_deref();
        let ended = Timeline::span(timeline, "passes", &tables.join(", "), || {
            pass::run(plan, &pass, settings, allowed, progress, &mut content)
        });
        let closed =
            plan.sources.get(&pass.root).filter(|_| pass.steps.contains(&pass.root)).map_or(Ok(()), |source| {
                let heading = plan.spec.steps[pass.root].heading.clone();
                source.close().map_err(|source| RunError::Stage { heading, source })
            });
        // What stopped the pass comes first: on a full disk, say, closing fails too.
        let ended = ended?;
        closed?;
        plan.refresh(&content)?;
        publish(plan, &pass.steps, outcome)?;
        let raw_bytes = if let Amount::Bytes(bytes) = amount { bytes } else { 0 };
        outcome.passes.push(PassRecord { tables, raw_bytes, seconds: started.elapsed().as_secs_f64() });
        if ended == Ended::Interrupted {
            return Err(RunError::Interrupted { kept: kept(plan, &pass) });
        }
        if ended == Ended::Whole {
            progress.finish();
        }
    }
    let wanted: Vec<usize> =
        (0..plan.tables.len()).filter(|&i| plan.tables[i].wanted && plan.tables[i].complete()).collect();
    publish(plan, &wanted, outcome)?;
    Ok(())
}

/// The wanted tables and all that they are made from, also where that is not kept: what was rejected on the way is
/// part of the outcome.
fn behind(plan: &Plan<'_>) -> Vec<usize> {
    let mut behind: Vec<bool> = plan.tables.iter().map(|table| table.wanted).collect();
    for i in (0..behind.len()).rev() {
        if behind[i] {
            plan.inputs(i).into_iter().for_each(|input| behind[input] = true);
        }
    }
    (0..behind.len()).filter(|&i| behind[i]).collect()
}

/// Those that tell what was rejected: not what is made from a sample of the captures that another source reads all of.
fn telling(plan: &Plan<'_>) -> Vec<usize> {
    let behind = behind(plan);
    let source = |i: usize| match &plan.spec.steps[i].node {
        Node::Source(source) => Some(source.as_ref()),
        Node::Operator(_) => None,
    };
    let sources: Vec<_> = behind.iter().filter_map(|&i| source(i)).collect();
    let mut is_sample = vec![false; plan.tables.len()];
    for &i in &behind {
        is_sample[i] = match source(i) {
            Some(own) => sources.iter().any(|other| own.is_sample_of(*other)),
            None => plan.from(i).is_some_and(|from| is_sample[from]),
        };
    }
    behind.into_iter().filter(|&i| !is_sample[i]).collect()
}

/// Records that the campaigns have for this run.
fn records(plan: &Plan<'_>) -> u64 {
    let sources = telling(plan).into_iter().filter_map(|i| plan.sources.get(&i));
    sources.flat_map(|source| source.parts()).map(|part| part.records).sum()
}

/// Rejected rows, in the parts that are on the shelf.
fn rejects(plan: &Plan<'_>) -> u64 {
    let parts = telling(plan).into_iter().flat_map(|i| plan.tables[i].present.iter().flatten());
    parts.filter_map(|part| part.files.get(Reject::TABLE)).map(|file| file.rows).sum()
}

/// What a pass reads: raw files, or a stored table.
pub(super) fn amount(plan: &Plan<'_>, pass: &Pass) -> Amount {
    if let Some(source) = plan.sources.get(&pass.root).filter(|_| pass.steps.contains(&pass.root)) {
        return Amount::Bytes(pass.parts.iter().map(|&part| source.parts()[part].bytes).sum());
    }
    let table = &plan.stored_tables(pass.root)[0].0;
    let parts = pass.parts.iter().filter_map(|&part| plan.tables[pass.root].present[part].as_ref());
    Amount::Rows(parts.filter_map(|part| part.files.get(table)).map(|file| file.rows).sum())
}

/// How many of the wanted tables are whole, and how many they are.
pub(super) fn whole(plan: &Plan<'_>) -> (usize, usize) {
    let wanted = || plan.tables.iter().zip(&plan.spec.steps).filter(|(table, step)| table.wanted && step.keep);
    (wanted().filter(|(table, _)| table.complete()).count(), wanted().count())
}

/// What an interrupted run leaves, in words.
pub(super) fn kept(plan: &Plan<'_>, pass: &Pass) -> String {
    let (whole, wanted) = whole(plan);
    let mut kept = vec![format!("{whole} of {wanted} tables")];
    for &i in &pass.steps {
        let (parts, heading) = (&plan.tables[i].present, &plan.spec.steps[i].heading);
        let finished = parts.iter().flatten().count();
        if plan.spec.steps[i].keep && finished > 0 && finished < parts.len() {
            kept.push(format!("{finished} of {} parts of {heading}", parts.len()));
        }
    }
    let last = kept.pop().expect("the tables stand first");
    if kept.is_empty() { last } else { format!("{} and {last}", kept.join(", ")) }
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
