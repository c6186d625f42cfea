//! `triangulate`: hidden strips from light that goes over them from one visible diffuser point to another (paper
//! section 6, figure 8 bottom: the 1-0-1 barcode).
//!
//! The beam lights diffuser points D_k in turn. A hidden strip reflects the light to its own exit, another diffuser
//! point E. There a sensor sees the third bounce, over D_k, strip and E. One pixel (`[views]`) covers the exits of all
//! strips, so that their pulses stand in one profile. First bounces off D_k, in a pixel that covers it, mark time zero.
//! [`crate::geometry::bistatic`] places the strips: every assignment of pulses to strips, with diffuser points and
//! delays open within their standard deviations. The laser fires again before late light is back. So each time is the
//! earliest that a way over anything but the straight line from D_k to E can have.
//!
//! campaign.toml gives:
//! - `position_m` (and `sd_m`) of every D_k and E; their `normal`, for the side on which strips are;
//! - hidden patches with `through`, their exit, in the order in which they stand. Without any, there is one strip for
//!   each patch of the view;
//! - of a glossy strip `size_m` and `lobe_rad`. The glint moves with the lit point, by the law of reflection; unless
//!   `normal` gives the normal, it was turned to the most light;
//! - of a strip of unknown reflection, `size_m` alone: its light may come from any point of it, and each onset has that
//!   error, half its size along the strip. Without `size_m` a strip is a point;
//! - `[hidden]`: `apart_max_m`, `along`. Where as many scans as dimensions fit with any assignment, these decide. What
//!   is not decided stands in `patches` as `alternative`.
//!
//! `gaps` has the verdict whether the middle between two strips is free. An object there that reflects at least
//! `share_least` of the weaker neighbour's light, over either exit, would have added a pulse. Every profile is fitted
//! with the strips' pulses alone and with at least that much between, times and amplitudes free
//! ([`crate::signal::between`]). A little light over the other's exit, and light spread over some picoseconds, are
//! allowed for. `certain` is how probable a verdict must be. Pulses closer than the response is wide leave the gap open
//! unless the signal is strong; `share_sd` is the error of the middle's share. Strips are placed as if the gap were
//! free; where the middle has onsets of its own, they are displaced.
//!
//! | method | |
//! |---|---|
//! | `likelihood` | the above |
//! | `ellipses` | the paper's: differences of arrival of third and first bounce, all else taken as exact, ellipses crossed |
//!
//! Takes `onsets`; writes `patches`: strips, and diffuser points as adjusted. Also takes `calibration`; for `gaps`
//! `profiles`, and `session` where `deconvolve` had one.
//!
//! Not modelled: footprints of diffuser points; a strip whose light leaves over several exits; pixels that cover the
//! exits of some strips only; photon counts in `gaps`.
//!
//! ```toml
//! [patches]
//! stage = "triangulate"
//! from = "onsets"
//! with = { calibration = "calibration", profiles = "profiles" }
//! ```

mod gap;
mod model;
mod rows;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::campaign::keys;
use crate::cancel::Cancel;
use crate::geometry::bistatic;
use crate::parameter::{Interval, Number, Share};
use crate::priors::calibration::Sensors;
use crate::priors::campaign_fields::{ByCampaign, Medium};
use crate::priors::delays::Latencies;
use crate::tables::{Calibration, Gap, Label, Onset, Patch, PatchCovariance, Profile, Row, Session};
use crate::units::PatchId;
use model::Model;

/// Parameters of `triangulate`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Triangulate {
    method: Method,
    /// Light of something in the middle over that of the weaker strip, from which it counts.
    share_least: Share,
    /// Probability that a verdict on a gap needs.
    certain: Number<AboveHalf>,
}

/// Probabilities that are enough for a verdict: above 0.5 and below 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct AboveHalf;

impl Interval for AboveHalf {
    const LEAST: f64 = 0.5;
    const MOST: f64 = 1.0;
    const IS_CLOSED: bool = false;
}

/// How strips are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Likelihood,
    Ellipses,
}

impl Default for Triangulate {
    fn default() -> Self {
        Self { method: Method::Likelihood, share_least: Share::new(1.0 / 3.0), certain: Number::new(0.99) }
    }
}

/// What campaign.toml says of the scene.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    dimensions: usize,
    #[serde(flatten)]
    medium: Medium,
    repetition_ps: Option<f64>,
    source_m: [f64; 3],
    /// Station of each sensor.
    sensors: BTreeMap<String, keys::Station>,
    patches: BTreeMap<PatchId, keys::Patch>,
    views: BTreeMap<PatchId, keys::View>,
    hidden: keys::Hidden,
}

/// The campaign, and the tables other than the onsets.
pub struct Context {
    campaign: String,
    fields: Fields,
    latencies: Latencies,
    sensors: Sensors,
    profiles: Option<Vec<Profile>>,
    sessions: Vec<Session>,
    cancel: Cancel,
}

impl Context {
    /// The patches that a number stands for.
    fn covers(&self, number: PatchId) -> Vec<PatchId> {
        self.fields.views.get(&number).map_or_else(|| vec![number], |view| view.patches.clone())
    }

    fn rejection(&self, reason: String) -> Rejection {
        Rejection::new(&self.campaign, reason)
    }
}

impl Stage for Triangulate {
    const KIND: &'static str = "triangulate";
    const VERSION: u32 = 7;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "profiles", table: "profiles", required: false },
        Beside { name: "session", table: "session", required: false },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: PatchCovariance::TABLE, schema: PatchCovariance::schema },
        Side { name: Label::TABLE, schema: Label::schema },
        Side { name: Gap::TABLE, schema: Gap::schema },
    ];
    type Input = Onset;
    type Output = Patch;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| {
            let station = |name: &String| Some((name.clone(), campaign.station_of(name)?.clone()));
            // No label and no ray: nothing here reads them.
            let read =
                |(id, patch): (&PatchId, &keys::Patch)| (*id, keys::Patch { label: None, ray: None, ..patch.clone() });
            Fields {
                dimensions: usize::from(campaign.dimensions),
                medium: campaign.into(),
                repetition_ps: campaign.repetition_ps,
                source_m: campaign.source().position_m,
                sensors: campaign.sensors.keys().filter_map(station).collect(),
                patches: campaign.patches.iter().map(read).collect(),
                views: campaign.views.clone(),
                hidden: campaign.hidden.clone(),
            }
        })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let (campaign, fields) = fields.into_only().map_err(|count| {
            StageError::Refused(format!("{count} campaigns; strips are placed campaign by campaign, give one"))
        })?;
        let calibration = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        Ok(Context {
            campaign,
            fields,
            latencies: Latencies::new(&calibration),
            sensors: Sensors::new(&calibration),
            profiles: beside.rows("profiles")?,
            sessions: beside.rows("session")?.unwrap_or_default(),
            cancel: beside.cancel.clone(),
        })
    }
}

impl Apply for Triangulate {
    fn apply(&self, context: &Context, group: Vec<Onset>) -> Result<Outcome<Patch>, StageError> {
        let (model, mut reasons) = match Model::new(context, group, self.method == Method::Ellipses) {
            Ok(made) => made,
            Err(reason) => return Ok(Outcome::rejected(context.rejection(reason))),
        };
        let solutions = match bistatic::solve(&model.problem) {
            Ok(solutions) => solutions,
            Err(unsolved) => {
                reasons.push(format!("strips are not placed: {unsolved}; {}", fix(&unsolved)));
                Vec::new()
            }
        };
        let mut gaps = Vec::new();
        if let Some(best) = solutions.first() {
            for pair in 1..model.strips.len() {
                gaps.extend(self.gap(context, &model, best, pair - 1, &mut reasons));
            }
        }
        Ok(Outcome {
            rows: model.patches(&solutions),
            sides: vec![
                PatchCovariance::to_batch(&model.covariances(&solutions)),
                Label::to_batch(&model.labels(&solutions)),
                Gap::to_batch(&gaps),
            ],
            rejections: reasons.into_iter().map(|reason| context.rejection(reason)).collect(),
        })
    }
}

/// What to add.
fn fix(unsolved: &bistatic::Unsolved) -> &'static str {
    match unsolved {
        bistatic::Unsolved::TooFew { .. } => {
            "light more diffuser points, or average more shots until every strip shows"
        }
        bistatic::Unsolved::InLine => "light diffuser points off that line too",
        bistatic::Unsolved::NoPlace => {
            "see whether positions, normals, `through`, and [hidden] `apart_max_m` and `along` in campaign.toml are right"
        }
        bistatic::Unsolved::TooMany => "raise threshold_sigma of `detect`, so that only the strips' pulses are left",
    }
}
