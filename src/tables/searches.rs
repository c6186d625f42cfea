//! Table `searches`: what a joint search of a wall's histograms came to.

use super::cell::Name;
use crate::table;

table! {
    /// A joint search as a whole, with its evidence: one row.
    "searches": JointSearch, JointSearchColumns {
        /// points: small things, with error bars; extended-object: a signal that points do not explain; nothing: no
        /// signal above noise; cannot-tell: undecided.
        verdict: Name,
        /// Why, in words.
        reason: Name,
        /// Histograms that entered.
        histograms: i32,
        /// Points of the last fit. Only the verdict `points` makes patches of them.
        points: i32,
        /// Share of the points that reappear in halves of the histograms; null where halves were not searched.
        reappear: Option<f64>,
        /// wall: the response is that of the wall's own light; calibration: that of the sensor's calibration.
        response: Name,
        /// Time over the hidden things from which on light counts.
        gate_ps: f64,
        /// End of the histograms, as time over the hidden things.
        end_ps: f64,
        /// Cells among which noise may exceed the threshold.
        cells: i64,
        /// Probability that noise exceeds the threshold in any cell.
        false_alarm: f64,
        /// Least z of a point: one over the relative standard deviation of its photons.
        threshold: f64,
        /// Largest filtered score before a point was fitted, in standard deviations.
        largest: f64,
        /// Factor on all covariances for arrivals that lie off the model; 1 where noise explains them.
        misfit: f64,
        /// Mean square of what no shift common to a histogram explains in its points' arrivals, in units of noise.
        own_misfit: f64,
        /// Standard deviation of arrivals beyond noise.
        scatter_ps: f64,
        /// Power of the distance with which light falls off.
        power: f64,
        /// Width of pulses over that of the response.
        stretch: f64,
    }
}
