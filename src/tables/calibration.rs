//! Table `calibration`: the properties of each sensor, from its response captures.

use super::cell::{Name, Samples};
use crate::table;

table! {
    /// One sensor (and vertical range): its impulse response, the template of its reference pulse, and its latency.
    "calibration": Calibration, CalibrationColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range, where captures were recorded at several.
        range: Option<Name>,
        /// Shots that it uses.
        shots: i32,
        /// Rejected shots: clipped, without reference pulse, or different from the first.
        rejected: i32,
        /// Step of the time grid of response and reference.
        step_ps: f64,
        /// Time of the first value of the response; its maximum is at time 0.
        response_t0_ps: f64,
        /// Impulse response; its extremum is 1, or -1 for a sensor whose pulses go down.
        response: Samples,
        /// Time of the first value of the reference template; its maximum is at time 0. Null without reference channel.
        reference_t0_ps: Option<f64>,
        /// Template of the reference pulse; its extremum is 1 or -1. Null without reference channel.
        reference: Option<Samples>,
        /// Delay from reference pulse (without one, trigger) to recorded maximum, minus the time of flight.
        latency_ps: f64,
        /// Standard deviation of the latency, which all arrivals of the sensor share.
        latency_sd_ps: f64,
        /// The contribution to it that all vertical ranges of the sensor share: the error of the known path's length.
        latency_common_sd_ps: Option<f64>,
        /// Wall-clock time of the first response shot (ISO 8601, time zone of the instrument).
        acquired_at: Option<Name>,
        /// Mean integral of the reference pulse in the response captures, which is proportional to the laser's energy.
        /// Null without reference channel.
        reference_v_ps: Option<f64>,
        /// Variance of one shot at level v: s0^2 + s1^2 abs(v) + s2^2 v^2 + j^2 (dv/dt)^2; the four coefficients in
        /// V^2, V, 1, ps^2.
        noise_model: Option<Vec<f64>>,
        /// Autocorrelation of the noise at lags 0, 1, 2...
        noise_acf: Option<Samples>,
        /// Full width at half maximum of the response.
        width_ps: f64,
        /// Standard deviation of the width.
        width_sd_ps: Option<f64>,
        /// Factor of the width by which the scene's own pulses corrected the response (`recalibrate`). Null where it is
        /// that of the response captures.
        scene_width: Option<f64>,
        /// Standard deviation of that factor.
        scene_width_sd: Option<f64>,
        /// Light that the scene's own pulses show behind the response of the response captures, in echoes and a tail,
        /// over that response's area. Null where it is none.
        scene_tail: Option<f64>,
        /// Logarithm of the ratio of likelihoods of the scene's pulses, with the corrected response over that of the
        /// response captures.
        scene_evidence: Option<f64>,
    }
}
