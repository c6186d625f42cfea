//! How much evidence to ask for a pulse: thresholds by the rate at which noise alone crosses them.

use super::model::Model;
use super::{Profile, Response, Whitener};

/// No threshold is lower: below it, single pulses are split.
const LEAST: f64 = 20.0;
/// Rounds of the fixed point for the joint threshold, which contracts by the order of one over the threshold.
const ROUNDS: usize = 12;

/// Threshold on the drop of chi2 a pulse, for `false_pulses` a record of white noise alone.
///
/// A matched filter's output, scaled to unit variance, crosses `u` upwards at the rate `beta / (2 pi) exp(-u^2 / 2)`,
/// with `beta^2 = sum h'^2 / sum h^2` (Rice, Bell Syst. Tech. J. 24, 46 (1945)); the best pulse lowers chi2 by `u^2`.
/// Hence `gamma = 2 ln(T beta / (2 pi false_pulses))`, T the record's length, and never below `LEAST`, against the
/// splitting of single pulses.
#[must_use]
pub fn evidence_min(response: &Response, record_ps: f64, false_pulses: f64) -> f64 {
    threshold(response, &[1.0], 0.0, record_ps, false_pulses)
}

/// [`evidence_min`] for a record of the noise that `profile` has: h is the whitened response.
#[must_use]
pub fn evidence_min_of(profile: &Profile, response: &Response, false_pulses: f64) -> f64 {
    let whitener = Whitener::new(&[1.0], profile.acf);
    let record_ps = profile.mean_v.len() as f64 * profile.dt_ps;
    threshold(response, whitener.stationary_taps(), profile.dt_ps, record_ps, false_pulses)
}

/// [`evidence_min`] for noise in all the records of `model`, of mean duration `record_ps`, together.
///
/// The drop of chi2 by a pulse with amplitudes of its own in G groups of records is a sum of up to G squares. Upward
/// crossings of `x` by the sum of m squares have the rate `beta / sqrt(pi) (x / 2)^((m - 1) / 2) exp(-x / 2) / Gamma(m
/// / 2)` (Sharpe, Adv. Appl. Probab. 10, 373 (1978)); with amplitudes >= 0, of the G squares m count in a part
/// `binomial(G, m) / 2^G` of cases.
pub(super) fn evidence_min_joint(model: &Model, record_ps: f64, false_pulses: f64) -> f64 {
    let rates = model.groups.iter().map(|group| {
        let (mut energy, mut slope_energy) = (0.0, 0.0);
        for record in &model.records[group.clone()] {
            let weights = record.whitener.weights();
            let weight = weights.iter().map(|w| w * w).sum::<f64>() / weights.len() as f64;
            let (own, slope) = energies(record.response, record.whitener.stationary_taps(), record.dt_ps);
            energy += weight * own;
            slope_energy += weight * slope;
        }
        if energy > 0.0 { (slope_energy / energy).sqrt() } else { 0.0 }
    });
    let beta = rates.fold(0.0, f64::max);
    let single = record_ps * beta / (std::f64::consts::TAU * false_pulses);
    let mut threshold = (2.0 * single.ln()).max(LEAST);
    for _ in 0..ROUNDS {
        threshold = (2.0 * (single * excess_rate(model.groups.len(), threshold)).ln()).max(LEAST);
    }
    threshold
}

/// Rate at which the best of `groups` amplitudes crosses `threshold`, in rates of one alone.
fn excess_rate(groups: usize, threshold: f64) -> f64 {
    let root_pi = std::f64::consts::PI.sqrt();
    // Gamma(m / 2) by its recursion from Gamma(1/2) and Gamma(1), and binomial(G, m) by its own.
    let (mut gammas, mut ways, mut sum) = ([root_pi, 1.0], 1.0, 0.0);
    for m in 1..=groups {
        ways *= (groups + 1 - m) as f64 / m as f64;
        sum += ways * (threshold / 2.0).powf((m as f64 - 1.0) / 2.0) / gammas[0];
        gammas = [gammas[1], gammas[0] * m as f64 / 2.0];
    }
    2.0 * root_pi * sum / 2.0_f64.powi(groups as i32)
}

/// The threshold for the response passed through a filter of `taps`, `dt_ps` apart.
fn threshold(response: &Response, taps: &[f64], dt_ps: f64, record_ps: f64, false_pulses: f64) -> f64 {
    let (energy, slope_energy) = energies(response, taps, dt_ps);
    let beta = (slope_energy / energy).sqrt();
    let crossings = record_ps * beta / (std::f64::consts::TAU * false_pulses);
    (2.0 * crossings.ln()).max(LEAST)
}

/// Energies of the response passed through a filter of `taps`, `dt_ps` apart, and of its slope.
fn energies(response: &Response, taps: &[f64], dt_ps: f64) -> (f64, f64) {
    let (first_ps, last_ps) = response.support_ps();
    let step_ps = (last_ps - first_ps + (taps.len() - 1) as f64 * dt_ps) / 1000.0;
    let filtered = |time_ps: f64| {
        taps.iter().enumerate().fold((0.0, 0.0), |(v, s), (j, tap)| {
            let (value, slope) = response.value_and_slope(time_ps - j as f64 * dt_ps);
            (v + tap * value, s + tap * slope)
        })
    };
    let (energy, slope_energy) = (0..=1000)
        .map(|i| filtered(first_ps + f64::from(i) * step_ps))
        .fold((0.0, 0.0), |(e, s), (value, slope)| (e + value * value, s + slope * slope));
    (step_ps * energy, step_ps * slope_energy)
}
