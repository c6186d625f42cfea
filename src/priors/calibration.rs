//! A calibrated sensor as the stages behind `average` use it, and what a profile says of its noise.

use std::collections::BTreeMap;

use super::sensor_range::{OfSensorRange, SensorRange, own_or_only};
use crate::signal::averaged_response::averaged_response;
use crate::signal::largest::largest;
use crate::signal::noise;
use crate::signal::response::Response;
use crate::signal::sparse;
use crate::tables::{Calibration, Profile};

/// Share of a record whose samples give the noise, where the profile does not say.
const BASELINE_SHARE: f64 = 0.1;

/// Share of the noise of a profile's samples that the cut ends of an averaged response may be, and the share of its
/// maximum that they may be at most.
const CUT_NOISE_SHARE: f64 = 0.1;
const CUT_MAX: f64 = 1e-4;

/// No response is as wide in each profile to less than this, however many profiles say so.
const WIDTH_SD_LEAST: f64 = 1e-3;

/// Response and latency of one sensor at one vertical range.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// Turned upwards.
    pub response: Response,
    /// -1 for a sensor whose pulses go down.
    pub polarity: f64,
    /// Delay beyond the light's time of flight.
    pub latency_ps: f64,
    /// Mean integral of the reference pulse when it was calibrated.
    pub reference_v_ps: Option<f64>,
    /// Width of the response over that of the response captures, and the standard deviation of its logarithm in the
    /// scene.
    pub width: [f64; 2],
}

impl Calibrated {
    /// From its row.
    pub fn new(row: &Calibration) -> Self {
        let mut values = row.response.to_f64();
        let extremum = values.iter().fold(0.0_f64, |most, value| if value.abs() > most.abs() { *value } else { most });
        let polarity = extremum.signum();
        values.iter_mut().for_each(|value| *value *= polarity);
        Self {
            response: Response::new(row.response_t0_ps, row.step_ps, &values),
            polarity,
            latency_ps: row.latency_ps,
            reference_v_ps: row.reference_v_ps,
            width: match row.scene_width.zip(row.scene_width_sd) {
                Some((width, sd)) => [width, sd.max(WIDTH_SD_LEAST)],
                None => [1.0, sparse::WIDTH_SD],
            },
        }
    }

    /// What averaging leaves of the response in a profile.
    pub fn averaged(&self, profile: &Profile) -> Response {
        averaged(&self.response, profile)
    }
}

/// What averaging leaves of a response, or of a part of one, in a profile.
pub fn averaged(response: &Response, profile: &Profile) -> Response {
    match &profile.phase_shots {
        Some(phase_shots) => averaged_response(response, profile.dt_ps, phase_shots, cut_share(profile)),
        None => response.clone(),
    }
}

/// Share of its maximum below which the ends of an averaged response are cut off: a power of ten, so that noise hides
/// the ends of even the strongest pulse.
pub fn cut_share(profile: &Profile) -> f64 {
    let hidden = CUT_NOISE_SHARE * noise_v(profile) / largest_v(profile);
    10.0_f64.powf(hidden.log10().floor()).min(CUT_MAX)
}

/// All calibrated sensors, by their vertical ranges.
#[derive(Debug)]
pub struct Sensors(BTreeMap<SensorRange, Calibrated>);

impl Sensors {
    /// From the rows of `calibration`.
    pub fn new(rows: &[Calibration]) -> Self {
        Self(rows.iter().map(|row| (row.sensor_range(), Calibrated::new(row))).collect())
    }

    /// The calibrated sensor of a profile, see [`own_or_only`], and what it is the calibration of.
    pub fn of(&self, profile: &Profile) -> Option<(&SensorRange, &Calibrated)> {
        let key = own_or_only(self.0.keys(), profile)?;
        Some((key, &self.0[key]))
    }
}

/// Standard deviation of each sample of a profile's mean. An ideal record, without noise, still has the rounding of its
/// f32 samples.
pub fn sd_v(profile: &Profile) -> Vec<f64> {
    let rounding_v = rounding_v(profile);
    profile.se_v().iter().map(|se| f64::from(*se).max(rounding_v)).collect()
}

/// Standard deviation of a sample of a profile's mean away from pulses, at least the rounding of its f32 samples.
pub fn noise_v(profile: &Profile) -> f64 {
    own_noise_v(profile).max(rounding_v(profile))
}

/// Whether that is rounding alone.
pub fn is_rounding(profile: &Profile) -> bool {
    own_noise_v(profile) <= rounding_v(profile)
}

fn own_noise_v(profile: &Profile) -> f64 {
    profile.noise_v / f64::from(profile.shots).sqrt()
}

/// Variances of the components of slow noise in a profile's mean, V^2.
pub fn slow_v2(profile: &Profile) -> Vec<f64> {
    profile.slow_noise.iter().flatten().map(|variance_v2| variance_v2 / f64::from(profile.shots)).collect()
}

/// Rounding of a profile's f32 samples.
fn rounding_v(profile: &Profile) -> f64 {
    f64::from(f32::EPSILON) * largest_v(profile)
}

fn largest_v(profile: &Profile) -> f64 {
    f64::from(largest(&profile.mean_v(), f32::MIN_POSITIVE, f32::abs))
}

/// Autocorrelation of a profile's noise, smoothed to that of an autoregressive process of the order that its samples
/// support.
pub fn correlation(profile: &Profile) -> Vec<f64> {
    // A table made elsewhere may not say how many samples the noise comes from: at least a tenth of one shot's.
    let usual = || profile.samples() as f64 * BASELINE_SHARE;
    let samples = profile.noise_samples.map_or_else(usual, f64::from);
    noise::autoregressive(&profile.noise_acf.to_f64(), samples.max(1.0) as usize)
}
