//! Table `subtotals`: sums over the pieces of a large capture.

use super::cell::Name;
use crate::table;

table! {
    /// Sums over one piece of a capture that several workers average. For each vertical range and kind of shots there
    /// is one row for each sub-sample phase, with the sums, and one row without phase, with all other counts. The
    /// pieces of one capture, joined in order, give its profile.
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
        /// Run of shots, for roles other than scene.
        run: Option<Name>,
        /// Vertical range, where captures were recorded at several.
        range: Option<Name>,
        /// Whether these are the shots with samples at the converter's rails, as opposed to those without.
        is_cut: bool,
        /// Sub-sample phase at which these shots begin, in 1/64 sample; null in a row of counts.
        phase: Option<i32>,
        /// Shots, or photon histograms, in the sums.
        shots: i64,
        /// Place of the first sum: samples after the reference pulse (without one, after the trigger).
        first: i64,
        /// First place that all these shots cover.
        covered_from: i64,
        /// Place after the last one that all these shots cover.
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
        /// Outlying shots with a sample at the converter's rails.
        clipped: i64,
        /// Other outlying shots.
        outlying: i64,
        /// Shots whose reference pulse is cut off at the rails.
        reference_clipped: i64,
        /// Shots without a reference pulse.
        without_reference: i64,
        /// Shots with a sample that is no number.
        not_a_number: i64,
        /// Shots with another scale, length or setting.
        other_scale: i64,
        /// Rejected shots with a sample at the rails, of signal or reference.
        at_rails: i64,
        /// Whether the piece has records of a reference channel.
        has_reference: bool,
        /// Whether the calibration lacks a template to time them by.
        missing_template: bool,
    }
}
