//! `deconvolve`: the sensor's response undone: which impulses of light explain a profile, and how sure (paper sections 3 and 6).
//!
//! | method | result |
//! |---|---|
//! | `sparse` | impulses off the grid by greedy maximum likelihood, with times, amplitudes, covariance and evidence |
//! | `nnls` | non-negative least squares on a grid, its atoms merged, refined off the grid and pruned by evidence |
//! | `pencil` | poles of the spectrum (ESPRIT), refined and pruned the same way |
//! | `richardson-lucy` | light on a grid by multiplicative steps until the residual is noise; an impulse for each lump, at its centroid |
//! | `wiener` | a regularised profile for the eye and for edge methods of `detect`; no impulses |
//!
//! The last four are there to compare with. `nnls`, `pencil` and `richardson-lucy` take noise as white and the baseline as the mean of the samples
//! that no light reaches; correlated noise brings false impulses and error bars that are too small. Times of `richardson-lucy` are biased by
//! picoseconds, and it splits pulses in strong noise: what it gives as standard deviation is that of a least-squares fit at its times, without either.
//!
//! Light that an extended patch spreads in time is modelled by `sparse` where `extent_max_ps` is positive: an impulse whose samples ask for it is
//! widened by a Gaussian, and by an exponential tail where that does not suffice; its time is that of the light's centroid, and `width_ps` the
//! standard deviation of both together. Two impulses closer than twice that limit may then be taken for one.
//!
//! With a known response the limit of time resolution is noise and not the sensor: `sparse` separates pulses closer than the response is
//! wide. Times are times of flight: the sensor's latency is taken off here. Pulses are of the
//! response's sign, unless `signed` allows both.
//!
//! Takes `profiles`; writes `stir`. Beside it: `calibration`. Noise is taken as equal along the record, of standard deviation `noise_v` over the root
//! of the shots and with the autocorrelation `noise_acf`, smoothed to that of an autoregressive process of the order that `noise_samples` can tell. `wiener`
//! knows the correlation in `profile_noise` only. Where the response fits far worse than the noise is (`chi2_dof` well above 1) and a single shot
//! tells the noise, its estimate weighs the misfit otherwise in every record: `correlated = false` keeps times comparable there. Not modelled yet:
//! noise that depends on the level.
//!
//! ```toml
//! [stir]
//! stage = "deconvolve"
//! from = "profiles"
//! with = { calibration = "calibration" }
//! params = { method = "sparse" }
//! ```

mod explain;

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::signal::averaged_response::averaged_response;
use crate::signal::fft::RealFft;
use crate::signal::noise;
use crate::signal::response::Response;
use crate::signal::wiener::{Transfer, Wiener};
use crate::tables::{Calibration, Name, Profile, Stir};
use explain::{Asked, Method, Record};

/// Share of a record whose samples tell the noise, where the profile does not say.
const BASELINE_SHARE: f64 = 0.1;

/// Parameters of `deconvolve`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Deconvolve {
    method: Method,
    /// Chi-square that one impulse more must gain, for `sparse`, `nnls` and `pencil`; absent: set by the record's length, for one false impulse in
    /// 10,000 records.
    evidence: Option<f64>,
    /// Most impulses in a profile, for `sparse` and `pencil`.
    impulses_max: usize,
    /// Whether impulses may be negative, for `sparse`: reflections on a line are, light is not.
    signed: bool,
    /// Whether the noise's correlation counts.
    correlated: bool,
    /// Largest standard deviation of the spread in time of one impulse's light, as extended patches give, for `sparse`; 0: points only.
    extent_max_ps: f64,
    /// Noise over signal power, for `wiener`; absent: estimated for each profile.
    noise_to_signal: Option<f64>,
    /// Where a Gaussian low-pass has fallen to exp(-1/2), for `wiener`; absent: none.
    lowpass_ghz: Option<f64>,
}

impl Default for Deconvolve {
    fn default() -> Self {
        Self {
            method: Method::Sparse,
            evidence: None,
            impulses_max: 16,
            signed: false,
            correlated: true,
            extent_max_ps: 0.0,
            noise_to_signal: None,
            lowpass_ghz: None,
        }
    }
}

/// Response and latency of one sensor.
pub struct Sensor {
    /// Turned upwards.
    response: Response,
    /// -1 for a sensor whose pulses go down.
    polarity: f64,
    latency_ps: f64,
}

/// The calibrated sensors, and tools that wait for their next use.
pub struct Sensors {
    calibrated: BTreeMap<(Name, Name), Sensor>,
    tools: Mutex<Vec<Tools>>,
}

/// What one worker has prepared, kept because captures of a campaign are mostly alike.
#[derive(Default)]
struct Tools {
    fft: RealFft,
    response: Option<(Alike, Response)>,
    filter: Option<(Alike, f64, Wiener)>,
}

/// What an averaged response depends on: sensor, time step, length, and phases of the shots.
type Alike = (Name, Name, u64, usize, Option<Vec<i32>>);

/// Noise of a mean record.
struct Noise {
    /// Standard deviation of each sample.
    sd_v: f64,
    /// Autocorrelation at lags 0, 1, ..
    acf: Vec<f64>,
}

/// Autocorrelation of a profile's noise.
fn correlation(profile: &Profile) -> Vec<f64> {
    // A table made elsewhere may not say how many samples tell the noise: at least a tenth of one shot's.
    let usual = || profile.mean_v.len() as f64 * BASELINE_SHARE;
    let samples = profile.noise_samples.map_or_else(usual, f64::from);
    noise::autoregressive(&profile.noise_acf.to_f64(), samples.max(1.0) as usize)
}

impl Stage for Deconvolve {
    const KIND: &'static str = "deconvolve";
    const VERSION: u32 = 2;
    const GRAIN: Grain = Grain::Capture;
    const BESIDE: &'static [Beside] = &[Beside { name: "calibration", table: "calibration", required: true }];
    type Input = Profile;
    type Output = Stir;
    type Fields = ();
    type Context = Sensors;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Sensors, StageError> {
        for (name, value) in
            [("noise_to_signal", self.noise_to_signal), ("lowpass_ghz", self.lowpass_ghz), ("evidence", self.evidence)]
        {
            if let Some(value) = value.filter(|value| value.is_nan() || *value <= 0.0) {
                return Err(StageError::Refused(format!("params.{name} = {value} must be positive")));
            }
        }
        if !(0.0..f64::INFINITY).contains(&self.extent_max_ps) {
            let extent_max_ps = self.extent_max_ps;
            return Err(StageError::Refused(format!("params.extent_max_ps = {extent_max_ps} must not be negative")));
        }
        if self.method != Method::Sparse && (self.signed || self.extent_max_ps > 0.0) {
            return Err(StageError::Refused(
                "params.signed and params.extent_max_ps go with method `sparse` alone".to_owned(),
            ));
        }
        let rows = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        let sensor = |row: Calibration| {
            let mut values = row.response.to_f64();
            let polarity = values
                .iter()
                .fold(0.0_f64, |most, value| if value.abs() > most.abs() { *value } else { most })
                .signum();
            values.iter_mut().for_each(|value| *value *= polarity);
            let response = Response::new(row.response_t0_ps, row.step_ps, &values);
            ((row.campaign, row.sensor), Sensor { response, polarity, latency_ps: row.latency_ps })
        };
        Ok(Sensors { calibrated: rows.into_iter().map(sensor).collect(), tools: Mutex::default() })
    }
}

impl Apply for Deconvolve {
    fn apply(&self, sensors: &Sensors, group: Vec<Profile>) -> Result<Outcome<Stir>, StageError> {
        let waiting = || sensors.tools.lock().unwrap_or_else(PoisonError::into_inner);
        let mut tools = waiting().pop().unwrap_or_default();
        let mut rows = Vec::new();
        for profile in group {
            let key = (profile.campaign.clone(), profile.sensor.clone());
            let sensor = sensors.calibrated.get(&key).ok_or_else(|| {
                let (campaign, sensor) = (&key.0, &key.1);
                StageError::Refused(format!("sensor `{sensor}` of campaign `{campaign}` is not calibrated: capture its response, or import a calibration"))
            })?;
            rows.push(self.deconvolve(sensor, &profile, &mut tools));
        }
        waiting().push(tools);
        Ok(Outcome::rows(rows))
    }
}

impl Tools {
    /// Makes the averaged response of a profile the one at hand.
    fn take_up(&mut self, sensor: &Sensor, profile: &Profile) -> Alike {
        let Profile { campaign, sensor: name, dt_ps, mean_v, phase_shots, .. } = profile;
        // Only shares of shots matter, but whole numbers compare exactly.
        let alike = (campaign.clone(), name.clone(), dt_ps.to_bits(), mean_v.len(), phase_shots.clone());
        if self.response.as_ref().is_none_or(|(of, _)| *of != alike) {
            let averaged = match phase_shots {
                Some(phase_shots) => averaged_response(&sensor.response, *dt_ps, phase_shots),
                None => sensor.response.clone(),
            };
            self.response = Some((alike.clone(), averaged));
        }
        alike
    }
}

impl Deconvolve {
    fn deconvolve(&self, sensor: &Sensor, profile: &Profile, tools: &mut Tools) -> Stir {
        let samples: Vec<f64> = profile.mean_v.to_f64().into_iter().map(|sample| sample * sensor.polarity).collect();
        // A record without any noise (an ideal one) still has the rounding of its f32 samples.
        let rounding =
            f64::from(f32::EPSILON) * samples.iter().fold(f64::MIN_POSITIVE, |most, sample| most.max(sample.abs()));
        let noise_v = (profile.noise_v / f64::from(profile.shots).sqrt()).max(rounding);
        let alike = tools.take_up(sensor, profile);
        // What is no more than the rounding of the samples is white.
        let is_white = !self.correlated || noise_v <= rounding;
        let acf = if is_white { vec![1.0] } else { correlation(profile) };
        let noise = Noise { sd_v: noise_v, acf };
        let (light, light_noise_v) = self.wiener(alike, profile.dt_ps, &samples, &noise, tools);
        let response = tools.response.as_ref().map(|(_, response)| response).expect("taken up above");
        let t0_ps = profile.t0_ps - sensor.latency_ps;
        let sd_v = vec![noise.sd_v; samples.len()];
        let record = Record { samples: &samples, sd_v, acf: &noise.acf, t0_ps, dt_ps: profile.dt_ps, response };
        let explained = match self.method {
            Method::Wiener => None,
            Method::Sparse => Some(record.sparse(self.asked())),
            Method::Nnls | Method::Pencil | Method::RichardsonLucy => Some(record.compared(self.method, self.asked())),
        };
        let chi2_dof = explained.as_ref().map(|explained| explained.chi2_dof);
        let (mut impulses, impulse_cov) =
            explained.map_or_else(Default::default, |explained| (explained.impulses, explained.covariance_ps2));
        for impulse in &mut impulses {
            impulse.amplitude_v *= sensor.polarity;
        }
        Stir {
            campaign: profile.campaign.clone(),
            sensor: profile.sensor.clone(),
            lit: profile.lit,
            seen: profile.seen,
            t0_ps,
            dt_ps: profile.dt_ps,
            profile: light.into_iter().collect(),
            profile_noise: light_noise_v,
            impulses,
            impulse_cov,
            chi2_dof,
            jitter_ps: profile.jitter_ps,
            gain_sd: profile.gain_sd,
            power_ratio: None,
        }
    }

    fn asked(&self) -> Asked {
        let Self { evidence, impulses_max, signed, extent_max_ps, .. } = *self;
        Asked { evidence, impulses_max, signed, extent_max_ps }
    }

    /// The Wiener estimate and the standard deviation of its noise.
    fn wiener(&self, alike: Alike, dt_ps: f64, samples: &[f64], noise: &Noise, tools: &mut Tools) -> (Vec<f64>, f64) {
        let Tools { fft, response, filter } = tools;
        let ready = |(of, ratio, _): &(Alike, f64, Wiener)| *of == alike && self.noise_to_signal == Some(*ratio);
        if !filter.as_ref().is_some_and(ready) {
            let (_, response) = response.as_ref().expect("taken up before");
            let transfer = Transfer::from_response(fft, response, dt_ps, samples.len());
            let noise_to_signal = self.noise_to_signal.unwrap_or_else(|| transfer.noise_to_signal(samples, noise.sd_v));
            let low_pass = self.lowpass_ghz.map(|lowpass_ghz| lowpass_ghz * dt_ps / 1000.0);
            *filter = Some((alike, noise_to_signal, Wiener::new(&transfer, noise_to_signal, low_pass)));
        }
        let (_, _, wiener) = filter.as_ref().expect("made above");
        let mut light = vec![0.0; samples.len()];
        wiener.apply(fft, samples, &mut light);
        let light_noise_v = noise.sd_v * wiener.noise_gain(fft, &noise.acf);
        (light, light_noise_v)
    }
}
