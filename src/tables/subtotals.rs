//! Table `subtotals`: what the pieces of a large capture add up to.

use super::cell::Name;
use crate::table;

table! {
    /// What a piece of a capture adds up to, where one worker is not to average all of it. For each vertical range and kind of shots: a row with phase for each phase of a
    /// sample, which has their sums, and one without, which has what else is counted. Pieces of one capture, joined in order, make its profile.
    "subtotals": Subtotal, SubtotalColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit (0: none).
        lit: i32,
        /// Patch that the sensor saw (0: none).
        seen: i32,
        /// What was captured.
        role: Name,
        /// Which run of shots, for other roles than scene.
        run: Option<Name>,
        /// Vertical range, where the capture was taken at several.
        range: Option<Name>,
        /// Whether these are the shots with samples at the converter's rails, not the whole ones.
        is_cut: bool,
        /// Where between two samples these shots begin, in 1/64 sample; null in a row of counts.
        phase: Option<i32>,
        /// Shots, or photon histograms, that were added up.
        shots: i64,
        /// Place of the first sum: samples after the reference pulse (without one, after the trigger).
        first: i64,
        /// First place that all these shots cover.
        covered_from: i64,
        /// Place behind the last one that all these shots cover.
        covered_to: i64,
        /// Sums of the codes, place by place.
        sums: Vec<i64>,
        /// Times of their reference pulses after the trigger, shot by shot.
        reference_ps: Vec<f64>,
        /// Standard deviations of these times.
        reference_sd_ps: Vec<f64>,
        /// Integrals of these pulses.
        reference_v_ps: Vec<f64>,
        /// Places with a sample at the converter's rails.
        clipped_places: Vec<i64>,
        /// Shots set aside, of both kinds: outlying, or without reference pulse.
        rejected: i64,
        /// Of these, shots with a sample at the converter's rails.
        clipped: i64,
        /// Shots of another scale, length or setting.
        other_scale: i64,
        /// Whether the piece holds records of a reference channel.
        has_reference: bool,
        /// Whether the calibration has no template to time them by.
        missing_template: bool,
    }
}
