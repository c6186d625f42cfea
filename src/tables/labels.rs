//! Table `labels`: which path of light made which onset.

use super::cell::Name;
use crate::table;

table! {
    /// An onset and a path that may have made it.
    "labels": Label, LabelColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Vertical range whose delay the times have, where captures were taken at several.
        range: Option<Name>,
        /// Rank of the onset in its profile.
        rank: i32,
        /// Time of flight, laser periods added.
        time_ps: f64,
        /// Standard deviation of the time, the profile's common jitter included.
        time_sd_ps: f64,
        /// Laser periods added to the onset's time.
        turns: i32,
        /// Bounces of the path (0: left unexplained).
        bounces: i32,
        /// Patches in the order the light met them, lit first, seen last; null: left unexplained.
        path: Option<Vec<i32>>,
        /// Measured minus predicted time, where patches are known.
        residual_ps: Option<f64>,
        /// Probability of this label.
        probability: f64,
        /// 0 for the best label of its onset, 1, 2... for others.
        alternative: i32,
    }
}
