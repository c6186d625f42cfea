//! Where else a hidden patch may be.

use super::Hidden;
use super::explanation::Explanation;
use crate::{Point, planes};

/// Another place with a log-likelihood ratio of less than this cannot be ruled out.
const LIKELY: f64 = 9.0;
/// Places within this many standard deviations are one.
const APART: f64 = 4.0;

impl Explanation<'_> {
    /// The mirror image of a patch in the plane nearest to the foci, which lengths to patches of one wall do not tell
    /// from it. Where the foci are far from any plane, nothing is near the image and there is no rival.
    pub(super) fn rival(&self, n: usize) -> Option<Hidden> {
        let now = self.surfaces[n];
        let foci: Vec<Point> = self.room.foci.iter().map(|focus| focus.point).collect();
        let (middle, normal) = planes::nearest(&foci, self.room.dimensions);
        let image = now.point - 2.0 * normal.dot(&(now.point - middle)) * normal;
        let left = self.left_for(n);
        let rival = self.hidden(self.view(now.surface, &left, now.seen).climb(image), now.seen)?;
        let widest_m = rival.covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
        let is_elsewhere = (rival.point - now.point).norm() > APART * widest_m;
        (is_elsewhere && rival.evidence > now.evidence - LIKELY && self.domain.holds(rival.point, 0.0)).then_some(rival)
    }
}
