//! Drift of a delay that path lengths show by themselves: a random walk through the time of their capture, and whether
//! the lengths ask for one.
//!
//! A walk that begins at 0 and has variance 1 at the end of its span is a sum of sines with independent coefficients of
//! variance 1 (Karhunen and Loève; Loève, Probability Theory, 1955), `t` from 0 to 1:
//!
//! ```text
//! w(t) = sum_k c_k sqrt(2) sin((k - 1/2) pi t) / ((k - 1/2) pi),   k = 1, 2...
//! ```
//!
//! So the first [`TERMS`] coefficients are errors that lengths have in common
//! ([`crate::maximum_likelihood::Observation::common`]). How large they are, in comparison to the errors of single
//! lengths, is told by the marginal likelihood. Of a solution with such errors, the covariance P and the values c say
//! what every other size would explain. With the eigenvalues p of P, the values c along its directions, and errors s
//! times as large,
//!
//! ```text
//! -2 ln L(s) = Q(s) / v + f ln v + sum ln(1 + s^2 (1/p - 1)) + constant
//! Q(s)       = loss + sum c^2 / p - sum s^2 (c/p)^2 / (1 + s^2 (1/p - 1))
//! ```
//!
//! with f degrees of freedom. The factor v on all variances is Q / f where that is above 1: lengths that scatter more
//! than they say, in any order, are no drift. But stated errors are seldom wrong by far: that v is not 1 costs
//! `(ln v)^2` more, as if its logarithm had the standard deviation 1.

use std::f64::consts::{PI, SQRT_2};
use std::ops::Range;

use crate::dense;
use crate::maximum_likelihood::Solution;

/// Terms of a walk.
pub const TERMS: usize = 64;

/// Sizes that are compared: powers of 2 by eighths, from `2^-8` to `2^5` of that of the solution.
const FINENESS: f64 = 8.0;
const EIGHTHS: Range<i32> = -64..41;

/// What one standard deviation of each term adds to a walk, at a place from 0 (its begin) to 1 (its end).
#[must_use]
pub fn terms(place: f64) -> [f64; TERMS] {
    std::array::from_fn(|k| {
        let frequency = (k as f64 + 0.5) * PI;
        SQRT_2 * (frequency * place).sin() / frequency
    })
}

/// Variance of a walk at a place that its [`TERMS`] leave.
#[must_use]
pub fn variance_left(place: f64) -> f64 {
    (place - terms(place).iter().map(|term| term * term).sum::<f64>()).max(0.0)
}

/// What a solution with common errors says of their size.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Chi-square of a solution without these errors.
    chi2: f64,
    degrees_of_freedom: f64,
    /// Independent directions of the errors: what the lengths know of one, and its squared slope.
    directions: Vec<[f64; 2]>,
}

impl Evidence {
    /// Of common errors by their numbers; `None` where nothing checks the solution.
    #[must_use]
    pub fn new(solution: &Solution, errors: Range<usize>) -> Option<Self> {
        if solution.degrees_of_freedom < 1 {
            return None;
        }
        let errors = errors.start..errors.end.min(solution.common.len());
        let values = solution.common.get(errors.clone())?;
        let (variances, vectors) = dense::symmetric_eigen(&solution.common_covariance(errors));
        let mut chi2 = solution.loss;
        let mut directions = Vec::new();
        for (k, variance) in variances.into_iter().enumerate() {
            let variance = variance.clamp(f64::EPSILON, 1.0);
            let along: f64 = values.iter().enumerate().map(|(i, value)| vectors[(i, k)] * value).sum();
            chi2 += along * along / variance;
            directions.push([1.0 / variance - 1.0, (along / variance).powi(2)]);
        }
        Some(Self { chi2, degrees_of_freedom: solution.degrees_of_freedom as f64, directions })
    }

    /// Log-likelihood of errors `scale` times as large as the solution has them, less that of none.
    #[must_use]
    pub fn gain(&self, scale: f64) -> f64 {
        let square = scale * scale;
        let sum = |value: &dyn Fn(f64, f64) -> f64| {
            self.directions.iter().map(|&[information, slope]| value(information, slope)).sum::<f64>()
        };
        let explained = sum(&|information, slope| square * slope / (1.0 + square * information));
        let volume = sum(&|information, _| (square * information).ln_1p());
        0.5 * (self.cost(self.chi2) - self.cost(self.chi2 - explained) - volume)
    }

    /// Of a chi-square, with the factor on all variances that it asks for.
    fn cost(&self, chi2: f64) -> f64 {
        let factor = (chi2 / self.degrees_of_freedom).max(1.0);
        chi2 / factor + self.degrees_of_freedom * factor.ln() + factor.ln().powi(2)
    }

    /// How much larger the errors are than the solution has them, and the largest gain. Of all sizes that the lengths
    /// allow, each in proportion to its likelihood, the root of the mean square: errors are not too small where few
    /// lengths know their size.
    #[must_use]
    pub fn size(&self) -> (f64, f64) {
        let sizes: Vec<(f64, f64)> = EIGHTHS
            .map(|eighths| (f64::from(eighths) / FINENESS).exp2())
            .map(|scale| (scale, self.gain(scale)))
            .collect();
        let most = sizes.iter().map(|(_, gain)| *gain).fold(f64::NEG_INFINITY, f64::max);
        let (mut weights, mut squares) = (0.0, 0.0);
        for (scale, gain) in sizes {
            let weight = (gain - most).exp();
            weights += weight;
            squares += weight * scale * scale;
        }
        ((squares / weights).sqrt(), most)
    }
}

#[cfg(test)]
mod tests;
