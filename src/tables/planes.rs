//! Tables `planes`: planes through groups of patches, and `footprints`: what light comes from around their centres.

use super::cell::Name;
use crate::table;

table! {
    /// A plane through patches: all points p with normal . p = offset_m, in the frame of the patches.
    "planes": Plane, PlaneColumns {
        /// Number, from 1, in order of decreasing number of patches; user-defined groups keep their order.
        plane: i32,
        /// Patches on it, ascending.
        patches: Vec<i32>,
        /// Unit normal, x; it points away from the frame's origin.
        normal_x: f64,
        /// Unit normal, y.
        normal_y: f64,
        /// Unit normal, z.
        normal_z: f64,
        /// Distance of the plane from the frame's origin.
        offset_m: f64,
        /// Largest standard deviation of the normal's two angles.
        normal_sd_rad: f64,
        /// Standard deviation of the offset.
        offset_sd_m: f64,
        /// Root mean square of the patches' distances from the plane.
        rms_m: f64,
        /// Patch farthest from the plane.
        farthest: i32,
        /// Its distance from the plane, negative on the origin's side.
        farthest_m: f64,
        /// Sum of the patches' squared distances, each over its variance; below the degrees of freedom where patches
        /// share errors.
        chi2: f64,
        /// Number of patches minus the plane's three parameters.
        degrees_of_freedom: i32,
        /// Angle between the plane and plane 1, at most a right angle; null for plane 1.
        tilt_rad: Option<f64>,
        /// Standard deviation of that angle, without errors that rotate both planes alike.
        tilt_sd_rad: Option<f64>,
    }
}

table! {
    /// Size and direction of a patch, as the widths of its pulses or campaign.toml give them: a flat disk.
    "footprints": PatchFootprint, PatchFootprintColumns {
        /// Patch.
        patch: i32,
        /// Diameter.
        size_m: f64,
        /// Unit normal, x, in the frame of the patches; its sign does not matter.
        normal_x: f64,
        /// Unit normal, y.
        normal_y: f64,
        /// Unit normal, z.
        normal_z: f64,
        /// Standard deviation of the normal's direction; 0 where it was given.
        normal_sd_rad: f64,
        /// Standard deviation of the diameter.
        size_sd_m: f64,
        /// Covariance of the normal times the diameter, x by x; 0 where both were given. Widths give the angle between
        /// the normal and the light much better than the rotation about the light.
        cov_xx_m2: f64,
        /// Covariance of the normal times the diameter, x by y.
        cov_xy_m2: f64,
        /// Covariance of the normal times the diameter, x by z.
        cov_xz_m2: f64,
        /// Covariance of the normal times the diameter, y by y.
        cov_yy_m2: f64,
        /// Covariance of the normal times the diameter, y by z.
        cov_yz_m2: f64,
        /// Covariance of the normal times the diameter, z by z.
        cov_zz_m2: f64,
        /// campaign (`size_m` of campaign.toml, the normal of a plane or of campaign.toml), or widths (of the patch's
        /// onsets).
        source: Name,
    }
}
