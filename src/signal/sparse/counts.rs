//! Pulses in histograms of single photons.
//!
//! A detector that counts at most one photon a dead time loses those that follow. Of N laser cycles, bin i finds `A_i =
//! N - sum_j n_j` ready, j the bins that its dead time reaches back to; the number that it counts is binomial, `n_i ~
//! B(A_i, 1 - exp(-mu_i / N))`, `mu_i` the number of photons that N cycles bring (Coates, J. Phys. E 1, 878 (1968)).
//! Hence the corrected counts `m_i = -N ln(1 - n_i / A_i)`, of variance `N^2 (exp(mu_i / N) - 1) / A_i`: Poisson's
//! where counts are few.
//!
//! The variance belongs to the mean that is fitted and not to the counts: weights by counts favour bins that have too
//! few by chance. Fits are repeated with the variance of the one before (iteratively reweighted least squares); their
//! fixed point solves the likelihood equations, and its covariance is the inverse Fisher information (McCullagh and
//! Nelder, *Generalized Linear Models*, section 2.5).
//!
//! Not modelled: after-pulses, dead time that differs from count to count, light of more than one cycle before.

use super::evidence::evidence_min_of;
use super::greedy::Fitter;
use super::joint::run;
use super::model::Model;
use super::{Baseline, FALSE_PULSES, Profile, Response, SparseFit, SparseOptions};
use crate::Error;

/// Repetitions at most; the first few reach the fixed point but where a pulse is on the edge of its evidence.
const ROUNDS: usize = 8;
/// From this round on, variances do not fall any more, so that such a pulse cannot come and go for ever.
const SETTLED: usize = 3;
/// Times that move by less than this, in sds, and amplitudes by as little, have arrived.
const ARRIVED: f64 = 1e-3;
/// A bin's mean is not taken for less than this part of a count a record.
const MEAN_MIN: f64 = 1.0;

/// A histogram freed of pile-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Unpiled {
    /// Photons that all cycles bring to each bin.
    pub counts: Vec<f64>,
    /// Cycles in which each bin was ready; 0 for a bin that says nothing.
    pub ready: Vec<f64>,
    /// Laser cycles.
    pub cycles: f64,
}

impl Unpiled {
    /// Frees `counts` (of each bin, over `cycles` laser cycles) of pile-up by a dead time of `dead_bins` bins after
    /// each count; counts do not reach into the next cycle.
    ///
    /// # Errors
    /// [`Error::DeadTime`] if more counts fall into a dead time than there are cycles.
    pub fn new(counts: &[u32], cycles: u64, dead_bins: usize) -> Result<Self, Error> {
        let total = cycles as f64;
        let mut busy = 0.0;
        let (mut corrected, mut ready) = (Vec::with_capacity(counts.len()), Vec::with_capacity(counts.len()));
        for (i, count) in counts.iter().enumerate() {
            let (count, free) = (f64::from(*count), total - busy);
            if count > free {
                return Err(Error::DeadTime { bin: i });
            }
            // A bin that counts in every cycle says only that there was much light.
            let says = free > 0.0 && count < free;
            corrected.push(if says { -total * (-count / free).ln_1p() } else { 0.0 });
            ready.push(if says { free } else { 0.0 });
            busy += count;
            if i >= dead_bins {
                busy -= f64::from(counts[i - dead_bins]);
            }
        }
        Ok(Self { counts: corrected, ready, cycles: total })
    }

    /// Variance of each bin whose mean is as given; infinite where a bin says nothing.
    fn variances(&self, means: &[f64]) -> Vec<f64> {
        let variance = |(mean, ready): (&f64, &f64)| self.cycles * self.cycles * (mean / self.cycles).exp_m1() / ready;
        means.iter().zip(&self.ready).map(variance).collect()
    }
}

/// Fits pulses to a histogram, bin `i` at `t0_ps + i * dt_ps`, by maximum likelihood; amplitudes and baseline are in
/// counts a bin.
///
/// # Panics
/// If there is no bin, or for what [`super::fit`] panics for.
#[must_use]
pub fn fit_counts(
    histogram: &Unpiled,
    t0_ps: f64,
    dt_ps: f64,
    response: &Response,
    options: &SparseOptions,
) -> SparseFit {
    assert!(!histogram.counts.is_empty(), "the histogram is empty");
    assert!(dt_ps > 0.0, "the bins must have a width");
    let least = MEAN_MIN / histogram.counts.len() as f64;
    let half = (0.25 * response.width_ps() / dt_ps).round() as usize;
    // Too much variance at the start hides weak pulses for a round; too little finds many that are none.
    let overall = histogram.counts.iter().sum::<f64>() / histogram.counts.len() as f64;
    let mut means: Vec<f64> =
        running_mean(&histogram.counts, half).iter().map(|mean| mean.max(overall).max(least)).collect();
    let mut last: Option<SparseFit> = None;
    for round in 0..ROUNDS {
        let fit = fit_with(histogram, &means, t0_ps, dt_ps, response, options);
        let has_arrived = last.as_ref().is_some_and(|last| is_same(last, &fit));
        let fitted = mean_of(&fit, response, t0_ps, dt_ps, means.len());
        for (mean, fitted) in means.iter_mut().zip(fitted) {
            *mean = if round < SETTLED { fitted.max(least) } else { mean.max(fitted) };
        }
        last = Some(fit);
        if has_arrived {
            break;
        }
    }
    last.expect("there is a round")
}

/// One fit with the variances that belong to `means`.
fn fit_with(
    histogram: &Unpiled,
    means: &[f64],
    t0_ps: f64,
    dt_ps: f64,
    response: &Response,
    options: &SparseOptions,
) -> SparseFit {
    let sd_v: Vec<f64> = histogram.variances(means).iter().map(|v| v.sqrt()).collect();
    let profile =
        Profile { mean_v: &histogram.counts, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps, dt_ps };
    let threshold = options.evidence_min.unwrap_or_else(|| evidence_min_of(&profile, response, FALSE_PULSES));
    assert!(threshold > 0.0, "the evidence must be positive");
    // Dark counts are as many in every bin.
    let options = SparseOptions { baseline: Baseline::Constant, ..options.clone() };
    let model = Model::new(&[(profile, response)], &options, true);
    // Of a Poisson number: one over its mean.
    let kurtosis = means.iter().map(|mean| 1.0 / mean).collect();
    let fitter = Fitter::new(model, &[&histogram.counts], threshold, options.pulses_max)
        .with_kurtosis(kurtosis)
        .starting_from(&options.predictions);
    let (state, evidences) = fitter.grown();
    run(&fitter, &state, evidences, Vec::new(), threshold).remove(0)
}

/// Mean of each bin by a fit.
fn mean_of(fit: &SparseFit, response: &Response, t0_ps: f64, dt_ps: f64, len: usize) -> Vec<f64> {
    let mut means = vec![fit.baseline_v; len];
    for pulse in &fit.pulses {
        for (n, value) in pulse.samples(response, t0_ps, dt_ps, len) {
            means[n] += value;
        }
    }
    means
}

/// Whether the second fit moved no pulse of the first.
fn is_same(first: &SparseFit, second: &SparseFit) -> bool {
    let count = second.pulses.len();
    let stays = |(k, (a, b)): (usize, (&super::Pulse, &super::Pulse))| {
        (a.time_ps - b.time_ps).abs() < ARRIVED * second.time_sd_ps(k)
            && (a.amplitude_v - b.amplitude_v).abs() < ARRIVED * b.amplitude_sd_v
    };
    first.pulses.len() == count && first.pulses.iter().zip(&second.pulses).enumerate().all(stays)
}

/// Mean over `half` values to either side of each.
fn running_mean(values: &[f64], half: usize) -> Vec<f64> {
    let around = |i: usize| &values[i.saturating_sub(half)..(i + half + 1).min(values.len())];
    (0..values.len()).map(|i| around(i).iter().sum::<f64>() / around(i).len() as f64).collect()
}
