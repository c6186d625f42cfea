//! Cuts what a plan lacks into passes: trees of steps that run together below a source or a stored table.
//!
//! A pass makes only what is missing. Where some parts of a table are finished and others not, the parts that lack the same steps make a pass
//! of their own, from the nearest table above them that is on the shelf.

use super::pass::Pass;
use super::plan::Plan;

/// What a tree of steps is to make.
#[derive(Clone, Copy)]
enum At {
    /// This part of all that streams.
    Part(usize),
    /// All parts, so that stages which gather can take part; of what streams, only tables of which no part is finished.
    All,
}

/// A root, and the steps that stream from one another below it; the root is among them where it is a source that is to be read.
type Tree = (usize, Vec<usize>);

/// The next tree of steps that can run: all tables beside them are finished, and their root can be read.
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

/// The nearest table above `first` that can be read, and the steps below it that are to be made and can be.
fn tree(plan: &Plan<'_>, first: usize, at: At) -> Tree {
    let is_stored = |i: usize| match at {
        At::Part(part) => plan.spec.steps[i].keep && !lacks(plan, i, At::Part(part)),
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
        // A stage that gathers waits for its input to be on the shelf, so that finished parts need not stream again.
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
    (root, steps)
}

/// Whether a step's own table lacks this part; all parts, where that is asked of a kept table that streams; any part of another.
fn lacks(plan: &Plan<'_>, i: usize, at: At) -> bool {
    let present = &plan.tables[i].present;
    match at {
        At::Part(part) => present.get(part).is_none_or(Option::is_none),
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

/// Whether anything is missing of a step's table, or of those that need its rows where they are not kept.
fn is_lacking(plan: &Plan<'_>, i: usize) -> bool {
    !plan.tables[i].complete()
        || (!plan.spec.steps[i].keep && consumers(plan, i).any(|consumer| is_lacking(plan, consumer)))
}

/// Whether a step can run now, and something comes of it.
fn is_due(plan: &Plan<'_>, i: usize) -> bool {
    let is_passed = !plan.spec.steps[i].keep && consumers(plan, i).any(|consumer| is_lacking(plan, consumer));
    let has_use =
        if is_passed { consumers(plan, i).any(|consumer| is_due(plan, consumer)) } else { !plan.tables[i].complete() };
    has_use && is_ready(plan, i)
}

/// Whether the tables beside a step, and those beside every step between it and a table that can be read, are finished.
fn is_ready(plan: &Plan<'_>, i: usize) -> bool {
    let beside = plan.beside_steps(i).all(|step| plan.tables[step].complete());
    let above = match plan.from(i) {
        None => true,
        Some(from) => plan.replayable(from) || is_ready(plan, from),
    };
    beside && above
}
