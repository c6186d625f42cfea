//! What lies under the pulses of a record, explained together with them: a constant, a slope, slow noise.
//!
//! Whitened samples of a model without pulses have the covariance `1 + sum_k p_k b_k b_k^T`: one direction `b_k` for
//! each thing that may lie under the pulses, `p_k` the variance of its amplitude, infinite where it may have any. The
//! inverse, `Q = 1 - sum_k v_k v_k^T`, takes the place of the unit matrix in every product of a fit. Its axes `v_k`
//! come one by one (Sherman and Morrison's formula; for infinite `p_k` that is Gram-Schmidt). Nothing is subtracted
//! before the pulses are known, and what a pulse shares with the ground under it is not counted for it.

use super::Baseline;
use crate::slow_noise::component;
use crate::whiten::Whitener;

/// A direction counts as explained by others if they leave no larger part of its length.
const NEW: f64 = 0.05;

/// Highest power of a line that bends, where there is slow noise. The components of that are level at both ends of a
/// record, and few of them are far from what is not: without bends, the ends of a record would show pulses.
const BENDS: i32 = 3;

/// A whitened direction, and the variance of its amplitude.
pub(super) type Direction = (Vec<f64>, f64);

/// The axes of Q.
#[derive(Clone, Debug, Default)]
pub(super) struct Nuisance {
    axes: Vec<Vec<f64>>,
    /// The whitened constant over its squared norm; nothing if none is fitted.
    mean: Vec<f64>,
    /// Logarithm of the determinant of the covariance, what may have any size left out.
    log_determinant: f64,
}

impl Nuisance {
    /// Of a record: its `baseline`, and slow noise whose components have the variances `slow_v2`.
    pub(super) fn new(whitener: &Whitener, baseline: Baseline, slow_v2: &[f64]) -> Self {
        let mut nuisance = Self::default();
        let len = whitener.weights().len();
        if baseline != Baseline::None {
            let constant = whitener.apply(&vec![1.0; len]);
            let norm = squared(&constant);
            nuisance.mean = constant.iter().map(|value| if norm > 0.0 { value / norm } else { 0.0 }).collect();
            nuisance.add(&constant, None);
        }
        if baseline == Baseline::Line {
            let half = 0.5 * len.saturating_sub(1).max(1) as f64;
            let is_slow = slow_v2.iter().any(|variance_v2| *variance_v2 > 0.0);
            for power in 1..=if is_slow { BENDS } else { 1 } {
                let bent: Vec<f64> = (0..len).map(|n| (n as f64 / half - 1.0).powi(power)).collect();
                nuisance.add(&whitener.apply(&bent), None);
            }
        }
        for (k, variance_v2) in slow_v2.iter().enumerate().filter(|(_, variance_v2)| **variance_v2 > 0.0) {
            nuisance.add(&slow_direction(whitener, k), Some(*variance_v2));
        }
        nuisance
    }

    /// Adds a direction of whitened samples, with an amplitude of this `variance` about 0, or of any size. One that the
    /// others explain is left out.
    pub(super) fn add(&mut self, direction: &[f64], variance: Option<f64>) {
        let mut axis = self.without(direction);
        let left: f64 = axis.iter().zip(direction).map(|(a, d)| a * d).sum();
        if variance.is_some() || left > NEW * NEW * squared(direction) {
            self.log_determinant += variance.map_or(0.0, |variance| (variance * left).ln_1p());
            let scale = (variance.map_or(0.0, f64::recip) + left).sqrt().recip();
            axis.iter_mut().for_each(|value| *value *= scale);
            self.axes.push(axis);
        }
    }

    /// The axes.
    pub(super) fn axes(&self) -> &[Vec<f64>] {
        &self.axes
    }

    /// `Q samples`.
    pub(super) fn without(&self, samples: &[f64]) -> Vec<f64> {
        let mut left = samples.to_vec();
        for axis in &self.axes {
            let along: f64 = axis.iter().zip(samples).map(|(a, s)| a * s).sum();
            subtract(&mut left, axis, along);
        }
        left
    }

    /// Degrees of freedom that chi2 of `Q samples` has less than samples: the trace of `1 - Q`.
    pub(super) fn freedom(&self) -> f64 {
        self.axes.iter().map(|axis| squared(axis)).sum()
    }

    /// Logarithm of the determinant of the covariance, what may have any size left out: with chi2, what a likelihood
    /// of the ground under the pulses costs.
    pub(super) fn log_determinant(&self) -> f64 {
        self.log_determinant
    }

    /// The constant under whitened samples from `first` on; 0 if none is fitted.
    pub(super) fn mean_v(&self, first: usize, samples: impl Iterator<Item = f64>) -> f64 {
        self.mean.iter().skip(first).zip(samples).map(|(m, s)| m * s).sum()
    }
}

/// Component `k` of slow noise, whitened.
pub(super) fn slow_direction(whitener: &Whitener, k: usize) -> Vec<f64> {
    let len = whitener.weights().len();
    whitener.apply(&(0..len).map(|n| component(k, n as f64, len)).collect::<Vec<_>>())
}

/// Takes `amount` of a direction away.
pub(super) fn subtract(samples: &mut [f64], direction: &[f64], amount: f64) {
    samples.iter_mut().zip(direction).for_each(|(s, d)| *s -= amount * d);
}

fn squared(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// `(1 + sum p b b^T) Q x = x` for directions of finite variance; and what is open, Q takes away.
    #[test]
    fn its_matrix_is_the_inverse_of_the_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut random = |len: usize| -> Vec<f64> { (0..len).map(|_| rng.random_range(-1.0..1.0)).collect() };
        let directions: Vec<Vec<f64>> = (0..5).map(|_| random(20)).collect();
        let variances = [0.3, 7.0, 1e-3, 40.0, 2.0];
        let mut nuisance = Nuisance::default();
        for (direction, variance) in directions.iter().zip(variances) {
            nuisance.add(direction, Some(variance));
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let samples = random(20);
        let solved = nuisance.without(&samples);
        for n in 0..20 {
            let slow: f64 = directions.iter().zip(variances).map(|(b, p)| p * b[n] * dot(b, &solved)).sum();
            assert!((solved[n] + slow - samples[n]).abs() < 1e-12);
        }
        let open = random(20);
        nuisance.add(&open, None);
        assert!(dot(&open, &nuisance.without(&samples)).abs() < 1e-12);
        // The trace of 1 - Q, column by column.
        let unit = |n: usize| (0..20).map(|m| f64::from(u8::from(m == n))).collect::<Vec<f64>>();
        let trace: f64 = (0..20).map(|n| 1.0 - nuisance.without(&unit(n))[n]).sum();
        assert!((nuisance.freedom() - trace).abs() < 1e-12);
    }

    #[test]
    fn a_record_of_one_sample_has_no_slope() {
        let whitener = Whitener::new(&[0.5], &[1.0]);
        let left = Nuisance::new(&whitener, Baseline::Line, &[0.1]).without(&whitener.apply(&[3.0]));
        assert!(left[0].abs() < 1e-12, "{left:?}");
    }

    #[test]
    fn lines_under_a_record_leave_nothing() {
        let whitener = Whitener::new(&[0.5; 30], &[1.0, 0.6, 0.2]);
        let line: Vec<f64> = (0..30).map(|n| 3.0 - 0.2 * f64::from(n)).collect();
        let left = |baseline: Baseline| {
            let left = Nuisance::new(&whitener, baseline, &[]).without(&whitener.apply(&line));
            left.iter().fold(0.0_f64, |most, value| most.max(value.abs()))
        };
        assert!(left(Baseline::Line) < 1e-10 && left(Baseline::Constant) > 0.1 && left(Baseline::None) > 1.0);
    }
}
