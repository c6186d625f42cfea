//! Observations that contradict the others, though they be many.
//!
//! Huber's loss bears some gross errors, but not a fifth of all lengths too long at once. That happens where the first
//! light of many pairs took a detour that no captured pair reveals. From a start on, the lengths are weighted by
//! `(c^2 / (c^2 + z^2))^2`, `z` their residuals in standard deviations. `c` shrinks from thrice the median residual to
//! [`LAST`]: at first most lengths count, in the end only those that agree. Source: graduated non-convexity with Geman
//! and McClure's loss, Yang, Antonante, Tzoumas and Carlone, IEEE Robotics and Automation Letters 5, 1127 (2020).

use super::rows::Values;
use super::{Observation, Problem, approach};
use crate::Point;
use crate::loss::Loss;

/// What `c` ends at, and the factor from round to round.
const LAST: f64 = 3.0;
const FACTOR: f64 = 0.7;
/// Rounds at the end.
const LAST_ROUNDS: usize = 3;
/// Steps of a round.
const STEPS: usize = 6;
const SETTLED_M: f64 = 1e-7;
/// Residuals beyond this many standard deviations contradict the rest.
const CONTRADICTS: f64 = 6.0;

/// Which observations contradict the others, and positions that explain those, from the best of some places; `None`
/// where leaving some out explains no more than `points` do.
#[must_use]
pub fn outliers(problem: &Problem, points: &[Point], from: &[&[Point]]) -> Option<(Vec<bool>, Vec<Point>)> {
    let start = |points: &[Point]| Values::start(&Problem { start: points.to_vec(), ..problem.clone() });
    let (values, z) = from
        .iter()
        .map(|points| graduated(problem, start(points)))
        .min_by(|a, b| contradiction(&a.1).total_cmp(&contradiction(&b.1)))?;
    let outliers: Vec<bool> = z.iter().map(|z| z.abs() > CONTRADICTS).collect();
    let before = contradiction(&standardised(problem, &start(points)));
    (contradiction(&z) < before && outliers.contains(&true)).then_some((outliers, values.points))
}

fn standardised(problem: &Problem, values: &Values) -> Vec<f64> {
    problem.observations.iter().map(|observation| values.residual_m(observation) / observation.sd_m).collect()
}

/// Where shrinking weights lead from a place, with the residuals there.
fn graduated(problem: &Problem, from: Values) -> (Values, Vec<f64>) {
    let mut values = from;
    let mut z = standardised(problem, &values);
    let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let mut scale = (3.0 * sizes[sizes.len() / 2]).max(LAST);
    let mut left = LAST_ROUNDS;
    while left > 0 {
        let weighted = |(observation, z): (&Observation, &f64)| Observation {
            sd_m: observation.sd_m * (1.0 + (z / scale).powi(2)),
            ..observation.clone()
        };
        let round = Problem {
            start: values.points,
            observations: problem.observations.iter().zip(&z).map(weighted).collect(),
            loss: Loss::Squared,
            ..problem.clone()
        };
        values = approach(&round, STEPS, SETTLED_M).0;
        z = standardised(problem, &values);
        left -= usize::from(scale <= LAST);
        scale = (scale * FACTOR).max(LAST);
    }
    (values, z)
}

/// Squared residuals, those of observations that contradict the rest counted as if they just did.
fn contradiction(z: &[f64]) -> f64 {
    z.iter().map(|z| (z * z).min(CONTRADICTS * CONTRADICTS)).sum()
}
