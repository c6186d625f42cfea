//! Tables `delays` and `residuals`: what a solver found beside the patches.

use super::row::Name;
use crate::table;

table! {
    /// Delay of one sensor that is left after calibration, as the solver found it.
    "delays": Delay, DelayColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Delay found.
        delay_ps: f64,
        /// Its standard deviation.
        sd_ps: f64,
        /// Standard deviation that calibration allowed it.
        prior_sd_ps: f64,
    }
}

table! {
    /// What one labelled onset has left over after the solution.
    "residuals": Residual, ResidualColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Rank of the onset in its profile.
        rank: i32,
        /// Path of the label.
        path: Vec<i32>,
        /// Measured minus predicted time.
        residual_ps: f64,
        /// Standard deviation of the measured time.
        sd_ps: f64,
        /// Residual in standard deviations.
        standardised: f64,
        /// Beyond four standard deviations: a label to doubt.
        suspect: bool,
    }
}
