//! Drift of a delay that path lengths show by themselves: a random walk through the time of their capture, and whether
//! the lengths ask for one.
//!
//! Steps of a walk are independent, and their variance is the time that they take. Between times at which the walk is
//! known, it is a Brownian bridge. So steps between knots are errors that lengths have in common
//! ([`crate::maximum_likelihood::Observation::common`]): nothing is left out where each capture has a knot, and lengths
//! of one capture share its place of the walk. How large these errors are, in comparison to those of single lengths, is
//! told by the marginal likelihood. Of a solution with such errors, the covariance P and the values c say what every
//! other size would explain. With the eigenvalues p of P, the values c along its directions, and errors s times as
//! large,
//!
//! ```text
//! -2 ln L(s) = Q(s) / v + f ln v + sum ln(1 + s^2 (1/p - 1)) + constant
//! Q(s)       = loss + sum c^2 / p - sum s^2 (c/p)^2 / (1 + s^2 (1/p - 1))
//! ```
//!
//! with f degrees of freedom. To decide whether there is a drift, the factor v on all variances is Q / f where that is
//! above 1: lengths that scatter more than they say, in any order, are no drift. But stated errors are seldom wrong by
//! far: that v is not 1 costs `(ln v)^2` more, as if its logarithm had the standard deviation 1. How large the drift
//! is follows with v = 1: what residuals exceed, the drift has to explain.

use std::ops::Range;

use crate::dense;
use crate::maximum_likelihood::Solution;

/// Most knots of a walk.
pub const KNOTS: usize = 129;

/// Sizes that are compared: powers of 2 by eighths, from `2^-8` to `2^5` of that of the solution.
const FINENESS: f64 = 8.0;
const EIGHTHS: Range<i32> = -64..41;

/// A random walk from 0 at its first knot on, with variance 1 after a unit of time.
#[derive(Clone, Debug)]
pub struct Walk {
    /// Times, ascending.
    knots: Vec<f64>,
}

impl Walk {
    /// With knots at these times, in any order; of more than [`KNOTS`], at every so many. `None` where all are one.
    #[must_use]
    pub fn through(times: &[f64]) -> Option<Self> {
        let mut times = times.to_vec();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let last = times.len().checked_sub(1).filter(|last| *last > 0)?;
        let steps = last.min(KNOTS - 1);
        Some(Self { knots: (0..=steps).map(|knot| times[knot * last / steps]).collect() })
    }

    /// Times of the knots.
    #[must_use]
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// What one standard deviation of each step adds to the walk at a time between its first and last knot.
    #[must_use]
    pub fn terms(&self, time: f64) -> Vec<f64> {
        let steps = self.knots.windows(2).take_while(|step| step[0] < time);
        steps.map(|step| ((time - step[0]) / (step[1] - step[0])).min(1.0) * (step[1] - step[0]).sqrt()).collect()
    }

    /// Variance of the walk at such a time that its steps leave.
    #[must_use]
    pub fn variance_left(&self, time: f64) -> f64 {
        let next = self.knots.partition_point(|knot| *knot < time).clamp(1, self.knots.len() - 1);
        let [from, to] = [self.knots[next - 1], self.knots[next]];
        ((time - from) * (to - time) / (to - from)).max(0.0)
    }
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

    /// Log-likelihood of errors `scale` times as large as the solution has them, less that of none; both with the
    /// factor on all variances that suits them best.
    #[must_use]
    pub fn gain(&self, scale: f64) -> f64 {
        0.5 * (self.cost(self.chi2) - self.cost(self.chi2_of(scale)) - self.volume(scale))
    }

    /// Chi-square with errors of this scale.
    fn chi2_of(&self, scale: f64) -> f64 {
        let square = scale * scale;
        let explained = |[information, slope]: &[f64; 2]| square * slope / (1.0 + square * information);
        self.chi2 - self.directions.iter().map(explained).sum::<f64>()
    }

    /// By how much such errors widen the distribution of all lengths: twice the logarithm of its volume.
    fn volume(&self, scale: f64) -> f64 {
        self.directions.iter().map(|[information, _]| (scale * scale * information).ln_1p()).sum()
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
        let scales = || EIGHTHS.map(|eighths| (f64::from(eighths) / FINENESS).exp2());
        let gain = scales().map(|scale| self.gain(scale)).fold(f64::NEG_INFINITY, f64::max);
        let log_likelihoods: Vec<f64> =
            scales().map(|scale| -0.5 * (self.chi2_of(scale) + self.volume(scale))).collect();
        let most = log_likelihoods.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (mut weights, mut squares) = (0.0, 0.0);
        for (scale, log_likelihood) in scales().zip(log_likelihoods) {
            let weight = (log_likelihood - most).exp();
            weights += weight;
            squares += weight * scale * scale;
        }
        ((squares / weights).sqrt(), gain)
    }
}

#[cfg(test)]
mod tests;
