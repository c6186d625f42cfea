//! `calibrate`: a sensor's impulse response, the template of its reference pulse, and its latency (paper sections 5 and 6).
//!
//! From captures of role `response`: shots over a path of known length. Their trigger jitter and sub-sample offsets spread the samples over the
//! pulse, so that response and template come out on a grid of 1/8 sample. The latency is the mean time of the response in the shots, each
//! relative to its own reference pulse, less the light's time over the known path. It is measured with the same template that `deconvolve` uses,
//! so that an error of the template's zero cancels.
//!
//! Takes `traces`; writes `calibration`. At most [`SHOTS_MAX`] shots a sensor are used, and no more than [`KEPT_BYTES`] of samples: the first ones.
//! Clipped shots are left out. Without `path_m` the latency is the prior of campaign.toml.
//!
//! Not used yet: captures of roles `fiducial`, `dark` and `blocked` (drift, noise model, pick-up); several vertical ranges of a sensor (the first
//! that comes is calibrated, the others go to `rejects`).
//!
//! ```toml
//! [calibration]
//! stage = "calibrate"
//! from = "calibration_traces"
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{BesideTables, Fold, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::keys::Sensor;
use crate::campaign::{Campaign, Role};
use crate::signal::codes::Codes;
use crate::signal::noise;
use crate::signal::oversample::{self, Shape, Shot};
use crate::signal::reference::fit_pulse;
use crate::tables::row::Cell;
use crate::tables::traces::TraceColumns;
use crate::tables::{Calibration, Name, Row, Trace};
use crate::units;

/// Most shots of a sensor that are used.
pub const SHOTS_MAX: usize = 4096;
/// Most bytes of samples of a sensor that are kept.
pub const KEPT_BYTES: usize = 64 << 20;
/// Robust standard deviations within which the times of single shots lie.
const STRAY_SIGMA: f64 = 5.0;
/// Groups of the jackknife that gives the width's standard deviation.
const GROUPS: usize = 8;
/// Fewer shots in a group have no shape of their own.
const GROUP_SHOTS: usize = 8;

/// Parameters of `calibrate`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibrate {}

/// What a campaign says of a sensor.
#[derive(Clone, Debug, Serialize)]
pub struct Prior {
    group_index: f64,
    latency_ps: Option<f64>,
    latency_sd_ps: Option<f64>,
}

/// A sensor under way.
pub struct State {
    campaign: Name,
    sensor: Name,
    /// First signal row: the others must have its range, time base and path.
    first: Option<Trace>,
    /// Reference of the shot whose signal comes next: shot number, samples.
    reference: Option<(i32, Shot)>,
    signals: Vec<Shot>,
    references: Vec<Shot>,
    bytes: usize,
    other: i32,
}

impl Stage for Calibrate {
    const KIND: &'static str = "calibrate";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::Sensor;
    type Input = Trace;
    type Output = Calibration;
    type Fields = BTreeMap<String, BTreeMap<String, Prior>>;
    type Context = Self::Fields;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let prior = |campaign: &Campaign, sensor: &Sensor| Prior {
            group_index: campaign.group_index,
            latency_ps: sensor.latency_ps,
            latency_sd_ps: sensor.latency_sd_ps,
        };
        let sensors = |campaign: &Campaign| {
            campaign.sensors.iter().map(|(name, sensor)| (name.clone(), prior(campaign, sensor))).collect()
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), sensors(campaign))).collect()
    }

    fn context(&self, fields: Self::Fields, _: &BesideTables) -> Result<Self::Context, StageError> {
        Ok(fields)
    }
}

impl Fold for Calibrate {
    type State = State;

    fn begin(&self, _: &Self::Context, first: Trace) -> State {
        State {
            campaign: first.campaign,
            sensor: first.sensor,
            first: None,
            reference: None,
            signals: Vec::new(),
            references: Vec::new(),
            bytes: 0,
            other: 0,
        }
    }

    fn step(
        &self,
        _: &Self::Context,
        state: &mut State,
        columns: &TraceColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        for i in rows.filter(|&i| columns.role.value(i) == Role::Response.name()) {
            state.take(columns, i);
        }
        Ok(())
    }

    fn finish(&self, priors: &Self::Context, state: State) -> Result<Outcome<Calibration>, StageError> {
        let prior = &priors[&*state.campaign][&*state.sensor];
        Ok(match state.calibrate(prior) {
            Ok(row) => Outcome { rejections: state.others().into_iter().collect(), ..Outcome::rows(vec![row]) },
            Err(why) => Outcome::rejected(state.rejection(why)),
        })
    }
}

impl State {
    fn take(&mut self, columns: &TraceColumns, i: usize) {
        if self.signals.len() >= SHOTS_MAX || self.bytes >= KEPT_BYTES {
            return;
        }
        let codes =
            Codes::of(columns.code_type.value(i), columns.codes.value(i)).expect("ingest writes known code types only");
        let gain_v = columns.gain_v.value(i);
        let samples = codes.to_f64().into_iter().map(|code| code * gain_v).collect();
        let shot = Shot { samples, t0_ps: columns.t0_ps.value(i) };
        let clipped = columns.clipped.values()[i] > 0;
        if columns.is_reference.value(i) {
            self.reference = (!clipped).then_some((columns.shot.value(i), shot));
            return;
        }
        let reference = self.reference.take();
        let first = self.first.get_or_insert_with(|| Trace::read(columns, i));
        let range = <Option<Name> as Cell>::get(&columns.range, i);
        let path = <Option<f64> as Cell>::get(&columns.path_m, i);
        let alike = (columns.dt_ps.value(i), columns.samples.value(i), path)
            == (first.dt_ps, first.samples, first.path_m)
            && range == first.range;
        let with_reference = !self.references.is_empty() || self.signals.is_empty();
        match reference {
            _ if !alike || clipped => self.other += 1,
            Some((of, reference)) if of == columns.shot.value(i) && with_reference => {
                self.bytes += 8 * (shot.samples.len() + reference.samples.len());
                self.signals.push(shot);
                self.references.push(reference);
            }
            None if self.references.is_empty() => {
                self.bytes += 8 * shot.samples.len();
                self.signals.push(shot);
            }
            _ => self.other += 1,
        }
    }

    fn rejection(&self, why: String) -> Rejection {
        Rejection {
            campaign: self.campaign.clone(),
            file: self.first.as_ref().map(|first| first.file.clone()),
            segment: None,
            byte_offset: None,
            reason: format!("sensor {} is not calibrated: {why}", self.sensor),
        }
    }

    /// Told only where more shots are left out than used: single bad shots are counted in the table.
    fn others(&self) -> Option<Rejection> {
        let why = format!(
            "{} response shots of sensor {} are left out of its calibration, more than are used: clipped, without reference pulse, or of another range, length or path than the first",
            self.other, self.sensor
        );
        (self.other as usize > self.signals.len()).then(|| Rejection { reason: why, ..self.rejection(String::new()) })
    }

    fn calibrate(&self, prior: &Prior) -> Result<Calibration, String> {
        let first =
            self.first.as_ref().ok_or("it has no capture of role `response`; add a [[captures]] rule for one")?;
        if self.signals.is_empty() {
            return Err(format!(
                "none of its {} response shots is usable; check range and reference channel",
                self.other
            ));
        }
        let no_pulse = |what: &str| format!("its {what} shows no pulse; check channel, vertical range and `samples`");
        let reference = if self.references.is_empty() {
            None
        } else {
            Some(
                oversample::shape_and_times(&self.references, first.dt_ps)
                    .ok_or_else(|| no_pulse("reference channel"))?,
            )
        };
        let shots = self.aligned(reference.as_ref().map(|(_, times)| times.as_slice()));
        if shots.is_empty() {
            return Err(no_pulse("reference channel"));
        }
        let shape = oversample::shape(&shots, first.dt_ps).ok_or_else(|| no_pulse("response"))?;
        let (arrival_ps, arrival_sd_ps) = arrival(&shots, first.dt_ps, &shape);
        let (latency_ps, latency_sd_ps) = match (first.path_m, prior.latency_ps) {
            (Some(path_m), _) => {
                let path_sd_ps = units::time_ps(first.path_sd_m.unwrap_or(0.0), prior.group_index);
                (arrival_ps - units::time_ps(path_m, prior.group_index), arrival_sd_ps.hypot(path_sd_ps))
            }
            (None, Some(latency_ps)) => (latency_ps, prior.latency_sd_ps.unwrap_or(0.0)),
            (None, None) => {
                return Err("its latency is unknown: give the response captures a `path_m` in campaign.toml, or the sensor a `latency_ps`".to_owned());
            }
        };
        let sign = shape.height.signum();
        let reference = reference
            .map(|(shape, _)| (shape.t0_ps, shape.values.iter().map(|value| value * shape.height.signum()).collect()));
        let (reference_t0_ps, reference) = reference.unzip();
        Ok(Calibration {
            campaign: self.campaign.clone(),
            sensor: self.sensor.clone(),
            range: first.range.clone(),
            shots: shots.len() as i32,
            rejected: self.other + (self.signals.len() - shots.len()) as i32,
            step_ps: shape.step_ps,
            response_t0_ps: shape.t0_ps,
            response: shape.values.iter().map(|value| value * sign).collect(),
            reference_t0_ps,
            reference,
            latency_ps,
            latency_sd_ps,
            width_ps: shape.response().width_ps(),
            width_sd_ps: width_sd_ps(&shots, first.dt_ps),
            reference_v_ps: None,
            noise_model: None,
            noise_acf: None,
            drift_from: None,
            drift_step_s: None,
            drift_ps: None,
            drift_sd_ps: None,
            pickup_t0_ps: None,
            pickup_dt_ps: None,
            pickup_v: None,
            pickup_se_v: None,
        })
    }

    /// Signals in the frame of their reference pulses; of the trigger, without.
    fn aligned(&self, times: Option<&[Option<(f64, f64)>]>) -> Vec<Shot> {
        let zero_ps = |i: usize| times.map_or(Some(0.0), |times| times[i].map(|(time_ps, _)| time_ps));
        let shots = self.signals.iter().enumerate();
        shots
            .filter_map(|(i, shot)| Some(Shot { samples: shot.samples.clone(), t0_ps: shot.t0_ps - zero_ps(i)? }))
            .collect()
    }
}

/// Mean time of the response in the shots, and its standard deviation from their spread. Where single shots are too noisy to be fitted, the maximum of
/// the shape, known to about its width over the signal-to-noise ratio of the mean.
fn arrival(shots: &[Shot], dt_ps: f64, shape: &Shape) -> (f64, f64) {
    let template = shape.response();
    let fits = shots.iter().filter_map(|shot| {
        fit_pulse(&shot.samples, dt_ps, &template).map(|fit| (shot.t0_ps + fit.time_ps, fit.time_sd_ps))
    });
    let fits: Vec<(f64, f64)> = fits.collect();
    if 2 * fits.len() <= shots.len() {
        let baseline: Vec<Vec<f64>> = shots
            .iter()
            .map(|shot| shot.samples[..(shot.samples.len() / 10).max(2).min(shot.samples.len())].to_vec())
            .collect();
        let snr = shape.height.abs() * (shots.len() as f64).sqrt() / noise::estimate(&baseline, 1).sd;
        return (shape.peak_ps, template.width_ps() / snr);
    }
    let kept = without_strays(fits);
    let count = kept.len() as f64;
    let mean = kept.iter().map(|(time_ps, _)| time_ps).sum::<f64>() / count;
    let spread = kept.iter().map(|(time_ps, _)| (time_ps - mean).powi(2)).sum::<f64>();
    let sd = if kept.len() > 1 { (spread / (count - 1.0) / count).sqrt() } else { kept[0].1 };
    (mean, sd)
}

/// Times within [`STRAY_SIGMA`] robust standard deviations of their median: a shot without light has its time anywhere.
fn without_strays(mut fits: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let middle = |mut values: Vec<f64>| {
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    };
    let median = middle(fits.iter().map(|(time_ps, _)| *time_ps).collect());
    let deviation = middle(fits.iter().map(|(time_ps, _)| (time_ps - median).abs()).collect());
    let fitted = middle(fits.iter().map(|(_, sd_ps)| *sd_ps).collect());
    // The fits' own standard deviation is a floor: times that happen to be equal leave none.
    let limit = STRAY_SIGMA * (1.4826 * deviation).max(fitted);
    fits.retain(|(time_ps, _)| (time_ps - median).abs() <= limit);
    fits
}

/// Standard deviation of the width by a jackknife that leaves out every eighth shot in turn; `None` with too few shots.
fn width_sd_ps(shots: &[Shot], dt_ps: f64) -> Option<f64> {
    if shots.len() < GROUPS * GROUP_SHOTS {
        return None;
    }
    let without = |group: usize| -> Vec<Shot> {
        shots.iter().enumerate().filter(|(i, _)| i % GROUPS != group).map(|(_, shot)| shot.clone()).collect()
    };
    let widths: Vec<f64> = (0..GROUPS)
        .map(|group| oversample::shape(&without(group), dt_ps).map(|shape| shape.response().width_ps()))
        .collect::<Option<_>>()?;
    let groups = GROUPS as f64;
    let mean = widths.iter().sum::<f64>() / groups;
    Some(((groups - 1.0) / groups * widths.iter().map(|width| (width - mean).powi(2)).sum::<f64>()).sqrt())
}
