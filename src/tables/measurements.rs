//! Table `measurements`: the pulse of each run of an instrument check, or of each capture of a scene.

use super::cell::Name;
use crate::table;

table! {
    /// Results of one run (or capture of the scene): its strongest pulse, its noise, and any later echo. Columns of the
    /// pulse are null where there is none: roles dark and blocked, and records whose pulse is below five standard
    /// deviations.
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
        /// Run of shots, for roles other than scene: its file; null for captures of the scene.
        run: Option<Name>,
        /// Averaged shots.
        shots: i32,
        /// Rejected shots: clipped, outliers, or without reference pulse.
        rejected: i32,
        /// Rejected shots with a sample of signal or reference at the converter's rails.
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
        /// Wall-clock time of the first shot, from its file (ISO 8601, time zone of the instrument).
        acquired_at: Option<Name>,
        /// Amplitude over its standard deviation from noise alone.
        snr: Option<f64>,
        /// Height of the pulse; negative for a pulse opposite to the sensor's polarity.
        amplitude_v: Option<f64>,
        /// Standard deviation of the height; includes the spread between shots beyond the noise.
        amplitude_sd_v: Option<f64>,
        /// Time of the pulse after the reference pulse (without one, the trigger); includes the latency.
        time_ps: Option<f64>,
        /// Standard deviation of the time; includes the residual of the alignment.
        time_sd_ps: Option<f64>,
        /// Factor by which the calibrated response must be stretched in time.
        width_ratio: Option<f64>,
        /// Standard deviation of that factor.
        width_ratio_sd: Option<f64>,
        /// Full width at half maximum of the calibrated response, stretched by that factor.
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
        /// Amplitude of the largest second pulse after the main one, over that of the main one.
        echo_ratio: Option<f64>,
        /// Standard deviation of the ratio.
        echo_ratio_sd: Option<f64>,
        /// Delay of that pulse after the main one.
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
