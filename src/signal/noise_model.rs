//! Variance of a record's samples as a function of level and slope.
//!
//! `sd^2 = s0^2 + s1^2 |v| + s2^2 v^2 + j^2 (dv/dt)^2`: converter and amplifier; shot noise, in proportion to the
//! light; the laser's energy, in proportion to the level; jitter, in proportion to the slope. The variance over shots
//! scatters at each sample by `sqrt(2 / (N - 1))` of itself, 37 % for 16 shots. A weight or an interval taken from it
//! is wrong by as much; a model with four unknowns fitted to all samples is not.
//!
//! The fit is by maximum likelihood for variances of normal shots, `(N - 1) s^2 / sd^2` distributed as chi squared: a
//! gamma regression with identity link (McCullagh and Nelder, *Generalized Linear Models*, chapter 8). It is solved by
//! least squares weighted by `(N - 1) / (2 sd^4)` with sd of the model, repeated until it settles; no coefficient is
//! negative. Level and slope are those of the mean, whose own noise passes for slope. The expected part is taken off
//! the square of the slope, as if the noise were the same all along the samples of a difference. Not modelled:
//! variances correlated between samples, which leave the coefficients right and their errors too small; noise of other
//! kinds, which `chi2_per_dof` shows.
//!
//! Every capture has such a fit, so it must cost as little as the sums of the average: a round is one pass over the
//! samples that gathers the normal equations, and allocates nothing.

use super::regression::invert;
use super::widest::widest;

/// Terms of the model.
pub const TERMS: usize = 4;
/// Rounds of reweighting after which the fit is taken as it is.
const ROUNDS: usize = 100;
/// The fit has settled when no coefficient changes by more than this share of its standard deviation.
const SETTLED: f64 = 1e-3;
/// Derivative over eight steps, exact for polynomials of order 8.
const WIDE: [f64; 9] = [1.0 / 280.0, -4.0 / 105.0, 0.2, -0.8, 0.0, 0.8, -0.2, 4.0 / 105.0, -1.0 / 280.0];
/// A model variance is not taken below this share of the mean variance: its inverse square is a weight, and one sample
/// must not decide the fit.
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
    let used = spread.variance_v2.iter().filter(|variance| variance.is_finite()).count();
    // A sample to be ignored is one without weight.
    let variances: Vec<f64> = spread.variance_v2.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
    let mean = variances.iter().sum::<f64>() / used.max(1) as f64;
    if used < TERMS || mean <= 0.0 {
        return None;
    }
    let mut columns = Columns::of(spread.mean_v, spread.dt_ps);
    // 1 for a sample that counts, 0 for one to be ignored.
    let finite: Vec<f64> = spread.variance_v2.iter().map(|v| f64::from(u8::from(v.is_finite()))).collect();
    let mut weights = finite.iter().map(|one| one / spread.weighing(mean)).collect::<Vec<f64>>();
    let mut model: Option<NoiseModel> = None;
    for _ in 0..ROUNDS {
        let smooth =
            model.as_ref().map_or([mean, 0.0, 0.0], |model| [model.values[0], model.values[1], model.values[2]]);
        columns.clear_of_noise(smooth.map(|value| value / spread.shots as f64));
        let next = Equations::of(&columns, &variances, &weights).solve(used)?;
        let settled = model.as_ref().is_some_and(|old| {
            (0..TERMS).all(|k| (next.values[k] - old.values[k]).abs() <= SETTLED * next.covariance[k][k].sqrt())
        });
        columns.variances(&next.values, &mut weights);
        let least = FLOOR * mean;
        widest(|| {
            for (weight, one) in weights.iter_mut().zip(&finite) {
                *weight = one / spread.weighing(weight.max(least));
            }
        });
        model = Some(next);
        if settled {
            break;
        }
    }
    model
}

impl Spread<'_> {
    /// Variance of a sample's variance, where the model has it at `variance`.
    fn weighing(&self, variance: f64) -> f64 {
        variance * variance * 2.0 / (self.shots - 1) as f64
    }
}

impl NoiseModel {
    /// Standard deviation of a single shot at each sample of a mean (of `shots`, which its noise is), V.
    ///
    /// # Panics
    /// If the step is not positive.
    #[must_use]
    pub fn sd_v(&self, mean_v: &[f64], shots: usize, dt_ps: f64) -> Vec<f64> {
        assert!(dt_ps > 0.0 && shots > 0, "a mean has shots and a step");
        let mut columns = Columns::of(mean_v, dt_ps);
        columns.clear_of_noise([0, 1, 2].map(|k| self.values[k] / shots as f64));
        let mut sd_v = vec![0.0; mean_v.len()];
        columns.variances(&self.values, &mut sd_v);
        sd_v.iter_mut().for_each(|value| *value = value.sqrt());
        sd_v
    }
}

/// The terms at each sample, and what they are made of.
struct Columns {
    /// Size of the level, and its square with the mean's own noise in it.
    level: Vec<f64>,
    square: Vec<f64>,
    /// Square of the slope with that noise in it, and how much a variance of 1 of the mean's samples adds.
    rise: Vec<f64>,
    gain: Vec<f64>,
    /// Both squares without.
    clear_square: Vec<f64>,
    clear_rise: Vec<f64>,
}

impl Columns {
    fn of(mean_v: &[f64], dt_ps: f64) -> Self {
        let len = mean_v.len();
        let (mut rise, mut gain) = (vec![0.0; len], vec![0.0; len]);
        // Differences over eight samples follow the slope's square of a pulse of 1.5 samples' sd to 2 %; over four they
        // would miss 8 %.
        for weights in [[-0.5, 0.0, 0.5].as_slice(), &WIDE] {
            let (before, per_ps2) = (weights.len() / 2, 1.0 / (dt_ps * dt_ps));
            let of_noise: f64 = weights.iter().map(|w| w * w).sum();
            for (n, values) in mean_v.windows(weights.len()).enumerate() {
                let slope: f64 = values.iter().zip(weights).map(|(v, w)| v * w).sum();
                (rise[n + before], gain[n + before]) = (slope * slope * per_ps2, of_noise * per_ps2);
            }
        }
        let square: Vec<f64> = mean_v.iter().map(|v| v * v).collect();
        let level = mean_v.iter().map(|v| v.abs()).collect();
        Self { level, clear_square: square.clone(), square, clear_rise: rise.clone(), rise, gain }
    }

    /// Takes the mean's own variance off the squares, that of a model of constant, level and its square.
    fn clear_of_noise(&mut self, [constant, level, square]: [f64; 3]) {
        widest(|| {
            let made_of = self.level.iter().zip(&self.square).zip(self.rise.iter().zip(&self.gain));
            let clear = self.clear_square.iter_mut().zip(&mut self.clear_rise);
            for ((clear_square, clear_rise), ((v, v2), (rise, gain))) in clear.zip(made_of) {
                let own = constant + level * v + square * v2;
                *clear_square = (v2 - own).max(0.0);
                *clear_rise = (rise - gain * own).max(0.0);
            }
        });
    }

    /// Variance of each sample by the model.
    fn variances(&self, values: &[f64; TERMS], out: &mut [f64]) {
        let [constant, of_level, of_square, of_rise] = *values;
        widest(|| {
            let terms = self.level.iter().zip(&self.clear_square).zip(&self.clear_rise);
            for (out, ((level, square), rise)) in out.iter_mut().zip(terms) {
                *out = constant + of_level * level + of_square * square + of_rise * rise;
            }
        });
    }
}

/// Normal equations of one round.
struct Equations {
    matrix: [[f64; TERMS]; TERMS],
    right: [f64; TERMS],
    /// Weighted square of the right side.
    square: f64,
}

impl Equations {
    fn of(columns: &Columns, right: &[f64], weights: &[f64]) -> Self {
        let Columns { level, clear_square, clear_rise, .. } = columns;
        let [weight, level, square, rise, right] =
            [weights, level, clear_square, clear_rise, right].map(|column| column.as_chunks::<LANES>());
        let mut sums = [[0.0; LANES]; SUMS];
        widest(|| {
            let terms = level.0.iter().zip(square.0).zip(rise.0);
            for ((weight, right), ((level, square), rise)) in weight.0.iter().zip(right.0).zip(terms) {
                add_products(&mut sums, weight, [&[1.0; LANES], level, square, rise], right);
            }
        });
        let [weight, level, square, rise, right] = [weight.1, level.1, square.1, rise.1, right.1].map(|rest| {
            let mut lanes = [0.0; LANES];
            lanes[..rest.len()].copy_from_slice(rest);
            lanes
        });
        add_products(&mut sums, &weight, [&[1.0; LANES], &level, &square, &rise], &right);
        let mut sums = sums.iter().map(|lanes| lanes.iter().sum::<f64>());
        let mut next = || sums.next().expect("as many as were added up");
        let mut matrix = [[0.0; TERMS]; TERMS];
        for i in 0..TERMS {
            for j in 0..=i {
                matrix[i][j] = next();
                matrix[j][i] = matrix[i][j];
            }
        }
        Self { matrix, right: std::array::from_fn(|_| next()), square: next() }
    }

    /// The best of all least-squares fits on a part of the terms whose values are not negative: the optimum of the
    /// bounded problem is among them.
    fn solve(&self, rows: usize) -> Option<NoiseModel> {
        let mut best: Option<(f64, usize, NoiseModel)> = None;
        for set in (1..1_usize << TERMS).rev() {
            let Some((values, covariance)) = self.solve_of(set) else { continue };
            let explained: f64 = values.iter().zip(&self.right).map(|(value, right)| value * right).sum();
            let chi2 = (self.square - explained).max(0.0);
            if values.iter().all(|value| *value >= 0.0) && best.as_ref().is_none_or(|(best, ..)| chi2 < *best) {
                let dof = rows - set.count_ones() as usize;
                best = Some((chi2, set, NoiseModel { values, covariance, chi2_per_dof: chi2 / dof.max(1) as f64 }));
            }
            // Nothing is better than all terms.
            if best.as_ref().is_some_and(|(_, set, _)| *set == (1 << TERMS) - 1) {
                break;
            }
        }
        best.map(|(.., model)| model)
    }

    /// Values and covariance of the terms in `set`, the others 0; `None` where the samples do not determine each of
    /// them.
    fn solve_of(&self, set: usize) -> Option<([f64; TERMS], [[f64; TERMS]; TERMS])> {
        let is_in = |k: usize| set >> k & 1 == 1;
        let scale: [f64; TERMS] = std::array::from_fn(|k| self.matrix[k][k].sqrt());
        if (0..TERMS).any(|k| is_in(k) && (scale[k] == 0.0 || !scale[k].is_finite())) {
            return None;
        }
        // Terms that are left out keep the row of a unit matrix.
        let (mut scaled, mut inverse) = ([0.0; TERMS * TERMS], [0.0; TERMS * TERMS]);
        for (at, value) in scaled.iter_mut().enumerate() {
            let (i, j) = (at / TERMS, at % TERMS);
            *value = if is_in(i) && is_in(j) {
                self.matrix[i][j] / (scale[i] * scale[j])
            } else {
                f64::from(u8::from(i == j))
            };
        }
        invert(&mut scaled, &mut inverse)?;
        let (mut values, mut covariance) = ([0.0; TERMS], [[0.0; TERMS]; TERMS]);
        for (i, j) in (0..TERMS * TERMS).map(|at| (at / TERMS, at % TERMS)).filter(|(i, j)| is_in(*i) && is_in(*j)) {
            covariance[i][j] = inverse[i * TERMS + j] / (scale[i] * scale[j]);
            values[i] += covariance[i][j] * self.right[j];
        }
        Some((values, covariance))
    }
}

/// Sums side by side, added up at the end: a fixed order that the processor may work on several at a time.
const LANES: usize = 4;
/// Sums of a round: the lower half of the matrix row by row, the right side, its square.
const SUMS: usize = TERMS * (TERMS + 1) / 2 + TERMS + 1;

#[inline]
fn add_products(
    sums: &mut [[f64; LANES]; SUMS],
    weight: &[f64; LANES],
    terms: [&[f64; LANES]; TERMS],
    right: &[f64; LANES],
) {
    let weighted = terms.map(|term| product(weight, term));
    let weighted_right = product(weight, right);
    let mut at = 0;
    let mut add = |a: &[f64; LANES], b: &[f64; LANES]| {
        sums[at].iter_mut().zip(product(a, b)).for_each(|(sum, product)| *sum += product);
        at += 1;
    };
    for i in 0..TERMS {
        (0..=i).for_each(|j| add(&weighted[i], terms[j]));
    }
    terms.iter().for_each(|term| add(&weighted_right, term));
    add(&weighted_right, right);
}

#[inline]
fn product(a: &[f64; LANES], b: &[f64; LANES]) -> [f64; LANES] {
    std::array::from_fn(|lane| a[lane] * b[lane])
}

#[cfg(test)]
mod tests;
