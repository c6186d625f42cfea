//! Table `shapes`: what the points of hidden surfaces lie on.

use super::cell::Name;
use crate::table;

table! {
    /// A plane, sphere or cylinder that points of a wall see first. A wall shows no more of it than its points in
    /// `points` of the same stage.
    "shapes": Shape, ShapeColumns {
        /// Number, from 1, in order of decreasing number of points of the wall.
        shape: i32,
        /// plane, sphere or cylinder.
        kind: Name,
        /// Middle of a sphere; of a plane or an axis the point next to the middle of what is seen of it. x, in the
        /// frame of the patches.
        x_m: f64,
        /// The same, y.
        y_m: f64,
        /// The same, z.
        z_m: f64,
        /// Covariance of that place, x with x; of planes and axes across them alone.
        cov_xx_m2: f64,
        /// Covariance, x with y.
        cov_xy_m2: f64,
        /// Covariance, x with z.
        cov_xz_m2: f64,
        /// Covariance, y with y.
        cov_yy_m2: f64,
        /// Covariance, y with z.
        cov_yz_m2: f64,
        /// Covariance, z with z.
        cov_zz_m2: f64,
        /// Root of the sum of the three variances.
        sd_m: f64,
        /// Normal of a plane, towards the wall; direction of a cylinder's axis. x; null for spheres.
        axis_x: Option<f64>,
        /// The same, y.
        axis_y: Option<f64>,
        /// The same, z.
        axis_z: Option<f64>,
        /// Largest standard deviation of the axis's two angles.
        axis_sd_rad: Option<f64>,
        /// Radius of a sphere or a cylinder.
        radius_m: Option<f64>,
        /// Its standard deviation.
        radius_sd_m: Option<f64>,
        /// Points of the wall that show it.
        wall_points: i32,
        /// Logarithm of how much likelier this kind is on their first light than the next one.
        evidence: f64,
        /// Chi-square of their first light over its degrees of freedom, with what lengths have in common.
        misfit: f64,
        /// Root mean square of what their first light is off.
        rms_m: f64,
    }
}
