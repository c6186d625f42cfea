//! Variance of a record's samples as a function of level and slope.
//!
//! `sd^2 = s0^2 + s1^2 |v| + s2^2 v^2 + j^2 (dv/dt)^2`: converter and amplifier; shot noise, in proportion to the light; the laser's energy, in
//! proportion to the level; jitter, in proportion to the slope. The variance over shots scatters at each sample by `sqrt(2 / (N - 1))` of itself,
//! 37 % for 16 shots, so that a weight or an interval taken from it is wrong by as much; a model with four unknowns fitted to all samples is not.
//!
//! The fit is by maximum likelihood for variances of normal shots, `(N - 1) s^2 / sd^2` distributed as chi squared: a gamma regression with
//! identity link, least squares weighted by `(N - 1) / (2 sd^4)` with sd of the model, repeated until it stays (McCullagh and Nelder,
//! *Generalized Linear Models*, chapter 8), the coefficients not negative. Level and slope are those of the mean, whose own noise passes for
//! slope: the expected part is taken off the square of the slope. Not modelled: variances correlated between samples, which leave the
//! coefficients right and their errors too small; noise of other kinds, which `chi2_per_dof` shows.

use super::regression::{Regression, least_squares};

/// Terms of the model.
pub const TERMS: usize = 4;
/// Rounds of reweighting after which the fit is taken as it is.
const ROUNDS: usize = 100;
/// The fit has settled when no coefficient changes by more than this share of its standard deviation.
const SETTLED: f64 = 1e-6;
/// Derivative over eight steps, exact for polynomials of order 8.
const WIDE: [f64; 9] = [1.0 / 280.0, -4.0 / 105.0, 0.2, -0.8, 0.0, 0.8, -0.2, 4.0 / 105.0, -1.0 / 280.0];
/// A model variance is not taken below this share of the mean variance.
const FLOOR: f64 = 1e-6;

/// Spread over the shots of a capture.
#[derive(Clone, Copy, Debug)]
pub struct Spread<'a> {
    /// Mean of each sample, V, the baseline removed.
    pub mean_v: &'a [f64],
    /// Variance over shots of each sample, V^2, with N - 1 in the denominator; not finite for a sample to be ignored.
    pub variance_v2: &'a [f64],
    /// Shots N.
    pub shots: usize,
    /// Time between samples, ps.
    pub dt_ps: f64,
}

/// The coefficients: `variance = sum_k values[k] * term_k` with the terms 1, `|v|`, `v^2`, `(dv/dt)^2`.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseModel {
    /// `s0^2` in V^2, `s1^2` in V, `s2^2`, `j^2` in ps^2; not negative.
    pub values: [f64; TERMS],
    /// Their covariance; zero for a coefficient that would be negative and is 0.
    pub covariance: [[f64; TERMS]; TERMS],
    /// Squared differences of the variances from the model, over their own variances, over degrees of freedom.
    pub chi2_per_dof: f64,
}

/// Fits the model. `None` if no sample varies, or there are fewer samples than terms.
///
/// # Panics
/// If lengths differ, there are fewer than two shots, or the step is not positive.
#[must_use]
pub fn fit(spread: &Spread) -> Option<NoiseModel> {
    let len = spread.mean_v.len();
    assert_eq!(len, spread.variance_v2.len(), "a variance for each sample");
    assert!(spread.shots >= 2 && spread.dt_ps > 0.0, "a spread is of two shots at least, and has a step");
    let used: Vec<usize> = (0..len).filter(|n| spread.variance_v2[*n].is_finite()).collect();
    let variances: Vec<f64> = used.iter().map(|n| spread.variance_v2[*n]).collect();
    let mean = variances.iter().sum::<f64>() / variances.len().max(1) as f64;
    if used.len() < TERMS || mean <= 0.0 {
        return None;
    }
    let mut sd_model = vec![mean; used.len()];
    let mut model: Option<NoiseModel> = None;
    for _ in 0..ROUNDS {
        let terms = terms(spread, &smooth(spread, model.as_ref(), mean));
        let columns: Vec<Vec<f64>> = terms.iter().map(|term| used.iter().map(|n| term[*n]).collect()).collect();
        let sd: Vec<f64> = sd_model.iter().map(|v| v * (2.0 / (spread.shots - 1) as f64).sqrt()).collect();
        let next = non_negative(&columns, &variances, &sd)?;
        let settled = model.as_ref().is_some_and(|old| {
            (0..TERMS).all(|k| (next.values[k] - old.values[k]).abs() <= SETTLED * next.covariance[k][k].sqrt())
        });
        for (i, v) in sd_model.iter_mut().enumerate() {
            *v = (0..TERMS).map(|k| next.values[k] * columns[k][i]).sum::<f64>().max(FLOOR * mean);
        }
        model = Some(next);
        if settled {
            break;
        }
    }
    model
}

impl NoiseModel {
    /// Standard deviation of a single shot at each sample of a mean (of `shots`, which its noise is), V.
    ///
    /// # Panics
    /// If the step is not positive.
    #[must_use]
    pub fn sd_v(&self, mean_v: &[f64], shots: usize, dt_ps: f64) -> Vec<f64> {
        assert!(dt_ps > 0.0 && shots > 0, "a mean has shots and a step");
        let spread = Spread { mean_v, variance_v2: &[], shots, dt_ps };
        let terms = terms(&spread, &smooth(&spread, Some(self), 0.0));
        (0..mean_v.len()).map(|n| (0..TERMS).map(|k| self.values[k] * terms[k][n]).sum::<f64>().sqrt()).collect()
    }
}

/// Variance of each sample of the mean, which is what its slope and square have too much: of the model without slope, or all the same.
fn smooth(spread: &Spread, model: Option<&NoiseModel>, mean: f64) -> Vec<f64> {
    let variance =
        |v: f64| model.map_or(mean, |model| model.values[0] + model.values[1] * v.abs() + model.values[2] * v * v);
    spread.mean_v.iter().map(|v| variance(*v) / spread.shots as f64).collect()
}

/// The four terms at each sample. `own` is the variance of the mean's samples.
fn terms(spread: &Spread, own: &[f64]) -> [Vec<f64>; TERMS] {
    let mean_v = spread.mean_v;
    // Differences over eight samples follow the slope's square of a pulse of 1.5 samples' sd to 2 %; over four they would miss 8 %.
    let difference = |n: usize, weights: &[f64], before: usize| {
        let range = n.checked_sub(before)?..n + weights.len() - before;
        let (values, own) = (mean_v.get(range.clone())?, &own[range]);
        let rise: f64 = values.iter().zip(weights).map(|(v, w)| v * w).sum();
        let noise: f64 = own.iter().zip(weights).map(|(own, w)| own * w * w).sum();
        Some((rise * rise - noise).max(0.0) / (spread.dt_ps * spread.dt_ps))
    };
    let slope_squared = |n: usize| {
        let wide = difference(n, &WIDE, WIDE.len() / 2);
        wide.or_else(|| difference(n, &[-0.5, 0.0, 0.5], 1)).unwrap_or(0.0)
    };
    [
        vec![1.0; mean_v.len()],
        mean_v.iter().map(|v| v.abs()).collect(),
        mean_v.iter().zip(own).map(|(v, own)| (v * v - own).max(0.0)).collect(),
        (0..mean_v.len()).map(slope_squared).collect(),
    ]
}

/// The best of all least-squares fits on a part of the columns whose values are not negative: the optimum of the bounded problem is among them.
fn non_negative(columns: &[Vec<f64>], right: &[f64], sd: &[f64]) -> Option<NoiseModel> {
    let mut best: Option<(Regression, Vec<usize>)> = None;
    for set in 1..1_usize << TERMS {
        let chosen: Vec<usize> = (0..TERMS).filter(|k| set >> k & 1 == 1).collect();
        let part: Vec<Vec<f64>> = chosen.iter().map(|k| columns[*k].clone()).collect();
        let Some(fit) = least_squares(&part, right, sd) else { continue };
        let possible = fit.values.iter().all(|v| *v >= 0.0);
        if possible && best.as_ref().is_none_or(|(best, _)| fit.chi2 < best.chi2) {
            best = Some((fit, chosen));
        }
    }
    let (fit, chosen) = best?;
    let (mut values, mut covariance) = ([0.0; TERMS], [[0.0; TERMS]; TERMS]);
    for (i, &k) in chosen.iter().enumerate() {
        values[k] = fit.values[i];
        for (j, &l) in chosen.iter().enumerate() {
            covariance[k][l] = fit.covariance[i][j];
        }
    }
    Some(NoiseModel { values, covariance, chi2_per_dof: fit.chi2 / fit.dof.max(1) as f64 })
}

#[cfg(test)]
mod tests;
