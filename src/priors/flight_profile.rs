//! A profile as estimators take it: upwards, without pick-up, in times of flight.

use super::calibration::{self, Calibrated};
use super::corrections::Correction;
use super::sensor_range::SensorRange;
use crate::signal::sparse::{self, Jitter};
use crate::tables::{Profile, Session};

/// Samples of a profile, turned upwards, with pick-up, latency and drift taken off.
pub struct FlightProfile {
    /// Mean of each sample.
    pub mean_v: Vec<f64>,
    /// Standard deviation of each mean, with that of the pick-up.
    pub sd_v: Vec<f64>,
    /// Autocorrelation of the noise.
    pub acf: Vec<f64>,
    /// Variances of the components of slow noise in the means.
    pub slow_v2: Vec<f64>,
    /// Scatter of the times of the shots.
    pub jitter: Option<Jitter>,
    /// Time of flight at the first sample.
    pub t0_ps: f64,
    /// Time between samples.
    pub dt_ps: f64,
    /// Standard deviation of the drift, which all times share.
    pub drift_sd_ps: f64,
}

impl FlightProfile {
    /// From a profile of a calibrated sensor, and what the `sessions` say of it; `sd_v` are the standard deviations of
    /// its samples without pick-up. A circular profile has the period `period_ps`.
    ///
    /// # Errors
    /// When drift or pick-up cannot be taken off; the text names the fix.
    pub fn new(
        profile: &Profile,
        (key, sensor): (&SensorRange, &Calibrated),
        sessions: &[Session],
        period_ps: Option<f64>,
        mut sd_v: Vec<f64>,
    ) -> Result<Self, String> {
        let correction = Correction::of(sessions, key, profile)?;
        let mut mean_v = profile.mean_v().to_f64();
        correction.take_pickup_off(profile, period_ps, &mut mean_v, &mut sd_v)?;
        mean_v.iter_mut().for_each(|sample| *sample *= sensor.polarity);
        Ok(Self {
            mean_v,
            sd_v,
            acf: acf(profile),
            slow_v2: calibration::slow_v2(profile),
            jitter: jitter(profile),
            t0_ps: profile.t0_ps - sensor.latency_ps - correction.drift_ps,
            dt_ps: profile.dt_ps,
            drift_sd_ps: correction.drift_sd_ps,
        })
    }

    /// The same as the kernel takes it.
    pub fn view(&self) -> sparse::Profile<'_> {
        let Self { mean_v, sd_v, acf, slow_v2, jitter, t0_ps, dt_ps, .. } = self;
        sparse::Profile { mean_v, sd_v, acf, slow_v2, jitter: *jitter, t0_ps: *t0_ps, dt_ps: *dt_ps }
    }
}

/// That of single shots, whose mean has its `jitter_ps`.
fn jitter(profile: &Profile) -> Option<Jitter> {
    let shots = f64::from(profile.shots);
    (profile.jitter_ps > 0.0).then(|| Jitter { sd_ps: profile.jitter_ps * shots.sqrt(), shots })
}

/// Autocorrelation of the noise; white where it is no more than the rounding of the samples.
fn acf(profile: &Profile) -> Vec<f64> {
    let is_rounding = calibration::is_rounding(profile);
    if is_rounding { vec![1.0] } else { calibration::correlation(profile) }
}
