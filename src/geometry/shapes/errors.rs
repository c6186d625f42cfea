//! Errors of first light over a wall: noise of each place, and smooth random functions that neighbours share.

use faer::Mat;

use super::Sighting;
use super::core::{UNKNOWNS, Unknowns};
use super::grow::Member;
use crate::dense::Definite;
use crate::waves::waves;

/// A smooth random function over the wall: a Gaussian process of this length, whose standard deviation each place has.
pub struct Smooth {
    pub length_m: f64,
    pub sd_m: Box<dyn Fn(&Sighting) -> f64>,
}

/// Covariance of the lengths of some sightings: noise, what all have in common, and smooth functions as sums of waves.
pub struct Errors {
    /// Over the variance of each.
    precision: Vec<f64>,
    /// Waves, one a column, times their standard deviations.
    waves: Mat<f64>,
    /// Covariance of the waves' heights, inverse.
    heights: Definite,
    /// Logarithm of the determinant of the covariance.
    pub log_determinant: f64,
}

impl Errors {
    /// With noise larger by a factor. `None` if a variance is no number.
    pub fn new(members: &[Member<'_>], scatter: f64, smooth: &[Smooth]) -> Option<Self> {
        let mut variances: Vec<f64> = members.iter().map(|one| (scatter * one.sighting.light.sd_m).powi(2)).collect();
        let mut columns: Vec<Vec<f64>> = vec![members.iter().map(|one| one.sighting.light.common_m).collect()];
        for function in smooth {
            let sds_m: Vec<f64> = members.iter().map(|one| (function.sd_m)(one.sighting)).collect();
            let along = |axis: usize| members.iter().map(|one| one.wall[axis]).collect::<Vec<f64>>();
            let [x, y] = [0, 1].map(|axis| waves(&along(axis), function.length_m));
            let mut left: Vec<f64> = vec![1.0; members.len()];
            for along in &x {
                for up in &y {
                    let column: Vec<f64> = along.iter().zip(up).map(|(a, b)| a * b).collect();
                    left.iter_mut().zip(&column).for_each(|(left, wave)| *left -= wave * wave);
                    columns.push(column.iter().zip(&sds_m).map(|(wave, sd_m)| wave * sd_m).collect());
                }
            }
            for ((variance, left), sd_m) in variances.iter_mut().zip(left).zip(&sds_m) {
                *variance += left.max(0.0) * sd_m * sd_m;
            }
        }
        let precision: Vec<f64> = variances.iter().map(|variance| 1.0 / variance).collect();
        let waves = Mat::from_fn(members.len(), columns.len(), |row, column| columns[column][row]);
        let scaled = Mat::from_fn(waves.nrows(), waves.ncols(), |i, j| waves[(i, j)] * precision[i].sqrt());
        let mut information = crate::dense::product(scaled.transpose(), scaled.as_ref());
        (0..information.nrows()).for_each(|k| information[(k, k)] += 1.0);
        let heights = Definite::of(information)?;
        let log_determinant = heights.log_determinant() + variances.iter().map(|variance| variance.ln()).sum::<f64>();
        log_determinant.is_finite().then_some(Self { precision, waves, heights, log_determinant })
    }

    /// Columns times the inverse of the covariance.
    fn over(&self, columns: &Mat<f64>) -> Mat<f64> {
        let scaled = Mat::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)] * self.precision[i]);
        let mut heights = crate::dense::product(self.waves.transpose(), scaled.as_ref());
        self.heights.solve(&mut heights);
        let shared = crate::dense::product(self.waves.as_ref(), heights.as_ref());
        Mat::from_fn(columns.nrows(), columns.ncols(), |i, j| scaled[(i, j)] - shared[(i, j)] * self.precision[i])
    }

    /// Chi-square of residuals, and information and gradient of the unknowns with these slopes.
    pub fn information(&self, residuals_m: &[f64], slopes: &[Unknowns]) -> (f64, Mat<f64>, Vec<f64>) {
        let columns =
            Mat::from_fn(slopes.len(), UNKNOWNS + 1, |i, j| if j < UNKNOWNS { slopes[i][j] } else { residuals_m[i] });
        let over = self.over(&columns);
        let all = crate::dense::product(columns.transpose(), over.as_ref());
        let gradient = (0..UNKNOWNS).map(|k| all[(k, UNKNOWNS)]).collect();
        (all[(UNKNOWNS, UNKNOWNS)], Mat::from_fn(UNKNOWNS, UNKNOWNS, |i, j| all[(i, j)]), gradient)
    }
}
