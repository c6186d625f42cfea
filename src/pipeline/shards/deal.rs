//! Distributes work: which parts must be finished first, and which go into one shard.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::json;

use super::pieces::adder;
use super::{Cut, Job, Shard, Work, make};
use crate::pipeline::plan::{Plan, Scope};
use crate::pipeline::progress::Progress;
use crate::pipeline::settings::{RunError, Settings};
use crate::stages::source::{Piece, Ticket};
use crate::store::{Digest, Shelf, StoreError};

/// Steps whose parts are distributed: those that stream from raw files, except those whose whole tables the others
/// need. Nor those that need a whole table that is made of the same files, since no part of it is there before all are.
fn dealt(plan: &Plan<'_>) -> Vec<usize> {
    let count = plan.tables.len();
    let mut streams = vec![false; count];
    // Of each step the source that it streams from, and all steps that it needs.
    let (mut sources, mut needs): (Vec<usize>, Vec<BTreeSet<usize>>) = (Vec::new(), Vec::new());
    for i in 0..count {
        sources.push(plan.from(i).map_or(i, |from| sources[from]));
        needs.push(plan.inputs(i).into_iter().flat_map(|input| needs[input].iter().copied().chain([input])).collect());
        let waits = plan.beside_steps(i).any(|step| step == sources[i] || needs[step].contains(&sources[i]));
        streams[i] = match plan.from(i) {
            None => plan.sources[&i].parts().is_empty() || plan.sources[&i].ticket(0).is_some(),
            Some(from) => plan.streams(i) && streams[from] && !waits,
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

/// Steps whose whole tables these steps need.
fn beside(plan: &Plan<'_>, steps: &[usize]) -> Vec<usize> {
    let beside: BTreeSet<usize> = steps.iter().flat_map(|&i| plan.beside_steps(i)).collect();
    beside.into_iter().collect()
}

/// Makes the whole tables that the distributed parts need.
///
/// # Errors
/// The first failure, or that it was interrupted; finished parts are kept.
pub fn prepare(plan: &mut Plan<'_>, settings: &Settings, progress: &Progress) -> Result<(), RunError> {
    let beside = beside(plan, &dealt(plan));
    let all = plan.about(Scope::Until(beside));
    make(plan, settings, progress, None)?;
    plan.about(all);
    Ok(())
}

/// The distributed work.
pub struct Dealt {
    /// What all shards have in common.
    pub work: Work,
    /// Shards of whole parts, by key.
    pub shards: Vec<(String, Shard)>,
    /// Shards of divided parts, by key, each with its pieces and their keys; includes finished pieces.
    pub cut: Vec<(String, Shard, Vec<(String, Cut)>)>,
    /// Why parts above a fair share are not divided, each reason once.
    pub uncut: Vec<String>,
}

/// A missing part.
struct Missing {
    source: usize,
    part: usize,
    ticket: Ticket,
}

/// Distributes what is missing over at most `count` shards with about equal raw bytes, in the order of the captures. A
/// part above a fair share is divided between its shots, if possible; the same way as before, if some of those pieces
/// are finished. The plan must be prepared.
///
/// # Errors
/// When the shelf cannot be read.
pub fn deal(plan: &Plan<'_>, common: Work, count: usize) -> Result<Dealt, StoreError> {
    let steps = dealt(plan);
    let heading = |i: usize| plan.spec.steps[i].heading.clone();
    let lineages = |i: usize| plan.tables[i].lineages.iter().copied().flatten().collect();
    let work = Work {
        stages: steps.iter().map(|&i| (heading(i), plan.tables[i].id.clone())).collect(),
        beside: beside(plan, &steps).into_iter().map(|i| (heading(i), lineages(i))).collect(),
        ..common
    };
    let missing = missing(plan, &steps);
    let shard = |parts: &[&Missing]| keyed_shard(plan, &work, parts);
    let Large { mut most, mut uncut } = large(plan, &missing, count);
    let mut cut: BTreeMap<usize, (String, Shard, Vec<(String, Cut)>)> = BTreeMap::new();
    let mut taken = 0;
    // As before, if some of these pieces are finished and the files have not changed.
    for i in most.keys().copied().collect::<Vec<_>>() {
        let (key, shard) = shard(&[&missing[i]]);
        let pieces = earlier(plan.shelf, &key)?;
        let unmade = unmade(plan.shelf, &pieces)?;
        if unmade < pieces.len() && divide(plan, &missing[i], pieces.len(), &key).as_ref() == Ok(&pieces) {
            most.remove(&i);
            taken += unmade;
            cut.insert(i, (key, shard, pieces));
        }
    }
    let bytes = |i: usize| missing[i].ticket.bytes;
    let rest = (0..missing.len()).filter(|i| !cut.contains_key(i) && !most.contains_key(i));
    let wanted: Vec<(u64, usize)> = most.iter().map(|(i, most)| (bytes(*i), *most)).collect();
    let shares = shares(rest.map(bytes).sum(), &wanted, count.saturating_sub(taken));
    for (&i, share) in most.keys().zip(shares).filter(|(_, share)| *share > 1) {
        let (key, shard) = shard(&[&missing[i]]);
        match divide(plan, &missing[i], share, &key) {
            Ok(pieces) if pieces.len() > 1 => {
                taken += pieces.len();
                cut.insert(i, (key, shard, pieces));
            }
            Ok(_) => {}
            Err(why) => uncut.push(why),
        }
    }
    let rest: Vec<&Missing> = (0..missing.len()).filter(|i| !cut.contains_key(i)).map(|i| &missing[i]).collect();
    let bytes: Vec<u64> = rest.iter().map(|missing| missing.ticket.bytes).collect();
    let mut rest = &rest[..];
    let hand = |size| shard(rest.split_off(..size).expect("hands hold no more than there are"));
    let shards = hands(&bytes, count.saturating_sub(taken).max(1)).into_iter().map(hand).collect();
    Ok(Dealt { work: work.clone(), shards, cut: cut.into_values().collect(), uncut })
}

/// A shard of these parts, with its key.
fn keyed_shard(plan: &Plan<'_>, work: &Work, missing: &[&Missing]) -> (String, Shard) {
    let mut parts: BTreeMap<String, Vec<Ticket>> = BTreeMap::new();
    for part in missing {
        let heading = plan.spec.steps[part.source].heading.clone();
        parts.entry(heading).or_default().push(part.ticket.clone());
    }
    let shard = Shard { work: work.clone(), parts };
    (Digest::of(&json!(shard)).short(), shard)
}

/// Divides a part into `count` pieces for the shard with this key; the error says why it cannot be divided.
fn divide(plan: &Plan<'_>, part: &Missing, count: usize, key: &str) -> Result<Vec<(String, Cut)>, String> {
    let source = plan.sources[&part.source].divisible().expect("only parts of divisible sources are large");
    Ok(keyed(key, source.cut(part.part, count)?))
}

/// The parts that lack any of these steps.
fn missing(plan: &Plan<'_>, steps: &[usize]) -> Vec<Missing> {
    let lacks = |source: usize, part: usize| {
        steps.iter().any(|&i| root(plan, i) == source && plan.tables[i].present.get(part).is_none_or(Option::is_none))
    };
    let sources = plan.sources.iter().filter(|(i, _)| steps.iter().any(|&step| root(plan, step) == **i));
    let parts = sources.flat_map(|(&i, source)| (0..source.parts().len()).map(move |part| (i, part)));
    let missing = parts.filter(|&(i, part)| lacks(i, part)).map(|(source, part)| {
        let ticket = plan.sources[&source].ticket(part).expect("only what gives tickets is dealt out");
        Missing { source, part, ticket }
    });
    missing.collect()
}

/// Parts above a fair share, by their number among the missing ones.
struct Large {
    /// Most pieces into which each can be divided.
    most: BTreeMap<usize, usize>,
    /// Why others cannot be divided, each reason once.
    uncut: Vec<String>,
}

fn large(plan: &Plan<'_>, missing: &[Missing], count: usize) -> Large {
    let total: u128 = missing.iter().map(|missing| u128::from(missing.ticket.bytes)).sum();
    let (mut most, mut uncut) = (BTreeMap::new(), BTreeSet::new());
    for (i, Missing { source, part, ticket }) in missing.iter().enumerate() {
        let Some(parts) = plan.sources[source].divisible() else { continue };
        let shares = u128::from(ticket.bytes) * count as u128;
        if shares <= total {
            continue;
        }
        let is_lacking = |step: &usize| plan.tables[*step].present.get(*part).is_none_or(Option::is_none);
        match parts.most_pieces(*part) {
            Ok(0 | 1) => {}
            Ok(pieces) => match adder(plan, *source) {
                // If only later steps are missing, finished rows suffice, and nothing needs to be divided.
                Ok(step) if is_lacking(&step) => _ = most.insert(i, pieces),
                Ok(_) => {}
                // Shards are never quite even, so a reason is reported only for parts of more than twice the share.
                Err(why) => _ = (shares > 2 * total).then(|| uncut.insert(why)),
            },
            Err(why) => _ = (shares > 2 * total).then(|| uncut.insert(why)),
        }
    }
    Large { most, uncut: uncut.into_iter().collect() }
}

/// The pieces into which a part was divided before.
fn earlier(shelf: &Shelf, key: &str) -> Result<Vec<(String, Cut)>, StoreError> {
    let job: Option<Job> = shelf.job().unwrap_or_default();
    let mut pieces = Vec::new();
    for key in job.and_then(|mut job| job.cut.remove(key)).unwrap_or_default() {
        match shelf.cut(&key)? {
            Some(cut) => pieces.push((key, cut)),
            None => return Ok(Vec::new()),
        }
    }
    Ok(pieces)
}

/// Number of these pieces that are not finished.
fn unmade(shelf: &Shelf, pieces: &[(String, Cut)]) -> Result<usize, StoreError> {
    pieces.iter().map(|(key, _)| Ok(usize::from(shelf.piece(key)?.is_none()))).sum()
}

fn keyed(of: &str, pieces: Vec<Piece>) -> Vec<(String, Cut)> {
    let count = pieces.len();
    let cut = |(i, piece)| {
        let cut = Cut { of: of.to_owned(), number: i + 1, count, piece };
        (Digest::of(&json!(cut)).short(), cut)
    };
    pieces.into_iter().enumerate().map(cut).collect()
}

/// How many of `count` workers each large part gets, given its bytes and its most pieces; the remaining parts share the
/// others. The next worker always goes to the largest number of bytes per worker.
fn shares(rest_bytes: u64, large: &[(u64, usize)], count: usize) -> Vec<usize> {
    let mut shares = vec![1; large.len()];
    let mut rest = usize::from(rest_bytes > 0);
    for _ in shares.len() + rest..count {
        let load = |i: usize| large[i].0 / shares[i] as u64;
        let heaviest = (0..large.len()).filter(|&i| shares[i] < large[i].1).max_by_key(|&i| load(i));
        match heaviest {
            Some(i) if rest == 0 || load(i) >= rest_bytes / rest as u64 => shares[i] += 1,
            _ => rest += 1,
        }
    }
    shares
}

/// How many parts each worker gets, given their bytes: in order, at least one, and about an equal share of the
/// remaining bytes.
fn hands(bytes: &[u64], count: usize) -> Vec<usize> {
    let mut hands = Vec::new();
    let (mut parts, mut left) = (bytes, bytes.iter().map(|&bytes| u128::from(bytes)).sum::<u128>());
    for hands_left in (1..=count.min(bytes.len())).rev() {
        let (mut size, mut held) = (1, u128::from(parts[0]));
        // Takes one more part if more than half of it still fits, and every other worker keeps at least one.
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
    fn large_parts_get_hands_by_their_bytes() {
        assert_eq!(shares(0, &[(1000, 99)], 8), [8]);
        assert_eq!(shares(1000, &[(1000, 99)], 8), [4]);
        assert_eq!(shares(100, &[(700, 99), (300, 99)], 11), [7, 3]);
        assert_eq!(shares(100, &[(700, 3), (300, 99)], 11), [3, 6], "a part has so many pieces at most");
        assert_eq!(shares(100, &[(700, 3)], 1), [1]);
        assert_eq!(shares(0, &[(700, 3)], 9), [3]);
    }

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
