//! Table `profiles`: mean time profile of a capture.

use arrow_array::{Array, RecordBatch};

use super::cell::{Name, Samples};
use crate::table;

table! {
    /// Mean time profile of one capture: baseline removed, every shot aligned to its reference pulse.
    "profiles": Profile, ProfileColumns {
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
        /// Vertical range whose scale the profile has; of several merged ones, the most sensitive. Null where captures
        /// have only one.
        range: Option<Name>,
        /// Averaged shots.
        shots: i32,
        /// Rejected shots: clipped, outliers, or without reference pulse.
        rejected: i32,
        /// Rejected shots with a sample of signal or reference at the converter's rails.
        clipped: i32,
        /// Time of sample 0 relative to the reference pulse (without one, to the trigger).
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Mean signal. Null for photon counters: their `counts`, less `baseline_v`, are the same.
        mean_v: Option<Samples>,
        /// Standard error of each mean, by the noise model, without slow noise; infinite for a sample that every range
        /// clipped. Null for photon counters: the root of the count, of `baseline_v` or of 1, whichever is largest.
        se_v: Option<Samples>,
        /// Standard deviation of the noise of one shot, before the pulse, of all kinds.
        noise_v: f64,
        /// Autocorrelation of that noise without its slow part at lags 0, 1, 2...
        noise_acf: Samples,
        /// Variance of one shot at level v: s0^2 + s1^2 abs(v) + s2^2 v^2 + j^2 (dv/dt)^2; the four coefficients in
        /// V^2, V, 1, ps^2. Null where shots are too few to estimate it.
        noise_model: Option<Vec<f64>>,
        /// Slow noise of one shot (hum, wander, 1/f): variances of the amplitudes of sqrt(2) cos(pi k (n + 1/2) / N) in
        /// V^2, k = 1, 2... over the N samples. Null where noise is fast alone.
        slow_noise: Option<Vec<f64>>,
        /// Number of samples from which this noise was estimated; null where it is unknown.
        noise_samples: Option<i32>,
        /// Mean baseline that was removed.
        baseline_v: f64,
        /// Shots at each of 64 sub-sample phases, which determine how averaging changes a response; null where samples
        /// are as recorded.
        phase_shots: Option<Vec<i32>>,
        /// Standard deviation of the time error that remains after alignment, which all arrivals of the profile share.
        jitter_ps: f64,
        /// Relative standard deviation that all amplitudes of the profile share: the laser's energy from shot to shot,
        /// and the factor between merged ranges.
        gain_sd: f64,
        /// Mean time of the reference pulse after the trigger. Null without reference channel.
        reference_ps: Option<f64>,
        /// Its standard error.
        reference_sd_ps: Option<f64>,
        /// Mean integral of the reference pulse over time, which is proportional to the laser's energy. Null without
        /// reference channel.
        reference_v_ps: Option<f64>,
        /// Its standard error.
        reference_sd_v_ps: Option<f64>,
        /// Photons counted in each bin, for photon counters.
        counts: Option<Vec<i32>>,
        /// Laser pulses over which they were counted.
        cycles: Option<i64>,
        /// Volts per code of the records.
        gain_v: f64,
        /// Known path from source to sensor, for roles response and fiducial.
        path_m: Option<f64>,
        /// Standard deviation of the known path.
        path_sd_m: Option<f64>,
        /// Optical density of the attenuator in the beam.
        attenuation_od: Option<f64>,
        /// Mean power of the laser, in watts.
        power_w: Option<f64>,
        /// Bounces of the known path, for roles response and fiducial.
        bounces: Option<i32>,
        /// Wall-clock time of the first shot, from its file (ISO 8601, time zone of the instrument).
        acquired_at: Option<Name>,
    }
}

impl Profile {
    /// Number of samples.
    #[must_use]
    pub fn samples(&self) -> usize {
        match (&self.mean_v, &self.counts) {
            (Some(mean_v), _) => mean_v.len(),
            (None, counts) => counts.as_ref().map_or(0, Vec::len),
        }
    }

    /// Mean signal: that of the table, or of what a photon counter counted.
    #[must_use]
    pub fn mean_v(&self) -> Samples {
        self.mean_v.clone().unwrap_or_else(|| self.counted().map(|count| count - self.baseline_v).collect())
    }

    /// Standard error of each mean: that of the table, or of what a photon counter counted; infinite where a table made
    /// elsewhere has neither.
    #[must_use]
    pub fn se_v(&self) -> Samples {
        let least = self.baseline_v.max(1.0);
        self.se_v.clone().unwrap_or_else(|| match &self.counts {
            Some(_) => self.counted().map(|count| count.max(least).sqrt()).collect(),
            None => vec![f32::INFINITY; self.samples()].into(),
        })
    }

    /// The first row of a table made elsewhere that has neither mean signal nor counts.
    #[must_use]
    pub fn without_samples(batch: &RecordBatch) -> Option<usize> {
        let is_null = |column: &str, i: usize| batch.column_by_name(column).is_none_or(|column| column.is_null(i));
        (0..batch.num_rows()).find(|i| is_null("mean_v", *i) && is_null("counts", *i))
    }

    fn counted(&self) -> impl Iterator<Item = f64> {
        self.counts.iter().flatten().map(|count| f64::from(*count))
    }
}
