//! Table `measurements`: the pulse of each run of an instrument check, or of each capture of a scene.

use super::cell::Name;
use crate::table;

table! {
    /// What one run (or capture of the scene) says: its strongest pulse, its noise, and what lies behind the pulse. Columns of the pulse are null where
    /// there is none: roles dark and blocked, and records with less than five standard deviations of it.
    "measurements": Measurement, MeasurementColumns {
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
        /// Which run of shots, for other roles than scene: its file; null for captures of the scene.
        run: Option<Name>,
        /// Shots averaged.
        shots: i32,
        /// Shots set aside: clipped, outlying, or without reference pulse.
        rejected: i32,
        /// Of these, shots with a sample of signal or reference at the converter's rails.
        clipped: i32,
        /// Known path from source to sensor.
        path_m: Option<f64>,
        /// Standard deviation of the known path.
        path_sd_m: Option<f64>,
        /// Optical density of the attenuator in the beam.
        attenuation_od: Option<f64>,
        /// Mean power of the laser.
        power_w: Option<f64>,
        /// Bounces of the known path.
        bounces: Option<i32>,
        /// Wall-clock time of the first shot as its file has it (ISO 8601, zone of the instrument).
        acquired_at: Option<Name>,
        /// Amplitude over its standard deviation from the noise alone.
        snr: Option<f64>,
        /// Height of the pulse; negative for a pulse against the sensor's polarity.
        amplitude_v: Option<f64>,
        /// Standard deviation of the height, what the shots spread beyond the noise included.
        amplitude_sd_v: Option<f64>,
        /// Time of the pulse after the reference pulse (without one, the trigger); the latency is in it.
        time_ps: Option<f64>,
        /// Standard deviation of the time, what the alignment leaves included.
        time_sd_ps: Option<f64>,
        /// Factor by which the calibrated response is stretched in time.
        width_ratio: Option<f64>,
        /// Standard deviation of that factor.
        width_ratio_sd: Option<f64>,
        /// Full width at half maximum: that of the calibrated response, stretched.
        width_ps: Option<f64>,
        /// Mean baseline.
        baseline_v: f64,
        /// Standard deviation of the noise of one shot, before the pulse.
        noise_v: f64,
        /// Autocorrelation of that noise at lag 1; null where a record is too short.
        noise_acf: Option<f64>,
        /// Spread of single shots where the pulse is highest.
        signal_noise_v: Option<f64>,
        /// Volts per code.
        gain_v: f64,
        /// Amplitude of the largest second pulse behind the main one, over that of the main one.
        echo_ratio: Option<f64>,
        /// Standard deviation of the ratio.
        echo_ratio_sd: Option<f64>,
        /// How far that pulse lies behind the main one.
        echo_delay_ps: Option<f64>,
        /// Independent positions among which it is the largest.
        echo_trials: Option<f64>,
        /// Largest deviation of the mean record from its own mean, for roles dark and blocked.
        pickup_v: Option<f64>,
        /// Standard error of the mean record.
        pickup_sd_v: Option<f64>,
        /// Independent positions among which it is the largest.
        pickup_trials: Option<f64>,
    }
}
