//! Where a patch may be: the best points of a grid.
//!
//! Noise makes every profile's best score within the reach of a large cube as good as that of a patch. So bounds over
//! cubes rule out nothing before the cubes are as small as the response is short. A grid of points as dense is as good,
//! and needs no bounds.
//!
//! Of many pairs the first few judge all points, and further ones only those that are left (successive rejects): a
//! patch that all pairs together show at 6 standard deviations is among the best tenth of the first 64 of 300 pairs in
//! 19 of 20 cases.

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::likelihood::searched;
use super::{Profile, Room};
use crate::Point;
use crate::hidden::search::Domain;

/// Distance of two points, as a share of the response's length: no place is further from one than scores remember.
pub(super) const STEP: f64 = 0.5;
/// Signal-to-noise ratio of the pulses that are looked for. Factors spread over a decade, so that it stands for weaker
/// and stronger ones.
const SEARCHED: f64 = 1.2;
/// No sum below this is a patch.
const LEAST: f32 = 5.0;
/// Pairs of the first round; each further round has so many times as many as all before.
const FIRST_PAIRS: usize = 64;
const MORE: usize = 8;
/// One point in so many is left after a round.
const LEFT: usize = 10;
/// One point in so many shows which sum a tenth of them exceeds.
const SAMPLED: usize = 61;

/// Profiles between the same two foci, as one curve: the sum of their log-likelihood ratios by length.
struct Pair {
    foci: [usize; 2],
    /// Length at the first value, and values in a metre.
    low_m: f32,
    per_m: f32,
    values: Vec<f32>,
    /// Number of the profiles.
    profiles: u32,
}

/// A point of the grid under way.
#[derive(Clone, Copy)]
struct Candidate {
    point: Point,
    sum: f32,
    /// Profiles so far that could have recorded a patch here.
    recorded: u32,
}

/// The points with the largest sums of log-likelihood ratios, `most` of them, best first, among those that more than
/// half of the profiles could have recorded.
pub(super) fn candidates(profiles: &[Profile], room: &Room, domain: &Domain, most: usize) -> Vec<Point> {
    let pairs = pairs(profiles, &room.cancel);
    let step_m = STEP * room.width_m;
    let side = (domain.half_m / step_m) as i32;
    let depth = if room.dimensions == 2 { 0 } else { side };
    let points = |i: i32| {
        let steps = (-side..=side).flat_map(move |j| (-depth..=depth).map(move |k| [i, j, k].map(f64::from)));
        steps.map(|steps| domain.centre + Vector3::from(steps) * step_m)
    };
    let (first, mut rest) = pairs.split_at(pairs.len().min(FIRST_PAIRS));
    let in_first: u32 = first.iter().map(|pair| pair.profiles).sum();
    let begun = |legs: &mut Vec<f32>, point: Point| {
        room.cancel.check();
        let candidate = Candidate { point, sum: 0.0, recorded: 0 }.with(first, room, legs);
        // Which profiles record a point is not quite the same in all pairs.
        let is_recorded = if rest.is_empty() {
            2 * candidate.recorded as usize > profiles.len()
        } else {
            5 * candidate.recorded > 2 * in_first
        };
        is_recorded.then_some(candidate)
    };
    let least = if rest.is_empty() {
        LEAST
    } else {
        let sample = |i: i32| {
            let mut legs = Vec::new();
            let some = points(i).skip((i + side) as usize % SAMPLED).step_by(SAMPLED);
            some.filter_map(|point| begun(&mut legs, point)).map(|candidate| candidate.sum).collect::<Vec<f32>>()
        };
        tenth((-side..=side).into_par_iter().flat_map_iter(sample).collect())
    };
    let plane = |i: i32| {
        let mut legs = Vec::new();
        points(i)
            .filter_map(|point| begun(&mut legs, point).filter(|candidate| candidate.sum > least))
            .collect::<Vec<_>>()
    };
    let mut left: Vec<Candidate> = (-side..=side).into_par_iter().flat_map_iter(plane).collect();
    let mut count = first.len();
    while !rest.is_empty() {
        let (next, later) = rest.split_at(rest.len().min(count * (MORE - 1)));
        let further = |candidate: &mut Candidate| {
            room.cancel.check();
            *candidate = candidate.with(next, room, &mut Vec::new());
        };
        left.par_iter_mut().for_each(further);
        if !later.is_empty() {
            let least = tenth(left.iter().map(|candidate| candidate.sum).collect());
            left.retain(|candidate| candidate.sum > least);
        }
        (rest, count) = (later, count + next.len());
    }
    left.retain(|candidate| 2 * candidate.recorded as usize > profiles.len() && candidate.sum > LEAST);
    left.sort_by(|a, b| b.sum.total_cmp(&a.sum));
    left.into_iter().take(most).map(|candidate| candidate.point).collect()
}

/// The value that one in [`LEFT`] exceeds.
fn tenth(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return f32::NEG_INFINITY;
    }
    let at = values.len() - 1 - values.len() / LEFT;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

impl Candidate {
    /// With more pairs. `legs`: room for the distances from the foci.
    fn with(mut self, pairs: &[Pair], room: &Room, legs: &mut Vec<f32>) -> Self {
        legs.clear();
        // No length over a focus that the point does not face lies on a curve.
        let leg = |focus: &crate::hidden::Focus| {
            if focus.faces(self.point, 0.0) { (self.point - focus.point).norm() as f32 } else { f32::NEG_INFINITY }
        };
        legs.extend(room.foci.iter().map(leg));
        for pair in pairs {
            let length_m = legs[pair.foci[0]] + legs[pair.foci[1]];
            let place = (length_m - pair.low_m) * pair.per_m + 0.5;
            if place >= 0.0
                && let Some(value) = pair.values.get(place as usize)
            {
                self.sum += value;
                self.recorded += pair.profiles;
            }
        }
        self
    }
}

/// Profiles by their foci, in an order in which neighbours differ in both.
fn pairs(profiles: &[Profile], cancel: &Cancel) -> Vec<Pair> {
    let mut pairs: std::collections::BTreeMap<[usize; 2], Vec<Pair>> = std::collections::BTreeMap::new();
    for (profile, curve) in profiles.iter().zip(searched(profiles, SEARCHED, cancel)) {
        let foci = [profile.foci[0].min(profile.foci[1]), profile.foci[0].max(profile.foci[1])];
        let between = pairs.entry(foci).or_default();
        let (low_m, per_m) = (curve.low_m as f32, (1.0 / curve.step_m) as f32);
        let is_alike =
            |pair: &&mut Pair| (pair.low_m, pair.per_m, pair.values.len()) == (low_m, per_m, curve.values.len());
        match between.iter_mut().find(is_alike) {
            Some(pair) => {
                pair.values.iter_mut().zip(&curve.values).for_each(|(sum, value)| *sum += value);
                pair.profiles += 1;
            }
            None => between.push(Pair { foci, low_m, per_m, values: curve.values, profiles: 1 }),
        }
    }
    // Multiples of the golden section lie evenly, however many there are.
    let section = 0.5 * (5.0_f64.sqrt() - 1.0);
    let mut pairs: Vec<(f64, Pair)> =
        pairs.into_values().flatten().enumerate().map(|(n, pair)| ((n as f64 * section).fract(), pair)).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    pairs.into_iter().map(|(_, pair)| pair).collect()
}
