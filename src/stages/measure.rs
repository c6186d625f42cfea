//! `measure`: the pulse of each run of an instrument check (paper figure 7), as numbers that runs can be compared by.
//!
//! The strongest pulse of the mean record is fitted with what averaging leaves of the calibrated response: amplitude,
//! time, baseline, then its width ([`pulse_fit`]). An echo is sought behind it ([`echo`]). Runs of roles dark and
//! blocked have no pulse: their row has the largest deviation of their mean record, which is what goes on in step with
//! the trigger. Times keep the latency. The response is one for all runs of a sensor: its own error is common to them,
//! and is in no standard deviation here.
//!
//! Takes `profiles` and `calibration`; writes `measurements`. Not modelled: several pulses of a scene (the strongest is
//! measured).
//!
//! ```toml
//! [measurements]
//! stage = "measure"
//! from = "profiles"
//! with = { calibration = "calibration" }
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::{Campaign, Role};
use crate::priors::calibration::{self, Calibrated};
use crate::priors::sensor_range::{OfSensorRange, SensorRange, own_or_only};
use crate::signal::echo::{self, Core};
use crate::signal::pulse_fit::{self, MeanRecord};
use crate::signal::reference::fit_pulse;
use crate::signal::response::Response;
use crate::signal::shot_spread::HEAD_SHOTS;
use crate::tables::{Calibration, Measurement, Profile};

/// Share of a record whose samples tell the noise, for the significance of its autocorrelation, where the profile does
/// not say.
const BASELINE_SHARE: f64 = 0.1;
/// An autocorrelation within this many standard deviations of 0 is none.
const ACF_SIGMA: f64 = 3.0;
/// Share of its maximum above which the pulse is high.
const HIGH_SHARE: f64 = 0.7;
/// Spread beyond the noise counts where it exceeds its own uncertainty by this factor.
const EXTRA_SIGMA: f64 = 2.0;

/// Parameters of `measure`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measure {}

/// The response of one sensor.
struct Sensor {
    calibrated: Calibrated,
    core: Option<Core>,
    width_ps: f64,
}

/// The calibrated sensors, by their vertical ranges.
pub struct Context(BTreeMap<SensorRange, Sensor>);

impl Stage for Measure {
    const KIND: &'static str = "measure";
    const VERSION: u32 = 4;
    const GRAIN: Grain = Grain::Capture;
    const BESIDE: &'static [Beside] = &[Beside { name: "calibration", table: "calibration", required: true }];
    type Input = Profile;
    type Output = Measurement;
    type Fields = ();
    type Context = Context;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Self::Context, StageError> {
        let rows = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        Ok(Context(rows.iter().map(|row| (row.sensor_range(), Sensor::of(row))).collect()))
    }
}

impl Sensor {
    fn of(row: &Calibration) -> Self {
        let calibrated = Calibrated::new(row);
        let core = Core::of(&calibrated.response, row.step_ps);
        Self { calibrated, core, width_ps: row.width_ps }
    }
}

impl Apply for Measure {
    fn apply(&self, Context(sensors): &Context, group: Vec<Profile>) -> Result<Outcome<Measurement>, StageError> {
        // A sensor without calibration has its noise measured all the same; `calibrate` has said why it has none.
        let measure =
            |profile: &Profile| measurement(profile, own_or_only(sensors.keys(), profile).map(|key| &sensors[key]));
        Ok(Outcome::rows(group.iter().map(measure).collect()))
    }
}

fn measurement(profile: &Profile, sensor: Option<&Sensor>) -> Measurement {
    let dark = [Role::Dark, Role::Blocked].iter().any(|role| *profile.role == *role.name());
    let row = blank(profile);
    if dark {
        let (pickup_v, trials) = largest_deviation(&profile.mean_v().to_f64());
        return Measurement {
            pickup_v: Some(pickup_v),
            pickup_sd_v: Some(noise_of_mean(profile, &(0..0))),
            pickup_trials: Some(trials),
            ..row
        };
    }
    match sensor {
        Some(sensor) => with_pulse(row, profile, sensor),
        None => row,
    }
}

/// Fills in the columns of the pulse, if there is one.
fn with_pulse(row: Measurement, profile: &Profile, sensor: &Sensor) -> Measurement {
    let samples: Vec<f64> =
        profile.mean_v().iter().map(|value| f64::from(*value) * sensor.calibrated.polarity).collect();
    let response = sensor.calibrated.averaged(profile);
    let Some(start) = fit_pulse(&samples, profile.dt_ps, &response) else {
        return row;
    };
    let noise = noise_of_mean(profile, &response.reach(start.time_ps, 0.0, profile.dt_ps, samples.len()));
    let acf = significant_acf(profile);
    let record = MeanRecord { samples: &samples, dt_ps: profile.dt_ps, noise, acf: &acf };
    let Some(pulse) = (noise > 0.0).then(|| pulse_fit::fit(&record, &response, &start)).flatten() else {
        return row;
    };
    let spread = spread(profile, &response, &pulse);
    let echo = sensor
        .core
        .as_ref()
        .and_then(|core| echo::largest(&record, core, &calibration::averaged(&core.response, profile)));
    Measurement {
        snr: Some(pulse.amplitude.abs() / pulse.amplitude_sd),
        amplitude_v: Some(pulse.amplitude),
        amplitude_sd_v: Some(pulse.amplitude_sd.hypot(spread.extra_v)),
        time_ps: Some(profile.t0_ps + pulse.time_ps),
        time_sd_ps: Some(pulse.time_sd_ps.hypot(profile.jitter_ps)),
        width_ratio: pulse.width.map(|(ratio, _)| ratio),
        width_ratio_sd: pulse.width.map(|(_, sd)| sd),
        width_ps: pulse.width.map(|(ratio, _)| ratio * sensor.width_ps),
        signal_noise_v: spread.shot_v,
        echo_ratio: echo.map(|echo| echo.ratio),
        echo_ratio_sd: echo.map(|echo| echo.ratio_sd),
        echo_delay_ps: echo.map(|echo| echo.delay_ps),
        echo_trials: echo.map(|echo| echo.trials),
        ..row
    }
}

/// Standard error of the mean record, all samples together but for those that a pulse reaches.
fn noise_of_mean(profile: &Profile, pulse: &Range<usize>) -> f64 {
    let se_v = profile.se_v();
    let quiet = se_v.iter().enumerate().filter(|(n, se)| !pulse.contains(n) && se.is_finite());
    let (sum, count) = quiet.fold((0.0, 0), |(sum, count), (_, se)| (sum + f64::from(*se).powi(2), count + 1));
    if sum > 0.0 { (sum / f64::from(count)).sqrt() } else { profile.noise_v / f64::from(profile.shots).sqrt() }
}

/// The autocorrelation of the noise as far as it differs from 0 for certain.
fn significant_acf(profile: &Profile) -> Vec<f64> {
    let usual = || (profile.shots as usize).min(HEAD_SHOTS) as f64 * profile.samples() as f64 * BASELINE_SHARE;
    let judged = profile.noise_samples.map_or_else(usual, f64::from).max(1.0);
    let least = ACF_SIGMA / judged.sqrt();
    let acf = profile.noise_acf.to_f64();
    let rest = acf.iter().skip(1).take_while(|r| r.abs() > least);
    std::iter::once(1.0).chain(rest.copied()).collect()
}

/// How the shots spread at the height of the pulse.
struct Spread {
    /// Standard deviation of one shot; `None` where it is not known.
    shot_v: Option<f64>,
    /// What the spread beyond the noise adds to the standard deviation of the mean's amplitude: light that fluctuates
    /// moves all samples together.
    extra_v: f64,
}

fn spread(profile: &Profile, response: &Response, pulse: &pulse_fit::MeanPulse) -> Spread {
    let Some(&[quiet, level, energy, _]) = profile.noise_model.as_deref() else {
        return Spread { shot_v: None, extra_v: 0.0 };
    };
    let height_v = (pulse.amplitude * response.height()).abs();
    // What the alignment leaves is no light that fluctuates.
    let extra = level * height_v + energy * height_v * height_v;
    let reach = response.reach(pulse.time_ps, 0.0, profile.dt_ps, profile.samples());
    let is_high =
        |n: &usize| response.value(*n as f64 * profile.dt_ps - pulse.time_ps) > HIGH_SHARE * response.height();
    let shots = f64::from(profile.shots);
    let judged = (shots.min(HEAD_SHOTS as f64) - 1.0) * reach.filter(is_high).count() as f64;
    let certain = extra > EXTRA_SIGMA * quiet * (2.0 / judged).sqrt();
    Spread { shot_v: Some((quiet + extra).sqrt()), extra_v: if certain { (extra / shots).sqrt() } else { 0.0 } }
}

/// The sample furthest from the mean of all, and how many there are.
fn largest_deviation(samples: &[f64]) -> (f64, f64) {
    let mean = samples.iter().sum::<f64>() / samples.len() as f64;
    let largest = samples
        .iter()
        .map(|value| value - mean)
        .fold(0.0_f64, |most, value| if value.abs() > most.abs() { value } else { most });
    (largest, samples.len() as f64)
}

/// A measurement of this profile with nothing known of a pulse.
fn blank(profile: &Profile) -> Measurement {
    Measurement {
        campaign: profile.campaign.clone(),
        sensor: profile.sensor.clone(),
        lit: profile.lit,
        seen: profile.seen,
        role: profile.role.clone(),
        run: profile.run.clone(),
        shots: profile.shots,
        rejected: profile.rejected,
        clipped: profile.clipped,
        path_m: profile.path_m,
        path_sd_m: profile.path_sd_m,
        attenuation_od: profile.attenuation_od,
        power_w: profile.power_w,
        bounces: profile.bounces,
        acquired_at: profile.acquired_at.clone(),
        snr: None,
        amplitude_v: None,
        amplitude_sd_v: None,
        time_ps: None,
        time_sd_ps: None,
        width_ratio: None,
        width_ratio_sd: None,
        width_ps: None,
        baseline_v: profile.baseline_v,
        noise_v: profile.noise_v,
        noise_acf: profile.noise_acf.get(1).map(|r| f64::from(*r)),
        signal_noise_v: None,
        gain_v: profile.gain_v,
        echo_ratio: None,
        echo_ratio_sd: None,
        echo_delay_ps: None,
        echo_trials: None,
        pickup_v: None,
        pickup_sd_v: None,
        pickup_trials: None,
    }
}
