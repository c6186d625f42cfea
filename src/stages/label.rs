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
//! With `patches` beside it, every path of up to `bounces` bounces is predicted, but for those over a pair whose direct light is missing, and every
//! onset associated ([`crate::geometry::association`]). A label less probable than `probability_min` is left open (path null), its candidates told
//! as alternatives.
//!
//! Onsets of a laser that repeats are known modulo its period (`repetition_ps` in campaign.toml). `turns` is how many periods were added: without
//! known patches such that first bounces (then the strongest onset, since later light may come before it) lie within one period beyond `near_m`,
//! and second bounces where their first bounces leave one choice; with them, as predicted.
//!
//! Takes `onsets`; writes `labels`. Beside it, optional: `patches` (of `refine`, with their standard deviations), and for the full error of a
//! prediction `covariances` (`patch_covariances` of the same stage) and `delays`. With `planes` (of `surface`, fitted to the same patches) the shift of the
//! light's centroid over large patches is predicted too, for those with a `size_m` in campaign.toml; where `fits` (of the same `refine`) says that the frame is fixed,
//! also by the normals of campaign.toml. Patches without covariance are not predicted from.
//!
//! Not modelled: amplitudes, which could tell paths of equal length apart; onsets of one profile whose errors are correlated. Not found without
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

mod blind;
mod predicted;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::footprints::{self, Footprints, Told};
use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::tables::{Delay, Fit, Label, Name, Onset, Patch, PatchCovariance, Plane};
use crate::units::{self, PatchId};
use predicted::Scene;

/// Stations closer than this are one.
const ONE_STATION_M: f64 = 1e-6;

/// Parameters of `label`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LabelOnsets {
    /// Largest order of bounces to label: to 3 without known patches, to 4 with them.
    bounces: i32,
    /// Least probability of a label, with known patches.
    probability_min: f64,
    /// Onsets that no path of the known patches explains, per nanosecond of a profile.
    clutter_per_ns: f64,
    /// No patch is nearer to laser and sensor than this; matters where the laser's period is given and patches are not known.
    near_m: f64,
}

impl Default for LabelOnsets {
    fn default() -> Self {
        Self { bounces: 2, probability_min: 0.95, clutter_per_ns: 0.05, near_m: 0.0 }
    }
}

/// What a campaign says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    group_index: f64,
    repetition_ps: Option<f64>,
    source_m: [f64; 3],
    sensors_m: BTreeMap<String, [f64; 3]>,
    footprints: BTreeMap<PatchId, Told>,
}

impl Setup {
    /// Distance between laser and a sensor.
    fn apart_m(&self, sensor: &str) -> f64 {
        let sensor_m = self.sensors_m[sensor];
        self.source_m.iter().zip(sensor_m).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
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
    probability: f64,
    /// Place among the onset's labels, the best 0.
    alternative: i32,
}

impl Verdict {
    /// Left unexplained.
    fn open() -> Self {
        Self { turns: 0, path: None, residual_ps: None, probability: 1.0, alternative: 0 }
    }
}

impl Stage for LabelOnsets {
    const KIND: &'static str = "label";
    const VERSION: u32 = 4;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "fits", table: "fits", required: false },
    ];
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
                let footprints = first.map(|known| Footprints::new(known, &planes, is_fixed)).unwrap_or_default();
                Some(Scene::new(&patches, &covariances, footprints).ok_or_else(|| {
                    let text = "with patches: no patch has a covariance, so nobody knows how far off its onsets may be; give patches from `refine`";
                    StageError::Refused(text.to_owned())
                })?)
            }
        };
        let most = if scene.is_some() { 4 } else { 3 };
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
        {
            return Err(StageError::Refused(
                "params: probability_min must lie between 0 and 1, clutter_per_ns be positive, near_m not negative"
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
        let of_one_profile = |a: &Onset, b: &Onset| (a.lit, a.seen) == (b.lit, b.seen);
        let mut rows = Vec::new();
        for of_sensor in group.chunk_by(of_one_sensor) {
            let profiles: Vec<&[Onset]> = of_sensor.chunk_by(of_one_profile).collect();
            let setup = &known.setups[&*of_sensor[0].campaign];
            let verdicts = match &known.scene {
                None => self.blind(setup, &profiles),
                Some(scene) => self.predicted(setup, scene, |onset| known.delay_ps(onset), &profiles),
            };
            for (profile, verdicts) in profiles.iter().zip(verdicts) {
                for (onset, verdicts) in profile.iter().zip(verdicts) {
                    rows.extend(verdicts.into_iter().map(|verdict| row(onset, verdict, setup)));
                }
            }
        }
        Ok(Outcome::rows(rows))
    }
}

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
        time_sd_ps: sd_ps(onset),
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
