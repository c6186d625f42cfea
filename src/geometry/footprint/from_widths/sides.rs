//! Light comes from the side of a patch that it goes to.

use nalgebra::{Matrix3, Vector3};

use super::Fit;

/// Both legs of a bounce leave the patch to one side, by at least this cosine: there is little light along a patch.
const ALONG: f64 = 0.05;
/// Standard deviation of the cosine that is short of it.
const SHORT_SD: f64 = 0.033;
/// What one bounce adds to chi-square, and all of one patch, at most.
const THROUGH: f64 = 9.0;
const THROUGH_MAX: f64 = 25.0;

impl Fit<'_> {
    /// What the bounces of a patch add to chi-square whose legs are on both sides of it, or nearly so.
    pub(super) fn through(&self, patch: usize, vector_m: Vector3<f64>) -> f64 {
        if self.is_translucent {
            return 0.0;
        }
        let of_bounce = |(_, short): (Vector3<f64>, f64)| f64::min(short * short, THROUGH);
        f64::min(self.short(patch, vector_m).map(of_bounce).sum(), THROUGH_MAX)
    }

    /// Normal matrix and right-hand side of [`Self::through`] for a patch's vector.
    pub(super) fn side_equations(&self, patch: usize, vector_m: Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
        let (mut normal, mut slope) = (Matrix3::zeros(), Vector3::zeros());
        let is_constant = self.is_translucent || self.through(patch, vector_m) >= THROUGH_MAX;
        let Some(along) = vector_m.try_normalize(0.0).filter(|_| !is_constant) else { return (normal, slope) };
        for (leg, short) in self.short(patch, vector_m).filter(|(_, short)| short * short < THROUGH) {
            let gradient = (leg - leg.dot(&along) * along) / (SHORT_SD * vector_m.norm());
            normal += gradient * gradient.transpose();
            slope += short * gradient;
        }
        (normal, slope)
    }

    /// Of each bounce that is short of being on one side of a patch: the leg that is, as it should turn the normal, and
    /// by how many standard deviations of its cosine.
    fn short(&self, patch: usize, vector_m: Vector3<f64>) -> impl Iterator<Item = (Vector3<f64>, f64)> {
        let normal = vector_m.try_normalize(0.0).unwrap_or_default();
        self.bounces(patch).filter_map(move |bounce| {
            let heights = bounce.legs.map(|leg| leg.dot(&normal));
            let lower = usize::from(heights[1].abs() < heights[0].abs());
            let side = heights[1 - lower].signum();
            let short = (ALONG - side * heights[lower]) / SHORT_SD;
            (short > 0.0).then(|| (side * bounce.legs[lower], short))
        })
    }
}
