//! `label`: which path of light made which onset (paper section 4.1, up to second bounces).
//!
//! With patch i lit and seen, the first light to arrive is the first bounce 0-i-0; with patch j lit and i seen it is the second bounce 0-j-i-0,
//! since no path of more bounces is shorter. Later onsets of a profile are left unexplained here (path null).
//!
//! Takes `onsets`; writes `labels`. Beside it, optional: `patches`. With them each path's time is predicted, the onset nearest to it within
//! five standard deviations gets the label, and `residual_ps` says how far off it is.
//!
//! Probability: that the onset is light at all and not noise, 1 - exp(-snr^2 / 2). That the direct path may be closed (coplanar or occluded
//! patches, whose first light is a third bounce) is not modelled yet, nor are laser periods: with `repetition_ps` the stage refuses.
//!
//! ```toml
//! [labels]
//! stage = "label"
//! from = "onsets"
//! params = { bounces = 2 }
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::tables::{Label, Onset, Patch};
use crate::units::{self, PatchId};

/// An onset further than this many standard deviations from its predicted time is not that path.
const GATE: f64 = 5.0;

/// Parameters of `label`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelOnsets {
    /// Largest order of bounces to label.
    #[serde(default = "two")]
    bounces: i32,
}

fn two() -> i32 {
    2
}

/// What a campaign says that paths are predicted from.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    group_index: f64,
    repetition_ps: Option<f64>,
    source_m: [f64; 3],
    sensors_m: BTreeMap<String, [f64; 3]>,
}

/// Patches and stations, to predict paths.
pub struct Prediction {
    setups: BTreeMap<String, Setup>,
    patches: Option<BTreeMap<PatchId, ([f64; 3], f64)>>,
}

impl Prediction {
    /// Time of a path and its standard deviation (that of the patches' positions), if all of it is known.
    fn time_ps(&self, onset: &Onset, path: &[PatchId]) -> Option<(f64, f64)> {
        let patches = self.patches.as_ref()?;
        let setup = self.setups.get(&*onset.campaign)?;
        let mut at = setup.source_m;
        let (mut length_m, mut variance_m2) = (0.0, 0.0);
        for patch in path {
            let (position_m, sd_m) = patches.get(patch)?;
            length_m += distance_m(at, *position_m);
            variance_m2 += (2.0 * sd_m).powi(2);
            at = *position_m;
        }
        length_m += distance_m(at, *setup.sensors_m.get(&*onset.sensor)?);
        let time = |length_m| units::time_ps(length_m, setup.group_index);
        Some((time(length_m), time(variance_m2.sqrt())))
    }
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Stage for LabelOnsets {
    const KIND: &'static str = "label";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[Beside { name: "patches", table: "patches", required: false }];
    type Input = Onset;
    type Output = Label;
    type Fields = BTreeMap<String, Setup>;
    type Context = Prediction;

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
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Self::Context, StageError> {
        if !(1..=2).contains(&self.bounces) {
            let text =
                format!("params.bounces = {}: bounces 1 and 2 are labelled; third bounces are not yet", self.bounces);
            return Err(StageError::Refused(text));
        }
        if let Some((campaign, _)) = fields.iter().find(|(_, setup)| setup.repetition_ps.is_some()) {
            return Err(StageError::Refused(format!(
                "campaign `{campaign}` gives repetition_ps: onsets are then known modulo the laser's period, which `label` does not resolve yet; \
                 remove repetition_ps from campaign.toml if every path is shorter than one period"
            )));
        }
        let patches = beside.rows::<Patch>("patches")?.map(|patches| {
            let best = patches.into_iter().filter(|patch| patch.alternative == 0);
            best.map(|patch| Ok((patch.patch, ([patch.x_m, patch.y_m, patch.z_m], patch.sd_m.ok_or(patch.patch)?))))
                .collect::<Result<_, PatchId>>()
        });
        let patches = patches.transpose().map_err(|patch| {
            let text = format!("with patches: patch {patch} has no sd_m, so nobody knows how far off its onsets may be; give patches from `refine`");
            StageError::Refused(text)
        })?;
        Ok(Prediction { setups: fields, patches })
    }
}

impl Apply for LabelOnsets {
    fn apply(&self, context: &Prediction, group: Vec<Onset>) -> Result<Outcome<Label>, StageError> {
        let same_profile =
            |a: &Onset, b: &Onset| (&a.campaign, &a.sensor, a.lit, a.seen) == (&b.campaign, &b.sensor, b.lit, b.seen);
        let labels = group.chunk_by(same_profile).flat_map(|profile| self.label(context, profile)).collect();
        Ok(Outcome::rows(labels))
    }
}

impl LabelOnsets {
    /// Labels the onsets of one profile.
    fn label(&self, context: &Prediction, profile: &[Onset]) -> Vec<Label> {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        let path = if lit == seen { vec![lit] } else { vec![lit, seen] };
        let path = Some(path).filter(|path| path.len() as i32 <= self.bounces);
        let predicted = path.as_ref().and_then(|path| context.time_ps(&profile[0], path));
        let sd = |onset: &Onset| onset.time_sd_ps.hypot(onset.jitter_ps);
        let chosen = match predicted {
            None => (0..profile.len()).min_by(|&a, &b| profile[a].time_ps.total_cmp(&profile[b].time_ps)),
            Some((time_ps, sd_ps)) => {
                let off = |i: usize| (profile[i].time_ps - time_ps).abs() / sd(&profile[i]).hypot(sd_ps);
                (0..profile.len()).filter(|&i| off(i) < GATE).min_by(|&a, &b| off(a).total_cmp(&off(b)))
            }
        };
        let row = |(i, onset): (usize, &Onset)| {
            let path = path.clone().filter(|_| chosen == Some(i));
            let residual_ps = predicted.filter(|_| path.is_some()).map(|(time_ps, _)| onset.time_ps - time_ps);
            let light = 1.0 - (-onset.snr * onset.snr / 2.0).exp();
            Label {
                campaign: onset.campaign.clone(),
                sensor: onset.sensor.clone(),
                lit,
                seen,
                rank: onset.rank,
                time_ps: onset.time_ps,
                time_sd_ps: sd(onset),
                turns: 0,
                bounces: path.as_deref().map_or(0, crate::path::bounces),
                probability: if path.is_some() { light } else { 1.0 },
                path,
                residual_ps,
                alternative: 0,
            }
        };
        profile.iter().enumerate().map(row).collect()
    }
}
