//! Table `gaps`: whether something stands between two hidden strips.

use super::cell::Name;
use crate::table;

table! {
    /// The middle between two hidden strips that follow one another: free, or occupied by a third that would have shown a pulse of its own.
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
        /// Visible patch over which light of the middle would leave: of those over which the neighbours' does, the one that speaks most for something there.
        through: i32,
        /// Profiles that were looked at.
        profiles: i32,
        /// Amplitude of a pulse from there over that of the weaker neighbour, in the mean of the profiles; null where nothing can be said.
        share: Option<f64>,
        /// Its standard deviation.
        share_sd: Option<f64>,
        /// The share from which the middle counts as occupied.
        share_least: f64,
        /// Natural log of the likelihood of nothing there over that of something of the least share or more.
        log_ratio: f64,
        /// Probability of nothing there, where either is as probable beforehand.
        free_probability: f64,
        /// free, occupied or open.
        verdict: Name,
    }
}
