//! `track`: what changes through a session, and what every shot of it has without any light.
//!
//! - Drift: captures of role `fiducial`, one fixed path again and again. Of the runs that differ in their time alone,
//!   the longest series is followed ([`drift`]). The result is the delay since the response captures, from which the
//!   latency was measured. A delay that jumps is no drift: it goes to `rejects`, with its time.
//! - Pick-up: captures of role `blocked`, the laser firing with its beam stopped. Their mean is what it induces in step
//!   with the shots ([`pickup`]); given where its power exceeds that of its errors by three standard deviations.
//!
//! `deconvolve` takes both off. What moves between reference pulse and trigger needs no tracking: every shot is aligned
//! to its reference.
//!
//! Takes `profiles` (only fiducial and blocked ones are used) and `calibration`; writes `session`.
//!
//! Not modelled: drift that differs between the vertical ranges of a sensor; pick-up that changes through the session
//! (its chi-square would show it).
//!
//! ```toml
//! [session]
//! stage = "track"
//! from = "session_profiles"
//! with = { calibration = "calibration" }
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{Beside, BesideTables, Fold, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::{Campaign, Role};
use crate::cancel::Cancel;
use crate::parameter::Positive;
use crate::priors::acquisition_time;
use crate::priors::calibration::{self, Calibrated};
use crate::priors::sensor_range::own_or_only;
use crate::signal::drift::{self, Drift, DriftError, DriftOptions, Point};
use crate::signal::pickup::{self, Blocked, Pickup};
use crate::signal::sparse::{self, SparseOptions};
use crate::tables::profiles::ProfileColumns;
use crate::tables::row::Row;
use crate::tables::{Calibration, Name, Profile, Session};

/// Fewer runs are no series.
const RUNS_MIN: usize = 3;
/// Pick-up is reported where its power exceeds its errors' by this many standard deviations.
const PICKUP_SIGMA: f64 = 3.0;

/// Parameters of `track`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Track {
    /// Time between the knots of the drift; absent: the median time between fiducials.
    knots_s: Option<Positive>,
    /// A jump of the delay by this many standard deviations is no drift.
    jump_sigma: Positive,
}

impl Default for Track {
    fn default() -> Self {
        Self { knots_s: None, jump_sigma: Positive::new(5.0) }
    }
}

/// A sensor under way.
pub struct State {
    campaign: Name,
    sensor: Name,
    fiducials: BTreeMap<Setting, Vec<Run>>,
    blocked: BTreeMap<Option<Name>, Vec<Profile>>,
}

/// What runs of one series have in common, numbers by their bits.
type Setting = (Option<Name>, [Option<u64>; 3], Option<i32>);

/// A fiducial run whose pulse was found.
struct Run {
    acquired_at: Option<Name>,
    delay_ps: f64,
    sd_ps: f64,
}

/// The calibrated sensors.
pub struct Sensors {
    calibration: Vec<Calibration>,
    cancel: Cancel,
}

impl Stage for Track {
    const KIND: &'static str = "track";
    const VERSION: u32 = 2;
    const GRAIN: Grain = Grain::Sensor;
    const BESIDE: &'static [Beside] = &[Beside { name: "calibration", table: "calibration", required: true }];
    type Input = Profile;
    type Output = Session;
    type Fields = ();
    type Context = Sensors;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Sensors, StageError> {
        let calibration = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        Ok(Sensors { calibration, cancel: beside.cancel.clone() })
    }
}

impl Fold for Track {
    type State = State;

    fn begin(&self, _: &Sensors, first: Profile) -> State {
        State { campaign: first.campaign, sensor: first.sensor, fiducials: BTreeMap::new(), blocked: BTreeMap::new() }
    }

    fn step(
        &self,
        sensors: &Sensors,
        state: &mut State,
        columns: &ProfileColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        let is = |i: usize, role: Role| columns.role.value(i) == role.name();
        for i in rows.filter(|&i| is(i, Role::Fiducial) || is(i, Role::Blocked)) {
            let profile = Profile::read(columns, i);
            if is(i, Role::Blocked) {
                state.blocked.entry(profile.range.clone()).or_default().push(profile);
            } else {
                state.take_fiducial(sensors, &profile);
            }
        }
        Ok(())
    }

    fn finish(&self, sensors: &Sensors, state: State) -> Result<Outcome<Session>, StageError> {
        let calibration = &sensors.calibration;
        let mut rejections = Vec::new();
        let drift = self.drift(calibration, &state).unwrap_or_else(|why| {
            rejections.push(state.rejection(why));
            None
        });
        let ranges = calibration.iter().filter(|row| row.campaign == state.campaign && row.sensor == state.sensor);
        let rows = ranges.map(|row| state.row(row.range.clone(), drift.as_ref())).collect();
        Ok(Outcome { rejections, ..Outcome::rows(rows) })
    }
}

/// Drift of a sensor since its response captures.
struct Followed {
    drift: Drift,
    origin_s: f64,
    from: Name,
    runs: usize,
}

impl Track {
    /// Drift through the longest series of fiducials, or why it is none.
    fn drift(&self, calibration: &[Calibration], state: &State) -> Result<Option<Followed>, String> {
        let Some(runs) = state.fiducials.values().max_by_key(|runs| runs.len()).filter(|runs| runs.len() >= RUNS_MIN)
        else {
            return Ok(None);
        };
        let of_sensor = |row: &&Calibration| row.campaign == state.campaign && row.sensor == state.sensor;
        let origin = calibration.iter().filter(of_sensor).find_map(|row| row.acquired_at.clone());
        let point = |run: &Run| {
            Some(Point { time_s: time_s(run.acquired_at.as_ref())?, delay_ps: run.delay_ps, sd_ps: run.sd_ps })
        };
        let points: Option<Vec<Point>> = runs.iter().map(point).collect();
        let (Some(points), Some(origin_s)) = (points, time_s(origin.as_ref())) else {
            return Err(
                "its fiducial or response files do not say when they were taken: drift is not followed".to_owned()
            );
        };
        let first = runs.iter().zip(&points).min_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s)).expect("there are runs");
        let mut times: Vec<f64> = points.iter().map(|point| point.time_s).collect();
        times.sort_by(f64::total_cmp);
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > 0.0).collect();
        gaps.sort_by(f64::total_cmp);
        let Some(spacing_s) = self.knots_s.map(Positive::get).or_else(|| gaps.get(gaps.len() / 2).copied()) else {
            return Err("its fiducial files all name the same time: drift is not followed".to_owned());
        };
        match drift::fit(&points, &DriftOptions { spacing_s, step_sigma: self.jump_sigma.get() }) {
            Ok(drift) => {
                let from = first.0.acquired_at.clone().expect("points have times");
                Ok(Some(Followed { drift, origin_s, from, runs: runs.len() }))
            }
            Err(DriftError::TooFew) => Ok(None),
            Err(DriftError::Step { between_s: (before_s, after_s), step_ps, sd_ps }) => {
                let hours = |at_s: f64| (at_s - times[0]) / 3600.0;
                let (before, after) = (hours(before_s), hours(after_s));
                Err(format!(
                    "its delay jumps by {step_ps:.2} ps (sd {sd_ps:.2}) between {before:.2} h and {after:.2} h after the first fiducial, which is no drift (a cable was touched?): \
                     analyse the captures before and after as two campaigns, or leave one part out with [[exclude]]; drift is not followed"
                ))
            }
        }
    }
}

fn time_s(moment: Option<&Name>) -> Option<f64> {
    acquisition_time::seconds(moment?)
}

impl State {
    fn take_fiducial(&mut self, sensors: &Sensors, profile: &Profile) {
        let bits = |value: Option<f64>| value.map(f64::to_bits);
        let settings = [bits(profile.path_m), bits(profile.attenuation_od), bits(profile.power_w)];
        let setting = (profile.range.clone(), settings, profile.bounces);
        let Some(calibrated) = own_or_only(&sensors.calibration, profile) else { return };
        if let Some((delay_ps, sd_ps)) = delay(profile, &Calibrated::new(calibrated), &sensors.cancel) {
            let run = Run { acquired_at: profile.acquired_at.clone(), delay_ps, sd_ps };
            self.fiducials.entry(setting).or_default().push(run);
        }
    }

    fn rejection(&self, why: String) -> Rejection {
        Rejection::new(&self.campaign, format!("sensor {}: {why}", self.sensor))
    }

    fn row(&self, range: Option<Name>, followed: Option<&Followed>) -> Session {
        let since = |followed: &Followed| -> Vec<(f64, f64)> {
            followed.drift.knots_s().map(|knot_s| followed.drift.since(followed.origin_s, knot_s)).collect()
        };
        let knots = followed.map(since);
        let pickup = self.blocked.get(&range).and_then(|blocked| pickup_of(blocked));
        let step_s = followed.and_then(|followed| {
            let mut knots_s = followed.drift.knots_s();
            let first_s = knots_s.next()?;
            Some(knots_s.next()? - first_s)
        });
        Session {
            campaign: self.campaign.clone(),
            sensor: self.sensor.clone(),
            range,
            fiducials: followed.map_or(0, |followed| followed.runs as i32),
            drift_from: followed.map(|followed| followed.from.clone()),
            drift_step_s: step_s,
            drift_ps: knots.as_ref().map(|knots| knots.iter().map(|(delay_ps, _)| *delay_ps).collect()),
            drift_sd_ps: knots.as_ref().map(|knots| knots.iter().map(|(_, sd_ps)| *sd_ps).collect()),
            pickup_t0_ps: pickup.as_ref().map(|(t0_ps, ..)| *t0_ps),
            pickup_dt_ps: pickup.as_ref().map(|(_, dt_ps, _)| *dt_ps),
            pickup_v: pickup.as_ref().map(|(.., pickup)| pickup.mean_v.iter().copied().collect()),
            pickup_se_v: pickup.as_ref().map(|(.., pickup)| pickup.se_v.iter().copied().collect()),
        }
    }
}

/// When the strongest pulse of a run arrives, and the standard deviation of that; `None` where it shows none.
fn delay(profile: &Profile, sensor: &Calibrated, cancel: &Cancel) -> Option<(f64, f64)> {
    let response = sensor.averaged(profile);
    let mean_v: Vec<f64> = profile.mean_v().iter().map(|value| f64::from(*value) * sensor.polarity).collect();
    let sd_v: Vec<f64> = calibration::sd_v(profile);
    let acf = calibration::correlation(profile);
    let record = sparse::Profile {
        mean_v: &mean_v,
        sd_v: &sd_v,
        acf: &acf,
        slow_v2: &[],
        jitter: None,
        t0_ps: profile.t0_ps,
        dt_ps: profile.dt_ps,
    };
    let one = SparseOptions { pulses_max: 1, cancel: cancel.clone(), ..SparseOptions::default() };
    let fit = sparse::fit(&record, &response, &one);
    let pulse = fit.pulses.first()?;
    Some((pulse.time_ps, fit.time_sd_ps(0).hypot(profile.jitter_ps)))
}

/// Pick-up in blocked profiles of one range, on the places that all of them have: time of its first sample, step, and
/// the pick-up. `None` where there is none, or runs of another step.
fn pickup_of(blocked: &[Profile]) -> Option<(f64, f64, Pickup)> {
    let dt_ps = blocked[0].dt_ps;
    let alike: Vec<&Profile> = blocked.iter().filter(|profile| profile.dt_ps == dt_ps).collect();
    let place = |profile: &Profile| (profile.t0_ps / dt_ps).round() as i64;
    let first = alike.iter().map(|profile| place(profile)).max()?;
    let end = alike.iter().map(|profile| place(profile) + profile.samples() as i64).min()?;
    let cut = |profile: &Profile, values: &[f32]| -> Vec<f64> {
        let start = (first - place(profile)) as usize;
        values[start..start + (end - first) as usize].iter().map(|value| f64::from(*value)).collect()
    };
    if first >= end {
        return None;
    }
    let parts: Vec<(Vec<f64>, Vec<f64>)> =
        alike.iter().map(|profile| (cut(profile, &profile.mean_v()), cut(profile, &profile.se_v()))).collect();
    let parts: Vec<Blocked<'_>> = parts.iter().map(|(mean_v, se_v)| Blocked { mean_v, se_v }).collect();
    if parts.iter().any(|part| part.se_v.iter().any(|se| *se <= 0.0)) {
        return None;
    }
    let pickup = pickup::mean(&parts);
    let (power_v2, sd_v2) = pickup.power();
    let t0_ps = alike[0].t0_ps + (first - place(alike[0])) as f64 * dt_ps;
    (power_v2 > PICKUP_SIGMA * sd_v2).then_some((t0_ps, dt_ps, pickup))
}
