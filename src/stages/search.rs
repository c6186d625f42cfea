//! `search`: hidden patches too weak for an onset in any single profile, found on waveforms over all profiles at once
//! (beyond the paper).
//!
//! `detect` needs a signal-to-noise ratio of about five in one profile. A hidden patch of 1.5 in each of 8 x 8 profiles
//! has 12 in all together, at one place in space and no other. [`crate::geometry::faint`] finds it, on matched-filter
//! scores of what known light leaves of each profile ([`sparse::matched`]). Known light is
//!
//! - what `stir` has fitted, explained or not. Amplitude and time of each impulse are open (of strong ones their width
//!   too): nothing they could explain counts for a patch, and they hide none of its light;
//! - third bounces over patches in place, where their pairs exchange light (`labels`). Too weak to be fitted, they are
//!   as strong as the hidden one. How strong on average is learned from all profiles, once; more than that nothing is
//!   assumed.
//!
//! Patches are found one after the other; each accepted patch is known light in the search for the next. They are
//! numbered on from the largest patch, as many as there are, or `[hidden] count` of campaign.toml at most. The
//! likeliest place that is not sure enough stands in `hypotheses` with `patch` null, and with it how many shots, and
//! hours, would show it.
//!
//! Takes `patches` (of `refine`), `profiles`, `stir`, `labels` and `calibration`; optional `session` (of `track`), and
//! `delays` and `covariances` (`patch_covariances`) of the same `refine`. Errors of visible patches and of delays are
//! common to all profiles, and travel to the new patches. Without `covariances` those of patches count as independent,
//! without `delays` delays count as known. Writes all `patches`, new ones added, and `hypotheses`.
//!
//! Not modelled: what errors of patches and of delays have in common with each other; footprints (`spread_ps` is the
//! spread of a hidden patch's light in time, the same in all profiles); records that a laser's period wraps; photon
//! counts; fourth and later bounces too weak to be fitted.
//!
//! ```toml
//! [found]
//! stage = "search"
//! from = "patches"
//! with = { profiles = "profiles", stir = "stir", labels = "labels", calibration = "calibration" }
//! with.covariances = "patches.patch_covariances"
//! with.delays = "patches.delays"
//! ```

mod pair_profile;
mod rows;
mod shared_errors;

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
use crate::priors::calibration::Sensors;
use crate::priors::campaign_fields::{ByCampaign, HiddenPatches, Medium, StationPositions};
use crate::priors::covariances::PatchCovariances;
use crate::priors::delays::Delays;
use crate::signal::sparse::{self, Open};
use crate::tables::{Hypothesis, Label, Patch, Profile, Row, Session, Stir};
use crate::units::PatchId;
use pair_profile::{Light, PairProfile};
use rows::SearchRows;

/// Patches found at most.
const FOUND_MAX: usize = 32;
/// Profiles searched at most: those of 50 patches. Time grows with the fourth power of the number of patches.
const PROFILES_MAX: u64 = 2500;

/// Parameters of `search`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Search {
    /// Probability that a patch is found where there is none.
    false_alarm: Share,
    /// Standard deviation of the spread in time of a hidden patch's light.
    spread_ps: NonNegative,
    /// Whether profiles that cannot be searched, and places that are not sure enough, are no faults.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    optional: bool,
}

impl Default for Search {
    fn default() -> Self {
        Self { false_alarm: Share::new(1e-3), spread_ps: NonNegative::new(30.0), optional: false }
    }
}

/// What campaign.toml says of the scene.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    medium: Medium,
    repetition_ps: Option<f64>,
    #[serde(flatten)]
    stations: StationPositions,
    dimensions: usize,
    #[serde(flatten)]
    hidden: HiddenPatches,
}

/// Campaigns, and the tables other than the patches.
pub struct Context {
    fields: ByCampaign<Fields>,
    /// Whether there are more profiles than are searched; `profiles` is then empty.
    is_too_large: bool,
    profiles: Vec<Profile>,
    stir: Vec<Stir>,
    labels: Vec<Label>,
    sensors: Sensors,
    sessions: Vec<Session>,
    delays: Delays,
    covariances: PatchCovariances,
    cancel: Cancel,
}

impl Stage for Search {
    const KIND: &'static str = "search";
    const VERSION: u32 = 5;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "profiles", table: "profiles", required: true },
        Beside { name: "stir", table: "stir", required: true },
        Beside { name: "labels", table: "labels", required: true },
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "session", table: "session", required: false },
    ];
    const ROWS_MAX: Option<(&'static str, u64)> = Some(("profiles", PROFILES_MAX));
    const SIDES: &'static [Side] = &[Side { name: Hypothesis::TABLE, schema: Hypothesis::schema }];
    type Input = Patch;
    type Output = Patch;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields {
            medium: campaign.into(),
            repetition_ps: campaign.repetition_ps,
            stations: campaign.into(),
            dimensions: usize::from(campaign.dimensions),
            hidden: campaign.into(),
        })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let profiles = beside.rows::<Profile>("profiles")?;
        let is_too_large = profiles.is_none();
        let mut profiles = profiles.unwrap_or_default();
        profiles.retain(|profile| &*profile.role == "scene");
        Ok(Context {
            fields,
            is_too_large,
            profiles,
            stir: beside.rows("stir")?.unwrap_or_default(),
            labels: beside.rows("labels")?.unwrap_or_default(),
            sensors: Sensors::new(&beside.rows("calibration")?.unwrap_or_default()),
            sessions: beside.rows("session")?.unwrap_or_default(),
            delays: Delays::new(&beside.rows("delays")?.unwrap_or_default()),
            covariances: PatchCovariances::new(&beside.rows("covariances")?.unwrap_or_default()),
            cancel: beside.cancel.clone(),
        })
    }
}

impl Apply for Search {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<Patch>, StageError> {
        let best = group.iter().filter(|patch| patch.alternative == 0);
        let mut points: BTreeMap<PatchId, Point> =
            best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
        let (mut pairs, mut rejections) = context.pairs(&points)?;
        let mut search = SearchRows::new(&pairs, -self.false_alarm.get().ln());
        let visible: Vec<PatchId> =
            pairs.iter().flat_map(|pair| [pair.lit, pair.seen]).collect::<BTreeSet<_>>().into_iter().collect();
        let room = match room(context, &points, &visible, &pairs) {
            Ok(room) => Some(room),
            Err(why) => {
                rejections.push(Rejection::new(context.fields.first_name(), why));
                None
            }
        };
        let light = Light::new(context, &pairs, &visible);
        let shared = context.shared_errors(&pairs, &group, &visible);
        if room.is_some() {
            light.learn(&mut pairs, &points, &context.cancel);
        }
        let already = points.len() - visible.len();
        let count = context.fields.first().and_then(|fields| fields.hidden.count);
        let most = count.map_or(FOUND_MAX, |count| (count as usize).saturating_sub(already));
        let listed = context.fields.values().map(|fields| fields.hidden.largest_patch);
        let largest = listed.chain(points.keys().copied()).max();
        for patch in (largest.unwrap_or(0) + 1..).take(most) {
            let Some(room) = &room else { break };
            let scores = |pair: &PairProfile| {
                let given = light.given(pair, &points);
                pair.scores(&visible, &given, self.spread_ps.get(), &context.cancel)
            };
            let profiles: Vec<faint::Profile> = pairs.par_iter().map(scores).collect();
            let Some(place) = faint::likeliest(&profiles, room) else { break };
            let gained_m2 = faint::gained_m2(place.point, &profiles, room, &shared);
            if !search.add(patch, place, gained_m2, room.dimensions) {
                break;
            }
            points.insert(patch, place.point);
        }
        rejections.extend(search.message().map(|text| Rejection::new(context.fields.first_name(), text)));
        if self.optional {
            rejections.clear();
        }
        let hypotheses = search.hypotheses();
        let mut rows = group;
        rows.extend(search.patches());
        Ok(Outcome { rows, sides: vec![Hypothesis::to_batch(&hypotheses)], rejections })
    }
}

/// What patches are searched in, or why they cannot be.
fn room(
    context: &Context,
    points: &BTreeMap<PatchId, Point>,
    visible: &[PatchId],
    pairs: &[PairProfile],
) -> Result<Room, String> {
    if context.is_too_large {
        return Err(format!("there are more than {PROFILES_MAX} profiles: they are not searched for weak patches"));
    }
    let Some((fields, pair)) = context.fields.first().zip(pairs.first()) else {
        return Err("no profile of two patches with known places can be searched for hidden patches".to_owned());
    };
    let at: Vec<Point> = visible.iter().map(|patch| points[patch]).collect();
    if !facing::spans(&at, fields.dimensions) {
        let count = at.len();
        return Err(format!(
            "the {count} visible patches with known places lie in one line: hidden patches are known but for a turn about it, and are not looked for; light and see a patch off that line"
        ));
    }
    let foci = facing::fronts(&at, &vec![None; at.len()], fields.stations.source(), fields.dimensions);
    let width_m = fields.medium.path_m(pair.response.width_ps());
    Ok(Room { foci, dimensions: fields.dimensions, width_m, cancel: context.cancel.clone() })
}
