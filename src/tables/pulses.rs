//! Table `pulses`: the laser pulses of a lidar, each with its beam, the pulse that left and the light that came back.

use super::cell::{Codes, Name};
use crate::table;

table! {
    /// One laser pulse of a lidar, as recorded by one channel. Light that comes back at time t comes from
    /// anchor + velocity * t.
    "pulses": Pulse, PulseColumns {
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
        /// GPS time at which it was fired, as the file counts it.
        gps_time_s: f64,
        /// Place of light of time 0, x, in the frame of the file.
        anchor_x_m: f64,
        /// The same, y.
        anchor_y_m: f64,
        /// The same, z.
        anchor_z_m: f64,
        /// How far that place moves with time, x: half the speed of light, along the beam.
        velocity_x_m_per_ps: f64,
        /// The same, y.
        velocity_y_m_per_ps: f64,
        /// The same, z.
        velocity_z_m_per_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Unit of the samples: V where the file has a scale, else adc, the digitiser's counts.
        unit: Name,
        /// Units per code.
        gain: f64,
        /// Units at code 0.
        offset: f64,
        /// Type of a code of returning light: i8, u8, i16, u16, i32, u32, f32 or f64.
        code_type: Name,
        /// Time of the first sample of each stretch that was recorded.
        starts_ps: Vec<f64>,
        /// Samples of each stretch.
        lengths: Vec<i32>,
        /// Codes of all stretches, one behind the other, little-endian.
        codes: Codes,
        /// Type of a code of the outgoing pulse; null where the file does not have the pulse.
        outgoing_type: Option<Name>,
        /// Time between samples of the outgoing pulse.
        outgoing_dt_ps: Option<f64>,
        /// Time of the first sample of the outgoing pulse, on the same clock; null where the file does not say.
        outgoing_t0_ps: Option<f64>,
        /// Codes of the outgoing pulse, little-endian.
        outgoing: Codes,
    }
}
