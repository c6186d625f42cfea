//! Errors of vectors by the profile likelihood: how far a coordinate goes while all else settles after it.

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::{Fit, LEAST_SD, MOST_SD};

/// An error is half of how far a coordinate goes until chi-square has risen by four.
const RISE: f64 = 4.0;
const SIGMA: f64 = 2.0;
/// Trials go on by this factor, until chi-square has risen enough, and settle in so many steps.
const FURTHER: f64 = 1.6;
const TRIALS: usize = 6;
const STEPS: usize = 6;
/// Variance of what goes with the square of a normal coordinate, over its square two standard deviations off.
const BENT: f64 = 3.0 / 16.0;
/// Minima that are nearer to one another than this share of a vector's length are one.
const SAME: f64 = 0.25;
/// How near a coordinate is held to its place, as a share of how far off that is.
const HELD: f64 = 0.02;

/// One coordinate of a patch's vector, held at a place.
#[derive(Clone, Copy)]
pub(super) struct Held {
    pub(super) patch: usize,
    /// Unit vector.
    pub(super) axis: Vector3<f64>,
    pub(super) at_m: f64,
    pub(super) sd_m: f64,
}

impl Held {
    /// How far the coordinate is short of its place, in standard deviations.
    pub(super) fn short(&self, vectors_m: &[Vector3<f64>]) -> f64 {
        (self.at_m - self.axis.dot(&vectors_m[self.patch])) / self.sd_m
    }
}

impl Fit<'_> {
    /// Errors of a patch's vector as shares of its length, where `errors` (columns) are those to first order: along
    /// each as far as the likelihood says, where that is further. Widths in few directions tell little more than how
    /// large a patch looks from there, and directions far apart explain them about as well.
    pub(super) fn profiled(
        &self,
        open: &[usize],
        patch: usize,
        errors: &Matrix3<f64>,
        cancel: &Cancel,
    ) -> Matrix3<f64> {
        let mut covariance = Matrix3::zeros();
        for column in errors.column_iter() {
            let sd = column.norm();
            let axis = column.normalize();
            let reach = |side: f64| self.reach(open, patch, &(side * axis), sd, cancel);
            let (along, aside) = [reach(-1.0), reach(1.0)].into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("two");
            let own = (along / SIGMA).min(MOST_SD).max(sd);
            covariance += own * own * axis * axis.transpose() + BENT * aside * aside.transpose();
        }
        covariance += self.between_minima(open, patch, cancel);
        let principal = covariance.symmetric_eigen();
        let sds = principal.eigenvalues.map(|variance| variance.max(0.0).sqrt().clamp(LEAST_SD, MOST_SD));
        principal.eigenvectors * Matrix3::from_diagonal(&sds)
    }

    /// Second moment of a patch's vector about where it is, as a share of its squared length, where other minima are
    /// about as likely.
    fn between_minima(&self, open: &[usize], patch: usize, cancel: &Cancel) -> Matrix3<f64> {
        let (at_m, least) = (self.vectors_m[patch], self.total(open));
        let (mut moment, mut all) = (Matrix3::zeros(), 1.0);
        let mut seen = vec![Vector3::zeros()];
        for other in self.turns(open, patch, cancel) {
            let vector_m = other.vectors_m[patch];
            let moved = (at_m.dot(&vector_m).signum() * vector_m - at_m) / at_m.norm();
            let likelihood = (0.5 * (least - other.total(open)).min(0.0)).exp();
            if seen.iter().all(|before: &Vector3<f64>| (moved - before).norm() > SAME) {
                moment += likelihood * moved * moved.transpose();
                all += likelihood;
                seen.push(moved);
            }
        }
        moment / all
    }

    /// How far a patch's vector goes along `axis` until chi-square has risen by four, and by how much it goes aside
    /// meanwhile, both as shares of its length; `sd` to begin with.
    fn reach(
        &self,
        open: &[usize],
        patch: usize,
        axis: &Vector3<f64>,
        sd: f64,
        cancel: &Cancel,
    ) -> (f64, Vector3<f64>) {
        let (length_m, least) = (self.vectors_m[patch].norm(), self.total(open));
        let mut fit = self.clone();
        let (mut share, mut last) = (SIGMA * sd, (0.0, 0.0));
        for _ in 0..TRIALS {
            let at_m = axis.dot(&self.vectors_m[patch]) + share * length_m;
            let short_m = at_m - axis.dot(&fit.vectors_m[patch]);
            fit.vectors_m[patch] += short_m * axis;
            fit.held = Some(Held { patch, axis: *axis, at_m, sd_m: HELD * share * length_m });
            fit.descend_together(open, STEPS, cancel);
            fit.held = None;
            let moved = (fit.vectors_m[patch] - self.vectors_m[patch]) / length_m;
            let along = axis.dot(&moved);
            // Grows linearly with the distance, as far as the likelihood is normal.
            let risen = (fit.total(open) - least).max(0.0).sqrt();
            let aside = moved - along * axis;
            if risen >= RISE.sqrt() {
                let (before, low) = last;
                let reach = before + (along - before) * (RISE.sqrt() - low) / (risen - low);
                return (reach, aside * (reach / along).powi(2));
            }
            if share >= SIGMA * MOST_SD {
                return (along, aside);
            }
            last = (along, risen);
            share = f64::min(FURTHER * share, SIGMA * MOST_SD);
        }
        (last.0, Vector3::zeros())
    }
}
