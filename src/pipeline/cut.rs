//! Divides what a plan lacks into passes: trees of steps that run together below a source or a stored table.
//!
//! A pass makes only what is missing. Where some parts of a table are finished, the missing ones are grouped by the
//! steps that they lack. Each group is a pass of its own, from the nearest table above it on the shelf.

use super::pass::Pass;
use super::plan::Plan;

/// What a tree of steps must make.
#[derive(Clone, Copy)]
enum At {
    /// This part of everything that streams.
    Part(usize),
    /// All parts, so that gathering stages can join; of streaming tables, only those without any finished part.
    All,
}

/// A root, and the steps that stream from one another below it. The root is among them if it is a source to be read.
type Tree = (usize, Vec<usize>);

/// The next tree of steps that can run: all whole tables that they need are finished, and the root can be read.
pub fn next_pass(plan: &Plan<'_>) -> Option<Pass> {
    let first = (0..plan.tables.len()).find(|&i| plan.tables[i].wanted && is_due(plan, i))?;
    let (root, steps) = tree(plan, first, At::All);
    let count = parts(plan, root);
    if plan.streams(first) {
        let trees: Vec<Tree> = (0..count).map(|part| tree(plan, first, At::Part(part))).collect();
        let makes = |(_, steps): &Tree| steps.contains(&first) && steps.iter().any(|&i| plan.spec.steps[i].keep);
        if let Some(like) = trees.iter().find(|tree| makes(tree)) {
            let alike: Vec<usize> = (0..count).filter(|&part| trees[part] == *like).collect();
            if alike.len() < count {
                return Some(Pass { root: like.0, steps: like.1.clone(), parts: alike, joined: None });
            }
        }
    }
    let gathers = steps.iter().any(|&i| !plan.streams(i));
    let parts = (0..count).filter(|&part| gathers || steps.iter().any(|&i| lacks(plan, i, At::Part(part)))).collect();
    Some(Pass { root, steps, parts, joined: None })
}

fn parts(plan: &Plan<'_>, i: usize) -> usize {
    plan.sources.get(&i).map_or(plan.tables[i].present.len(), |source| source.parts().len())
}

/// The nearest table above `first` that can be read, and the steps below it that are missing and can run.
fn tree(plan: &Plan<'_>, first: usize, at: At) -> Tree {
    let is_stored = |i: usize| match at {
        At::Part(part) => plan.stands_in(i) && !plan.lacks(i, part),
        At::All => plan.replayable(i),
    };
    let mut root = first;
    while let Some(from) = plan.from(root) {
        root = from;
        if is_stored(root) {
            break;
        }
    }
    let mut taken = vec![false; plan.tables.len()];
    for i in (root..taken.len()).rev() {
        let can_run = plan.tables[i].wanted && is_ready(plan, i) && (plan.streams(i) || matches!(at, At::All));
        // A gathering stage waits until its input is on the shelf, so that finished parts need not stream again.
        let waits = !plan.streams(i) && plan.from(i).is_some_and(|from| plan.spec.steps[from].keep && from != root);
        let is_passed = !plan.spec.steps[i].keep && consumers(plan, i).any(|consumer| is_lacking(plan, consumer));
        let has_use = if is_passed { consumers(plan, i).any(|consumer| taken[consumer]) } else { lacks(plan, i, at) };
        taken[i] = can_run && !waits && has_use;
    }
    let mut steps = Vec::new();
    for i in root..taken.len() {
        let is_read = i == root && !is_stored(i);
        if is_read || (taken[i] && plan.from(i).is_some_and(|from| from == root || steps.contains(&from))) {
            steps.push(i);
        }
    }
    if let At::Part(part) = at
        && steps == [root]
        && plan.spec.steps[root].keep
        && !plan.lacks(root, part)
    {
        // An index that stands, and nothing to be made of its samples.
        steps.clear();
    }
    (root, steps)
}

/// Whether a step's own table lacks this part. For all parts: whether a kept streaming table lacks all of them, or
/// another table any.
fn lacks(plan: &Plan<'_>, i: usize, at: At) -> bool {
    let present = &plan.tables[i].present;
    match at {
        At::Part(part) => plan.lacks(i, part),
        At::All if plan.streams(i) && plan.spec.steps[i].keep => {
            !present.is_empty() && present.iter().all(Option::is_none)
        }
        At::All => !plan.tables[i].complete(),
    }
}

/// Wanted steps that stream from this one.
fn consumers<'a>(plan: &'a Plan<'_>, i: usize) -> impl Iterator<Item = usize> + use<'a> {
    (i + 1..plan.tables.len()).filter(move |&consumer| plan.tables[consumer].wanted && plan.from(consumer) == Some(i))
}

/// Whether a step's table lacks anything, or a table that needs its rows where they are not kept.
fn is_lacking(plan: &Plan<'_>, i: usize) -> bool {
    !plan.tables[i].complete()
        || (!plan.spec.steps[i].keep && consumers(plan, i).any(|consumer| is_lacking(plan, consumer)))
}

/// Whether a step can run now and has a use.
fn is_due(plan: &Plan<'_>, i: usize) -> bool {
    let is_passed = !plan.spec.steps[i].keep && consumers(plan, i).any(|consumer| is_lacking(plan, consumer));
    let has_use =
        if is_passed { consumers(plan, i).any(|consumer| is_due(plan, consumer)) } else { !plan.tables[i].complete() };
    has_use && is_ready(plan, i)
}

/// Whether the whole tables are finished that a step needs, and every step between it and a readable table.
fn is_ready(plan: &Plan<'_>, i: usize) -> bool {
    let beside = plan.beside_steps(i).all(|step| plan.tables[step].complete());
    let above = match plan.from(i) {
        None => true,
        Some(from) => plan.replayable(from) || is_ready(plan, from),
    };
    beside && above
}
