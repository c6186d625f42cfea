//! A solution: positions, delays, common errors, and how sure they are.

use std::ops::Range;

use faer::Mat;
use nalgebra::Matrix3;

use super::by_chance;
use super::problem::Observation;
use super::rows::{Layout, Values};
use crate::Point;

/// The solution.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Positions of the patches.
    pub points: Vec<Point>,
    /// Positions of the stations.
    pub stations: Vec<Point>,
    /// Delays, as lengths.
    pub delays_m: Vec<f64>,
    /// What the laser's period is longer than its nominal length.
    pub period_m: f64,
    /// Errors that observations have in common, in their standard deviations.
    pub common: Vec<f64>,
    /// Residual of each observation: measured minus predicted length.
    pub residuals_m: Vec<f64>,
    /// Of each observation, the variance of its predicted length: near its own variance, nothing else checks it. Not
    /// known without the normal matrix, and for paths over open patches infinite.
    pub predicted_variance_m2: Option<Vec<f64>>,
    /// Sum of squared standardised residuals, priors included.
    pub chi2: f64,
    /// The same with large residuals counted linearly where the problem asked for it: what was minimised.
    pub loss: f64,
    /// Measurements and priors less unknowns, what nothing determines given back.
    pub degrees_of_freedom: i64,
    /// Factor on variances where the model does not explain the measurements, else 1: that of an M-estimator.
    pub misfit: f64,
    /// Patches that are joined by paths, largest part first.
    pub parts: Vec<Vec<usize>>,
    /// Rotations of each part that no measurement determines.
    pub free_rotations: Vec<usize>,
    /// Patches that can move freely, rotations of their part apart; they have no covariance.
    pub open: Vec<usize>,
    pub(super) layout: Layout,
    pub(super) covariance: Covariance,
}

/// Of the unknowns.
#[derive(Clone, Debug)]
pub enum Covariance {
    /// Of all unknowns.
    Exact(Mat<f64>),
    /// Of each patch, and of all unknowns that are no coordinates of patches.
    Blocks(Vec<Matrix3<f64>>, Mat<f64>),
}

impl Solution {
    /// Covariance of the coordinates of two patches; in flatland z has none. Of two patches of a matrix-free solution
    /// it is not known, and zero here.
    #[must_use]
    pub fn patch_covariance_m2(&self, a: usize, b: usize) -> Matrix3<f64> {
        match &self.covariance {
            Covariance::Exact(covariance) => {
                let (a, b) = (self.layout.patch(a).start, self.layout.patch(b).start);
                block(covariance, a, b, self.layout.dimensions)
            }
            Covariance::Blocks(blocks, _) if a == b => blocks[a],
            Covariance::Blocks(..) => Matrix3::zeros(),
        }
    }

    /// Covariance of a station's coordinates; zero for an exact one.
    #[must_use]
    pub fn station_covariance_m2(&self, station: usize) -> Matrix3<f64> {
        let Some(at) = self.layout.stations[station] else {
            return Matrix3::zeros();
        };
        match &self.covariance {
            Covariance::Exact(covariance) => block(covariance, at, at, self.layout.dimensions),
            Covariance::Blocks(_, others) => {
                let at = at - self.layout.coordinates;
                block(others, at, at, self.layout.dimensions)
            }
        }
    }

    /// Measured less predicted lengths of observations of the same stations, patches and delays.
    #[must_use]
    pub fn residuals_of_m(&self, observations: &[Observation]) -> Vec<f64> {
        let values = Values {
            points: self.points.clone(),
            stations: self.stations.clone(),
            delays_m: self.delays_m.clone(),
            period_m: self.period_m,
            common: self.common.clone(),
        };
        observations.iter().map(|observation| values.residual_m(observation)).collect()
    }

    /// Variance of a delay.
    #[must_use]
    pub fn delay_variance_m2(&self, delay: usize) -> f64 {
        self.variance_m2(self.layout.delays + delay)
    }

    /// Variance of the laser's period; `None` if the period is exact or no observation depends on it.
    #[must_use]
    pub fn period_variance_m2(&self) -> Option<f64> {
        self.layout.period.map(|at| self.variance_m2(at))
    }

    /// Covariance of common errors by their numbers, in their standard deviations.
    ///
    /// # Panics
    /// When there is none of one of these numbers.
    #[must_use]
    pub fn common_covariance(&self, errors: Range<usize>) -> Mat<f64> {
        let first = self.layout.common + errors.start;
        Mat::from_fn(errors.len(), errors.len(), |i, k| self.covariance_m2(first + i, first + k))
    }

    /// What a delay and common errors add to a length, and the variance of that. Errors that no observation has add
    /// their own variance.
    #[must_use]
    pub fn addition_m(&self, delay: Option<usize>, common: &[(usize, f64)]) -> (f64, f64) {
        let (of_observations, others): (Vec<_>, Vec<_>) =
            common.iter().partition(|(error, _)| *error < self.common.len());
        let of_delay = delay.map(|delay| (self.layout.delays + delay, 1.0));
        let of_errors = of_observations.iter().map(|(error, each_m)| (self.layout.common + error, *each_m));
        let terms: Vec<(usize, f64)> = of_delay.into_iter().chain(of_errors).collect();
        let pairs = terms.iter().flat_map(|a| terms.iter().map(move |b| (a, b)));
        let variance_m2: f64 = pairs.map(|(&(i, a), &(k, b))| a * self.covariance_m2(i, k) * b).sum();
        let sum_m: f64 = of_observations.iter().map(|(error, each_m)| self.common[*error] * each_m).sum();
        let delay_m = delay.map_or(0.0, |delay| self.delays_m[delay]);
        (delay_m + sum_m, variance_m2 + others.iter().map(|(_, each_m)| each_m * each_m).sum::<f64>())
    }

    fn variance_m2(&self, at: usize) -> f64 {
        self.covariance_m2(at, at)
    }

    /// Of two unknowns that are no coordinates of patches.
    fn covariance_m2(&self, a: usize, b: usize) -> f64 {
        match &self.covariance {
            Covariance::Exact(covariance) => covariance[(a, b)],
            Covariance::Blocks(_, others) => others[(a - self.layout.coordinates, b - self.layout.coordinates)],
        }
    }

    /// Whether residuals are larger than chance makes them where the model is right.
    #[must_use]
    pub fn exceeds_chance(&self) -> bool {
        self.loss > by_chance(self.degrees_of_freedom as f64)
    }

    /// Whether covariances are those of the whole Fisher matrix, not of its blocks.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        matches!(self.covariance, Covariance::Exact(_))
    }

    /// Patches without a place among the others: those that can move, and small parts that turn on their own. (Of a
    /// part of less than three patches, in flatland two, so little is fixed that it has no shape.)
    #[must_use]
    pub fn unplaced(&self) -> Vec<usize> {
        let loose = self.parts.iter().zip(&self.free_rotations).skip(1);
        let loose = loose.filter(|(part, free)| **free > 0 && part.len() < self.layout.dimensions);
        let mut unplaced: Vec<usize> = loose.flat_map(|(part, _)| part.iter().copied()).collect();
        unplaced.extend(&self.open);
        unplaced.sort_unstable();
        unplaced.dedup();
        unplaced
    }

    /// Number of unknowns.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.layout.size
    }
}

fn block(matrix: &Mat<f64>, a: usize, b: usize, dimensions: usize) -> Matrix3<f64> {
    Matrix3::from_fn(|i, k| if i < dimensions && k < dimensions { matrix[(a + i, b + k)] } else { 0.0 })
}
