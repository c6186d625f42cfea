//! Table `checks`: what the runs of an instrument check say of the instrument.

use super::cell::Name;
use crate::table;

table! {
    /// One check of one sensor: what was found, what was expected, and the verdict.
    "checks": Check, CheckColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Name of the check.
        check: Name,
        /// What was found; null where captures are missing.
        value: Option<f64>,
        /// Unit of value, sd, expected and tolerance.
        unit: Name,
        /// Standard deviation of the value.
        sd: Option<f64>,
        /// Value of a good instrument; null for what is only told.
        expected: Option<f64>,
        /// How far a good instrument may be from it.
        tolerance: Option<f64>,
        /// How many standard deviations the value lies beyond the tolerance; 0 within.
        z: Option<f64>,
        /// Independent values of which this is the most extreme.
        trials: Option<f64>,
        /// Chance that a good instrument is as far off, trials counted; null where the verdict is no matter of chance.
        chance: Option<f64>,
        /// pass, fail, info (only told), or missing (captures are lacking).
        verdict: Name,
        /// What a fail means and its mend, or which captures are missing.
        cause: Name,
        /// Runs that went into it.
        runs: i32,
    }
}
