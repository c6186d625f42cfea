//! Table `surface_points`: points of hidden surfaces, from the first light at each point of a wall.

use super::cell::Name;
use crate::table;

table! {
    /// A point of a hidden surface whose light begins to arrive at a pair of points of the wall. Errors of neighbouring
    /// points are common in part: a mean over them is less sure than their number says.
    "surface_points": SurfacePoint, SurfacePointColumns {
        /// Lit patch of the wall.
        lit: i32,
        /// Seen patch of the wall.
        seen: i32,
        /// 1: of first light; 2 and more: of light that rises again, of a thing or a part behind, or of light that has
        /// weaker light before it.
        rank: i32,
        /// Position, x, in the frame of the patches.
        x_m: f64,
        /// Position, y.
        y_m: f64,
        /// Position, z.
        z_m: f64,
        /// Covariance of the position, x with x: noise, the law of first light, bias of the window.
        cov_xx_m2: f64,
        /// Covariance of the position, x with y.
        cov_xy_m2: f64,
        /// Covariance of the position, x with z.
        cov_xz_m2: f64,
        /// Covariance of the position, y with y.
        cov_yy_m2: f64,
        /// Covariance of the position, y with z.
        cov_yz_m2: f64,
        /// Covariance of the position, z with z.
        cov_zz_m2: f64,
        /// Root of the sum of the three variances.
        sd_m: f64,
        /// Unit vector away from the surface, x: its normal where `kind` is smooth, else the direction to the wall.
        normal_x: f64,
        /// The same, y.
        normal_y: f64,
        /// The same, z.
        normal_z: f64,
        /// Covariance of the normal, x with x.
        normal_cov_xx: f64,
        /// Covariance of the normal, x with y.
        normal_cov_xy: f64,
        /// Covariance of the normal, x with z.
        normal_cov_xz: f64,
        /// Covariance of the normal, y with y.
        normal_cov_yy: f64,
        /// Covariance of the normal, y with z.
        normal_cov_yz: f64,
        /// Covariance of the normal, z with z.
        normal_cov_zz: f64,
        /// smooth: the surface faces the wall; edge; corner, or a thing that is small in all directions; unknown.
        kind: Name,
        /// Larger curvature of the surface, positive where it is convex; of smooth points of confocal captures.
        curvature_max_per_m: Option<f64>,
        /// Smaller curvature.
        curvature_min_per_m: Option<f64>,
        /// Pairs of points of the wall that entered, about: those that are joined are counted by their mean number.
        wall_points: i32,
        /// Chi-square of their first returns over its degrees of freedom.
        misfit: f64,
        /// Length of first light under the law that edges nearby set: half of its way there and back; of a lit point
        /// apart, its way from there over the surface.
        light_m: f64,
        /// Standard deviation of its noise, and of the error that each place has for itself.
        light_sd_m: f64,
        /// Standard deviation of the error of that law, a smooth random function over the wall.
        light_law_sd_m: f64,
        /// Length on the wall over which the correlation of that error falls as a Gaussian.
        light_zone_m: f64,
        /// Standard deviation of the error that all first light of a scan has in common.
        light_common_sd_m: f64,
        /// Probability that light of the neighbourhood comes from edges or corners, by how it rises, where lengths show
        /// neither: of steps whose edges lie in a plane.
        edges: f64,
        /// Shape of `shapes` that the point lies on; null where there is none, and before `shape`.
        shape: Option<i32>,
    }
}
