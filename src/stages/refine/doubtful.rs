//! Patches whose own light contradicts their place.
//!
//! From a right place, later light of a patch has paths as that of others has. In a wrong one, such as the mirror image
//! in the plane of its few neighbours, the onsets that placed it are explained as well, but no path explains most later
//! onsets of the profiles in which it is lit or seen. A patch is doubtful if these are without a path more often than
//! those of the other profiles, by more than chance allows. A patch that is dark has few later onsets, and is not.

use std::collections::BTreeSet;

use crate::tables::Label;
use crate::units::PatchId;

/// Chance, at most, that a right patch of a campaign is taken for doubtful.
const BY_CHANCE: f64 = 1e-3;
/// Bounces from which light is later light.
const LATER: usize = 3;

/// Onsets behind first light, with a path and without.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    with: u32,
    without: u32,
}

/// Doubtful ones of some patches, by all labels of a campaign, those without a path among them. None where no later
/// light was labelled.
pub fn doubtful(labels: &[Label], patches: &[PatchId]) -> Vec<PatchId> {
    let best = || labels.iter().filter(|label| label.alternative == 0);
    let bounces = |label: &&Label| label.path.as_ref().map_or(LATER, Vec::len);
    let later: Vec<&Label> = best().filter(|label| bounces(label) >= LATER).collect();
    let count = |counts: &dyn Fn(&Label) -> bool| {
        let mut count = Count::default();
        for label in later.iter().filter(|label| counts(label)) {
            if label.path.is_some() { count.with += 1 } else { count.without += 1 }
        }
        count
    };
    if count(&|_| true).with == 0 {
        return Vec::new();
    }
    let has_end = |label: &Label, patch: PatchId| label.lit == patch || label.seen == patch;
    let ends: BTreeSet<PatchId> = best().flat_map(|label| [label.lit, label.seen]).collect();
    let is_doubtful = |patch: PatchId| {
        let own = count(&|label| has_end(label, patch));
        let others = count(&|label| !has_end(label, patch));
        // As if one more of either kind had been seen, so that few onsets decide nothing.
        let rate = f64::from(others.without + 1) / f64::from(others.with + others.without + 2);
        at_least(own.without, own.with + own.without, rate) < BY_CHANCE / patches.len() as f64
    };
    patches.iter().copied().filter(|patch| ends.contains(patch) && is_doubtful(*patch)).collect()
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

    fn label(lit: PatchId, seen: PatchId, over: Option<PatchId>) -> Label {
        Label { lit, seen, path: over.map(|over| vec![lit, over, seen]), ..Label::default() }
    }

    /// Profiles of four patches, four later onsets each, of which one in four has no path; of those of patch 4 some more.
    fn labels(of_four: usize) -> Vec<Label> {
        let mut labels = Vec::new();
        for (lit, seen) in (1..=4).flat_map(|lit| (1..=4).map(move |seen| (lit, seen))) {
            let without = if lit == 4 || seen == 4 { of_four } else { 1 };
            labels.extend((0..4).map(|n| label(lit, seen, (n >= without).then_some(9))));
        }
        labels
    }

    #[test]
    fn a_patch_is_doubtful_whose_later_light_has_no_path() {
        assert_eq!(doubtful(&labels(4), &[1, 2, 3, 4]), [4]);
        assert!(doubtful(&labels(1), &[1, 2, 3, 4]).is_empty());
        // Where first light alone is labelled, later light tells nothing.
        let first: Vec<Label> = labels(4).into_iter().map(|label| Label { path: None, ..label }).collect();
        assert!(doubtful(&first, &[1, 2, 3, 4]).is_empty());
    }

    #[test]
    fn chances_are_binomial() {
        assert!((at_least(2, 3, 0.5) - 0.5).abs() < 1e-12 && (at_least(0, 3, 0.2) - 1.0).abs() < 1e-12);
        assert!((at_least(3, 3, 0.2) - 0.008).abs() < 1e-12);
    }
}
