//! `deconvolve`: the sensor's response undone: which impulses of light explain a profile, and how sure (paper sections
//! 3 and 6).
//!
//! | method | result |
//! |---|---|
//! | `sparse` | impulses off the grid by greedy maximum likelihood, with times, amplitudes, covariance and evidence |
//! | `wiener` | a regularised profile for the eye and for edge methods of `detect`; no impulses |
//! | `none` | the profile as it was measured, for edge methods of `detect`: what a reader of the oscilloscope's screen sees |
//!
//! How `sparse` compares with other methods, which are not in the program, stands in docs/time-resolution.md.
//!
//! Light that an extended patch spreads in time is modelled by `sparse` where `extent_max_ps` is positive: an impulse
//! whose samples ask for it is widened by a Gaussian; where that does not suffice, by what even disks make of light in
//! its place, with a tilt or without, or by an exponential tail behind it. Its time is that of the light's centroid,
//! `width_ps` the standard deviation of all together (`tail_ps` of it is the tail). `width_kurtosis` tells light over
//! disks (from -1) from a Gaussian (0), and `width_tilt` how it changes over one standard deviation.
//!
//! Two impulses closer than twice that limit may then be taken for one: the best two points in the place of a wide
//! impulse stay beside it (the fields `pair_...` of an impulse), for `label` to choose by what it knows of the scene.
//!
//! With a known response the limit of time resolution is noise and not the sensor: `sparse` separates pulses closer
//! than the response is wide. Times are times of flight: the sensor's latency is taken off here. Pulses are of the
//! response's sign, unless `signed` allows both.
//!
//! Where laser and sensor stand together, profiles (i, k) and (k, i) hold the same paths walked in opposite directions.
//! With `joint` they are explained together: times are better by up to the root of 2, and close arrivals are separated
//! as at as much more signal. The impulses then stand in the row of the smaller `lit` alone, so that nothing counts
//! twice.
//!
//! With `predictions` (of `predict`), impulses start where a solution predicts them, with its times and widths as
//! priors, and stay in the fit even where they show no light. `own_time_ps`, `impulse_cov` and `own_variance_ps2` are
//! those of the profile alone, so that a prediction never counts as a measurement; only widths, and the two points in
//! the place of a wide impulse, keep what the predictions of their neighbours say.
//!
//! Photon counts are explained by the likelihood of counts, freed of pile-up by the dead time in campaign.toml;
//! amplitudes are counts a bin.
//!
//! Under the impulses lie a line (bent, where there is slow noise) and that noise, explained together with them; and
//! where shots jitter, what finitely many of them do to the shape of their mean. Where
//! noise does not explain a profile, a baseline that moves the same way in every shot is tried (`ground_v`), and where
//! its pulses ask for it, a response of another width than the calibration's (`response_width`). Both are kept where
//! the profile is the likelier for it, and their errors are in the covariance.
//!
//! Takes `profiles` and `calibration`; optional `session` and `predictions`; writes `stir`. With `session` (of
//! `track`), drift and pick-up are taken off; the drift's error joins `jitter_ps`, the pick-up's the noise. The noise
//! of each sample is the profile's `se_v`. Its autocorrelation is `noise_acf`, smoothed to that of an autoregressive
//! process of the order that `noise_samples` support. `wiener` assumes equal noise along the record. Set `correlated =
//! false` where the response fits far worse than the noise (`chi2_dof` well above 1) and a single shot gives the noise:
//! else each record weighs the misfit differently, and times are not comparable.
//!
//! Not modelled: light that wraps around the end of a record (`average` cuts circular profiles open where they are
//! quiet); counts explained jointly; the delay between two vertical ranges in a jointly explained pair.
//!
//! ```toml
//! [stir]
//! stage = "deconvolve"
//! from = "profiles"
//! with = { calibration = "calibration", session = "session" }
//! params = { method = "sparse" }
//! ```

mod explain;
mod predictions;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Deserializer, Serialize};

use super::method;
use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::parameter::{Condition, Count, NonNegative, Positive};
use crate::priors::calibration::{self, Calibrated};
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::flight_profile::FlightProfile;
use crate::priors::sensor_range::SensorRange;
use crate::signal::fft::RealFft;
use crate::signal::response::Response;
use crate::signal::sparse::{self, Baseline, SparseOptions, Unpiled};
use crate::signal::wiener::{Transfer, Wiener};
use crate::tables::{Calibration, Profile, Session, Stir};
use explain::{Explained, Method};
use predictions::Predictions;

/// Parameters of `deconvolve`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Deconvolve {
    #[serde(deserialize_with = "method_of")]
    method: Method,
    /// Chi-square that one impulse more must gain, for `sparse`; absent: set by the record's length, for one false
    /// impulse in 10,000 records.
    evidence: Option<Positive>,
    /// Most impulses in a profile, for `sparse`.
    impulses_max: Count,
    /// Whether impulses may be negative, for `sparse`: reflections on a line are, light is not.
    signed: bool,
    /// Whether the noise's correlation counts.
    correlated: bool,
    /// Whether reciprocal profiles are explained together, for `sparse`: where laser and sensor stand together.
    joint: bool,
    /// Largest standard deviation of the spread in time of one impulse's light, as extended patches give, for `sparse`;
    /// 0: points only.
    extent_max_ps: NonNegative,
    /// Noise over signal power, for `wiener`; absent: estimated for each profile.
    noise_to_signal: Option<Positive>,
    /// Where a Gaussian low-pass has fallen to exp(-1/2), for `wiener`; absent: none.
    lowpass_ghz: Option<Positive>,
}

impl Default for Deconvolve {
    fn default() -> Self {
        Self {
            method: Method::Sparse,
            evidence: None,
            impulses_max: Count::new(16),
            signed: false,
            correlated: true,
            joint: false,
            extent_max_ps: NonNegative::new(0.0),
            noise_to_signal: None,
            lowpass_ghz: None,
        }
    }
}

fn method_of<'de, D: Deserializer<'de>>(name: D) -> Result<Method, D::Error> {
    let former = ["nnls", "pencil", "richardson-lucy"];
    method::named(name, &former, "use `sparse`; there are also `wiener` and `none`")
}

/// What campaign.toml says of laser and sensors.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    repetition_ps: Option<f64>,
    /// Dead times of photon counters.
    dead_times_ps: BTreeMap<String, f64>,
    /// Sensors that stand where the laser stands.
    with_laser: Vec<String>,
}

/// The calibrated sensors, and tools that wait for their next use.
pub struct Context {
    sensors: calibration::Sensors,
    sessions: Vec<Session>,
    predictions: Predictions,
    fields: ByCampaign<Fields>,
    tools: Mutex<Vec<Tools>>,
    cancel: Cancel,
}

/// What one worker has prepared, kept because captures of a campaign are mostly alike.
#[derive(Default)]
struct Tools {
    fft: RealFft,
    response: Option<(Alike, Arc<Response>)>,
    filter: Option<(Alike, f64, Wiener)>,
}

/// What an averaged response depends on: sensor and range, time step, length, where its ends are cut off, and phases of
/// the shots.
type Alike = (SensorRange, u64, usize, u64, Option<Vec<i32>>);

/// A profile made ready.
struct Ready {
    flight: FlightProfile,
    /// Time error that all its arrivals share.
    jitter_ps: f64,
    response: Arc<Response>,
    /// Width of the response over that of the response captures, and the standard deviation of its logarithm.
    width: [f64; 2],
    unpiled: Option<Unpiled>,
    polarity: f64,
    power_ratio: Option<f64>,
    light: Vec<f64>,
    light_noise_v: f64,
    predictions: Vec<sparse::Prediction>,
}

impl Stage for Deconvolve {
    const KIND: &'static str = "deconvolve";
    const VERSION: u32 = 16;
    const GRAIN: Grain = Grain::Pair;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "session", table: "session", required: false },
        Beside { name: "predictions", table: "predictions", required: false },
    ];
    const RESPONSES: Option<&'static Beside> = Some(&Self::BESIDE[0]);
    const CONDITIONS: &'static [Condition] = &[
        Condition("evidence", "method", &["sparse"]),
        Condition("impulses_max", "method", &["sparse"]),
        Condition("signed", "method", &["sparse"]),
        Condition("joint", "method", &["sparse"]),
        Condition("extent_max_ps", "method", &["sparse"]),
        Condition("noise_to_signal", "method", &["wiener"]),
        Condition("lowpass_ghz", "method", &["wiener"]),
    ];
    type Input = Profile;
    type Output = Stir;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| {
            let with_laser = |name: &&String| {
                campaign.station_of(name).is_some_and(|at| at.position_m == campaign.source().position_m)
            };
            Fields {
                repetition_ps: campaign.repetition_ps,
                dead_times_ps: campaign
                    .sensors
                    .iter()
                    .filter_map(|(name, sensor)| Some((name.clone(), sensor.dead_time_ps?)))
                    .collect(),
                with_laser: campaign.sensors.keys().filter(with_laser).cloned().collect(),
            }
        })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let rows = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        let sessions = beside.rows::<Session>("session")?.unwrap_or_default();
        let predictions = Predictions::new(beside.rows("predictions")?.unwrap_or_default());
        let (sensors, cancel) = (calibration::Sensors::new(&rows), beside.cancel.clone());
        Ok(Context { sensors, sessions, predictions, fields, tools: Mutex::default(), cancel })
    }
}

impl Apply for Deconvolve {
    fn apply(&self, context: &Context, group: Vec<Profile>) -> Result<Outcome<Stir>, StageError> {
        let waiting = || context.tools.lock().unwrap_or_else(PoisonError::into_inner);
        let mut tools = waiting().pop().unwrap_or_default();
        let mut outcome = Outcome::rows(Vec::new());
        let mut ready: Vec<(&Profile, Ready)> = Vec::new();
        for profile in &group {
            context.cancel.check();
            match self.prepare(context, profile, &mut tools)? {
                Ok(one) => ready.push((profile, one)),
                Err(why) => outcome.rejections.push(rejection(profile, &why)),
            }
        }
        waiting().push(tools);
        let explained = self.explain(context, &ready);
        for ((profile, ready), explained) in ready.into_iter().zip(explained) {
            outcome.rows.push(stir(profile, ready, explained));
        }
        Ok(outcome)
    }
}

fn rejection(profile: &Profile, why: &str) -> Rejection {
    let Profile { campaign, sensor, lit, seen, .. } = profile;
    Rejection::new(campaign, format!("profile of sensor {sensor}, lit {lit}, seen {seen}, {why}"))
}

fn stir(profile: &Profile, ready: Ready, explained: Option<Explained>) -> Stir {
    let chi2_dof = explained.as_ref().map(|explained| explained.chi2_dof);
    let ground_v = explained.as_ref().map_or(0.0, |explained| explained.ground_v);
    let width = explained.as_ref().and_then(|explained| explained.width);
    let (mut impulses, impulse_cov) =
        explained.map_or_else(Default::default, |explained| (explained.impulses, explained.covariance_ps2));
    for impulse in &mut impulses {
        impulse.amplitude_v *= ready.polarity;
        if let Some(pair) = &mut impulse.pair {
            pair.first_amplitude_v *= ready.polarity;
            pair.second_amplitude_v *= ready.polarity;
        }
    }
    Stir {
        campaign: profile.campaign.clone(),
        sensor: profile.sensor.clone(),
        lit: profile.lit,
        seen: profile.seen,
        range: profile.range.clone(),
        acquired_at: profile.acquired_at.clone(),
        t0_ps: ready.flight.t0_ps,
        dt_ps: ready.flight.dt_ps,
        profile: ready.light.into_iter().collect(),
        profile_noise: ready.light_noise_v,
        background: profile.counts.as_ref().map(|_| profile.baseline_v.max(1.0)),
        impulses,
        impulse_cov,
        chi2_dof,
        ground_v,
        response_width: width.map(|[factor, _]| ready.width[0] * factor),
        response_width_sd: width.map(|[_, sd]| sd),
        jitter_ps: ready.jitter_ps,
        gain_sd: profile.gain_sd,
        power_ratio: ready.power_ratio,
    }
}

impl Deconvolve {
    /// What the impulses are; `None` for a profile whose impulses stand with its reciprocal one, or that has none to be
    /// found.
    fn explain(&self, context: &Context, ready: &[(&Profile, Ready)]) -> Vec<Option<Explained>> {
        if let [(first, a), (second, b)] = ready
            && self.joint
            && (first.lit, first.seen) == (second.seen, second.lit)
            && first.lit != first.seen
            && a.unpiled.is_none()
            && b.unpiled.is_none()
            && a.flight.dt_ps == b.flight.dt_ps
            && context.fields.of(&first.campaign).with_laser.iter().any(|sensor| **sensor == *first.sensor)
        {
            let together = explain::jointly(&[a.profile(), b.profile()], &self.options(&context.cancel, a));
            return if first.lit < first.seen { vec![Some(together), None] } else { vec![None, Some(together)] };
        }
        ready.iter().map(|(_, ready)| self.explain_alone(context, ready)).collect()
    }

    fn explain_alone(&self, context: &Context, ready: &Ready) -> Option<Explained> {
        match (self.method, &ready.unpiled) {
            (Method::Wiener | Method::None, _) => None,
            (Method::Sparse, Some(unpiled)) => {
                Some(explain::counts(unpiled, ready.profile(), &self.options(&context.cancel, ready)))
            }
            (Method::Sparse, None) => Some(explain::jointly(&[ready.profile()], &self.options(&context.cancel, ready))),
        }
    }

    /// A profile made ready, or why it cannot be.
    fn prepare(
        &self,
        context: &Context,
        profile: &Profile,
        tools: &mut Tools,
    ) -> Result<Result<Ready, String>, StageError> {
        let sensor = context.sensors.of(profile).ok_or_else(|| {
            let (campaign, sensor) = (&profile.campaign, &profile.sensor);
            let range = profile.range.as_ref().map(|range| format!(" at range `{range}`")).unwrap_or_default();
            StageError::Refused(format!("sensor `{sensor}` of campaign `{campaign}` is not calibrated{range}: capture its response, or import a calibration"))
        })?;
        Ok(self.ready(context, profile, sensor, tools))
    }

    fn ready(
        &self,
        context: &Context,
        profile: &Profile,
        (key, calibrated): (&SensorRange, &Calibrated),
        tools: &mut Tools,
    ) -> Result<Ready, String> {
        let fields = context.fields.get(&profile.campaign);
        let (sd_v, period_ps) = (calibration::sd_v(profile), fields.and_then(|fields| fields.repetition_ps));
        let mut flight = FlightProfile::new(profile, (key, calibrated), &context.sessions, period_ps, sd_v)?;
        if !self.correlated {
            flight.acf = vec![1.0];
        }
        let predictions = context.predictions.of(profile, &flight, period_ps);
        let noise_v = calibration::noise_v(profile);
        let alike = tools.take_up(key.clone(), calibrated, profile);
        let (light, light_noise_v) = match self.method {
            Method::None => (flight.mean_v.clone(), noise_v),
            Method::Sparse | Method::Wiener => self.wiener(alike, &flight, noise_v, tools),
        };
        let dead_time_ps = fields.and_then(|fields| fields.dead_times_ps.get(&*profile.sensor));
        let unpiled = unpiled(profile, dead_time_ps.copied().unwrap_or(0.0))?;
        let power = |reference_v_ps: f64| Some(reference_v_ps / calibrated.reference_v_ps?);
        Ok(Ready {
            jitter_ps: profile.jitter_ps.hypot(flight.drift_sd_ps),
            flight,
            response: Arc::clone(&tools.response.as_ref().expect("taken up above").1),
            width: calibrated.width,
            unpiled,
            polarity: calibrated.polarity,
            power_ratio: profile.reference_v_ps.and_then(power),
            light,
            light_noise_v,
            predictions,
        })
    }

    fn options(&self, cancel: &Cancel, ready: &Ready) -> SparseOptions {
        SparseOptions {
            evidence_min: self.evidence.map(Positive::get),
            pulses_max: self.impulses_max.get() as usize,
            // On a line, steps and ringing are signal.
            baseline: if self.signed { Baseline::Constant } else { Baseline::Line },
            signed: self.signed,
            extent_max_ps: self.extent_max_ps.get(),
            width_sd: ready.width[1],
            predictions: ready.predictions.clone(),
            cancel: cancel.clone(),
        }
    }

    /// The Wiener estimate and the standard deviation of its noise.
    fn wiener(&self, alike: Alike, flight: &FlightProfile, noise_v: f64, tools: &mut Tools) -> (Vec<f64>, f64) {
        let samples = &flight.mean_v;
        let Tools { fft, response, filter } = tools;
        let ready = |(of, ratio, _): &(Alike, f64, Wiener)| {
            *of == alike && self.noise_to_signal.map(Positive::get) == Some(*ratio)
        };
        if !filter.as_ref().is_some_and(ready) {
            let (_, response) = response.as_ref().expect("taken up before");
            let transfer = Transfer::from_response(fft, response, flight.dt_ps, samples.len());
            let noise_to_signal = self.noise_to_signal.map(Positive::get);
            let noise_to_signal = noise_to_signal.unwrap_or_else(|| transfer.noise_to_signal(samples, noise_v));
            let low_pass = self.lowpass_ghz.map(|lowpass_ghz| lowpass_ghz.get() * flight.dt_ps / 1000.0);
            *filter = Some((alike, noise_to_signal, Wiener::new(&transfer, noise_to_signal, low_pass)));
        }
        let (_, _, wiener) = filter.as_ref().expect("made above");
        let mut light = vec![0.0; samples.len()];
        wiener.apply(fft, samples, &mut light);
        let light_noise_v = noise_v * wiener.noise_gain(&flight.acf);
        (light, light_noise_v)
    }
}

/// Counts freed of pile-up; `None` for voltages.
fn unpiled(profile: &Profile, dead_time_ps: f64) -> Result<Option<Unpiled>, String> {
    let Some((counts, cycles)) = profile.counts.as_ref().zip(profile.cycles) else {
        return Ok(None);
    };
    let counts: Vec<u32> = counts.iter().map(|count| u32::try_from(*count).unwrap_or(0)).collect();
    let dead_bins = (dead_time_ps / profile.dt_ps).round() as usize;
    Unpiled::new(&counts, u64::try_from(cycles).unwrap_or(0), dead_bins)
        .map(Some)
        .map_err(|error| format!("has {error}; check `cycles` and `dead_time_ps` in campaign.toml"))
}

impl Ready {
    /// The profile as the kernel takes it, and the response that its pulses have in it.
    fn profile(&self) -> (sparse::Profile<'_>, &Response) {
        (self.flight.view(), &self.response)
    }
}

impl Tools {
    /// Makes the averaged response of a profile the one at hand.
    fn take_up(&mut self, key: SensorRange, sensor: &Calibrated, profile: &Profile) -> Alike {
        let Profile { dt_ps, phase_shots, .. } = profile;
        // Only shares of shots matter, but whole numbers compare exactly.
        let alike =
            (key, dt_ps.to_bits(), profile.samples(), calibration::cut_share(profile).to_bits(), phase_shots.clone());
        if self.response.as_ref().is_none_or(|(of, _)| *of != alike) {
            self.response = Some((alike.clone(), Arc::new(sensor.averaged(profile))));
        }
        alike
    }
}
