//! Table `predictions`: light that a solution predicts in each profile.

use super::cell::Name;
use crate::table;

table! {
    /// The light of one path in one profile, as a solution predicts it.
    "predictions": Prediction, PredictionColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Vertical range whose delay applies to the times, where captures were recorded at several.
        range: Option<Name>,
        /// Patches in the order in which the light meets them: lit first, seen last.
        path: Vec<i32>,
        /// Time of flight of the centroid of its light.
        time_ps: f64,
        /// Standard deviation of the time, by the errors of patches and delay.
        time_sd_ps: f64,
        /// Standard deviation of the spread of its light over the patches of the path, as far as these have footprints.
        width_ps: f64,
        /// Standard deviation of the width; null where the size of a patch is not known.
        width_sd_ps: Option<f64>,
    }
}
