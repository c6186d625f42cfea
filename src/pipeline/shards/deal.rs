//! Dealing out: which parts wait for one another, and which go into one shard.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::json;

use super::{Shard, Work, make};
use crate::pipeline::plan::{Plan, Scope};
use crate::pipeline::progress::Progress;
use crate::pipeline::settings::{RunError, Settings};
use crate::stages::source::Ticket;
use crate::store::Digest;

/// Steps whose parts are dealt out: those that stream from raw files, but for what the others stand beside.
fn dealt(plan: &Plan<'_>) -> Vec<usize> {
    let count = plan.tables.len();
    let mut streams = vec![false; count];
    for i in 0..count {
        streams[i] = match plan.from(i) {
            None => plan.sources[&i].parts().is_empty() || plan.sources[&i].ticket(0).is_some(),
            Some(from) => plan.streams(i) && streams[from],
        };
    }
    let mut is_beside = vec![false; count];
    for i in (0..count).rev() {
        if is_beside[i] {
            plan.inputs(i).into_iter().for_each(|input| is_beside[input] = true);
        } else if streams[i] && plan.tables[i].wanted {
            plan.beside_steps(i).for_each(|step| is_beside[step] = true);
        }
    }
    (0..count).filter(|&i| streams[i] && plan.tables[i].wanted && !is_beside[i]).collect()
}

/// Steps whose whole tables stand beside these.
fn beside(plan: &Plan<'_>, steps: &[usize]) -> Vec<usize> {
    let beside: BTreeSet<usize> = steps.iter().flat_map(|&i| plan.beside_steps(i)).collect();
    beside.into_iter().collect()
}

/// Makes whole what the parts that are to be dealt out stand beside.
///
/// # Errors
/// The first failure, or that it was stopped; finished parts are kept.
pub fn prepare(plan: &mut Plan<'_>, settings: &Settings, progress: &Progress) -> Result<(), RunError> {
    let beside = beside(plan, &dealt(plan));
    let all = plan.about(Scope::Until(beside));
    make(plan, settings, progress)?;
    plan.about(all);
    Ok(())
}

/// Deals what is missing out in at most `count` shards of about as many raw bytes, in the order of the captures; gives what they have in common, completed,
/// and the shards by key. The plan is to be prepared.
#[must_use]
pub fn deal(plan: &Plan<'_>, common: Work, count: usize) -> (Work, Vec<(String, Shard)>) {
    let steps = dealt(plan);
    let heading = |i: usize| plan.spec.steps[i].heading.clone();
    let lineages = |i: usize| plan.tables[i].lineages.iter().copied().flatten().collect();
    let work = Work {
        stages: steps.iter().map(|&i| (heading(i), plan.tables[i].id.clone())).collect(),
        beside: beside(plan, &steps).into_iter().map(|i| (heading(i), lineages(i))).collect(),
        ..common
    };
    let lacks = |source: usize, part: usize| {
        steps.iter().any(|&i| root(plan, i) == source && plan.tables[i].present.get(part).is_none_or(Option::is_none))
    };
    let sources = plan.sources.iter().filter(|(i, _)| steps.iter().any(|&step| root(plan, step) == **i));
    let parts = sources.flat_map(|(&i, source)| (0..source.parts().len()).map(move |part| (i, part)));
    let missing: Vec<(usize, Ticket)> = parts
        .filter(|&(i, part)| lacks(i, part))
        .map(|(i, part)| (i, plan.sources[&i].ticket(part).expect("only what gives tickets is dealt out")))
        .collect();
    let shard = |parts| {
        let shard = Shard { work: work.clone(), parts };
        (Digest::of(&json!(shard)).short(), shard)
    };
    let hands = hands(&missing.iter().map(|(_, ticket)| ticket.bytes).collect::<Vec<_>>(), count);
    let mut missing = missing.into_iter();
    let hand = |size| {
        let mut parts: BTreeMap<String, Vec<Ticket>> = BTreeMap::new();
        missing.by_ref().take(size).for_each(|(i, ticket)| parts.entry(heading(i)).or_default().push(ticket));
        shard(parts)
    };
    let shards = hands.into_iter().map(hand).collect();
    (work, shards)
}

/// How many parts each hand gets, of parts of so many bytes: in order, at least one, and about as many bytes as are left for each hand that is left.
fn hands(bytes: &[u64], count: usize) -> Vec<usize> {
    let mut hands = Vec::new();
    let (mut parts, mut left) = (bytes, bytes.iter().map(|&bytes| u128::from(bytes)).sum::<u128>());
    for hands_left in (1..=count.min(bytes.len())).rev() {
        let (mut size, mut held) = (1, u128::from(parts[0]));
        // One part more where more than half of it still fits, and each of the other hands keeps one.
        while parts.len() - size >= hands_left
            && (hands_left == 1 || (2 * held + u128::from(parts[size])) * hands_left as u128 <= 2 * left)
        {
            held += u128::from(parts[size]);
            size += 1;
        }
        hands.push(size);
        (parts, left) = (&parts[size..], left - held);
    }
    hands
}

/// The source that step `i` streams from.
fn root(plan: &Plan<'_>, i: usize) -> usize {
    std::iter::successors(Some(i), |&i| plan.from(i)).last().expect("the step itself")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_hand_gets_a_part_and_about_as_many_bytes_as_the_others() {
        assert_eq!(hands(&[], 3), [] as [usize; 0]);
        assert_eq!(hands(&[5, 0, 7], 8), [1, 1, 1]);
        assert_eq!(hands(&[1; 12], 4), [3; 4]);
        assert_eq!(hands(&[0; 4], 2), [3, 1], "without bytes nothing is even, and all is dealt out");
        assert_eq!(hands(&[90, 1, 1, 1, 1, 1, 1], 4), [1, 2, 2, 2], "a large part alone");
        for (parts, count) in [(1000, 7), (29, 28), (64, 9)] {
            let bytes: Vec<u64> = (0..parts).map(|i| 50 + (i * 7919) % 100).collect();
            let hands = hands(&bytes, count);
            assert!(hands.len() == count && hands.iter().sum::<usize>() == bytes.len());
            let mut rest = &bytes[..];
            let held = hands.iter().map(|&size| rest.split_off(..size).unwrap().iter().sum::<u64>());
            let held: Vec<u64> = held.collect();
            let fair = bytes.iter().sum::<u64>() / count as u64;
            assert!(held.iter().all(|held| held.abs_diff(fair) <= 150), "{held:?} {fair}");
        }
    }
}
