//! `locate`: small hidden things from all photon histograms of a relay wall together, or why there are none.
//!
//! In one histogram the returns of several things blend, and `label` cannot say which arrival belongs to which.
//! `locate` fits points to the counts of all histograms at once ([`crate::geometry::joint`]). It needs no onsets and no
//! labels. Where a confocal scan begins with the light of the wall, that light shows the response, with its tail, and
//! moves the gate of `image` ([`crate::signal::image::gate`]) on to where only the tail is left ([`joint::WallSum`]).
//! Else the response is that of the calibration.
//!
//! It answers with a verdict: points, an extended object, nothing, or that it cannot decide. Only the first adds hidden
//! patches, numbered on from the largest patch.
//!
//! Takes `patches` (of `anchor` or `refine`: points of the wall), `profiles` and `calibration`. Writes all `patches`,
//! new ones added, and one row of `searches`. Captures of other roles than scene, and of patches without a place, are
//! left out.
//!
//! Voltages have Gaussian noise of one standard deviation for all captures: that of a pulse's arrival, or of its
//! height if that is larger, where the noise is correlated.
//!
//! Relief of the wall and jitter shift all light of a histogram alike; where arrivals show it, these shifts are unknown
//! too. Not modelled: pile-up, errors of the wall's places along it, occlusion, normals, more than three bounces.
//!
//! ```toml
//! [patches]
//! stage = "locate"
//! from = "anchors"
//! with = { profiles = "profiles", calibration = "calibration" }
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::joint::{self, Noise, Problem, Pulse, Verdict, joint_search};
use crate::parameter::{NonNegative, Positive, Share};
use crate::priors::calibration::Sensors;
use crate::priors::campaign_fields::{ByCampaign, HiddenPatches, Medium};
use crate::priors::covariances;
use crate::priors::relay_histograms::{self, Histogram, Times, Waveforms};
use crate::tables::{JointSearch, Patch, Row};
use crate::units::PatchId;

/// Bins across the response at the least; finer ones are joined, which costs no information.
const ACROSS: f64 = 6.0;
/// Samples of a calibrated response across its width.
const SAMPLES: f64 = 40.0;

/// Parameters of `locate`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Locate {
    /// Probability that noise makes a point.
    false_alarm: Share,
    /// Which response is taken.
    response: Source,
    /// Time over the hidden things from which on light counts, in place of the gate that the histograms show.
    gate_ps: Option<NonNegative>,
    /// Largest depth.
    depth_max_m: Option<Positive>,
}

/// Where the response comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Source {
    Auto,
    Wall,
    Calibration,
}

impl Default for Locate {
    fn default() -> Self {
        Self { false_alarm: Share::new(0.01), response: Source::Auto, gate_ps: None, depth_max_m: None }
    }
}

/// What campaign.toml says of the scene.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    wall: relay_histograms::Fields,
    #[serde(flatten)]
    hidden: HiddenPatches,
}

/// Campaigns, and the light of each capture.
pub struct Context {
    fields: ByCampaign<Fields>,
    waveforms: Waveforms,
    cancel: Cancel,
}

impl Stage for Locate {
    const KIND: &'static str = "locate";
    const VERSION: u32 = 4;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "profiles", table: "profiles", required: true },
        Beside { name: "calibration", table: "calibration", required: true },
    ];
    const SIDES: &'static [Side] = &[Side { name: JointSearch::TABLE, schema: JointSearch::schema }];
    type Input = Patch;
    type Output = Patch;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields { wall: campaign.into(), hidden: campaign.into() })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let sensors = Sensors::new(&beside.rows("calibration")?.unwrap_or_default());
        let waveforms = Waveforms::new(beside.batches("profiles"), &sensors)?;
        Ok(Context { fields, waveforms, cancel: beside.cancel.clone() })
    }
}

impl Apply for Locate {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<Patch>, StageError> {
        let best = group.iter().filter(|patch| patch.alternative == 0);
        let points: BTreeMap<PatchId, Point> =
            best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
        let wall = |campaign: &str| context.fields.get(campaign).map(|fields| &fields.wall);
        let histograms: Vec<Histogram<'_>> =
            context.waveforms.calibrated.iter().filter_map(|one| Histogram::new(one, &points, wall)).collect();
        let mut rejections = left_out(context, histograms.len());
        let mut rows = group;
        let mut searches = Vec::new();
        match self.search(context, &histograms)? {
            Ok((outcome, search)) => {
                if outcome.verdict == Verdict::Points {
                    let listed = context.fields.values().map(|fields| fields.hidden.largest_patch);
                    let largest = listed.chain(points.keys().copied()).max().unwrap_or(0);
                    rows.extend(outcome.points.iter().zip(largest + 1..).map(|(point, patch)| {
                        covariances::patch_row(patch, "hidden", point.place, Some(&point.covariance_m2))
                    }));
                }
                searches.push(search);
            }
            Err(why) => rejections.push(Rejection::new(context.fields.first_name(), why)),
        }
        Ok(Outcome { rows, sides: vec![JointSearch::to_batch(&searches)], rejections })
    }
}

/// Outcome and row; or why nothing was searched.
type Answer = Result<(joint::Outcome, JointSearch), String>;

impl Locate {
    fn search(&self, context: &Context, histograms: &[Histogram<'_>]) -> Result<Answer, StageError> {
        let Some((first, fields)) = histograms.first().zip(context.fields.first()) else {
            return Ok(Err("no capture of the scene has a calibration and places of its patches".to_owned()));
        };
        let mut times = match Times::new(histograms, self.gate_ps.map(NonNegative::get)) {
            Ok(times) => times,
            Err(why) => return Ok(Err(why)),
        };
        let medium = fields.wall.medium;
        let binning = Binning::new(first, medium);
        let lengths = (medium, binning.bin_m());
        let wall = relay_histograms::first_bounce(histograms, &mut times, lengths, &context.cancel);
        let wall = wall.filter(|_| self.response != Source::Calibration);
        if wall.is_none() && self.response == Source::Wall {
            return Err(StageError::Refused(
                "response = \"wall\" needs a confocal scan that begins with the light of the wall; take out `response`"
                    .to_owned(),
            ));
        }
        let source = if wall.is_some() { "wall" } else { "calibration" };
        let pulse = wall.unwrap_or_else(|| binning.calibrated(first));
        let noise = binning.noise(histograms, &pulse);
        if matches!(noise, Noise::Gauss { sd } if sd <= 0.0) {
            let text = "the noise of the profiles is not known; a voltage needs a standard error, from several shots";
            return Ok(Err(text.to_owned()));
        }
        let depth_m = 0.5 * medium.path_m(times.end_ps);
        let depth_m = self.depth_max_m.map_or(depth_m, |most| depth_m.min(most.get()));
        let front = fields.wall.stations.source();
        let joined = histograms.iter().map(|one| binning.joined(one, &times)).collect();
        let problem = Problem::new(
            joined,
            (binning.bin_m(), pulse, noise),
            (front, depth_m),
            self.false_alarm.get(),
            context.cancel.clone(),
        );
        let Some(problem) = problem else {
            let text = "a joint search needs 16 histograms or more, of points that do not lie in one line";
            return Ok(Err(text.to_owned()));
        };
        let outcome = joint_search(&problem);
        let row = self.row(&outcome, (histograms.len(), times, source, medium));
        Ok(Ok((outcome, row)))
    }

    fn row(
        &self,
        outcome: &joint::Outcome,
        (histograms, times, source, medium): (usize, Times, &str, Medium),
    ) -> JointSearch {
        let verdict = match outcome.verdict {
            Verdict::Points => "points",
            Verdict::ExtendedObject => "extended-object",
            Verdict::Nothing => "nothing",
            Verdict::CannotTell => "cannot-tell",
        };
        JointSearch {
            verdict: verdict.into(),
            reason: outcome.reason.as_str().into(),
            histograms: histograms as i32,
            points: outcome.points.len() as i32,
            reappear: outcome.reappear,
            response: source.into(),
            gate_ps: times.gate_ps,
            end_ps: times.end_ps,
            cells: outcome.cells as i64,
            false_alarm: self.false_alarm.get(),
            threshold: outcome.threshold,
            largest: outcome.largest,
            misfit: outcome.misfit,
            own_misfit: outcome.own_misfit,
            scatter_ps: medium.time_ps(outcome.scatter_m),
            power: outcome.power,
            stretch: outcome.stretch,
        }
    }
}

/// Bins of the histograms, joined.
struct Binning {
    dt_ps: f64,
    /// Bins in one.
    count: usize,
    width_ps: f64,
    medium: Medium,
}

impl Binning {
    fn new(first: &Histogram<'_>, medium: Medium) -> Self {
        let (dt_ps, width_ps) = (first.dt_ps(), first.width_ps());
        let count = (width_ps / dt_ps / ACROSS).max(1.0) as usize;
        Self { dt_ps, count, width_ps, medium }
    }

    fn bin_m(&self) -> f64 {
        self.medium.path_m(self.dt_ps * self.count as f64)
    }

    /// Noise of a joined bin. Correlated noise counts as white noise under which height and arrival of a pulse would
    /// be no surer than they are.
    fn noise(&self, histograms: &[Histogram<'_>], pulse: &Pulse) -> Noise {
        let noises: Vec<(f64, Vec<f64>)> = histograms.iter().filter_map(Histogram::noise).collect();
        let Some((_, acf)) = noises.first() else { return Noise::Counts };
        let variance = noises.iter().map(|(variance, _)| variance).sum::<f64>() / noises.len() as f64;
        let reach = (2.0 * self.width_ps / self.dt_ps) as i32;
        let place_m = |n: i32| self.medium.path_m(f64::from(n) * self.dt_ps);
        let height: Vec<f64> = (-reach..=reach).map(|n| pulse.at(place_m(n))).collect();
        let arrival: Vec<f64> = height.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let factor = |template: &[f64]| {
            let lagged = |lag: usize| template.iter().zip(&template[lag..]).map(|(a, b)| a * b).sum::<f64>();
            let beside = |lag: usize| 2.0 * acf.get(lag).copied().unwrap_or(0.0) * lagged(lag);
            1.0 + (1..template.len()).map(beside).sum::<f64>() / lagged(0)
        };
        let factor = factor(&height).max(factor(&arrival)).max(0.0);
        Noise::Gauss { sd: (variance * factor * self.count as f64).sqrt() }
    }

    /// A histogram behind the gate. `first_ps` of a profile is the middle of its first bin.
    fn joined(&self, histogram: &Histogram<'_>, times: &Times) -> joint::Histogram {
        let (first_ps, values) = histogram.behind(times);
        let values = values.chunks_exact(self.count).map(|bins| bins.iter().sum::<f64>() as f32).collect();
        let first_m = self.medium.path_m(first_ps - 0.5 * self.dt_ps);
        joint::Histogram { lit: histogram.lit, seen: histogram.seen, first_m, values, ends: [[0.0; 2]; 2] }
    }

    /// The response of a sensor's calibration.
    fn calibrated(&self, histogram: &Histogram<'_>) -> Pulse {
        let response = histogram.response();
        let (first_ps, last_ps) = response.support_ps();
        let step_ps = self.width_ps / SAMPLES;
        let count = ((last_ps - first_ps) / step_ps).ceil() as usize + 1;
        let values: Vec<f64> = (0..count).map(|n| response.value(first_ps + n as f64 * step_ps).max(0.0)).collect();
        Pulse::new(self.medium.path_m(first_ps), self.medium.path_m(step_ps), &values, self.bin_m())
    }
}

/// Why captures of the scene are left out.
fn left_out(context: &Context, histograms: usize) -> Vec<Rejection> {
    let reject = |count: usize, why: &str| {
        (count > 0).then(|| Rejection::new(context.fields.first_name(), format!("{count} profiles are of {why}")))
    };
    let reasons = [
        (context.waveforms.uncalibrated, "sensors without calibration; capture a response for each sensor"),
        (
            context.waveforms.calibrated.len() - histograms,
            "patches without a place; give `position_m` for both patches of each capture, or patches from `refine`",
        ),
    ];
    reasons.into_iter().filter_map(|(count, why)| reject(count, why)).collect()
}
