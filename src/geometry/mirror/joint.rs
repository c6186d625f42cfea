//! Maximum likelihood over mirror, beams, folded lengths, stations and delays, by Gauss-Newton.
//!
//! The reflected beam ends on the diffuser by construction (`D` is the mirror image of `Q`). So the diffuser point's
//! given position is a measurement of `D`, as the arrivals are of the length; no constraint needs a weight. Errors of
//! what is given count as normal.

use nalgebra::Matrix3;
use thiserror::Error;

use super::closed_forms::from_beams;
use super::unknowns::{Layout, Slopes, State};
use super::{Experiment, Mirror};
use crate::dense::{Definite, product};
use crate::{Matrix, Point};

/// Most steps.
const STEPS: usize = 100;
/// Halvings of a step.
const HALVINGS: usize = 30;
/// A step that lowers chi-square by less is the last.
const SETTLED: f64 = 1e-9;

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Unsolved {
    /// No mirror to start from.
    #[error("the beams lead straight to the diffuser points, within their errors: nothing turns them")]
    Straight,
    /// Something is not determined.
    #[error("the scans leave the mirror undetermined")]
    Undetermined,
    /// Steps do not end.
    #[error("no mirror explains the scans: the search did not settle")]
    NotSettled,
}

/// The likeliest mirror.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The mirror.
    pub mirror: Mirror,
    /// Where each beam meets it.
    pub points: Vec<Point>,
    /// Where each beam meets the diffuser.
    pub diffuser: Vec<Point>,
    /// Sum of squared residuals in standard deviations, priors included.
    pub chi2: f64,
    /// Measurements and priors less unknowns; 0 for one scan, which nothing checks.
    pub degrees_of_freedom: usize,
    /// Covariance of points, diffuser points, normal (three rows each) and offset.
    covariance: Matrix,
}

impl Solution {
    /// Covariance of two places in m^2: mirror points first, then diffuser points.
    #[must_use]
    pub fn covariance_m2(&self, a: usize, b: usize) -> Matrix3<f64> {
        Matrix3::from_fn(|i, k| self.covariance[(3 * a + i, 3 * b + k)])
    }

    /// Covariance of the mirror's normal.
    #[must_use]
    pub fn normal_covariance(&self) -> Matrix3<f64> {
        self.covariance_m2(2 * self.points.len(), 2 * self.points.len())
    }

    /// Standard deviation of the mirror's offset.
    #[must_use]
    pub fn offset_sd_m(&self) -> f64 {
        let last = self.covariance.nrows() - 1;
        self.covariance[(last, last)].sqrt()
    }
}

/// The mirror that explains all scans best.
///
/// # Errors
/// When nothing turns the beams, something is undetermined, or the search does not end.
///
/// # Panics
/// Without scans, or where something has no standard deviation.
pub fn solve(experiment: &Experiment) -> Result<Solution, Unsolved> {
    let layout = Layout::new(experiment);
    let mut state = State::new(experiment, from_beams(experiment).ok_or(Unsolved::Straight)?);
    let mut chi2 = layout.chi2(&state);
    for _ in 0..STEPS {
        experiment.cancel.check();
        let (fisher, right) = layout.normal_equations(&state);
        let factored = Definite::new(&fisher).ok_or(Unsolved::Undetermined)?;
        let mut step = Matrix::from_fn(right.len(), 1, |i, _| right[i]);
        factored.solve(&mut step);
        let gain: f64 = right.iter().enumerate().map(|(i, right)| right * step[(i, 0)]).sum();
        if gain < SETTLED * (1.0 + chi2) {
            return solution(&layout, &state, chi2, &factored.inverse()).ok_or(Unsolved::NotSettled);
        }
        let part = (0..HALVINGS).map(|halvings| 0.5_f64.powi(halvings as i32));
        let tried = part.map(|part| layout.moved(&state, |i| part * step[(i, 0)]));
        let better = tried.map(|trial| (layout.chi2(&trial), trial)).find(|(trial_chi2, _)| *trial_chi2 < chi2);
        (chi2, state) = better.ok_or(Unsolved::NotSettled)?;
    }
    Err(Unsolved::NotSettled)
}

/// What the unknowns say of points, diffuser points and mirror; `None` where a beam does not meet the mirror on its
/// way.
fn solution(layout: &Layout, state: &State, chi2: f64, inverse: &Matrix) -> Option<Solution> {
    let (dimensions, scans) = (layout.experiment.dimensions, layout.experiment.scans.len());
    let points: Option<Vec<_>> = (0..scans).map(|scan| layout.point(state, scan)).collect();
    let (points, diffuser) = (points?, (0..scans).map(|scan| layout.diffuser(state, scan)));
    let (places, levers): (Vec<Point>, Vec<Slopes>) = points.into_iter().chain(diffuser).unzip();
    let mut slopes = Matrix::zeros(6 * scans + 4, layout.count());
    for (row, lever) in levers.iter().chain([&layout.normal(state)]).enumerate() {
        for (unknown, slope) in lever {
            (0..3).for_each(|k| slopes[(3 * row + k, *unknown)] = slope[k]);
        }
    }
    slopes[(6 * scans + 3, layout.offset())] = 1.0;
    let arrivals: usize = layout.experiment.scans.iter().map(|scan| scan.arrivals.len()).sum();
    Some(Solution {
        mirror: state.mirror,
        points: places[..scans].to_vec(),
        diffuser: places[scans..].to_vec(),
        chi2,
        degrees_of_freedom: arrivals + (dimensions - 1) * scans - dimensions,
        covariance: product(product(slopes.as_ref(), inverse.as_ref()).as_ref(), slopes.transpose()),
    })
}
