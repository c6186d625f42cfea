//! Table `hypotheses`: hidden patches and planes that the program searched for.

use super::cell::Name;
use crate::table;

table! {
    /// A hidden patch or plane that explains signal which nothing else does (`label` searches among onsets, `search` in
    /// whole profiles), or the likeliest place of one more patch whose evidence did not suffice.
    "hypotheses": Hypothesis, HypothesisColumns {
        /// Number, from 1, in order of decreasing evidence.
        hypothesis: i32,
        /// `patch`, or `plane`: a floor, a wall or a mirror that reflects light from one visible patch to the other.
        kind: Name,
        /// 1: visible patches show it, in third bounces; 2: only hidden patches do, in fifth bounces.
        layer: i32,
        /// Number of the patch; null for a plane, or if the evidence did not suffice.
        patch: Option<i32>,
        /// 0: the chosen place; 1: its mirror image in the wall of the patches that show it, which the onsets do not
        /// exclude.
        alternative: i32,
        /// Position, x, in the frame of `patches`; for a plane, the foot of the perpendicular from the middle of the
        /// visible patches.
        x_m: f64,
        /// Position, y.
        y_m: f64,
        /// Position, z.
        z_m: f64,
        /// Variance of x, given the positions of the patches that show it.
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
        /// Unit normal of a plane, towards the visible patches, x; null for a patch.
        normal_x: Option<f64>,
        /// Unit normal, y.
        normal_y: Option<f64>,
        /// Unit normal, z.
        normal_z: Option<f64>,
        /// Natural log of the Bayes factor of this patch or plane over none.
        evidence: f64,
        /// Evidence required to accept it: minus the log of `false_alarm`.
        evidence_needed: f64,
        /// Share of the profiles (in layer 2: of the paths) in which it is seen.
        seen: f64,
        /// Expected number of its onsets.
        onsets: f64,
        /// Shots per capture at which nine of ten campaigns would accept a declined patch, if it exists; null for an
        /// accepted one, and where only onsets were searched.
        shots_needed: Option<f64>,
        /// Hours of a campaign with this many shots; null where the captures have no times.
        hours_needed: Option<f64>,
    }
}
