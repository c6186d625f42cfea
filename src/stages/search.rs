//! `search`: hidden patches too weak for an onset in any single profile, found on waveforms over all profiles at once (beyond the paper).
//!
//! `detect` needs a signal-to-noise ratio of about five in one profile. A hidden patch of 1.5 in each of 8 x 8 profiles has 12 in all of them together, at one place
//! in space and no other: [`crate::geometry::faint`] finds it, on matched-filter scores of what known light leaves of each profile ([`sparse::matched`]). Known is
//!
//! - what `stir` has fitted, explained or not: amplitude and time of each impulse are taken as open (of strong ones their width too), so that nothing they could explain
//!   counts for a patch, and none of its light is lost in them unseen;
//! - third bounces over patches in place, where their pairs exchange light (`labels` tells): too weak to be fitted they are as strong as the hidden one. How strong on average
//!   is learned from all profiles, once; more than that nothing is assumed.
//!
//! Patches are found one after the other, the light of one known to the search for the next. They are numbered on from the largest patch, as many as there are, or
//! `[hidden] count` of campaign.toml at most. The likeliest place that is not sure enough stands in `hypotheses` with `patch` null, and with it what would show it: how many shots, and hours.
//!
//! Takes `patches` (of `refine`) and writes them on, new ones added; beside them `hypotheses`. Beside it `profiles`, `stir`, `labels` and `calibration`; optional `delays`
//! (of the same `refine`) and `session` (of `track`).
//!
//! Not modelled: errors of visible patches and delays, small beside the width of a response; footprints (`spread_ps` is the spread of a hidden patch's light in time, the same in all
//! profiles); records that a laser's period wraps; photon counts; fourth and later bounces too weak to be fitted.
//!
//! ```toml
//! [found]
//! stage = "search"
//! from = "patches"
//! with = { profiles = "profiles", stir = "stir", labels = "labels", calibration = "calibration", delays = "patches.delays" }
//! ```

mod record;
mod written;

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::faint::{self, Room};
use crate::geometry::hidden::facing;
use crate::parameter::{NonNegative, Share};
use crate::priors::calibration::{self, Calibrated, Key, key_of};
use crate::signal::sparse::{self, Open};
use crate::tables::{Calibration, Delay, Hypothesis, Label, Patch, Profile, Row, Session, Stir};
use crate::units::{self, PatchId};
use record::{Light, Record};
use written::Search as Written;

/// Patches found at most.
const FOUND_MAX: usize = 32;

/// Parameters of `search`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Search {
    /// Probability that a patch is found where there is none.
    false_alarm: Share,
    /// Standard deviation of the spread in time of a hidden patch's light.
    spread_ps: NonNegative,
}

impl Default for Search {
    fn default() -> Self {
        Self { false_alarm: Share::new(1e-3), spread_ps: NonNegative::new(30.0) }
    }
}

/// What a campaign says that matters here.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    group_index: f64,
    repetition_ps: Option<f64>,
    source_m: [f64; 3],
    sensors_m: BTreeMap<String, [f64; 3]>,
    dimensions: usize,
    largest_patch: PatchId,
    hidden_count: Option<u32>,
}

/// The tables beside.
pub struct Known {
    setups: BTreeMap<String, Setup>,
    profiles: Vec<Profile>,
    stir: Vec<Stir>,
    labels: Vec<Label>,
    calibration: Vec<Calibration>,
    calibrated: BTreeMap<Key, Calibrated>,
    sessions: Vec<Session>,
    delays: Vec<Delay>,
    cancel: Cancel,
}

impl Stage for Search {
    const KIND: &'static str = "search";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "profiles", table: "profiles", required: true },
        Beside { name: "stir", table: "stir", required: true },
        Beside { name: "labels", table: "labels", required: true },
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "session", table: "session", required: false },
    ];
    const SIDES: &'static [Side] = &[Side { name: Hypothesis::TABLE, schema: Hypothesis::schema }];
    type Input = Patch;
    type Output = Patch;
    type Fields = BTreeMap<String, Setup>;
    type Context = Known;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let setup = |campaign: &Campaign| {
            let station = |sensor: &String| Some((sensor.clone(), campaign.station_of(sensor)?.position_m));
            Setup {
                group_index: campaign.group_index,
                repetition_ps: campaign.repetition_ps,
                source_m: campaign.source().position_m,
                sensors_m: campaign.sensors.keys().filter_map(station).collect(),
                dimensions: usize::from(campaign.dimensions),
                largest_patch: campaign.patches.keys().copied().max().unwrap_or(0),
                hidden_count: campaign.hidden.count,
            }
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, setups: Self::Fields, beside: &BesideTables) -> Result<Known, StageError> {
        let calibration = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        let mut profiles = beside.rows::<Profile>("profiles")?.unwrap_or_default();
        profiles.retain(|profile| &*profile.role == "scene");
        Ok(Known {
            setups,
            profiles,
            stir: beside.rows("stir")?.unwrap_or_default(),
            labels: beside.rows("labels")?.unwrap_or_default(),
            calibrated: calibration.iter().map(|row| (key_of(row), Calibrated::new(row))).collect(),
            calibration,
            sessions: beside.rows("session")?.unwrap_or_default(),
            delays: beside.rows("delays")?.unwrap_or_default(),
            cancel: beside.cancel.clone(),
        })
    }
}

impl Apply for Search {
    fn apply(&self, known: &Known, group: Vec<Patch>) -> Result<Outcome<Patch>, StageError> {
        let best = group.iter().filter(|patch| patch.alternative == 0);
        let mut points: BTreeMap<PatchId, Point> =
            best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
        let (mut records, mut rejections) = known.records(&points)?;
        let mut written = Written::new(&records, -self.false_alarm.get().ln());
        let visible: Vec<PatchId> =
            records.iter().flat_map(|record| [record.lit, record.seen]).collect::<BTreeSet<_>>().into_iter().collect();
        let room = match room(known, &points, &visible, &records) {
            Ok(room) => Some(room),
            Err(why) => {
                rejections.push(rejection(&known.first_campaign(), why));
                None
            }
        };
        let light = Light::new(known, &records, &visible);
        if room.is_some() {
            light.learn(&mut records, &points, &known.cancel);
        }
        let already = points.len() - visible.len();
        let count = known.setups.values().next().and_then(|setup| setup.hidden_count);
        let most = count.map_or(FOUND_MAX, |count| (count as usize).saturating_sub(already));
        let largest = known.setups.values().map(|setup| setup.largest_patch).chain(points.keys().copied()).max();
        for patch in (largest.unwrap_or(0) + 1..).take(most) {
            let Some(room) = &room else { break };
            let scores = |record: &Record| {
                let given = light.given(record, &points);
                record.scores(&visible, &given, self.spread_ps.get(), &known.cancel)
            };
            let profiles: Vec<faint::Profile> = records.par_iter().map(scores).collect();
            let Some(place) = faint::likeliest(&profiles, room) else { break };
            if !written.add(patch, place, room.dimensions) {
                break;
            }
            points.insert(patch, place.point);
        }
        rejections.extend(written.message().map(|text| rejection(&known.first_campaign(), text)));
        let hypotheses = written.hypotheses();
        let mut rows = group;
        rows.extend(written.patches());
        Ok(Outcome { rows, sides: vec![Hypothesis::to_batch(&hypotheses)], rejections })
    }
}

/// What patches are searched in, or why they cannot be.
fn room(
    known: &Known,
    points: &BTreeMap<PatchId, Point>,
    visible: &[PatchId],
    records: &[Record],
) -> Result<Room, String> {
    let Some((setup, record)) = known.setups.values().next().zip(records.first()) else {
        return Err("no profile of two patches with known places can be searched for hidden patches".to_owned());
    };
    let at: Vec<Point> = visible.iter().map(|patch| points[patch]).collect();
    if !facing::spans(&at, setup.dimensions) {
        let count = at.len();
        return Err(format!(
            "the {count} visible patches with known places lie in one line: hidden patches are known but for a turn about it, and are not looked for; light and see a patch off that line"
        ));
    }
    let foci = facing::fronts(&at, &vec![None; at.len()], Point::from(setup.source_m), setup.dimensions);
    let width_m = units::path_m(record.response.width_ps(), setup.group_index);
    Ok(Room { foci, dimensions: setup.dimensions, width_m, cancel: known.cancel.clone() })
}

fn rejection(campaign: &str, reason: String) -> Rejection {
    Rejection { campaign: campaign.into(), file: None, segment: None, byte_offset: None, reason }
}
