//! Table `onsets`: arrivals of light.

use super::cell::Name;
use crate::table;

table! {
    /// One arrival of light in one profile; key and rank are its id.
    "onsets": Onset, OnsetColumns {
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
        /// Order of arrival within its profile, from 1.
        rank: i32,
        /// Time of flight of the arrival.
        time_ps: f64,
        /// Standard deviation of the time, misfit included; the profile's common jitter and the sensor's latency are not.
        time_sd_ps: f64,
        /// When the arrival begins to rise, where the method tells.
        earliest_ps: Option<f64>,
        /// Amplitude in the unit of the profile.
        amplitude: f64,
        /// Standard deviation of the amplitude, that of all amplitudes of the profile together included, where the method tells.
        amplitude_sd: Option<f64>,
        /// Extra width of the light itself (0: none modelled).
        width_ps: f64,
        /// Matched-filter signal-to-noise ratio.
        snr: f64,
        /// Chi-square that leaving it out would cost, where the method tells.
        evidence: Option<f64>,
        /// Covariance of its time with those of all onsets of its profile in ps^2, in order of rank.
        covariance: Vec<f64>,
        /// Standard deviation of the time error that all onsets of the profile share.
        jitter_ps: f64,
        /// Laser's energy over that in the response captures, which amplitudes of other captures compare by. Null without reference channel.
        power_ratio: Option<f64>,
        /// What to know about it: blended, extended, misfit, at-edge.
        flags: Vec<Name>,
    }
}
