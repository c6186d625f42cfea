//! `label`: which path of light made which onset (paper sections 4.1 and 4.3).
//!
//! Without `patches`, the first light of each profile decides: a first bounce, a second one, or no label where the
//! light may have come over a third patch. With `patches`, every path of up to `bounces` bounces (5 at most) is
//! predicted. All onsets of a profile are then associated with the predictions at once
//! ([`crate::geometry::labelling`]).
//!
//! `patches` may have alternatives: a patch on the other side of its neighbours. The first light left these open; third
//! and later bounces may decide. So all onsets are weighed under each, and the likeliest places are taken
//! ([`labelling::Comparison`]). The table `scenes` has what was taken, and how much less likely the rest is.
//!
//! Orders are labelled while at most 0.3 of their paths lie within a standard deviation of a time; the first order with
//! more, and all above it, are not. A label less probable than `probability_min` is left open (path null), its
//! candidates listed as alternatives.
//!
//! Onsets of a laser that repeats are known modulo its period (`repetition_ps` in campaign.toml); `turns` is how many
//! periods were added.
//!
//! Hidden patches, which neither laser nor sensor sees, show in third bounces over visible ones. With `bounces` of 3 or
//! more:
//!
//! | hidden | |
//! |---|---|
//! | `search` | places whose third bounces explain more onsets than chance does ([`crate::geometry::hidden`]): table `hypotheses` |
//! | `rank` | the paper's: the n-th onset that visible patches do not explain is hidden patch n in every profile |
//! | `none` | not looked for |
//!
//! Fourth and later bounces count only in a bright room: where more onsets lie at the times of fourth bounces over
//! visible patches and the surest hidden ones than beside these times (by four standard deviations). In others they
//! would take onsets from hidden patches.
//!
//! With `bounces` of 5, patches that only hidden ones show are then searched for too; three hidden patches that do not
//! lie in line must show them (in flatland two). All are numbered on from the largest patch, `[hidden] count` of
//! campaign.toml at most.
//!
//! A wall reflects only to the side that it is lit from. Patches whose normal is known (`planes`, or campaign.toml in a
//! fixed frame) show nothing behind them; nor do any patches if all lie on one plane. Onsets may leave both a place and
//! its mirror image in a nearly flat wall. The one on the laser's side is then chosen and the other listed
//! (`hypotheses.alternative`). About visible patches in one line nothing is searched for: their onsets leave a circle.
//!
//! A floor or a wall outside of campaign.toml reflects light too, by the shortest way over it. Such planes would pass
//! for many patches, so they are searched for along with the patches and listed (`hypotheses.kind`); their onsets stay
//! without a path.
//!
//! Another path may come within `blend_ps` of an onset and have none of its own. Its light may pull the onset, and the
//! label's `time_sd_ps` is larger by that; 0 takes every onset for single. The search for hidden patches expects no
//! onset of its own from a patch where that of another path is so near.
//!
//! A wide onset may be light that patches spread, or two pulses that came close together: `deconvolve` keeps both. With
//! `patches`, whichever reading the predicted paths and the widths of first bounces make likelier is labelled; read as
//! two it has two rows, `part` 1 and 2, each with its own time. The other reading stays among the alternatives with its
//! probability. Light that either reading explains is no sign of a hidden patch. Without patches the likelier reading
//! counts by widths alone, and the error of first light covers the other.
//!
//! Takes `onsets`; writes `labels`, `hypotheses` and `scenes`. Optional tables:
//! - `patches` (of `refine`, with their standard deviations); no prediction uses a patch without covariance;
//! - `anchors` (of `anchor`), used in place of `patches` where that is absent and every patch that is lit or seen is an
//!   anchor;
//! - for the full error of a prediction, `covariances` (`patch_covariances` of the same stage) and `delays`;
//! - `planes` (of `surface`, fitted to the same patches), for normals and, without `footprints`, for the shift of the
//!   light's centroid over patches with a `size_m` in campaign.toml;
//! - `footprints` (of the same `refine`), for that shift over all patches whose size and direction are known;
//! - `fits` (of the same `refine`): where it has a fixed frame, the normals of campaign.toml hold.
//!
//! Known limits: alternatives are compared without hidden patches, 32 at most; those that move the same patches only
//! one by one. A patch of `patches` that only hidden ones show is taken for one that visible ones show. Without
//! `patches`, false onsets before a first bounce pass for it, if they are a quarter as strong or more. Also, most
//! detours over patches with missing pairs (not captured, or left open) then pass for second bounces.
//!
//! ```toml
//! [labels]
//! stage = "label"
//! from = "onsets"
//! with.patches = "visible"
//! with.covariances = "visible.patch_covariances"
//! with.delays = "visible.delays"
//! with.planes = "planes"
//! params = { bounces = 3 }
//! ```

mod alternatives;
mod rows;

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::labelling::{self, Arrival, Medium, Options, Pair, Profile, Scene, SensorProfiles};
use crate::parameter::{Condition, Count, NonNegative, Positive, Share, Within};
use crate::priors::campaign_fields::{self, ByCampaign, StationPositions};
use crate::priors::delays::Delays;
use crate::priors::footprints::{self, Extent};
use crate::tables::{Fit, Hypothesis, Label, Onset, Patch, PatchCovariance, PatchFootprint, Plane, Row, SceneOdds};
use crate::units::PatchId;
use alternatives::PlacedPatches;

/// Beyond, every profile is one onset.
const BLEND_MAX_PS: i32 = 400;
/// Largest order of bounces that is labelled with patches.
const DEEPEST: u32 = 5;
/// The same without patches.
const DEEPEST_BLIND: u32 = 3;

/// Parameters of `label`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LabelOnsets {
    /// Largest order of bounces to label: to 3 without known patches, to 5 with them.
    bounces: Count<1, DEEPEST>,
    /// Least probability of a label, with known patches.
    probability_min: Within<0, 1>,
    /// Onsets that no path of the known patches explains, per nanosecond of a profile.
    clutter_per_ns: Positive,
    /// No patch is nearer to laser and sensor than this; matters where the laser's period is given and patches are not
    /// known.
    near_m: NonNegative,
    /// Which patches that nothing shows directly are looked for, with known patches and `bounces` of 3 or more.
    hidden: HiddenPatches,
    /// Probability, at most, that `search` finds a hidden patch where there is none, and as much again that it finds a
    /// plane.
    false_alarm: Share,
    /// Pulses of two known paths that are nearer than this may be one onset: about as wide as the response.
    blend_ps: Within<0, BLEND_MAX_PS>,
}

impl Default for LabelOnsets {
    fn default() -> Self {
        Self {
            bounces: Count::new(2),
            probability_min: Within::new(0.95),
            clutter_per_ns: Positive::new(0.05),
            near_m: NonNegative::new(0.0),
            hidden: HiddenPatches::Search,
            false_alarm: Share::new(1e-3),
            blend_ps: Within::new(100.0),
        }
    }
}

/// How hidden patches are found among onsets that known ones do not explain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum HiddenPatches {
    /// Not at all.
    None,
    /// By their likelihood over all profiles, their number unknown.
    Search,
    /// By order of arrival in each profile, as in the paper.
    Rank,
}

/// What campaign.toml says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    medium: campaign_fields::Medium,
    repetition_ps: Option<f64>,
    #[serde(flatten)]
    stations: StationPositions,
    extents: BTreeMap<PatchId, Extent>,
    dimensions: usize,
    #[serde(flatten)]
    hidden: campaign_fields::HiddenPatches,
}

/// What labelling starts from, in addition to the onsets.
pub struct Context {
    fields: ByCampaign<Fields>,
    placed: Option<PlacedPatches>,
    /// Places that campaign.toml gives.
    anchors: Option<Scene>,
    cancel: Cancel,
    delays: Delays,
}

impl Context {
    /// The patches in place: the likeliest of those given, else the anchors where every patch that is lit or seen is
    /// one. With the odds of other places.
    fn scene_of(&self, sensors: &[SensorProfiles], options: &Options) -> (Option<Scene>, Vec<SceneOdds>) {
        if let Some(placed) = &self.placed {
            let (scene, odds) = placed.likeliest(sensors, options, &self.cancel);
            return (Some(scene), odds);
        }
        let profiles = || sensors.iter().flat_map(|sensor| &sensor.profiles);
        let is_whole = |anchors: &&Scene| profiles().all(|profile| anchors.has(&[profile.lit, profile.seen]));
        (self.anchors.as_ref().filter(is_whole).cloned(), Vec::new())
    }

    /// The profiles of one sensor, from all its onsets.
    fn sensor_profiles(&self, onsets: &[Onset]) -> SensorProfiles {
        let Onset { campaign, sensor, .. } = &onsets[0];
        let Fields { medium, repetition_ps, stations, dimensions, hidden, .. } = self.fields.of(campaign);
        SensorProfiles {
            medium: Medium { group_index: medium.group_index, repetition_ps: *repetition_ps },
            source: stations.source(),
            sensor: stations.sensor(sensor).expect("campaign.toml has the sensors of its captures"),
            dimensions: *dimensions,
            largest_patch: hidden.largest_patch,
            hidden_count: hidden.count,
            profiles: onsets
                .chunk_by(|a, b| (a.lit, a.seen) == (b.lit, b.seen))
                .map(|onsets| self.profile(onsets))
                .collect(),
        }
    }

    fn profile(&self, onsets: &[Onset]) -> Profile {
        let Onset { lit, seen, .. } = onsets[0];
        let (delay_ps, delay_sd_ps) = self.delays.delay_ps(&onsets[0], onsets[0].acquired_at.as_deref());
        Profile { lit, seen, delay_ps, delay_sd_ps, arrivals: onsets.iter().map(arrival).collect() }
    }
}

impl Stage for LabelOnsets {
    const KIND: &'static str = "label";
    const VERSION: u32 = 25;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "anchors", table: "patches", required: false },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "footprints", table: "footprints", required: false },
        Beside { name: "fits", table: "fits", required: false },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: Hypothesis::TABLE, schema: Hypothesis::schema },
        Side { name: SceneOdds::TABLE, schema: SceneOdds::schema },
    ];
    const CONDITIONS: &'static [Condition] = &[Condition("false_alarm", "hidden", &["search"])];
    type Input = Onset;
    type Output = Label;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields {
            medium: campaign.into(),
            repetition_ps: campaign.repetition_ps,
            stations: campaign.into(),
            extents: footprints::extents(campaign),
            dimensions: usize::from(campaign.dimensions),
            hidden: campaign.into(),
        })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let given = beside.rows::<Patch>("patches")?;
        let placed = given.map(|rows| placed(rows, &fields, beside)).transpose()?;
        let anchors = beside.rows::<Patch>("anchors")?.filter(|rows| !rows.is_empty());
        let anchors = anchors.map(|rows| scene_of_anchors(&rows, &fields)).transpose()?;
        self.check(placed.is_some())?;
        let delays = Delays::new(&beside.rows("delays")?.unwrap_or_default());
        Ok(Context { fields, placed, anchors, cancel: beside.cancel.clone(), delays })
    }
}

impl LabelOnsets {
    /// Whether `bounces` can be labelled, with patches in place and without.
    fn check(&self, has_scene: bool) -> Result<(), StageError> {
        let bounces = self.bounces.get();
        if has_scene || bounces <= DEEPEST_BLIND {
            return Ok(());
        }
        Err(StageError::Refused(format!(
            "params.bounces = {bounces}: must be at most {DEEPEST_BLIND} without `patches`; give them with `with`"
        )))
    }

    fn options(&self) -> Options {
        Options {
            bounces: self.bounces.get() as usize,
            probability_min: self.probability_min.get(),
            clutter_per_ns: self.clutter_per_ns.get(),
            near_m: self.near_m.get(),
            hidden: self.hidden.into(),
            false_alarm: self.false_alarm.get(),
            blend_ps: self.blend_ps.get(),
        }
    }
}

impl From<HiddenPatches> for labelling::HiddenPatches {
    fn from(hidden: HiddenPatches) -> Self {
        match hidden {
            HiddenPatches::None => Self::None,
            HiddenPatches::Search => Self::Search,
            HiddenPatches::Rank => Self::Rank,
        }
    }
}

impl Apply for LabelOnsets {
    fn apply(&self, context: &Context, group: Vec<Onset>) -> Result<Outcome<Label>, StageError> {
        let is_one_sensor = |a: &Onset, b: &Onset| (&a.campaign, &a.sensor) == (&b.campaign, &b.sensor);
        let sensors: Vec<SensorProfiles> =
            group.chunk_by(is_one_sensor).map(|onsets| context.sensor_profiles(onsets)).collect();
        let options = self.options();
        let (scene, odds) = context.scene_of(&sensors, &options);
        let solution = labelling::label(&sensors, scene.as_ref(), &options, &context.cancel);
        let hypotheses = rows::hypotheses(&solution, self.false_alarm.get());
        Ok(Outcome {
            rejections: rows::rejections(&group, &sensors, solution.visible_in_line),
            rows: rows::labels(&group, &sensors, solution),
            sides: vec![Hypothesis::to_batch(&hypotheses), SceneOdds::to_batch(&odds)],
        })
    }
}

/// Patches with a covariance; refused where none has one.
fn placed(rows: Vec<Patch>, fields: &ByCampaign<Fields>, beside: &BesideTables) -> Result<PlacedPatches, StageError> {
    alternatives::places(&rows)?;
    let between = beside.rows::<PatchCovariance>("covariances")?.unwrap_or_default();
    let given = fields.first().map(|fields| &fields.extents);
    let normals = given.map(|given| normals(given, beside)).transpose()?.unwrap_or_default();
    let footprints = match beside.rows::<PatchFootprint>("footprints")? {
        Some(rows) => footprints::of_table(&rows),
        None => given.map(|given| footprints::of(given, &normals)).unwrap_or_default(),
    };
    Ok(PlacedPatches { rows, between, footprints, normals })
}

/// Anchors, whose errors are independent. They fix the frame, so that the normals of campaign.toml hold in it.
fn scene_of_anchors(rows: &[Patch], fields: &ByCampaign<Fields>) -> Result<Scene, StageError> {
    let given = fields.first().map(|fields| &fields.extents);
    let normals = given.map(|given| footprints::normals(given, &[], true)).unwrap_or_default();
    let footprints = given.map(|given| footprints::of(given, &normals)).unwrap_or_default();
    Ok(Scene::new(&alternatives::places(rows)?, &BTreeMap::new(), footprints, normals))
}

/// Normals of patches on the table `planes`, and where the frame is fixed those of campaign.toml.
fn normals(
    given: &BTreeMap<PatchId, Extent>,
    beside: &BesideTables,
) -> Result<BTreeMap<PatchId, Vector3<f64>>, StageError> {
    let planes = beside.rows::<Plane>("planes")?.unwrap_or_default();
    let fits = beside.rows::<Fit>("fits")?.unwrap_or_default();
    let is_fixed = fits.iter().any(|fit| fit.alternative == 0 && &*fit.frame == "fixed");
    Ok(footprints::normals(given, &planes, is_fixed))
}

fn arrival(onset: &Onset) -> Arrival {
    let width_sd_ps = onset.width_sd_ps.unwrap_or(0.0);
    let point = Arrival::point(onset.time_ps, sd_ps(onset), onset.snr);
    let blended = onset.flags.iter().any(|flag| &**flag == "blended");
    Arrival { amplitude: onset.amplitude, blended, width_ps: onset.width_ps, width_sd_ps, pair: pair(onset), ..point }
}

/// The two pulses that a wide onset may be; `None` where none fit.
fn pair(onset: &Onset) -> Option<Pair> {
    let sds_ps = [onset.pair_first_sd_ps?, onset.pair_second_sd_ps?];
    let amplitudes = [onset.pair_first_amplitude?, onset.pair_second_amplitude?];
    // What the profile's onsets share moves both alike.
    let shared_ps2 = onset.jitter_ps.powi(2);
    let both_ps2 = onset.pair_correlation? * sds_ps[0] * sds_ps[1];
    Some(Pair {
        times_ps: [onset.pair_first_ps?, onset.pair_second_ps?],
        covariance_ps2: [sds_ps[0].powi(2), both_ps2, sds_ps[1].powi(2)].map(|own_ps2| own_ps2 + shared_ps2),
        snrs: amplitudes.map(|amplitude| onset.snr * (amplitude / onset.amplitude).abs()),
        gain: onset.pair_gain?,
    })
}

/// Standard deviation of an onset's time, with the part that its profile shares.
fn sd_ps(onset: &Onset) -> f64 {
    onset.time_sd_ps.hypot(onset.jitter_ps)
}

#[cfg(test)]
mod tests;
