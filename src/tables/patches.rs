//! Table `patches`: where the surfaces are.

use super::row::Name;
use crate::table;

table! {
    /// Position of one patch with its covariance, in the frame that the table's metadata states.
    "patches": Patch, PatchColumns {
        /// Patch.
        patch: i32,
        /// visible, hidden or mirror.
        kind: Name,
        /// Position, x.
        x_m: f64,
        /// Position, y.
        y_m: f64,
        /// Position, z.
        z_m: f64,
        /// Variance of x.
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
        /// Onsets that its position rests on.
        onsets: i32,
        /// Chi-square of the whole solution over its degrees of freedom; null for a start value.
        chi2_dof: Option<f64>,
        /// 0 for the best solution; others where the data leave a choice, such as a mirror image.
        alternative: i32,
        /// Log-likelihood of the solution, up to a constant; null for a start value.
        log_likelihood: Option<f64>,
    }
}
