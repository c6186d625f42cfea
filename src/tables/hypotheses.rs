//! Table `hypotheses`: hidden patches and planes that were looked for.

use super::cell::Name;
use crate::table;

table! {
    /// A hidden patch or plane that was found in light which nothing else explains (by `label` among onsets, by `search` in whole profiles), or the likeliest place for one more patch
    /// that was not sure enough.
    "hypotheses": Hypothesis, HypothesisColumns {
        /// Number, from 1: the surest first.
        hypothesis: i32,
        /// `patch`, or `plane`: a floor, a wall or a mirror that throws light on from one visible patch to the other.
        kind: Name,
        /// 1: visible patches show it, in third bounces; 2: only hidden ones do, in fifth bounces.
        layer: i32,
        /// Number of the patch; null: declined, or a plane.
        patch: Option<i32>,
        /// 0: the chosen place; 1: its mirror image in the wall that shows it, which the onsets do not rule out.
        alternative: i32,
        /// Position, x, in the frame of the patches beside; of a plane the foot of the perpendicular from the middle of the visible patches.
        x_m: f64,
        /// Position, y.
        y_m: f64,
        /// Position, z.
        z_m: f64,
        /// Variance of x, patches that show it taken as they are.
        cov_xx_m2: f64,
        /// Covariance of x and y.
        cov_xy_m2: f64,
        /// Covariance of x and z.
        cov_xz_m2: f64,
        /// Variance of y.
        cov_yy_m2: f64,
        /// Covariance of y and z.
        cov_yz_m2: f64,
        /// Variance of z.
        cov_zz_m2: f64,
        /// Root of the sum of the three variances.
        sd_m: f64,
        /// Unit normal of a plane towards the visible patches, x; null for a patch.
        normal_x: Option<f64>,
        /// Unit normal, y.
        normal_y: Option<f64>,
        /// Unit normal, z.
        normal_z: Option<f64>,
        /// Natural log of the Bayes factor of this patch or plane over none.
        evidence: f64,
        /// What it must exceed: minus the log of `false_alarm`.
        evidence_needed: f64,
        /// Share of the profiles (in layer 2 of the paths) in which it is seen.
        seen: f64,
        /// Onsets that it makes, expected.
        onsets: f64,
        /// Shots a capture that would show a declined patch in nine of ten campaigns, if it is one; null for what was found, and where onsets alone were looked at.
        shots_needed: Option<f64>,
        /// Hours that a campaign of so many shots takes; null where the captures' times are not known.
        hours_needed: Option<f64>,
    }
}
