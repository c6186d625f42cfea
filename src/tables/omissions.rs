//! Table `omissions`: points of a wall of which `surface_points` has no row, and why.

use super::cell::Name;
use crate::table;

table! {
    /// A pair of points of the wall without a point of a hidden surface.
    "omissions": Omission, OmissionColumns {
        /// Lit patch of the wall.
        lit: i32,
        /// Seen patch of the wall.
        seen: i32,
        /// no-rise: no light rises by the threshold; untimed: when it began is not determined; earlier-light: with the
        /// histograms of its neighbours there is light before it, too weak to be timed; no-field: neighbouring points
        /// of the wall do not agree on one surface, or are too few; no-scan: its pair is in no scan; no-noise: the
        /// levels do not vary.
        reason: Name,
        /// Length of the light that was found, as of a surface without an edge near: as `light_m` of `surface_points`;
        /// null where none was timed. Of earlier-light it is that of a surface behind.
        light_m: Option<f64>,
        /// Standard deviation of its noise.
        light_sd_m: Option<f64>,
    }
}
