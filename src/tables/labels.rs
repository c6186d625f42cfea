//! Table `labels`: which light path caused which onset.

use super::cell::Name;
use crate::table;

table! {
    /// An onset and a path that may have caused it.
    "labels": Label, LabelColumns {
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
        /// Wall-clock time of the capture's first shot (ISO 8601, time zone of the instrument), where its file has it.
        acquired_at: Option<Name>,
        /// Rank of the onset in its profile.
        rank: i32,
        /// 0 for the onset as a whole; 1 and 2 for the earlier and the later of two pulses that a wide onset is read
        /// as.
        part: i32,
        /// Time of flight, with laser periods added; of a part, its own.
        time_ps: f64,
        /// Standard deviation of the time, the jitter that the profile's onsets share included.
        time_sd_ps: f64,
        /// Covariance of the time error with those of all onsets of its profile in ps^2, in order of rank, the jitter
        /// that they share included; at its own rank, for a part that with the other part, else the variance without
        /// what light of other paths adds. Empty for alternatives.
        covariance: Vec<f64>,
        /// Width of the onset beyond the sensor's response; null for a part, which is a point.
        width_ps: Option<f64>,
        /// Standard deviation of the width, where the onset has one.
        width_sd_ps: Option<f64>,
        /// Variance of its light beyond the sensor's response as its profile alone has it, in ps^2; below 0 where noise
        /// makes it so, null for a part and where no light was predicted in the profile. Its standard deviation is
        /// `2 width_ps width_sd_ps`.
        own_variance_ps2: Option<f64>,
        /// Excess kurtosis of the spread that makes the onset wide: 0 for a Gaussian, -1 for the chords of a disk,
        /// between them for light over more disks.
        width_kurtosis: Option<f64>,
        /// Signal-to-noise ratio of the onset, or of the part.
        snr: f64,
        /// Laser periods added to the onset's time.
        turns: i32,
        /// Bounces of the path (0: unexplained).
        bounces: i32,
        /// Patches in the order in which the light meets them: lit first, seen last; null: unexplained.
        path: Option<Vec<i32>>,
        /// Measured minus predicted time, where patches are given.
        residual_ps: Option<f64>,
        /// Probability of this label.
        probability: f64,
        /// 0 for the best label of its onset, or of each of its two parts; 1, 2... for others, among them those of the
        /// less likely reading (one wide pulse, or two).
        alternative: i32,
    }
}
