//! Sparse deconvolution: the pulses, between samples and closer than the response, that explain a profile best.
//!
//! Model: `y_n = b + sum_k a_k h(t_n - t_k) + w_n`, `a_k >= 0` (or of any sign), response h known, w white with known sd a sample, b a constant baseline.
//! Maximum likelihood for a number of pulses that grows greedily:
//! 1. candidates: the matched filter's maximum in the residual, and the best pair in place of each pulse whose residual looks widened;
//! 2. each candidate is refined jointly with the pulses around it;
//! 3. the best is kept if it lowers chi2 by more than `evidence_min` ([`evidence_min`]), and all pulses are refined together;
//! 4. at the end, pulses that turn out to be worth less than that are taken out again.
//!
//! Times then scatter at the Cramer-Rao bound `sd^2 (J^T J)^-1`, and two equal pulses are told apart down to a distance that falls with
//! the square root of the SNR, far below the response's width. Sources: alternating descent (Boyd, Schiebinger and Recht, SIAM J. Optim.
//! 27, 616 (2017)) without its l1 penalty; resolution limit as in Smith, IEEE Trans. Signal Process. 53, 1597 (2005).
//!
//! Not modelled: noise correlated between samples, light wrapped around the end of the record, bounces widened by extended patches, an
//! inexact response. An error of the response shows as `chi2_per_dof` above 1 and, on strong pulses, as false pulses beside them; where
//! its size is known, adding it to the sd of the samples under a strong pulse keeps both away.

mod greedy;
mod linear;
mod model;
mod refine;
mod search;
#[cfg(test)]
mod tests;

use super::response::Response;
use greedy::{Fitter, State};
pub use search::evidence_min;

/// Standard deviations of chi2 that a misfit must exceed.
const MISFIT_SIGMA: f64 = 3.0;
/// False pulses a record of pure noise, where the caller sets no threshold.
const FALSE_PULSES: f64 = 1e-4;

/// An averaged record: sample `n` at `t0_ps + n * dt_ps`.
#[derive(Clone, Copy, Debug)]
pub struct Profile<'a> {
    /// Mean of each sample, V.
    pub mean_v: &'a [f64],
    /// Standard deviation of each mean, V; infinite for a sample to be ignored.
    pub sd_v: &'a [f64],
    /// Time of the first sample, ps.
    pub t0_ps: f64,
    /// Time between samples, ps.
    pub dt_ps: f64,
}

/// What is asked of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparseOptions {
    /// Drop of chi2 that a pulse must be worth; `None` for [`evidence_min`] at 1e-4 false pulses a record.
    pub evidence_min: Option<f64>,
    /// The fit stops at this many pulses.
    pub pulses_max: usize,
    /// Whether a constant is fitted with the pulses; it costs one degree of freedom.
    pub baseline: bool,
    /// Whether amplitudes may be negative, as reflections on a line are; light is never. Pulses closer than the response is wide are then not
    /// told apart: two of opposite sign imitate anything.
    pub signed: bool,
}

impl Default for SparseOptions {
    fn default() -> Self {
        Self { evidence_min: None, pulses_max: 64, baseline: true, signed: false }
    }
}

/// One pulse of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulse {
    /// Arrival, ps: where time 0 of the response lies.
    pub time_ps: f64,
    /// Factor of the response: V for a response whose maximum is 1.
    pub amplitude_v: f64,
    /// Standard deviation of the amplitude.
    pub amplitude_sd_v: f64,
    /// Rise of chi2 when this pulse is taken out and its neighbours are fitted again.
    pub evidence: f64,
    /// Chi2 over degrees of freedom of the samples that this pulse reaches.
    pub chi2_per_dof: f64,
}

/// Pulses of a profile in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseFit {
    /// Pulses by rising time.
    pub pulses: Vec<Pulse>,
    /// Covariance of the times, ps^2, row-major: `sd^2 (J^T J)^-1`, each pulse's sd multiplied by the square root of its `chi2_per_dof`
    /// where that exceeds 1 by more than three of its standard deviations.
    pub covariance_ps2: Vec<f64>,
    /// Constant under the pulses, V; 0 if none is fitted.
    pub baseline_v: f64,
    /// Chi2 over degrees of freedom of the record.
    pub chi2_per_dof: f64,
    /// The threshold that was applied to the evidence.
    pub evidence_min: f64,
}

/// Fits pulses to `profile`.
///
/// # Panics
/// If the profile is empty, its slices differ in length, a mean is not finite, an sd is not positive, `dt_ps` is not positive, or
/// the evidence asked for is not positive.
#[must_use]
pub fn fit(profile: &Profile, response: &Response, options: &SparseOptions) -> SparseFit {
    let len = profile.mean_v.len();
    assert!(len > 0, "the profile is empty");
    assert_eq!(len, profile.sd_v.len(), "one sd a sample");
    assert!(profile.dt_ps > 0.0, "the sample step must be positive");
    let finite = profile.mean_v.iter().all(|v| v.is_finite());
    assert!(finite, "the means must be finite");
    let positive = profile.sd_v.iter().all(|sd| *sd > 0.0);
    assert!(positive, "the sds must be positive");

    let record_ps = len as f64 * profile.dt_ps;
    let threshold = options.evidence_min.unwrap_or_else(|| evidence_min(response, record_ps, FALSE_PULSES));
    assert!(threshold > 0.0, "the evidence must be positive");
    let fitter = Fitter::new(profile, response, options, threshold);
    let mut state = fitter.start();
    while state.pulses() < options.pulses_max {
        let Some(grown) = fitter.grow(&state) else {
            break;
        };
        state = grown;
    }
    let (state, evidences) = fitter.prune(state);
    describe(&fitter, &state, &evidences, threshold)
}

/// The fit as its caller sees it, pulses in order of time.
fn describe(fitter: &Fitter, state: &State, evidences: &[f64], evidence_min: f64) -> SparseFit {
    let mut order: Vec<usize> = (0..state.pulses()).collect();
    order.sort_by(|i, j| state.time_ps(*i).total_cmp(&state.time_ps(*j)));
    // Amplitude and time of pulse k are unknowns 2k and 2k + 1.
    let unknowns = 2 * order.len();
    let all = state.covariance();
    let covariance = |i: usize, j: usize| all[i * unknowns + j];
    let inflations: Vec<f64> = order.iter().map(|&k| inflation(fitter.chi2_per_dof(state, Some(k)))).collect();
    let pulse = |(&k, inflation): (&usize, &f64)| Pulse {
        time_ps: state.time_ps(k),
        amplitude_v: state.amplitude(k),
        amplitude_sd_v: covariance(2 * k, 2 * k).sqrt() * inflation,
        evidence: evidences[k],
        chi2_per_dof: fitter.chi2_per_dof(state, Some(k)).0,
    };
    let pulses = order.iter().zip(&inflations).map(pulse).collect();
    let covariance_ps2 = order
        .iter()
        .zip(&inflations)
        .flat_map(|(&i, p)| order.iter().zip(&inflations).map(move |(&j, q)| (i, j, p * q)))
        .map(|(i, j, inflation)| covariance(2 * i + 1, 2 * j + 1) * inflation)
        .collect();
    SparseFit {
        pulses,
        covariance_ps2,
        baseline_v: state.baseline_v(),
        chi2_per_dof: fitter.chi2_per_dof(state, None).0,
        evidence_min,
    }
}

/// Factor of a standard deviation for a misfit: the root of chi2 per degree of freedom, where noise alone does not explain it. (Multiplying by
/// whatever exceeds 1 would widen every second interval of a right model.)
fn inflation((chi2_per_dof, freedom): (f64, f64)) -> f64 {
    if chi2_per_dof > 1.0 + MISFIT_SIGMA * (2.0 / freedom).sqrt() { chi2_per_dof.sqrt() } else { 1.0 }
}
