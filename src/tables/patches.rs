//! Table `patches`: where the surfaces are.

use super::cell::Name;
use crate::table;

table! {
    /// Position of one patch with its covariance. Table `fits` gives the frame. If anchors, rays and separate stations
    /// fix it, it is the campaign's. Otherwise it is canonical: the first patch on +x from the laser, the next that is
    /// clearly off that line in the xy plane at y > 0, the next that is clearly off that plane at z > 0 (the data do
    /// not distinguish mirror images); covariances exclude the three rotations of the visible patches about the laser.
    /// With stations on a line, the first patch off that line is towards +y (else +z), and covariances exclude the
    /// rotation about the line.
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
        /// Variance of x; null for a start value.
        cov_xx_m2: Option<f64>,
        /// Covariance of x and y; null for a start value.
        cov_xy_m2: Option<f64>,
        /// Covariance of x and z; null for a start value.
        cov_xz_m2: Option<f64>,
        /// Variance of y; null for a start value.
        cov_yy_m2: Option<f64>,
        /// Covariance of y and z; null for a start value.
        cov_yz_m2: Option<f64>,
        /// Variance of z; null for a start value.
        cov_zz_m2: Option<f64>,
        /// Root of the sum of the three variances; null for a start value.
        sd_m: Option<f64>,
        /// Onsets that determine its position.
        onsets: i32,
        /// Chi-square of the whole solution over its degrees of freedom; null for a start value.
        chi2_dof: Option<f64>,
        /// 0 for the best solution; higher for other solutions that the data allow, such as a mirror image.
        alternative: i32,
        /// Log-likelihood of the solution, up to a constant; null for a start value.
        log_likelihood: Option<f64>,
        /// Share of the likelihood among all places of this patch, 1 where there is one; null where likelihoods were
        /// not compared.
        probability: Option<f64>,
    }
}

table! {
    /// Covariance between the positions of two patches; that of a patch with itself is in `patches`.
    "patch_covariances": PatchCovariance, PatchCovarianceColumns {
        /// Patch of the rows.
        a: i32,
        /// Patch of the columns, larger than a.
        b: i32,
        /// Covariance of x of a and x of b.
        cov_xx_m2: f64,
        /// Covariance of x of a and y of b.
        cov_xy_m2: f64,
        /// Covariance of x of a and z of b.
        cov_xz_m2: f64,
        /// Covariance of y of a and x of b.
        cov_yx_m2: f64,
        /// Covariance of y of a and y of b.
        cov_yy_m2: f64,
        /// Covariance of y of a and z of b.
        cov_yz_m2: f64,
        /// Covariance of z of a and x of b.
        cov_zx_m2: f64,
        /// Covariance of z of a and y of b.
        cov_zy_m2: f64,
        /// Covariance of z of a and z of b.
        cov_zz_m2: f64,
        /// 0 for the best solution; higher for others as in `patches`, which have only pairs with a patch that they
        /// move.
        alternative: i32,
    }
}
