//! Table `echoes`: the echoes of the laser pulses of a lidar.

use super::cell::Name;
use crate::table;

table! {
    /// An echo of a laser pulse. Its errors are from noise and from what the fit of the pulse leaves; errors of the
    /// beam are not in them.
    "echoes": Echo, EchoColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Run of pulses: its raw file, relative to the campaign folder.
        run: Name,
        /// Number of the pulse among those of the run with returning light, from 0.
        pulse: i64,
        /// Channel of the returning light.
        channel: Name,
        /// GPS time at which the pulse was fired, as the file counts it.
        gps_time_s: f64,
        /// Number of the echo within its pulse, from 1, in order of time.
        echo: i32,
        /// Echoes of the pulse.
        echoes: i32,
        /// Arrival: when the maximum of the outgoing pulse, moved onto the echo, comes back. After the maximum of the
        /// outgoing pulse left where the file has its time, else on the clock of the record.
        time_ps: f64,
        /// Standard deviation of the arrival.
        time_sd_ps: f64,
        /// Leading edge: when the record, without the other echoes, rises through half of the echo's height, on the
        /// clock of the record; null where the record begins later.
        edge_ps: Option<f64>,
        /// Standard deviation of the leading edge.
        edge_sd_ps: Option<f64>,
        /// Height of the echo, in the unit of the samples.
        height: f64,
        /// Standard deviation of the height.
        height_sd: f64,
        /// Standard deviation of the Gaussian that widens the outgoing pulse to the echo.
        width_ps: f64,
        /// Standard deviation of that width; its upper limit where the width is less.
        width_sd_ps: f64,
        /// Distance from the anchor along the beam.
        range_m: f64,
        /// Standard deviation of the distance, and of the place along the beam.
        range_sd_m: f64,
        /// Place, x, in the frame of the file.
        x_m: f64,
        /// Place, y.
        y_m: f64,
        /// Place, z.
        z_m: f64,
        /// Samples of the echo's stretch at the converter's rail, which did not count.
        clipped: i32,
        /// Standard deviation of what the fit of the stretch leaves, in the unit of the samples.
        noise: f64,
        /// Independent values among what the fit leaves: fewer than samples where that is correlated.
        independent: f64,
    }
}
