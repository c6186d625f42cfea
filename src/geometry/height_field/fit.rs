//! The likeliest heights of a surface, and how likely a size of its curvatures is.

use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::grid::{Bend, Foot, Grid};
use crate::Point;
use crate::band::{Band, Factor};
use crate::shapes::Sighting;

/// Sizes of curvatures that are tried, in turn (1/m). The largest is that of what has edges at each node.
const BENDS_PER_M: [f64; 7] = [16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25];
/// By so many of these sizes a surface may bend more than is likeliest: that would smooth edges, and what is bent alike
/// all over, by more than its error bars say.
const LOOSER: usize = 2;
/// A size that is less likely than the likeliest by so much (logarithm) ends the search.
const LESS: f64 = 60.0;
/// Degrees of freedom of the curvatures' prior, and the side of a patch of the surface that has one curvature.
const FREEDOM: f64 = 4.0;
const PATCH_M: f64 = 0.05;
/// Standard deviation of a height: where no length and no curvature tells it.
const HEIGHT_SD_M: f64 = 10.0;
/// Standard deviations beyond which a length counts by its distance, not by its square (Huber).
const OUTLIER: f64 = 4.0;
/// Rounds of least squares, the change of the objective that ends them, and dampings of a step.
const ROUNDS: usize = 40;
const DONE: f64 = 0.3;
const DAMPING: f64 = 1e-3;
const MOST_DAMPING: f64 = 1e6;

/// Lengths from places to a surface over a grid.
pub struct Problem<'a> {
    pub grid: &'a Grid,
    places: &'a [Point],
    lengths_m: Vec<f64>,
    variances_m2: Vec<f64>,
    bends: Vec<Bend>,
    /// Share of a patch that a node has.
    patch: f64,
}

impl<'a> Problem<'a> {
    /// Places in the frame of the grid, with the lengths of their sightings.
    pub fn new(grid: &'a Grid, places: &'a [Point], all: &[&Sighting]) -> Self {
        Self {
            grid,
            places,
            lengths_m: all.iter().map(|one| one.light.length_m).collect(),
            variances_m2: all.iter().map(|one| one.light.sd_m.powi(2) + one.light.law_m.powi(2)).collect(),
            bends: grid.bends(),
            patch: (grid.spacing_m / PATCH_M).powi(2),
        }
    }

    /// The surface that reaches furthest, and lies behind no length.
    fn envelope(&self) -> Vec<f64> {
        let height = |node: usize| {
            let place = self.grid.place(node);
            let below = self.places.iter().zip(&self.lengths_m).filter_map(|(seen, length_m)| {
                let square = length_m * length_m - (place - seen.coords.xy()).norm_squared();
                (square > 0.0).then(|| seen.z - square.sqrt())
            });
            below.fold(f64::INFINITY, f64::min)
        };
        let mut heights: Vec<f64> = (0..self.grid.count()).into_par_iter().map(height).collect();
        let least = heights.iter().copied().filter(|height| height.is_finite()).fold(0.0, f64::min);
        heights.iter_mut().filter(|height| !height.is_finite()).for_each(|height| *height = least);
        heights
    }

    /// The point of the surface next to each place. Those at heights before, if there are any, are near.
    fn feet(&self, heights_m: &[f64], before: &[Foot]) -> Vec<Foot> {
        let nodes = self.grid.nodes(heights_m);
        let near = |n: usize| before.get(n).map(|foot| foot.nodes[0] as usize);
        (0..self.places.len()).into_par_iter().map(|n| nodes.foot(&self.places[n], near(n))).collect()
    }
}

/// Heights, with what they say of the lengths.
#[derive(Clone)]
pub struct Fit {
    pub heights_m: Vec<f64>,
    /// The point of the surface next to each place.
    pub feet: Vec<Foot>,
    pub bend_per_m: f64,
    /// Squared scores of lengths, outliers for less.
    pub square: f64,
    /// Twice the prior's logarithm, with its sign changed.
    prior: f64,
    /// Logarithm of how likely the size of its curvatures is.
    evidence: f64,
}

impl Fit {
    /// The likeliest size of curvatures, and the fit with larger ones. `None` if the largest is likeliest: then nothing
    /// is smooth.
    pub fn loose(problem: &Problem<'_>, cancel: &Cancel) -> Option<(f64, Self)> {
        let mut fits: Vec<Self> = Vec::new();
        let mut best = 0;
        let mut heights_m = problem.envelope();
        for (n, bend_per_m) in BENDS_PER_M.into_iter().enumerate() {
            let before = fits.last().map_or(&[][..], |fit| &fit.feet);
            let fit = Self::new(problem, heights_m.clone(), before, bend_per_m, cancel)?;
            heights_m.clone_from(&fit.heights_m);
            fits.push(fit);
            let gain = fits[n].evidence - fits[best].evidence;
            if gain > 0.0 {
                best = n;
            } else if gain < -LESS {
                break;
            }
        }
        (best > 0).then(|| (BENDS_PER_M[best], fits.swap_remove(best.saturating_sub(LOOSER))))
    }

    /// From these heights on, with the feet before them, if there are any.
    fn new(
        problem: &Problem<'_>,
        heights_m: Vec<f64>,
        before: &[Foot],
        bend_per_m: f64,
        cancel: &Cancel,
    ) -> Option<Self> {
        let mut fit = Self::at(problem, heights_m, before, bend_per_m);
        let mut damping = DAMPING;
        for _ in 0..ROUNDS {
            cancel.check();
            let (information, gradient) = (fit.information(problem), fit.gradient(problem));
            let before = fit.square + fit.prior;
            let next = loop {
                let mut step = gradient.clone();
                information.clone().damped(damping).factor()?.solve(&mut step);
                let heights_m = fit.heights_m.iter().zip(&step).map(|(height, step)| height + step).collect();
                let next = Self::at(problem, heights_m, &fit.feet, bend_per_m);
                if next.square + next.prior < before {
                    damping *= 0.2;
                    break Some(next);
                }
                damping *= 5.0;
                if damping > MOST_DAMPING {
                    break None;
                }
            };
            let Some(next) = next else { break };
            let gain = before - next.square - next.prior;
            fit = next;
            if gain < DONE {
                break;
            }
        }
        let flat = vec![0.0; problem.grid.count()];
        let before = prior(problem, &flat, bend_per_m).factor()?.log_determinant();
        let after = fit.factor(problem)?.log_determinant();
        fit.evidence = -0.5 * (fit.square + fit.prior + after - before);
        Some(fit)
    }

    fn at(problem: &Problem<'_>, heights_m: Vec<f64>, before: &[Foot], bend_per_m: f64) -> Self {
        let feet = problem.feet(&heights_m, before);
        let loss = |n: usize| {
            let score = score(problem, &feet, n).abs();
            if score < OUTLIER { score * score } else { OUTLIER * (2.0 * score - OUTLIER) }
        };
        let square = (0..feet.len()).map(loss).sum();
        let of_bend = |bend: &Bend| FREEDOM * ((bend.of(&heights_m) / bend_per_m).powi(2) / FREEDOM).ln_1p();
        let bends: f64 = problem.bends.iter().map(of_bend).sum();
        let heights: f64 = heights_m.iter().map(|height| (height / HEIGHT_SD_M).powi(2)).sum();
        let prior = problem.patch * bends + heights;
        Self { heights_m, feet, bend_per_m, square, prior, evidence: f64::NEG_INFINITY }
    }

    /// Weight of a length: over its variance, less for an outlier.
    pub fn weight(&self, problem: &Problem<'_>, n: usize) -> f64 {
        let score = score(problem, &self.feet, n).abs();
        (OUTLIER / score).min(1.0) / problem.variances_m2[n]
    }

    fn information(&self, problem: &Problem<'_>) -> Band {
        let mut information = prior(problem, &self.heights_m, self.bend_per_m);
        for (n, foot) in self.feet.iter().enumerate() {
            let weight = self.weight(problem, n) * foot.slope.powi(2);
            for (a, share) in foot.nodes.iter().zip(foot.shares) {
                for (b, other) in foot.nodes.iter().zip(foot.shares).filter(|(b, _)| **b <= *a) {
                    information.add(*a as usize, *b as usize, weight * share * other);
                }
            }
        }
        information
    }

    fn gradient(&self, problem: &Problem<'_>) -> Vec<f64> {
        let off = |n: usize| self.weight(problem, n) * (problem.lengths_m[n] - self.feet[n].distance_m);
        let mut gradient = self.weighted(&(0..self.feet.len()).map(off).collect::<Vec<f64>>());
        for (value, height) in gradient.iter_mut().zip(&self.heights_m) {
            *value -= height / HEIGHT_SD_M.powi(2);
        }
        for bend in &problem.bends {
            let value = bend.of(&self.heights_m);
            let weight = problem.patch * precision(value, self.bend_per_m) * value;
            bend.nodes.iter().zip(bend.factors).for_each(|(node, factor)| gradient[*node] -= weight * factor);
        }
        gradient
    }

    /// Values of places, summed at the nodes by how much these change the lengths.
    pub fn weighted(&self, values: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.heights_m.len()];
        for (foot, value) in self.feet.iter().zip(values) {
            for (node, share) in foot.nodes.iter().zip(foot.shares) {
                sums[*node as usize] += foot.slope * share * value;
            }
        }
        sums
    }

    /// Of the information of all heights.
    pub fn factor(&self, problem: &Problem<'_>) -> Option<Factor> {
        self.information(problem).factor()
    }
}

/// What a length is off, over its standard deviation.
fn score(problem: &Problem<'_>, feet: &[Foot], n: usize) -> f64 {
    (problem.lengths_m[n] - feet[n].distance_m) / problem.variances_m2[n].sqrt()
}

/// Precision of a curvature under Student's prior.
fn precision(bend: f64, bend_per_m: f64) -> f64 {
    1.0 / (bend_per_m * bend_per_m * (1.0 + (bend / bend_per_m).powi(2) / FREEDOM))
}

/// Precision of heights before there are lengths, with the weights of these curvatures.
fn prior(problem: &Problem<'_>, heights_m: &[f64], bend_per_m: f64) -> Band {
    let grid = problem.grid;
    let mut prior = Band::new(grid.count(), 2 * grid.columns);
    (0..grid.count()).for_each(|node| prior.add(node, node, HEIGHT_SD_M.powi(-2)));
    for bend in &problem.bends {
        let weight = problem.patch * precision(bend.of(heights_m), bend_per_m);
        for (a, factor) in bend.nodes.iter().zip(bend.factors) {
            for (b, other) in bend.nodes.iter().zip(bend.factors).filter(|(b, _)| **b <= *a) {
                prior.add(*a, *b, weight * factor * other);
            }
        }
    }
    prior
}
