//! Where in space a sum of functions of path lengths is large: branch and bound over an octree (in flatland a
//! quadtree).
//!
//! The sum is a log-likelihood ratio `L(q) = sum_ab l_ab(|q - a| + |q - b|)`. Within a cube of half diagonal r a path
//! over q changes by at most 2 r. Each curve is replaced by its maximum over that reach; the sum at the centre then
//! bounds the sum everywhere in the cube. Cubes whose bound is too low are dropped, the others cut. Nothing is sampled,
//! and nothing is missed with two exceptions. A place right behind the plane of one wall may be given up with what lies
//! before it. And the sum over curves ends early once it is below `-SURE`. A true patch's sum comes that low on its way
//! with a probability of `exp(-SURE)` at most (Ville's inequality: under a true patch `exp(-L)` of the curves so far is
//! a martingale of mean 1, and a bound lies above it).

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Focus;
use crate::Point;

/// Partial sums below minus this are given up.
const SURE: f32 = 14.0;
/// Cubes that one task cuts.
const CHUNK: usize = 256;

/// A function of a path's length.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Length at the first value.
    pub low_m: f64,
    /// Distance of two values.
    pub step_m: f64,
    /// Values; beyond them the curve is 0.
    pub values: Vec<f32>,
}

impl Curve {
    /// At least the largest value within `reach_m` of each length, on steps of about half of that. Windows begin and
    /// end on blocks of an eighth of a step.
    fn widened(&self, reach_m: f64) -> Self {
        let bins = ((0.5 * reach_m / self.step_m).floor() as usize).max(1);
        let block = (bins / 8).max(1);
        let bins = bins / block * block;
        let reach = (reach_m / self.step_m).ceil() as usize + 1;
        let largest = |values: &[f32]| values.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a });
        let blocks: Vec<f32> = self.values.chunks(block).map(largest).collect();
        // One bin covers the lengths from its first value up to the next bin's; bins begin early enough for the reach.
        let before = reach.div_ceil(bins) * bins;
        let count = (before + self.values.len() + reach).div_ceil(bins);
        let values = (0..count).map(|bin| {
            // Both ends counted from `before` values in front of the curve, where all is 0.
            let (first, last) = (bin * bins, (bin + 1) * bins + reach);
            let from = first.saturating_sub(before + reach) / block;
            let to = (last.saturating_sub(before) / block + 1).min(blocks.len());
            let is_inside = first >= before + reach && last < before + self.values.len();
            let inside = if last < before { f32::NEG_INFINITY } else { largest(&blocks[from.min(to)..to]) };
            if is_inside { inside } else { inside.max(0.0) }
        });
        Self {
            low_m: self.low_m - before as f64 * self.step_m,
            step_m: bins as f64 * self.step_m,
            values: values.collect(),
        }
    }
}

/// Paths that come from one point and go on to another, and what a length of theirs is worth.
#[derive(Clone, Debug, PartialEq)]
pub struct Legs {
    /// Positions of both points among the foci, the smaller first.
    pub foci: [usize; 2],
    /// Profiles that the curve stands for.
    pub profiles: usize,
    /// Log-likelihood ratio by length.
    pub curve: Curve,
}

/// The same for a cube: the largest value over its reach.
struct Wide {
    foci: [usize; 2],
    profiles: usize,
    low_m: f64,
    /// Values per metre.
    per_m: f64,
    values: Vec<f32>,
}

impl Wide {
    fn new(legs: &Legs, reach_m: f64) -> Self {
        let Curve { low_m, step_m, values } = legs.curve.widened(reach_m);
        Self { foci: legs.foci, profiles: legs.profiles, low_m, per_m: 1.0 / step_m, values }
    }

    fn value(&self, length_m: f64) -> f32 {
        let bin = (length_m - self.low_m) * self.per_m;
        // A negative bin becomes one that is not there.
        if bin >= 0.0 { self.values.get(bin as usize).copied().unwrap_or(0.0) } else { 0.0 }
    }
}

/// Part of space: a cube.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    /// Middle of the cube.
    pub centre: Point,
    /// Half an edge.
    pub half_m: f64,
    /// 3, or 2 for flatland, where z stays that of the centre.
    pub dimensions: usize,
}

impl Domain {
    /// Whether a point, or one nearer to it than `slack_m`, may lie in it.
    #[must_use]
    pub fn holds(&self, point: Point, slack_m: f64) -> bool {
        let reach_m = self.half_m + slack_m;
        (0..self.dimensions).all(|k| (point[k] - self.centre[k]).abs() <= reach_m)
    }

    fn half_diagonal_m(&self) -> f64 {
        self.half_m * (self.dimensions as f64).sqrt()
    }
}

/// Centres of cubes with a half diagonal of at most `fine_m` in which the sum may exceed `least`, with the bound of
/// each, best first. Places that half of the profiles cannot have seen, since they lie behind a wall, do not count.
#[must_use]
pub fn search(
    foci: &[Focus],
    legs: &[Legs],
    domain: &Domain,
    fine_m: f64,
    least: f32,
    cancel: &Cancel,
) -> Vec<(Point, f32)> {
    // Paths among few foci first: early ends need few distances.
    let mut order: Vec<&Legs> = legs.iter().collect();
    order.sort_by_key(|legs| (legs.foci[1], legs.foci[0]));
    let mut cubes = vec![(domain.centre, 0.0_f32)];
    let profiles: usize = legs.iter().map(|legs| legs.profiles).sum();
    let (mut radius_m, mut half_m) = (domain.half_diagonal_m(), domain.half_m);
    loop {
        let level: Vec<Wide> = order.par_iter().map(|legs| Wide::new(legs, 2.0 * radius_m)).collect();
        let is_last = radius_m <= fine_m;
        let cut = |chunk: &[(Point, f32)]| -> Vec<(Point, f32)> {
            cancel.check();
            let mut distances_m = vec![None; foci.len()];
            let bound = |cube: &(Point, f32)| {
                Some((cube.0, bound(&level, profiles.div_ceil(2), foci, cube.0, radius_m, &mut distances_m)?))
            };
            let kept = chunk.iter().filter(|cube| domain.holds(cube.0, radius_m)).filter_map(bound);
            let kept = kept.filter(|(_, bound)| *bound > least);
            if is_last {
                kept.collect()
            } else {
                kept.flat_map(|cube| children(cube.0, half_m, domain.dimensions)).collect()
            }
        };
        cubes = cubes.par_chunks(CHUNK).flat_map_iter(cut).collect();
        if is_last || cubes.is_empty() {
            break;
        }
        radius_m /= 2.0;
        half_m /= 2.0;
    }
    cubes.sort_by(|a, b| b.1.total_cmp(&a.1));
    cubes
}

/// The parts of a cube cut once along each axis.
fn children(centre: Point, half_m: f64, dimensions: usize) -> impl Iterator<Item = (Point, f32)> {
    (0..1 << dimensions).map(move |octant: usize| {
        let side = |k: usize| match (k < dimensions, octant >> k & 1) {
            (false, _) => 0.0,
            (true, 0) => -half_m / 2.0,
            (true, _) => half_m / 2.0,
        };
        (centre + Vector3::new(side(0), side(1), side(2)), 0.0)
    })
}

/// The largest sum within some radius of a point; `None` once it is below what a true patch reaches, or `most` profiles
/// cannot have seen it. What a wall's plane cuts counts as in front of it.
fn bound(
    order: &[Wide],
    most: usize,
    foci: &[Focus],
    at: Point,
    radius_m: f64,
    distances_m: &mut [Option<f64>],
) -> Option<f32> {
    let (mut sum, mut computed, mut blind) = (0.0_f32, 0, 0);
    for wide in order {
        let [a, b] = &wide.foci;
        while computed <= *b {
            distances_m[computed] = foci[computed].faces(at, radius_m).then(|| (at - foci[computed].point).norm());
            computed += 1;
        }
        let (Some(a), Some(b)) = (distances_m[*a], distances_m[*b]) else {
            blind += wide.profiles;
            if blind >= most {
                return None;
            }
            continue;
        };
        sum += wide.value(a + b);
        if sum < -SURE {
            return None;
        }
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Compared with the largest of all values near, at many lengths and reaches.
    #[test]
    fn a_widened_curve_holds_what_is_near() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            let values: Vec<f32> = (0..rng.random_range(1..60)).map(|_| rng.random_range(-3.0..3.0)).collect();
            let curve = Curve { low_m: rng.random_range(-1.0..1.0), step_m: 0.1, values };
            let value = |at: &Curve, length_m: f64| {
                let bin = (length_m - at.low_m) / at.step_m;
                if bin >= 0.0 { at.values.get(bin as usize).copied().unwrap_or(0.0) } else { 0.0 }
            };
            let reach_m = rng.random_range(0.01..2.0);
            let wide = curve.widened(reach_m);
            for _ in 0..100 {
                let length_m = rng.random_range(-4.0..9.0);
                let near_m: f64 = length_m + rng.random_range(-reach_m..reach_m);
                assert!(value(&wide, length_m) >= value(&curve, near_m), "{length_m} {near_m} {reach_m}");
            }
        }
    }
}
