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

use std::ops::Range;

use super::regression::invert;
use super::sums::sum;
use super::widest::widest;

/// Terms of the model.
pub const TERMS: usize = 4;
/// Rounds of reweighting after which the fit is taken as it is.
const ROUNDS: usize = 100;
/// The fit has settled when no coefficient changes by more than this share of its standard deviation.
const SETTLED: f64 = 1e-3;
/// Derivative over eight steps, exact for polynomials of order 8.
const WIDE: [f64; 9] = [1.0 / 280.0, -4.0 / 105.0, 0.2, -0.8, 0.0, 0.8, -0.2, 4.0 / 105.0, -1.0 / 280.0];
/// Samples that it reaches to either side.
const REACH: usize = WIDE.len() / 2;
/// Derivative over two steps.
const NARROW: [f64; 3] = [-0.5, 0.0, 0.5];
/// A model variance is not taken below this share of the mean variance: its inverse square is a weight, and one sample
/// must not decide the fit.
const FLOOR: f64 = 1e-6;
/// Samples that go through a round together.
const STRETCH: usize = 256;

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
    let mean = sum(&variances) / used.max(1) as f64;
    if used < TERMS || mean <= 0.0 {
        return None;
    }
    let mut columns = Columns::of(spread.mean_v, spread.dt_ps);
    // 1 for a sample that counts, 0 for one to be ignored.
    let finite: Vec<f64> = spread.variance_v2.iter().map(|v| f64::from(u8::from(v.is_finite()))).collect();
    let mut model: Option<NoiseModel> = None;
    for _ in 0..ROUNDS {
        let mut sums = Sums::default();
        // Stretch by stretch: all columns together exceed the nearest cache.
        for start in (0..len).step_by(STRETCH) {
            let places = start..len.min(start + STRETCH);
            let mut weights = [mean; STRETCH];
            let weights = &mut weights[..places.len()];
            if let Some(model) = &model {
                columns.variances(places.clone(), &model.values, weights);
            }
            spread.weigh(&finite[places.clone()], FLOOR * mean, weights);
            let smooth = model.as_ref().map_or([mean, 0.0, 0.0], |model| [0, 1, 2].map(|k| model.values[k]));
            columns.clear_of_noise(places.clone(), smooth.map(|value| value / spread.shots as f64));
            sums.add(&columns, places.clone(), &variances[places], weights);
        }
        let next = sums.equations().solve(used)?;
        let settled = model.as_ref().is_some_and(|old| {
            (0..TERMS).all(|k| (next.values[k] - old.values[k]).abs() <= SETTLED * next.covariance[k][k].sqrt())
        });
        model = Some(next);
        if settled {
            break;
        }
    }
    model
}

impl Spread<'_> {
    /// Weights of samples in place of their variances by the model, of which none is taken below `least`: the inverse
    /// variance of a variance over shots.
    fn weigh(&self, finite: &[f64], least: f64, weights: &mut [f64]) {
        let half_freedom = 0.5 * (self.shots - 1) as f64;
        widest(
            #[inline(always)]
            || {
                for (weight, one) in weights.iter_mut().zip(finite) {
                    let variance = weight.max(least);
                    *weight = one * half_freedom / (variance * variance);
                }
            },
        );
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
        columns.clear_of_noise(0..mean_v.len(), [0, 1, 2].map(|k| self.values[k] / shots as f64));
        let mut sd_v = vec![0.0; mean_v.len()];
        columns.variances(0..mean_v.len(), &self.values, &mut sd_v);
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
        // would miss 8 %. The ends have neighbours for differences over two alone.
        let width = len.min(REACH + 1);
        for end in [0..width, len - width..len] {
            squared_slopes(&mean_v[end.clone()], NARROW, dt_ps, &mut rise[end.clone()], &mut gain[end]);
        }
        squared_slopes(mean_v, WIDE, dt_ps, &mut rise, &mut gain);
        let square: Vec<f64> = mean_v.iter().map(|v| v * v).collect();
        let level = mean_v.iter().map(|v| v.abs()).collect();
        Self { level, clear_square: square.clone(), square, clear_rise: rise.clone(), rise, gain }
    }

    /// Takes the mean's own variance off the squares, that of a model of constant, level and its square.
    fn clear_of_noise(&mut self, places: Range<usize>, [constant, level, square]: [f64; 3]) {
        let [levels, squares, rises, gains] =
            [&self.level, &self.square, &self.rise, &self.gain].map(|column| &column[places.clone()]);
        let clear = self.clear_square[places.clone()].iter_mut().zip(&mut self.clear_rise[places.clone()]);
        widest(
            #[inline(always)]
            || {
                let made_of = levels.iter().zip(squares).zip(rises.iter().zip(gains));
                for ((clear_square, clear_rise), ((v, v2), (rise, gain))) in clear.zip(made_of) {
                    let own = constant + level * v + square * v2;
                    *clear_square = (v2 - own).max(0.0);
                    *clear_rise = (rise - gain * own).max(0.0);
                }
            },
        );
    }

    /// Variance of each sample by the model.
    fn variances(&self, places: Range<usize>, values: &[f64; TERMS], out: &mut [f64]) {
        let [constant, of_level, of_square, of_rise] = *values;
        let [levels, squares, rises] =
            [&self.level, &self.clear_square, &self.clear_rise].map(|column| &column[places.clone()]);
        widest(
            #[inline(always)]
            || {
                let terms = levels.iter().zip(squares).zip(rises);
                for (out, ((level, square), rise)) in out.iter_mut().zip(terms) {
                    *out = constant + of_level * level + of_square * square + of_rise * rise;
                }
            },
        );
    }
}

/// Squares of the slope at the places that have all neighbours which the `weights` take, and how much a variance of 1
/// of the samples adds.
fn squared_slopes<const WIDTH: usize>(
    mean_v: &[f64],
    weights: [f64; WIDTH],
    dt_ps: f64,
    rise: &mut [f64],
    gain: &mut [f64],
) {
    let count = (mean_v.len() + 1).saturating_sub(WIDTH);
    let (places, per_ps2) = (WIDTH / 2..WIDTH / 2 + count, 1.0 / (dt_ps * dt_ps));
    if count == 0 {
        return;
    }
    let of_noise: f64 = weights.iter().map(|w| w * w).sum();
    gain[places.clone()].fill(of_noise * per_ps2);
    let rise = &mut rise[places];
    widest(
        #[inline(always)]
        || {
            for (rise, neighbours) in rise.iter_mut().zip(mean_v.array_windows::<WIDTH>()) {
                let mut slope = 0.0;
                for k in 0..WIDTH {
                    slope += neighbours[k] * weights[k];
                }
                *rise = slope * slope * per_ps2;
            }
        },
    );
}

/// Normal equations of one round.
struct Equations {
    matrix: [[f64; TERMS]; TERMS],
    right: [f64; TERMS],
    /// Weighted square of the right side.
    square: f64,
}

/// Sums of products over samples, lanes apart: those of the matrix, row by row, of the right side and its square.
#[derive(Default)]
struct Sums([[f64; LANES]; SUMS]);

impl Sums {
    /// Adds the samples at these places. What follows them is added after they were: all but the last are a multiple of
    /// the lanes.
    fn add(&mut self, columns: &Columns, places: Range<usize>, right: &[f64], weights: &[f64]) {
        let Self(sums) = self;
        let terms = [&columns.level, &columns.clear_square, &columns.clear_rise].map(|column| &column[places.clone()]);
        let [weight, level, square, rise, right] =
            [weights, terms[0], terms[1], terms[2], right].map(|column| column.as_chunks::<LANES>());
        widest(
            #[inline(always)]
            || {
                // The compiler keeps what is its own in registers.
                let mut own = *sums;
                let terms = level.0.iter().zip(square.0).zip(rise.0);
                for ((weight, right), ((level, square), rise)) in weight.0.iter().zip(right.0).zip(terms) {
                    add_products(&mut own, weight, [&[1.0; LANES], level, square, rise], right);
                }
                *sums = own;
            },
        );
        if weight.1.is_empty() {
            return;
        }
        let [weight, level, square, rise, right] = [weight.1, level.1, square.1, rise.1, right.1].map(|rest| {
            let mut lanes = [0.0; LANES];
            lanes[..rest.len()].copy_from_slice(rest);
            lanes
        });
        add_products(sums, &weight, [&[1.0; LANES], &level, &square, &rise], &right);
    }

    fn equations(&self) -> Equations {
        let mut sums = self.0.iter().map(|lanes| lanes.iter().sum::<f64>());
        let mut next = || sums.next().expect("as many as were added up");
        let mut matrix = [[0.0; TERMS]; TERMS];
        for i in 0..TERMS {
            for j in 0..=i {
                matrix[i][j] = next();
                matrix[j][i] = matrix[i][j];
            }
        }
        Equations { matrix, right: std::array::from_fn(|_| next()), square: next() }
    }
}

impl Equations {
    /// The best of all least-squares fits on a part of the terms whose values are not negative: the optimum of the
    /// bounded problem is among them.
    fn solve(&self, rows: usize) -> Option<NoiseModel> {
        let mut best: Option<(f64, NoiseModel)> = None;
        let mut solved: Vec<usize> = Vec::with_capacity(1 << TERMS);
        for set in (1..1_usize << TERMS).rev() {
            // No part of the terms is better than all of them.
            if solved.iter().any(|of_more| of_more & set == set) {
                continue;
            }
            let Some((values, covariance)) = self.solve_of(set) else { continue };
            if !values.iter().all(|value| *value >= 0.0) {
                continue;
            }
            solved.push(set);
            let explained: f64 = values.iter().zip(&self.right).map(|(value, right)| value * right).sum();
            let chi2 = (self.square - explained).max(0.0);
            if best.as_ref().is_none_or(|(best, _)| chi2 < *best) {
                let dof = rows - set.count_ones() as usize;
                best = Some((chi2, NoiseModel { values, covariance, chi2_per_dof: chi2 / dof.max(1) as f64 }));
            }
        }
        best.map(|(_, model)| model)
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

#[allow(clippy::inline_always, reason = "else it stays on narrow vectors")]
#[inline(always)]
fn add_products(
    sums: &mut [[f64; LANES]; SUMS],
    weight: &[f64; LANES],
    terms: [&[f64; LANES]; TERMS],
    right: &[f64; LANES],
) {
    for lane in 0..LANES {
        let (weight, right) = (weight[lane], right[lane]);
        let mut at = 0;
        for i in 0..TERMS {
            let weighted = weight * terms[i][lane];
            for term in &terms[..=i] {
                sums[at][lane] += weighted * term[lane];
                at += 1;
            }
        }
        let weighted = weight * right;
        for term in terms {
            sums[at][lane] += weighted * term[lane];
            at += 1;
        }
        sums[at][lane] += weighted * right;
    }
}

#[cfg(test)]
mod tests;
