//! The law under which light begins at each place: of a surface that faces it, an edge or a corner.
//!
//! One histogram seldom tells. Neighbours together do, by their likelihoods, and so does the curvature of the lengths:
//! on edges and corners it is one over the distance. Both give shares, not choices, so that lengths do not jump from
//! one law to the next; what the laws differ by, weighted with the shares, is the error of the law.

use rayon::prelude::*;

use super::field::Sample;
use super::windows::Chosen;
use super::{Place, Scan};

/// Places whose likelihoods count together, and whose curvatures do.
const POOL: usize = 150;
const CURVED: usize = 21;
/// Power of a likelihood that counts: laws are first orders, and their misfits are common to neighbours.
const TEMPER: f64 = 0.1;
/// Power of the shares by likelihood beside those by curvature.
const BESIDE: f64 = 0.3;
/// Share of a law that nothing speaks for, in places.
const NONE: f64 = 0.3;
/// Standard deviation of the law's error over that of the response: of a step, with more for an edge and a corner.
const ERROR: [f64; 3] = [0.12, 0.24, 0.36];
/// Least standard deviation of a curvature times distance, and likelihood of one that no surface has.
const LEAST_SD: f64 = 0.05;
const BEYOND: f64 = 1e-3;

/// Shares of the laws.
pub type Shares = [f64; 3];

/// Of each place, by the likelihoods of its neighbours.
pub fn by_likelihood(scan: &Scan, near: &[Vec<u32>]) -> Vec<Shares> {
    let share = scan.share();
    let of_place = |(place, near): (&Place, &Vec<u32>)| {
        let own = place.returns[0];
        let zone_m2 = 2.0 * scan.zone_m(own.length_m * 0.5).powi(2);
        let mut sums = [0.0; 3];
        for other in near.iter().take(POOL).map(|n| &scan.places[*n as usize]) {
            let apart_m2 = (other.seen - place.seen).norm_squared();
            let [step, ..] = other.returns;
            // Lengths of one surface differ by no more than their places do.
            let most_m = apart_m2.sqrt() + 4.0 * share * step.sd_m.hypot(own.sd_m);
            if share * (step.length_m - own.length_m).abs() > most_m {
                continue;
            }
            let weight = TEMPER * (-0.5 * apart_m2 / zone_m2).exp();
            sums.iter_mut().zip(&other.returns).for_each(|(sum, one)| *sum += weight * one.log_likelihood);
        }
        let most = sums.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        normalised(sums.map(|sum| (sum - most).exp()))
    };
    scan.places.par_iter().zip(near).map(of_place).collect()
}

/// Of each place, by the curvatures of the fields about it and these shares.
pub fn by_curvature(scan: &Scan, near: &[Vec<u32>], likely: &[Shares], fields: &[Option<Chosen>]) -> Vec<Shares> {
    let of_field = |chosen: &Option<Chosen>| {
        let Some(chosen) = chosen else { return [0.0; 3] };
        let [first, second] = chosen.field.bends(scan.lit.as_ref()).map(|[bend, sd]| {
            let sd = sd.hypot(LEAST_SD);
            let z = (1.0 - bend) / sd;
            let ends = (-0.5 * z * z).exp() / (sd * std::f64::consts::TAU.sqrt());
            // A surface that faces the wall has any curvature below that of an edge.
            let faces = if z < 0.0 { BEYOND.max(0.02 * ends) } else { 1.0 };
            ends / (ends + faces)
        });
        [(1.0 - first) * (1.0 - second), first * (1.0 - second) + second * (1.0 - first), first * second]
    };
    let own: Vec<Shares> = fields.iter().map(of_field).collect();
    let of_place = |(near, likely): (&Vec<u32>, &Shares)| {
        let sum = |k: usize| near.iter().take(CURVED).map(|n| own[*n as usize][k]).sum::<f64>() + NONE;
        normalised(std::array::from_fn(|k| sum(k) * (likely[k] + BEYOND).powf(BESIDE)))
    };
    near.iter().zip(likely).map(of_place).collect()
}

fn normalised(shares: Shares) -> Shares {
    let sum: f64 = shares.iter().sum();
    shares.map(|share| share / sum)
}

/// Lengths under these shares.
pub fn samples(scan: &Scan, shares: &[Shares]) -> Vec<Sample> {
    let of_place = |(place, shares): (&Place, &Shares)| {
        let mean = |of: &dyn Fn(usize) -> f64| shares.iter().enumerate().map(|(k, share)| share * of(k)).sum::<f64>();
        let length_m = mean(&|k| place.returns[k].length_m);
        let apart_m2 = mean(&|k| (place.returns[k].length_m - length_m).powi(2));
        let error_m = scan.sigma_m * mean(&|k| ERROR[k]);
        Sample {
            at: place.seen,
            length_m: scan.share() * length_m,
            sd_m: scan.share() * mean(&|k| place.returns[k].sd_m.powi(2)).sqrt(),
            law_m: scan.share() * apart_m2.sqrt().hypot(error_m),
        }
    };
    scan.places.iter().zip(shares).map(of_place).collect()
}
