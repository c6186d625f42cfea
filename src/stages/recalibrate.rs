//! `recalibrate`: the response of each sensor as the scene's own pulses show it, where they contradict the response
//! captures ([`ResponseErrors`]).
//!
//! A response captured another day, at another bias or behind another cable is some per cent wider or narrower, or has
//! an echo or a tail. One profile can hardly tell that from light; many together can, since light arrives at other
//! distances in each. The first profiles of a sensor and range are explained under the response as it is, weak pulses
//! last, and what all of them leave in common corrects it: its width, or a blur to either side (jitter of the trigger,
//! a slower amplifier), and with either its shape after the maximum. The calibration stands where it explains the
//! profiles as well, where they are too few, and where what they leave differs from profile to profile: patches that
//! spread light each in their own way are no property of the sensor.
//!
//! Takes `profiles` and `calibration`; writes `calibration` of the sensors that it has profiles of, with
//! `scene_width`, `scene_width_sd`, `scene_tail` and `scene_evidence` where it corrected one. Set `extent_max_ps` as in
//! `deconvolve`: where light may be spread in time, a wider response is not sought, nor echoes next to the maximum. At
//! most [`PROFILES_MAX`] profiles of a sensor and range are used, the first ones. An `ingest` of its own with
//! `captures_max` keeps the rest of the pipeline streaming.
//!
//! Not modelled: counters, steps, and responses that change through a session stay as they are. A response that arrives
//! earlier or later as a whole looks like a latency. Bounces that follow the first one by the same time with the same
//! share in every profile look like an echo of the sensor.
//!
//! ```toml
//! [scene_calibration]
//! stage = "recalibrate"
//! from = "first_profiles"
//! with = { calibration = "calibration", session = "session" }
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::stage::{Beside, BesideTables, Fold, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::parameter::NonNegative;
use crate::priors::calibration::{self, Calibrated, Sensors, averaged};
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::flight_profile::FlightProfile;
use crate::priors::sensor_range::{OfSensorRange, SensorRange};
use crate::signal::response::Response;
use crate::signal::sparse::{OwnResponse, ResponseErrors, SparseOptions};
use crate::tables::profiles::ProfileColumns;
use crate::tables::row::Row;
use crate::tables::{Calibration, Name, Profile, Session};

/// Most profiles of a sensor and range that are used.
pub const PROFILES_MAX: usize = 256;

/// Most pulses of a profile: more are rather what a wrong response leaves than light.
const PULSES_MAX: usize = 12;

/// Share of the maximum below which a corrected response ends.
const NEGLIGIBLE: f64 = 1e-4;

/// Parameters of `recalibrate`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recalibrate {
    /// Largest standard deviation of the spread in time of one impulse's light, as in `deconvolve`; 0: points only.
    extent_max_ps: NonNegative,
}

impl Default for Recalibrate {
    fn default() -> Self {
        Self { extent_max_ps: NonNegative::new(0.0) }
    }
}

/// What campaign.toml says of the laser.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    repetition_ps: Option<f64>,
}

/// The calibrated sensors.
pub struct Context {
    calibration: Vec<Calibration>,
    sensors: Sensors,
    sessions: Vec<Session>,
    fields: ByCampaign<Fields>,
    cancel: Cancel,
}

/// A sensor under way.
pub struct State {
    campaign: Name,
    sensor: Name,
    /// The first profiles of each range.
    profiles: BTreeMap<SensorRange, Vec<Profile>>,
}

impl Stage for Recalibrate {
    const KIND: &'static str = "recalibrate";
    const VERSION: u32 = 6;
    const GRAIN: Grain = Grain::Sensor;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "session", table: "session", required: false },
    ];
    type Input = Profile;
    type Output = Calibration;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields { repetition_ps: campaign.repetition_ps })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let calibration = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        let sessions = beside.rows::<Session>("session")?.unwrap_or_default();
        let (sensors, cancel) = (Sensors::new(&calibration), beside.cancel.clone());
        Ok(Context { calibration, sensors, sessions, fields, cancel })
    }
}

impl Fold for Recalibrate {
    type State = State;

    fn begin(&self, _: &Context, first: Profile) -> State {
        State { campaign: first.campaign, sensor: first.sensor, profiles: BTreeMap::new() }
    }

    fn step(
        &self,
        context: &Context,
        state: &mut State,
        columns: &ProfileColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        for i in rows {
            let profile = Profile::read(columns, i);
            if let Some((key, _)) = context.sensors.of(&profile).filter(|_| profile.counts.is_none()) {
                let profiles = state.profiles.entry(key.clone()).or_default();
                if profiles.len() < PROFILES_MAX {
                    profiles.push(profile);
                }
            }
        }
        Ok(())
    }

    fn finish(&self, context: &Context, state: State) -> Result<Outcome<Calibration>, StageError> {
        let of_sensor = |row: &&Calibration| row.campaign == state.campaign && row.sensor == state.sensor;
        let rows = context.calibration.iter().filter(of_sensor).map(|row| {
            let profiles = state.profiles.get(&row.sensor_range()).map_or(&[][..], Vec::as_slice);
            self.corrected(context, row, profiles)
        });
        Ok(Outcome::rows(rows.collect()))
    }
}

impl Recalibrate {
    /// The row with the response that the profiles show; as it is, where they show no other.
    fn corrected(&self, context: &Context, row: &Calibration, profiles: &[Profile]) -> Calibration {
        let calibrated = Calibrated::new(row);
        let stands = || row.clone();
        let Some(errors) = ResponseErrors::new(&calibrated.response, self.extent_max_ps.get() > 0.0) else {
            return stands();
        };
        let ready = |profile| ready(context, row, &calibrated, profile);
        let records: Vec<(&Profile, FlightProfile)> = profiles.iter().filter_map(ready).collect();
        let Some(own) = self.own_response(context, &errors, &records).filter(OwnResponse::is_common) else {
            return stands();
        };
        with_response(row, &calibrated, &errors, &own)
    }

    fn own_response(
        &self,
        context: &Context,
        errors: &ResponseErrors,
        records: &[(&Profile, FlightProfile)],
    ) -> Option<OwnResponse> {
        let options = SparseOptions {
            extent_max_ps: self.extent_max_ps.get(),
            pulses_max: PULSES_MAX,
            cancel: context.cancel.clone(),
            ..SparseOptions::default()
        };
        errors.own_response(|coefficients, least_share| {
            let score = |(profile, flight): &(&Profile, FlightProfile)| {
                context.cancel.check();
                let averaged = |response: &Response| averaged(response, profile);
                errors.score(&flight.view(), coefficients, averaged, least_share, &options)
            };
            records.par_iter().filter_map(score).collect()
        })
    }
}

/// A profile as estimators take it; `None` for one that `deconvolve` will refuse.
fn ready<'a>(
    context: &Context,
    row: &Calibration,
    calibrated: &Calibrated,
    profile: &'a Profile,
) -> Option<(&'a Profile, FlightProfile)> {
    let period_ps = context.fields.get(&profile.campaign).and_then(|fields| fields.repetition_ps);
    let (key, sd_v) = (row.sensor_range(), calibration::sd_v(profile));
    let flight = FlightProfile::new(profile, (&key, calibrated), &context.sessions, period_ps, sd_v).ok()?;
    Some((profile, flight))
}

/// The row with another response. Its arrival stays where it was, since no profile shows it: it is known to half of
/// what the response became wider or narrower, and no better than what that moves pulses by.
fn with_response(
    row: &Calibration,
    calibrated: &Calibrated,
    errors: &ResponseErrors,
    own: &OwnResponse,
) -> Calibration {
    let response = errors.response(&own.coefficients);
    let moved_ps = (0.5 * (response.width_ps() - row.width_ps)).abs().max(errors.delay_ps(&response).abs());
    let (first_ps, last_ps) = response.support_ps();
    let (first, last) = ((first_ps / row.step_ps).floor(), (last_ps / row.step_ps).ceil());
    let height = response.height();
    let value = |n: f64| response.value(n * row.step_ps) / height;
    let behind = (0..=(last - first) as usize).rev().find(|n| value(first + *n as f64).abs() > NEGLIGIBLE);
    let values = (0..=behind.unwrap_or(0) + 1).map(|n| calibrated.polarity * value(first + n as f64));
    Calibration {
        response_t0_ps: first * row.step_ps,
        response: values.collect(),
        latency_sd_ps: row.latency_sd_ps.hypot(moved_ps),
        width_ps: response.width_ps(),
        width_sd_ps: own.width.map_or(row.width_sd_ps, |[_, sd]| Some(response.width_ps() * sd)),
        scene_width: own.width.map(|[width, _]| width),
        scene_width_sd: own.width.map(|[_, sd]| sd),
        scene_tail: own.tail(),
        scene_evidence: Some(own.gain),
        ..row.clone()
    }
}
