//! Table `gaps`: whether there is an object between two hidden strips.

use super::cell::Name;
use crate::table;

table! {
    /// The middle between two neighbouring hidden strips: free, or occupied by a third one, which would have a pulse of
    /// its own.
    "gaps": Gap, GapColumns {
        /// Strip on one side.
        a: i32,
        /// Strip on the other.
        b: i32,
        /// Middle between them, x.
        x_m: f64,
        /// Middle between them, y.
        y_m: f64,
        /// Middle between them, z.
        z_m: f64,
        /// Visible patch from which light of the middle would reach the sensor: of those that show the neighbours, the
        /// one with the strongest evidence of an object there.
        through: i32,
        /// Profiles that were tested.
        profiles: i32,
        /// Amplitude of a pulse from there over that of the weaker neighbour, averaged over the profiles; null where
        /// nothing can be concluded.
        share: Option<f64>,
        /// Its standard deviation.
        share_sd: Option<f64>,
        /// Share from which the middle counts as occupied.
        share_least: f64,
        /// Natural log of the likelihood of no object over that of an object with the least share or more.
        log_ratio: f64,
        /// Probability of no object, with equal prior probabilities.
        free_probability: f64,
        /// free, occupied or open.
        verdict: Name,
    }
}
