//! Patches whose own light contradicts their place.
//!
//! From a right place, later light of a patch has paths as that of others has. In a wrong one, such as the mirror image
//! in the plane of its few neighbours, the onsets that placed it are explained as well, but no path explains most later
//! onsets of the profiles in which it is lit or seen. A patch is doubtful if these are without a path more often than
//! those of the other profiles, by more than chance allows. A patch that is dark has few later onsets, and is not.
//!
//! If all is wrong, no patch differs from the others. So where less than half of the later light that the placed
//! patches would make has a path, all patches are doubtful that too few others check.

use std::collections::{BTreeMap, BTreeSet};

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::maximum_likelihood::Solution;
use crate::tables::Label;
use crate::units::PatchId;

/// Chance, at most, that a right patch of a campaign is taken for doubtful.
const BY_CHANCE: f64 = 1e-3;
/// Bounces from which light is later light.
const LATER: usize = 3;
/// Least share of later light with a path, of what placed patches would make.
const EXPLAINED: f64 = 0.5;
/// A patch with light from more others than this is checked by these.
const FEW: usize = 4;

/// Places that differ by more of their standard deviations are different.
const ELSEWHERE: f64 = 3.0;

/// Patches that stand elsewhere in a solution with all onsets, by their positions among the unknowns. What counts is
/// their distance from the others, the middle one of all, so that one patch does not move those beside it.
pub fn contested(solution: &Solution, with_all: &[Point], cancel: &Cancel) -> Vec<usize> {
    let points = &solution.points;
    let is_elsewhere = |&place: &usize| {
        cancel.check();
        let others = (0..points.len()).filter(|other| *other != place);
        let apart_m = |points: &[Point], other: usize| (points[place] - points[other]).norm();
        let mut changes_m: Vec<f64> =
            others.map(|other| (apart_m(points, other) - apart_m(with_all, other)).abs()).collect();
        if changes_m.is_empty() {
            return false;
        }
        let middle = changes_m.len() / 2;
        let change_m = *changes_m.select_nth_unstable_by(middle, f64::total_cmp).1;
        let sd_m = (solution.misfit * solution.patch_covariance_m2(place, place).trace().max(0.0)).sqrt();
        change_m > ELSEWHERE * sd_m
    };
    let unplaced = solution.unplaced();
    (0..points.len()).filter(|place| !unplaced.contains(place)).filter(is_elsewhere).collect()
}

/// Onsets behind first light, and who has direct light from whom.
pub struct Later {
    /// Lit and seen patch, and whether the onset has a path.
    onsets: Vec<(PatchId, PatchId, bool)>,
    neighbours: BTreeMap<PatchId, BTreeSet<PatchId>>,
}

impl Later {
    /// By all labels of a campaign, those without a path among them.
    pub fn new(labels: &[Label]) -> Self {
        let (mut onsets, mut neighbours) = (Vec::new(), BTreeMap::<PatchId, BTreeSet<PatchId>>::new());
        for Label { lit, seen, path, .. } in labels.iter().filter(|label| label.alternative == 0) {
            let ends = neighbours.entry(*lit).or_default();
            if path.as_ref().is_none_or(|path| path.len() >= LATER) {
                onsets.push((*lit, *seen, path.is_some()));
            } else {
                ends.insert(*seen);
                neighbours.entry(*seen).or_default().insert(*lit);
            }
            neighbours.entry(*seen).or_default();
        }
        for (patch, others) in &mut neighbours {
            others.remove(patch);
        }
        Self { onsets, neighbours }
    }

    /// Doubtful patches, of those that are lit or seen and not `unplaced`. None where no later light was labelled.
    pub fn doubtful(&self, unplaced: &[PatchId]) -> Vec<PatchId> {
        let placed: Vec<PatchId> = self.neighbours.keys().copied().filter(|patch| !unplaced.contains(patch)).collect();
        if !self.onsets.iter().any(|(_, _, has_path)| *has_path) {
            return Vec::new();
        }
        let is_all_wrong = self.is_all_wrong(&placed);
        let is_doubtful = |patch: &PatchId| {
            let has_end = |(lit, seen): (PatchId, PatchId)| lit == *patch || seen == *patch;
            let [without, with] = self.count(has_end);
            let of_others = self.count(|ends| !has_end(ends));
            // As if one more of either kind had been seen, so that few onsets decide nothing.
            let rate = f64::from(of_others[0] + 1) / f64::from(of_others[0] + of_others[1] + 2);
            let chance = at_least(without, without + with, rate);
            chance < BY_CHANCE / placed.len() as f64 || is_all_wrong && self.neighbours[patch].len() <= FEW
        };
        placed.iter().copied().filter(is_doubtful).collect()
    }

    /// Whether less later light among the placed patches has a path than they would make.
    fn is_all_wrong(&self, placed: &[PatchId]) -> bool {
        let [without, with] = self.count(|(lit, seen)| placed.contains(&lit) && placed.contains(&seen));
        // Lit and seen patch apart, others make the light.
        let others = |patches: usize| patches.saturating_sub(2) as f64;
        let rate = 1.0 - EXPLAINED * others(placed.len()) / others(self.neighbours.len()).max(1.0);
        at_least(without, without + with, rate) < BY_CHANCE
    }

    /// Onsets without a path and with one, of profiles with some ends.
    fn count(&self, counts: impl Fn((PatchId, PatchId)) -> bool) -> [u32; 2] {
        let of_ends = self.onsets.iter().filter(|(lit, seen, _)| counts((*lit, *seen)));
        of_ends.fold([0, 0], |[without, with], (_, _, has_path)| {
            [without + u32::from(!has_path), with + u32::from(*has_path)]
        })
    }
}

/// Chance that as many of `of` or more happen, each at this rate.
fn at_least(hits: u32, of: u32, rate: f64) -> f64 {
    let mut log_term = f64::from(of) * (1.0 - rate).ln();
    let mut below = 0.0;
    for n in 0..hits {
        below += log_term.exp();
        log_term += (f64::from(of - n) / f64::from(n + 1) * rate / (1.0 - rate)).ln();
    }
    1.0 - below
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(lit: PatchId, seen: PatchId, path: Option<&[PatchId]>) -> Label {
        Label { lit, seen, path: path.map(<[PatchId]>::to_vec), ..Label::default() }
    }

    /// Profiles of four patches, four later onsets each, of which `without[0]` have no path; in those of patch 4
    /// `without[1]`.
    fn later(without: [usize; 2]) -> Vec<Label> {
        let mut labels = Vec::new();
        for (lit, seen) in (1..=4).flat_map(|lit| (1..=4).map(move |seen| (lit, seen))) {
            labels.push(label(lit, seen, Some(if lit == seen { &[1][..] } else { &[1, 2] })));
            let without = without[usize::from(lit == 4 || seen == 4)];
            labels.extend((0..4).map(|n| label(lit, seen, (n >= without).then_some(&[1, 9, 2][..]))));
        }
        labels
    }

    #[test]
    fn a_patch_is_doubtful_whose_later_light_has_no_path() {
        assert_eq!(Later::new(&later([1, 4])).doubtful(&[]), [4]);
        assert!(Later::new(&later([1, 4])).doubtful(&[4]).is_empty());
        assert!(Later::new(&later([1, 1])).doubtful(&[]).is_empty());
        // Where first light alone is labelled, later light tells nothing.
        assert!(Later::new(&later([4, 4])).doubtful(&[]).is_empty());
    }

    #[test]
    fn where_most_later_light_has_no_path_all_are_doubtful_that_few_others_check() {
        let mut labels = later([3, 3]);
        assert_eq!(Later::new(&labels).doubtful(&[]), [1, 2, 3, 4]);
        labels.extend((5..=9).map(|seen| label(1, seen, Some(&[1, 2]))));
        assert_eq!(Later::new(&labels).doubtful(&[])[..2], [2, 3]);
        // What patches without a place make has no path.
        assert!(Later::new(&labels).doubtful(&[4, 5, 6, 7, 8, 9]).is_empty());
    }

    #[test]
    fn chances_are_binomial() {
        assert!((at_least(2, 3, 0.5) - 0.5).abs() < 1e-12 && (at_least(0, 3, 0.2) - 1.0).abs() < 1e-12);
        assert!((at_least(3, 3, 0.2) - 0.008).abs() < 1e-12);
    }
}
