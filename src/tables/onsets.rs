//! Table `onsets`: arrivals of light in profiles.

use super::cell::Name;
use crate::table;

table! {
    /// One arrival in one profile; key and rank identify it.
    "onsets": Onset, OnsetColumns {
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
        /// Order of arrival within its profile, from 1.
        rank: i32,
        /// Time of flight of the arrival, with what was predicted of it.
        time_ps: f64,
        /// Standard deviation of the time, misfit included; excludes the jitter that the profile's onsets share, and
        /// the sensor's latency.
        time_sd_ps: f64,
        /// Time of flight as its profile alone has it, to which `covariance` belongs; null where no light was
        /// predicted in the profile.
        own_time_ps: Option<f64>,
        /// Time at which the arrival begins to rise, if the method gives it.
        earliest_ps: Option<f64>,
        /// Amplitude in the unit of the profile.
        amplitude: f64,
        /// Standard deviation of the amplitude, with the part that all amplitudes of the profile share, if the method
        /// gives it.
        amplitude_sd: Option<f64>,
        /// Width of the arrival beyond the sensor's response (0: none modelled).
        width_ps: f64,
        /// Standard deviation of the width, where the arrival has one.
        width_sd_ps: Option<f64>,
        /// Variance of its light beyond the sensor's response as its profile alone has it, in ps^2; below 0 where noise
        /// makes it so, null where no light was predicted in the profile. Its standard deviation is
        /// `2 width_ps width_sd_ps`.
        own_variance_ps2: Option<f64>,
        /// Excess kurtosis of the spread that makes the arrival wide: 0 for a Gaussian, -1 for the chords of a disk,
        /// between them for light over more disks.
        width_kurtosis: Option<f64>,
        /// Matched-filter signal-to-noise ratio.
        snr: f64,
        /// Increase of chi-square without this arrival, if the method gives it.
        evidence: Option<f64>,
        /// Covariance of its time with those of all onsets of its profile in ps^2, in order of rank.
        covariance: Vec<f64>,
        /// Standard deviation of the time error that all onsets of the profile share.
        jitter_ps: f64,
        /// Width of the response over that of the response captures, as all arrivals of the profile show it; null where
        /// they do not determine it.
        response_width: Option<f64>,
        /// Standard deviation of that.
        response_width_sd: Option<f64>,
        /// Laser energy relative to the response captures, by which amplitudes of different captures are compared. Null
        /// without reference channel.
        power_ratio: Option<f64>,
        /// Of a wide arrival, the time of the earlier of the two points that explain it best in its place; null where
        /// none do.
        pair_first_ps: Option<f64>,
        /// Time of the later of the two.
        pair_second_ps: Option<f64>,
        /// Standard deviation of the earlier time.
        pair_first_sd_ps: Option<f64>,
        /// Standard deviation of the later time.
        pair_second_sd_ps: Option<f64>,
        /// Correlation of both times.
        pair_correlation: Option<f64>,
        /// Amplitude of the earlier one, in the unit of the profile.
        pair_first_amplitude: Option<f64>,
        /// Amplitude of the later one, in the unit of the profile.
        pair_second_amplitude: Option<f64>,
        /// Chi-square of one wide arrival less that of the pair, over the chi-square per degree of freedom of the
        /// better one where noise does not explain it.
        pair_gain: Option<f64>,
        /// Special conditions: blended, extended, misfit, moving-baseline, at-edge.
        flags: Vec<Name>,
    }
}
