//! Other positions that explain the lengths about as well.

use super::{Measurements, STEPS, State};
use crate::Point;
use crate::maximum_likelihood::Problem;

/// A solution whose loss is higher by less than this (a log-likelihood ratio of 9) cannot be ruled out.
const MORE: f64 = 18.0;

/// How another solution differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// All patches lie mirrored in a plane near the stations, anchors and rays.
    Mirror,
    /// A patch or a group of patches lies at a second place, the others settled with it.
    Flip,
}

/// Another solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternative {
    /// How it differs.
    pub kind: Kind,
    /// Patches that lie elsewhere.
    pub patches: Vec<usize>,
    /// All positions.
    pub points: Vec<Point>,
    /// By how much the loss is higher; minus twice the logarithm of the likelihood ratio.
    pub more: f64,
}

/// Other solutions near in likelihood to the one at `points`, likeliest first. Where stations, anchors and rays leave a
/// rotation free, the mirror image of the whole is a convention as the rotation is, and no alternative. Nor is another
/// place of a patch in `open`: nothing determines these, so that they have any number of places.
///
/// # Panics
/// As [`super::place`], and when there are not as many points as patches.
#[must_use]
pub fn alternatives(problem: &Problem, points: &[Point], open: &[usize]) -> Vec<Alternative> {
    assert!(points.len() == problem.start.len(), "{} points, {} patches", points.len(), problem.start.len());
    let measurements = Measurements { open: open.to_vec(), ..Measurements::new(problem) };
    let best = measurements.settle(points.iter().copied().map(Some).collect(), STEPS);
    let mirrored = measurements.mirrored(&best).map(|state| (Kind::Mirror, state));
    let flips = measurements.moves(&best).into_iter().filter_map(|(patch, point)| {
        let flipped = measurements.moved(&best, patch, point);
        measurements.elsewhere(&flipped, &best).contains(&patch).then_some((Kind::Flip, flipped))
    });
    let folds = measurements.all_folded(&best).into_iter().map(|places| measurements.settle(places, STEPS));
    let mut states: Vec<(Kind, State)> = mirrored.into_iter().chain(flips).collect();
    for state in folds.chain(measurements.restarted(&best, MORE)) {
        let is_new = |old: &State| !measurements.elsewhere(&state, old).is_empty();
        if is_new(&best) && states.iter().all(|(_, old)| is_new(old)) {
            states.push((Kind::Flip, state));
        }
    }
    let alternative = |(kind, state): (Kind, State)| Alternative {
        kind,
        patches: measurements.elsewhere(&state, &best),
        points: state.points(),
        more: state.loss - best.loss,
    };
    let mut alternatives: Vec<Alternative> = states.into_iter().map(alternative).collect();
    alternatives.retain(|alternative| alternative.more < MORE && !alternative.patches.is_empty());
    // Groups of few patches first: of equal likelihood, they are what the onsets leave open.
    alternatives.sort_by(|a, b| a.patches.len().cmp(&b.patches.len()).then_with(|| a.patches.cmp(&b.patches)));
    alternatives.sort_by(|a, b| (a.more - 1.0).max(0.0).total_cmp(&(b.more - 1.0).max(0.0)));
    alternatives
}

impl Measurements<'_> {
    /// Patches whose places differ.
    pub(super) fn elsewhere(&self, a: &State, b: &State) -> Vec<usize> {
        let places = a.points().into_iter().zip(b.points()).enumerate();
        let differ = places.filter(|(patch, (a, b))| (a - b).norm() > self.apart_m && !self.open.contains(patch));
        differ.map(|(patch, _)| patch).collect()
    }
}
