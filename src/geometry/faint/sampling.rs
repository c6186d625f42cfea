//! The integral of the likelihood about a place, and its moments there, by importance sampling.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::Faint;
use super::likelihood::{Likelihood, PlaceLikelihood};
use crate::Point;

/// Points of a round, of the last one, and rounds before it.
const POINTS: usize = 96;
const LAST_POINTS: usize = 768;
const ROUNDS: usize = 6;
const FEW_ROUNDS: usize = 3;
/// Proposals are wider than what they are fitted to, so that tails count.
const WIDER: f64 = 1.4;
/// A round's weights are flattened until so large a share of the points counts.
const COUNTING: f64 = 0.2;
/// Variance that a proposal has at least, as a share of the start's.
const NARROWEST: f64 = 1e-4;

/// A normal density in one to three dimensions.
struct Proposal {
    mean: Point,
    covariance: Matrix3<f64>,
}

/// A sample: its place, and the log of its weight.
struct Sample {
    point: Point,
    place: PlaceLikelihood,
    log_weight: f64,
}

impl Proposal {
    /// The samples of a round.
    fn samples(&self, all: &Likelihood, normals: &[Vector3<f64>]) -> Option<Vec<Sample>> {
        let mut covariance = self.covariance * (WIDER * WIDER);
        let dimensions = all.domain.dimensions;
        if dimensions == 2 {
            (0..2).for_each(|k| (covariance[(2, k)], covariance[(k, 2)]) = (0.0, 0.0));
            covariance[(2, 2)] = 1.0;
        }
        let root = covariance.cholesky()?.l();
        let log_scale = root.diagonal().map(f64::ln).sum() + 0.5 * dimensions as f64 * std::f64::consts::TAU.ln();
        let sample = |normal: &Vector3<f64>| {
            let mut normal = *normal;
            if dimensions == 2 {
                normal.z = 0.0;
            }
            let point = self.mean + root * normal;
            let place = all.place(&point)?;
            Some(Sample { point, place, log_weight: place.mean() + 0.5 * normal.norm_squared() + log_scale })
        };
        Some(normals.par_iter().map(sample).collect::<Vec<_>>().into_iter().flatten().collect())
    }
}

/// Weights of samples relative to the largest, to the power `flat`.
fn weights(samples: &[Sample], flat: f64) -> Vec<f64> {
    let most = samples.iter().map(|sample| sample.log_weight).fold(f64::NEG_INFINITY, f64::max);
    samples.iter().map(|sample| (flat * (sample.log_weight - most)).exp()).collect()
}

/// How many samples count: the squared sum of the weights over the sum of their squares.
fn counting(weights: &[f64]) -> f64 {
    weights.iter().sum::<f64>().powi(2) / weights.iter().map(|weight| weight * weight).sum::<f64>()
}

/// Mean and covariance of weighted samples.
fn moments(samples: &[Sample], weights: &[f64]) -> (Point, Matrix3<f64>) {
    let total: f64 = weights.iter().sum();
    let weighted = || samples.iter().zip(weights);
    let mean = weighted().map(|(sample, weight)| sample.point.coords * *weight).sum::<Vector3<f64>>() / total;
    let square = |(sample, weight): (&Sample, &f64)| {
        let off = sample.point.coords - mean;
        off * off.transpose() * *weight
    };
    (Point::from(mean), weighted().map(square).sum::<Matrix3<f64>>() / total)
}

impl Likelihood<'_> {
    /// Places about each start.
    pub(super) fn sampled(&self, starts: &[Point], sd_m: f64, closely: bool) -> Vec<Faint> {
        let normals: Vec<Vector3<f64>> = (1..=LAST_POINTS).map(normal).collect();
        starts.iter().filter_map(|start| self.about(*start, sd_m, closely, &normals)).collect()
    }

    fn about(&self, start: Point, sd_m: f64, closely: bool, normals: &[Vector3<f64>]) -> Option<Faint> {
        let mut proposal = Proposal { mean: start, covariance: Matrix3::identity() * (sd_m * sd_m) };
        for _ in 0..if closely { ROUNDS } else { FEW_ROUNDS } {
            let samples = proposal.samples(self, &normals[..POINTS])?;
            if samples.is_empty() {
                return None;
            }
            let mut flat = 1.0;
            while counting(&weights(&samples, flat)) < COUNTING * samples.len() as f64 {
                flat *= 0.7;
            }
            let (mean, covariance) = moments(&samples, &weights(&samples, flat));
            proposal = Proposal { mean, covariance: covariance + Matrix3::identity() * (NARROWEST * sd_m * sd_m) };
        }
        let normals = if closely { normals } else { &normals[..POINTS] };
        let samples = proposal.samples(self, normals)?;
        let weights = weights(&samples, 1.0);
        let total: f64 = weights.iter().sum();
        let most = samples.iter().map(|sample| sample.log_weight).fold(f64::NEG_INFINITY, f64::max);
        let (point, mut covariance) = moments(&samples, &weights);
        if self.domain.dimensions == 2 {
            (0..3).for_each(|k| (covariance[(2, k)], covariance[(k, 2)]) = (0.0, 0.0));
        }
        let mean = |value: &dyn Fn(&PlaceLikelihood) -> f64| {
            samples.iter().zip(&weights).map(|(sample, weight)| weight * value(&sample.place)).sum::<f64>() / total
        };
        Some(Faint {
            point,
            covariance,
            evidence: most + (total / normals.len() as f64).ln() - self.log_volume,
            likelihood: samples.iter().map(|sample| sample.place.most()).fold(f64::NEG_INFINITY, f64::max),
            snr: mean(&PlaceLikelihood::squared_snr).sqrt(),
            seen: mean(&|place| place.profiles as f64) / self.profiles.len() as f64,
        })
    }
}

/// Point `n` of a sequence of low discrepancy (Halton's, in bases 2, 3, 5 and 7), as three normal numbers by Box and
/// Muller.
fn normal(n: usize) -> Vector3<f64> {
    let [a, b, c, d] = [2, 3, 5, 7].map(|base| halton(n, base));
    let (radius, turn) = ((-2.0 * a.ln()).sqrt(), std::f64::consts::TAU * b);
    let (other, other_turn) = ((-2.0 * c.ln()).sqrt(), std::f64::consts::TAU * d);
    Vector3::new(radius * turn.cos(), radius * turn.sin(), other * other_turn.cos())
}

/// The digits of `n` mirrored about the point.
fn halton(mut n: usize, base: usize) -> f64 {
    let (mut value, mut share) = (0.0, 1.0);
    while n > 0 {
        share /= base as f64;
        value += share * (n % base) as f64;
        n /= base;
    }
    value
}
