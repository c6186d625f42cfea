//! Table `checks`: results of the instrument checks.

use super::cell::Name;
use crate::table;

table! {
    /// One check of one sensor: the measured value, the expected one, and the verdict.
    "checks": Check, CheckColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Name of the check.
        check: Name,
        /// Measured value; null where captures are missing.
        value: Option<f64>,
        /// Unit of value, sd, expected and tolerance.
        unit: Name,
        /// Standard deviation of the value.
        sd: Option<f64>,
        /// Value of a good instrument; null for values that are only reported.
        expected: Option<f64>,
        /// Largest deviation of a good instrument from the expected value.
        tolerance: Option<f64>,
        /// Standard deviations of the value beyond the tolerance; 0 within.
        z: Option<f64>,
        /// Number of independent values of which this is the most extreme.
        trials: Option<f64>,
        /// Probability that a good instrument deviates as far, trials included; null where the verdict does not depend
        /// on chance.
        chance: Option<f64>,
        /// pass, fail, info (only reported), or missing (captures are missing).
        verdict: Name,
        /// What a failure means and how to fix it, or which captures are missing.
        cause: Name,
        /// Runs that the check uses.
        runs: i32,
    }
}
