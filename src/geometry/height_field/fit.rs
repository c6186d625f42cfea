//! The likeliest heights of a surface, and how likely a size of its curvatures is.

use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::grid::{Bend, Foot, Grid};
use crate::Point;
use crate::band::{Band, Factor};
use crate::shapes::Sighting;

/// Sizes of curvatures that are tried, in turn (1/m): a stiff surface finds its place, and then bends. The largest is
/// that of what has edges at each node.
const BENDS_PER_M: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// By so many of these sizes a surface may bend more than is likeliest: that would smooth edges, and what is bent alike
/// all over, by more than its error bars say.
const LOOSER: usize = 2;
/// A size that is less likely than the likeliest by so much (logarithm) ends the search, once the looser one is fitted.
const LESS: f64 = 60.0;
/// Degrees of freedom of the curvatures' prior, and the side of a patch of the surface that has one curvature.
const FREEDOM: f64 = 4.0;
const PATCH_M: f64 = 0.05;
/// Standard deviation of a height: where no length and no curvature tells it.
const HEIGHT_SD_M: f64 = 10.0;
/// Standard deviations beyond which a length counts by its distance, not by its square (Huber).
const OUTLIER: f64 = 4.0;
/// Newton's steps, the gain that ends them, dampings of a step, and the share of the gain that a step promises from
/// which on damping falls.
const STEPS: usize = 40;
const DONE: f64 = 1.0;
const LEAST_DAMPING: f64 = 1e-5;
const MOST_DAMPING: f64 = 1e6;
const FOLLOWED: f64 = 0.75;

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
        for (n, bend_per_m) in BENDS_PER_M.into_iter().enumerate() {
            let fit = match fits.last() {
                Some(fit) => Self::at(problem, fit.heights_m.clone(), &fit.feet, bend_per_m),
                None => Self::at(problem, vec![0.0; problem.grid.count()], &[], bend_per_m),
            };
            fits.push(fit.likeliest(problem, cancel)?);
            if fits[n].evidence > fits[best].evidence {
                best = n;
            } else if fits[n].evidence < fits[best].evidence - LESS && n >= best + LOOSER {
                break;
            }
        }
        let likeliest_per_m = BENDS_PER_M[best] * f64::powf(2.0, summit(&fits, best)?);
        let loose = (best + LOOSER).min(fits.len() - 1);
        Some((likeliest_per_m, fits.swap_remove(loose)))
    }

    /// The likeliest heights from these on, with curvatures of the same size.
    pub fn likeliest(mut self, problem: &Problem<'_>, cancel: &Cancel) -> Option<Self> {
        let mut damping = LEAST_DAMPING;
        for _ in 0..STEPS {
            cancel.check();
            let Some(next) = self.next(problem, &mut damping) else { break };
            let gain = self.loss() - next.loss();
            self = next;
            if gain < DONE {
                break;
            }
        }
        let flat = vec![0.0; problem.grid.count()];
        let before = prior(problem, &flat, self.bend_per_m).factor()?.log_determinant();
        let after = self.factor(problem)?.log_determinant();
        self.evidence = -0.5 * (self.loss() + after - before);
        Some(self)
    }

    /// After a step that is damped until it gains; `None` if none does.
    fn next(&self, problem: &Problem<'_>, damping: &mut f64) -> Option<Self> {
        let (curvature, gradient) = (self.curvature(problem), self.gradient(problem));
        while *damping < MOST_DAMPING {
            if let Some(factor) = curvature.clone().damped(*damping).factor() {
                let mut step = gradient.clone();
                factor.solve(&mut step);
                let promised: f64 = step.iter().zip(&gradient).map(|(step, slope)| step * slope).sum();
                let heights_m = self.heights_m.iter().zip(&step).map(|(height, step)| height + step).collect();
                let next = Self::at(problem, heights_m, &self.feet, self.bend_per_m);
                let gain = self.loss() - next.loss();
                if gain > FOLLOWED * promised {
                    *damping = (*damping * 0.2).max(LEAST_DAMPING);
                }
                if gain > 0.0 {
                    return Some(next);
                }
            }
            *damping *= 5.0;
        }
        None
    }

    /// Twice the logarithm of the likelihood and the prior, with its sign changed.
    pub fn loss(&self) -> f64 {
        self.square + self.prior
    }

    /// These heights, with curvatures of a size. Feet at heights before, if there are any, are near.
    pub fn at(problem: &Problem<'_>, heights_m: Vec<f64>, before: &[Foot], bend_per_m: f64) -> Self {
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

    /// Second derivatives of half the loss. Of lengths that are too long for the surface, how distances bend is in it:
    /// on flat surfaces that is more than the information. Of those that are too short, it would be taken away, and the
    /// matrix might be no longer positive.
    fn curvature(&self, problem: &Problem<'_>) -> Band {
        let mut curvature = self.information(problem);
        for (n, foot) in self.feet.iter().enumerate() {
            let off = self.weight(problem, n) * (problem.lengths_m[n] - foot.distance_m);
            if off > 0.0 {
                for (a, bends) in foot.nodes.iter().zip(problem.grid.bend_per_m(foot, &self.heights_m)) {
                    for (b, bend) in foot.nodes.iter().zip(bends).filter(|(b, _)| **b <= *a) {
                        curvature.add(*a as usize, *b as usize, -off * bend);
                    }
                }
            }
        }
        curvature
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

/// How far from the likeliest of some sizes, in steps, the summit of the parabola through it and its neighbours lies.
/// `None` if it is the largest.
fn summit(fits: &[Fit], best: usize) -> Option<f64> {
    let after = fits[best].evidence - fits.get(best + 1)?.evidence;
    let Some(before) = best.checked_sub(1) else { return Some(0.0) };
    let before = fits[best].evidence - fits[before].evidence;
    Some(0.5 * (before - after) / (before + after))
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
