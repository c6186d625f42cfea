//! `label`: which path of light made which onset (paper sections 4.1 and 4.3).
//!
//! Without known patches, the first light tells:
//! - With patch i lit and seen it is the first bounce 0-i-0.
//! - With i lit and j seen it is the second bounce 0-i-j-0, or, where the two exchange no light (coplanar, occluded and specular pairs), a third
//!   bounce over some k: [`crate::geometry::detours`] tells, from path lengths alone. Such a pair is left open, unless k is certain and `bounces` 3.
//!   So is a second bounce that passes another patch too closely to be told from a detour over it.
//! - No second bounce is shorter than both first bounces nor longer than their sum, and where laser and sensor stand together, (j, i) has the same
//!   first light as (i, j): that sets false onsets aside.
//!
//! With `patches` beside it, every path of up to `bounces` bounces (5 at most) is predicted, but for those over a pair whose direct light is missing (or was not captured, where both lie on one wall), and every
//! onset associated ([`crate::geometry::association`]). How often paths of an order are seen, with and without hidden patches among theirs, is learned from the campaign, once. The first order of
//! which more than 0.3 paths lie within a standard deviation of a time is not labelled, nor are those above it: from its first path on it counts as clutter. A label less probable than `probability_min` is left open (path null), its candidates told
//! as alternatives.
//!
//! Onsets of a laser that repeats are known modulo its period (`repetition_ps` in campaign.toml). `turns` is how many periods were added: without
//! known patches such that first bounces (then the strongest onset, since later light may come before it) lie within one period beyond `near_m`,
//! and second bounces where their first bounces leave one choice; with them, as predicted.
//!
//! Hidden patches, which neither laser nor sensor sees, show in third bounces over visible ones (paper section 4.3). With `bounces` of 3 or more:
//!
//! | hidden | |
//! |---|---|
//! | `search` | places whose third bounces explain onsets in so many profiles that chance does not ([`crate::geometry::hidden`]); table `hypotheses` |
//! | `rank` | the paper's: the n-th onset that visible patches do not explain is hidden patch n in every profile |
//! | `none` | not looked for |
//!
//! With `bounces` of 5, patches that only hidden ones show are searched for next, in fifth bounces (lit, hidden, such a patch, hidden, seen), among what all paths over patches in place leave unexplained;
//! three hidden patches that do not lie in line must show them (in flatland two). Places are then taken from minimal sets of onsets alone, since a search of all space would follow the many later
//! bounces.
//!
//! They are numbered on from the largest patch, as many as there are, or `[hidden] count` of campaign.toml at most.
//!
//! A wall throws light back to the side that it is lit from only. Patches whose normal is known (`planes`, or campaign.toml in a fixed frame), and all if they lie on one plane,
//! show nothing behind them. Where onsets leave both a place and its mirror image in a wall that is nearly flat, the one on the laser's side is taken and the other told
//! (`hypotheses.alternative`). About visible patches in one line nothing is looked for: their onsets leave a circle.
//!
//! A floor or a wall that nobody declared throws light on too, by the shortest way over it. Such planes are looked for along with the patches and are told (`hypotheses.kind`), since they
//! would pass for many patches; their onsets stay without a path.
//!
//! Pulses that the response does not tell apart make one onset between their times. Where another path of known patches comes within `blend_ps` of an onset and has none of its own, the
//! label's `time_sd_ps` is as much larger as the other path's light may pull it; 0 takes every onset for single. The search for hidden patches expects no onset of its own from a patch where
//! that of another path is so near.
//!
//! Takes `onsets`; writes `labels` and, beside it, `hypotheses`. Beside it, optional: `patches` (of `refine`, with their standard deviations), and for the full error of a
//! prediction `covariances` (`patch_covariances` of the same stage) and `delays`. With `planes` (of `surface`, fitted to the same patches) the shift of the
//! light's centroid over large patches is predicted too, for those with a `size_m` in campaign.toml; where `fits` (of the same `refine`) says that the frame is fixed,
//! also by the normals of campaign.toml. Patches without covariance are not predicted from.
//!
//! Not modelled: amplitudes, which could tell paths of equal length apart; onsets of one profile whose errors are correlated; density of later bounces that grows with time, so that in a
//! room where more than a tenth of all fourth bounces are seen before hidden patches are known a patch may be found that is none; a patch among `patches` that only hidden ones show, which is taken for one that visible
//! ones show. Not found without
//! known patches: false onsets before a first bounce, and most detours over patches whose pairs are missing (not captured, or left open): they pass
//! for second bounces.
//!
//! ```toml
//! [labels]
//! stage = "label"
//! from = "onsets"
//! with = { patches = "visible", covariances = "visible.patch_covariances", delays = "visible.delays", planes = "planes" }
//! params = { bounces = 3 }
//! ```

mod blends;
mod blind;
mod chances;
mod facing;
mod hidden;
mod legs;
mod paths;
mod predicted;
mod rank;
mod scene;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::Point;
use crate::priors::footprints::{self, Footprints, Told};
use crate::tables::{Delay, Fit, Hypothesis, Label, Name, Onset, Patch, PatchCovariance, Plane, Row};
use crate::units::{self, PatchId};
use scene::{Scene, View};

/// Stations closer than this are one.
const ONE_STATION_M: f64 = 1e-6;
/// Beyond, every profile is one onset.
const BLEND_MAX_PS: f64 = 400.0;

/// Parameters of `label`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LabelOnsets {
    /// Largest order of bounces to label: to 3 without known patches, to 5 with them.
    bounces: i32,
    /// Least probability of a label, with known patches.
    probability_min: f64,
    /// Onsets that no path of the known patches explains, per nanosecond of a profile.
    clutter_per_ns: f64,
    /// No patch is nearer to laser and sensor than this; matters where the laser's period is given and patches are not known.
    near_m: f64,
    /// Which patches that nothing shows directly are looked for, with known patches and `bounces` of 3 or more.
    hidden: HiddenPatches,
    /// Probability, at most, that `search` finds a hidden patch where there is none, and as much again that it finds a plane.
    false_alarm: f64,
    /// Pulses of two known paths that are nearer than this may be one onset: about as wide as the response.
    blend_ps: f64,
}

impl Default for LabelOnsets {
    fn default() -> Self {
        let (clutter_per_ns, hidden, false_alarm) = (0.05, HiddenPatches::Search, 1e-3);
        Self { bounces: 2, probability_min: 0.95, clutter_per_ns, near_m: 0.0, hidden, false_alarm, blend_ps: 100.0 }
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

/// What a campaign says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    group_index: f64,
    repetition_ps: Option<f64>,
    source_m: [f64; 3],
    sensors_m: BTreeMap<String, [f64; 3]>,
    footprints: BTreeMap<PatchId, Told>,
    dimensions: usize,
    /// Largest number of a patch.
    largest_patch: PatchId,
    /// Number of hidden patches, where it is known.
    hidden_count: Option<u32>,
}

/// The profiles of one sensor.
struct OfSensor<'a> {
    known: &'a Known,
    setup: &'a Setup,
    source: Point,
    sensor: Point,
    profiles: Vec<&'a [Onset]>,
}

impl<'a> OfSensor<'a> {
    fn new(known: &'a Known, onsets: &'a [Onset]) -> Self {
        let setup = &known.setups[&*onsets[0].campaign];
        let profiles = onsets.chunk_by(|a, b| (a.lit, a.seen) == (b.lit, b.seen)).collect();
        let sensor = Point::from(setup.sensors_m[&*onsets[0].sensor]);
        Self { known, setup, source: Point::from(setup.source_m), sensor, profiles }
    }

    fn view(&self, profile: &[Onset]) -> View<'_> {
        View { setup: self.setup, source: self.source, sensor: self.sensor, delay_ps: self.known.delay_ps(&profile[0]) }
    }

    /// Distance between laser and sensor.
    fn apart_m(&self) -> f64 {
        (self.source - self.sensor).norm()
    }
}

/// Setups of the campaigns, and what is known of the scene.
pub struct Known {
    setups: BTreeMap<String, Setup>,
    scene: Option<Scene>,
    /// Delay that calibration left, and its standard deviation, by campaign, sensor and range.
    delays_ps: BTreeMap<(Name, Name, Option<Name>), (f64, f64)>,
}

impl Known {
    /// Delay of a profile: that of its range, or the only one of its sensor.
    fn delay_ps(&self, onset: &Onset) -> (f64, f64) {
        let key = (onset.campaign.clone(), onset.sensor.clone(), onset.range.clone());
        let of_range = self.delays_ps.get(&key);
        let mut of_sensor = self.delays_ps.iter().filter(|(of, _)| (&of.0, &of.1) == (&key.0, &key.1));
        let only = || of_sensor.next().filter(|_| of_sensor.next().is_none()).map(|(_, delay)| delay);
        of_range.or_else(only).copied().unwrap_or_default()
    }
}

/// What became of one onset.
struct Verdict {
    /// Laser periods added to its time.
    turns: i32,
    /// `None`: left unexplained.
    path: Option<Vec<PatchId>>,
    residual_ps: Option<f64>,
    /// Standard deviation that the light of other paths may add to the onset's time.
    blend_sd_ps: f64,
    probability: f64,
    /// Place among the onset's labels, the best 0.
    alternative: i32,
}

impl Verdict {
    /// Left unexplained.
    fn open() -> Self {
        Self { turns: 0, path: None, residual_ps: None, blend_sd_ps: 0.0, probability: 1.0, alternative: 0 }
    }
}

impl Stage for LabelOnsets {
    const KIND: &'static str = "label";
    const VERSION: u32 = 11;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "fits", table: "fits", required: false },
    ];
    const SIDES: &'static [Side] = &[Side { name: Hypothesis::TABLE, schema: Hypothesis::schema }];
    type Input = Onset;
    type Output = Label;
    type Fields = BTreeMap<String, Setup>;
    type Context = Known;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let setup = |campaign: &Campaign| Setup {
            group_index: campaign.group_index,
            repetition_ps: campaign.repetition_ps,
            source_m: campaign.source().position_m,
            sensors_m: campaign
                .sensors
                .keys()
                .filter_map(|sensor| Some((sensor.clone(), campaign.station_of(sensor)?.position_m)))
                .collect(),
            footprints: footprints::told(campaign),
            dimensions: usize::from(campaign.dimensions),
            largest_patch: campaign.patches.keys().copied().max().unwrap_or(0),
            hidden_count: campaign.hidden.count,
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, setups: Self::Fields, beside: &BesideTables) -> Result<Known, StageError> {
        let scene = match beside.rows::<Patch>("patches")? {
            None => None,
            Some(patches) => {
                let covariances = beside.rows::<PatchCovariance>("covariances")?.unwrap_or_default();
                let planes = beside.rows::<Plane>("planes")?.unwrap_or_default();
                let first = setups.values().next().map(|setup| &setup.footprints);
                let fits = beside.rows::<Fit>("fits")?.unwrap_or_default();
                let is_fixed = fits.iter().any(|fit| fit.alternative == 0 && &*fit.frame == "fixed");
                let normals = first.map(|told| footprints::normals(told, &planes, is_fixed)).unwrap_or_default();
                let footprints = first.map(|told| Footprints::new(told, &normals)).unwrap_or_default();
                Some(Scene::new(&patches, &covariances, footprints, normals).ok_or_else(|| {
                    let text = "with patches: no patch has a covariance, so nobody knows how far off its onsets may be; give patches from `refine`";
                    StageError::Refused(text.to_owned())
                })?)
            }
        };
        let most = if scene.is_some() { 5 } else { 3 };
        if !(1..=most).contains(&self.bounces) {
            let bounces = self.bounces;
            let known = if scene.is_some() { "with known patches" } else { "without known patches" };
            return Err(StageError::Refused(format!(
                "params.bounces = {bounces}: {known} bounces 1 to {most} are labelled"
            )));
        }
        if !(0.0..=1.0).contains(&self.probability_min)
            || self.clutter_per_ns.is_nan()
            || self.clutter_per_ns <= 0.0
            || self.near_m.is_nan()
            || self.near_m < 0.0
            || !(0.0..=BLEND_MAX_PS).contains(&self.blend_ps)
            || !(self.false_alarm > 0.0 && self.false_alarm < 1.0)
        {
            return Err(StageError::Refused(
                "params: probability_min and false_alarm must lie between 0 and 1, clutter_per_ns be positive, near_m not negative, blend_ps between 0 and 400"
                    .to_owned(),
            ));
        }
        let delays = beside.rows::<Delay>("delays")?.unwrap_or_default();
        let delay = |row: Delay| ((row.campaign, row.sensor, row.range), (row.delay_ps, row.sd_ps));
        let delays_ps = delays.into_iter().map(delay).collect();
        Ok(Known { setups, scene, delays_ps })
    }
}

impl Apply for LabelOnsets {
    fn apply(&self, known: &Known, group: Vec<Onset>) -> Result<Outcome<Label>, StageError> {
        let of_one_sensor = |a: &Onset, b: &Onset| (&a.campaign, &a.sensor) == (&b.campaign, &b.sensor);
        let sensors: Vec<OfSensor> = group.chunk_by(of_one_sensor).map(|onsets| OfSensor::new(known, onsets)).collect();
        let (verdicts, hypotheses, rejections) = match &known.scene {
            None => (sensors.iter().map(|sensor| self.blind(sensor)).collect(), Vec::new(), Vec::new()),
            Some(scene) => self.with_known(scene, &sensors),
        };
        let mut rows = Vec::new();
        for (sensor, verdicts) in sensors.iter().zip(verdicts) {
            for (onset, verdicts) in sensor.profiles.iter().copied().flatten().zip(verdicts.into_iter().flatten()) {
                rows.extend(verdicts.into_iter().map(|verdict| row(onset, verdict, sensor.setup)));
            }
        }
        Ok(Outcome { rows, sides: vec![Hypothesis::to_batch(&hypotheses)], rejections })
    }
}

/// For each profile of a sensor, for each onset, its labels.
type Verdicts = Vec<Vec<Vec<Verdict>>>;

/// Standard deviation of an onset's time, what its profile shares included.
fn sd_ps(onset: &Onset) -> f64 {
    onset.time_sd_ps.hypot(onset.jitter_ps)
}

/// Probability that an onset is light at all and not noise.
fn light(onset: &Onset) -> f64 {
    1.0 - (-onset.snr * onset.snr / 2.0).exp()
}

fn row(onset: &Onset, verdict: Verdict, setup: &Setup) -> Label {
    let turns_ps = f64::from(verdict.turns) * setup.repetition_ps.unwrap_or(0.0);
    Label {
        campaign: onset.campaign.clone(),
        sensor: onset.sensor.clone(),
        lit: onset.lit,
        seen: onset.seen,
        range: onset.range.clone(),
        rank: onset.rank,
        time_ps: onset.time_ps + turns_ps,
        time_sd_ps: sd_ps(onset).hypot(verdict.blend_sd_ps),
        turns: verdict.turns,
        bounces: verdict.path.as_deref().map_or(0, crate::path::bounces),
        path: verdict.path,
        residual_ps: verdict.residual_ps,
        probability: verdict.probability,
        alternative: verdict.alternative,
    }
}

/// Path from laser to sensor over patches, in the order light meets them, that is direct: each patch once.
fn direct(profile: &[Onset]) -> Vec<PatchId> {
    let (lit, seen) = (profile[0].lit, profile[0].seen);
    if lit == seen { vec![lit] } else { vec![lit, seen] }
}

fn time_ps(length_m: f64, setup: &Setup) -> f64 {
    units::time_ps(length_m, setup.group_index)
}

#[cfg(test)]
mod tests;
