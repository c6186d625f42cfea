//! `calibrate`: a sensor's impulse response, the template of its reference pulse, its latency and its noise (paper
//! sections 5 and 6).
//!
//! From captures of role `response`: shots over a path of known length, at each vertical range for itself. Their
//! trigger jitter and sub-sample offsets spread the samples over the pulse. So response and template come out on a grid
//! of 1/8 sample. They include certain echoes, and the tail as far as it rises above the noise. Shots whose amplitude
//! or time strays are left out. The latency is the mean time of the response in the shots less the time of flight over
//! the known path. Each shot's time is relative to its own reference pulse. The latency is measured with the same
//! template that `deconvolve` uses, so that an error of the template's zero cancels; the reference's template is one
//! for all ranges of a sensor. The residuals of the shots give the noise by level and slope
//! ([`crate::signal::noise_model`]).
//!
//! Photon counters have one histogram a capture, freed of pile-up; its maximum is timed by the counts' likelihood, and
//! the response lies on the bins' own grid, interpolated: bins no wider than a third of it are needed.
//!
//! Takes `traces`; writes `calibration`. At most [`SHOTS_MAX`] shots a range are used, and no more than [`KEPT_BYTES`]
//! of samples: the first ones. Clipped shots, and those with a sample that is no number, are left out. A width or
//! latency that no sensor has is reported in `rejects`. Without `path_m` the latency is the prior of campaign.toml.
//! `track` adds what changes through a session (drift, pick-up).
//!
//! ```toml
//! [calibration]
//! stage = "calibrate"
//! from = "calibration_traces"
//! ```

mod analog;
mod counter;

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{BesideTables, Fold, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::keys::{Sensor, SensorKind};
use crate::campaign::{Campaign, Role};
use crate::cancel::Cancel;
use crate::signal::codes::Codes;
use crate::signal::oversample::{Shape, Shot};
use crate::tables::cell::Cell;
use crate::tables::traces::TraceColumns;
use crate::tables::{Calibration, Name, Row, Trace};
use crate::units;

/// Most shots of a sensor and range that are used.
pub const SHOTS_MAX: usize = 4096;
/// Most bytes of samples of a sensor and range that are kept.
pub const KEPT_BYTES: usize = 64 << 20;

/// A narrower response is doubted: the fastest photodiodes take some picoseconds.
const WIDTH_LEAST_PS: f64 = 1.0;
/// A latency below it is doubted: the reference's way would have to be 200 m of cable longer than the signal's.
const LATENCY_LEAST_PS: f64 = -1e6;

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
    counter: Option<Counter>,
}

/// A sensor that counts photons.
#[derive(Clone, Copy, Debug, Serialize)]
struct Counter {
    /// Laser pulses behind each histogram.
    cycles: Option<u64>,
    dead_time_ps: f64,
}

/// A sensor under way.
pub struct State {
    campaign: Name,
    sensor: Name,
    ranges: BTreeMap<Option<Name>, Shots>,
    /// Reference of the shot whose signal comes next: shot number, samples.
    reference: Option<(i32, Shot)>,
}

/// Response shots of one vertical range.
struct Shots {
    /// First signal row: the others must have its time base and path.
    first: Trace,
    signals: Vec<Shot>,
    /// As many, or none without reference channel.
    references: Vec<Shot>,
    bytes: usize,
    other: i32,
}

/// What a range's shots say.
struct Estimate {
    shape: Shape,
    /// Time of the response after the reference pulse (or the trigger), and its standard deviation.
    arrival_ps: (f64, f64),
    width_sd_ps: Option<f64>,
    noise_model: Option<Vec<f64>>,
    noise_acf: Option<Vec<f64>>,
    shots: usize,
}

/// Reference pulse of a sensor.
struct Reference {
    shape: Shape,
    /// Mean integral of the range's pulses.
    integral_v_ps: f64,
}

/// What campaign.toml says of each campaign's sensors.
pub struct Context {
    priors: BTreeMap<String, BTreeMap<String, Prior>>,
    cancel: Cancel,
}

impl Stage for Calibrate {
    const KIND: &'static str = "calibrate";
    const VERSION: u32 = 7;
    const GRAIN: Grain = Grain::Sensor;
    type Input = Trace;
    type Output = Calibration;
    type Fields = BTreeMap<String, BTreeMap<String, Prior>>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let counter =
            |sensor: &Sensor| Counter { cycles: sensor.cycles, dead_time_ps: sensor.dead_time_ps.unwrap_or(0.0) };
        let prior = |campaign: &Campaign, sensor: &Sensor| Prior {
            group_index: campaign.group_index,
            latency_ps: sensor.latency_ps,
            latency_sd_ps: sensor.latency_sd_ps,
            counter: (sensor.kind == SensorKind::Counts).then(|| counter(sensor)),
        };
        let sensors = |campaign: &Campaign| {
            campaign.sensors.iter().map(|(name, sensor)| (name.clone(), prior(campaign, sensor))).collect()
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), sensors(campaign))).collect()
    }

    fn context(&self, priors: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        Ok(Context { priors, cancel: beside.cancel.clone() })
    }
}

impl Fold for Calibrate {
    type State = State;

    fn begin(&self, _: &Self::Context, first: Trace) -> State {
        State { campaign: first.campaign, sensor: first.sensor, ranges: BTreeMap::new(), reference: None }
    }

    fn step(
        &self,
        _: &Self::Context,
        state: &mut State,
        columns: &TraceColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        columns.require_codes(rows.clone()).map_err(StageError::Refused)?;
        for i in rows.filter(|&i| columns.role.value(i) == Role::Response.name()) {
            state.take(columns, i);
        }
        Ok(())
    }

    fn finish(&self, context: &Context, state: State) -> Result<Outcome<Calibration>, StageError> {
        Ok(state.calibrate(&context.priors[&*state.campaign][&*state.sensor], &context.cancel))
    }
}

impl State {
    fn take(&mut self, columns: &TraceColumns, i: usize) {
        let codes =
            Codes::of(columns.code_type.value(i), columns.codes.value(i)).expect("ingest writes known code types only");
        let gain_v = columns.gain_v.value(i);
        let shot = || Shot {
            samples: codes.to_f64().into_iter().map(|code| code * gain_v).collect(),
            t0_ps: columns.t0_ps.value(i),
        };
        // A shot with a sample that is no number is no better than one with a sample at the rails.
        let clipped = columns.clipped.values()[i] > 0 || !codes.is_finite();
        if columns.is_reference.value(i) {
            self.reference = (!clipped).then(|| (columns.shot.value(i), shot()));
            return;
        }
        let reference = self.reference.take().filter(|(of, _)| *of == columns.shot.value(i));
        let range = <Option<Name> as Cell>::get(&columns.range, i);
        let shots = self.ranges.entry(range).or_insert_with(|| Shots::new(Trace::read(columns, i)));
        if shots.signals.len() >= SHOTS_MAX || shots.bytes >= KEPT_BYTES {
            return;
        }
        let first = &shots.first;
        let path = <Option<f64> as Cell>::get(&columns.path_m, i);
        let alike =
            (columns.dt_ps.value(i), columns.samples.value(i), path) == (first.dt_ps, first.samples, first.path_m);
        let with_reference = !shots.references.is_empty() || (reference.is_some() && shots.signals.is_empty());
        if !alike || clipped || reference.is_some() != with_reference {
            shots.other += 1;
            return;
        }
        let signal = shot();
        shots.bytes += 8 * signal.samples.len();
        shots.signals.push(signal);
        if let Some((_, reference)) = reference {
            shots.bytes += 8 * reference.samples.len();
            shots.references.push(reference);
        }
    }

    fn rejection(&self, range: Option<&Shots>, why: &str) -> Rejection {
        let name = range.and_then(|range| range.first.range.as_deref());
        let at = name.map(|name| format!(" at range {name}")).unwrap_or_default();
        Rejection {
            campaign: self.campaign.clone(),
            file: range.map(|range| range.first.file.clone()),
            segment: None,
            byte_offset: None,
            reason: format!("sensor {}{at} is not calibrated: {why}", self.sensor),
        }
    }

    fn calibrate(&self, prior: &Prior, cancel: &Cancel) -> Outcome<Calibration> {
        if self.ranges.is_empty() {
            return Outcome::rejected(
                self.rejection(None, "it has no capture of role `response`; add a [[captures]] rule for one"),
            );
        }
        let most = self.ranges.values().max_by_key(|range| range.references.len()).expect("there is a range");
        let template = analog::template(&most.references, most.first.dt_ps);
        let (mut rows, mut rejections) = (Vec::new(), Vec::new());
        for range in self.ranges.values() {
            cancel.check();
            match range.row(self, prior, template.as_ref(), cancel) {
                Ok(row) => {
                    let doubts = doubts(&row, &range.first);
                    rejections.extend(doubts.map(|why| Rejection { reason: why, ..self.rejection(Some(range), "") }));
                    rows.push(row);
                }
                Err(why) => {
                    rejections.push(self.rejection(Some(range), &why));
                    continue;
                }
            }
            // Reported only where more shots are left out than used: single bad shots are counted in the table.
            if range.other as usize > range.signals.len() {
                let why = format!(
                    "{} response shots of sensor {} are left out of its calibration, more than are used: clipped, without reference pulse, or of another length or path than the first",
                    range.other, self.sensor
                );
                rejections.push(Rejection { reason: why, ..self.rejection(Some(range), "") });
            }
        }
        Outcome { rejections, ..Outcome::rows(rows) }
    }
}

/// What no real sensor has: mostly a wrong unit. It is reported, and the calibration used as it is.
fn doubts(row: &Calibration, first: &Trace) -> impl Iterator<Item = String> {
    let Calibration { sensor, width_ps, latency_ps, .. } = row;
    let fast = (*width_ps < WIDTH_LEAST_PS).then(|| {
        let why = first.time_base_doubt().unwrap_or_else(|| "is `dt_ps` in ps?".to_owned());
        format!("the response of sensor {sensor} is {width_ps:.3} ps wide, less than of any photodiode: {why}")
    });
    let early = first.path_m.filter(|_| *latency_ps < LATENCY_LEAST_PS).map(|path_m| {
        format!(
            "the response of sensor {sensor} comes {:.0} ns before light can have gone path_m = {path_m}: is it in m? is its t0_ps right?",
            -latency_ps * 1e-3
        )
    });
    fast.into_iter().chain(early)
}

impl Shots {
    fn new(first: Trace) -> Self {
        Self { first, signals: Vec::new(), references: Vec::new(), bytes: 0, other: 0 }
    }

    fn row(&self, of: &State, prior: &Prior, template: Option<&Shape>, cancel: &Cancel) -> Result<Calibration, String> {
        if self.signals.is_empty() {
            let other = self.other;
            return Err(format!("none of its {other} response shots is usable; check range and reference channel"));
        }
        let (estimate, reference) = match prior.counter {
            Some(counter) => (counter::estimate(&self.signals, self.first.dt_ps, counter, cancel)?, None),
            None => analog::estimate(self, template)?,
        };
        let (arrival_ps, arrival_sd_ps) = estimate.arrival_ps;
        let (latency_ps, latency_sd_ps, latency_common_sd_ps) = match (self.first.path_m, prior.latency_ps) {
            (Some(path_m), _) => {
                let path_sd_ps = units::time_ps(self.first.path_sd_m.unwrap_or(0.0), prior.group_index);
                let latency_ps = arrival_ps - units::time_ps(path_m, prior.group_index);
                (latency_ps, arrival_sd_ps.hypot(path_sd_ps), path_sd_ps)
            }
            // One prior for the sensor, whatever the range.
            (None, Some(latency_ps)) => {
                let sd_ps = prior.latency_sd_ps.unwrap_or(0.0);
                (latency_ps, sd_ps, sd_ps)
            }
            (None, None) => {
                return Err("its latency is unknown: give the response captures a `path_m` in campaign.toml, or the sensor a `latency_ps`".to_owned());
            }
        };
        let upward = |shape: &Shape| shape.values.iter().map(|value| value * shape.height.signum()).collect();
        Ok(Calibration {
            campaign: of.campaign.clone(),
            sensor: of.sensor.clone(),
            range: self.first.range.clone(),
            shots: estimate.shots as i32,
            rejected: self.other + (self.signals.len() - estimate.shots) as i32,
            step_ps: estimate.shape.step_ps,
            response_t0_ps: estimate.shape.t0_ps,
            response: upward(&estimate.shape),
            reference_t0_ps: reference.as_ref().map(|reference| reference.shape.t0_ps),
            reference: reference.as_ref().map(|reference| upward(&reference.shape)),
            latency_ps,
            latency_sd_ps,
            latency_common_sd_ps: Some(latency_common_sd_ps),
            acquired_at: self.first.acquired_at.clone(),
            reference_v_ps: reference.as_ref().map(|reference| reference.integral_v_ps),
            noise_model: estimate.noise_model,
            noise_acf: estimate.noise_acf.map(|acf| acf.into_iter().collect()),
            width_ps: estimate.shape.response().width_ps(),
            width_sd_ps: estimate.width_sd_ps,
            scene_width: None,
            scene_width_sd: None,
            scene_tail: None,
            scene_evidence: None,
        })
    }
}
