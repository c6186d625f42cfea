//! `reflect`: a mirror that is seen only through a diffuser (paper Fig. 8, top: missing direct reflection).
//!
//! The laser is aimed at patches of role `mirror`, in known directions (`ray`); no light comes straight back from
//! there. The reflected beam meets the diffuser in a point, which the sensor sees. The position of that point is known:
//! `position_m` and `sd_m`, or the table `patches`, in the frame of campaign.toml. The time of flight places each
//! mirror point on its ray ([`crate::geometry::mirror`]).
//!
//! | method | |
//! |---|---|
//! | `joint` | maximum likelihood over the mirror, rays, diffuser points, delays and stations, each known with its error; with covariances |
//! | `virtual-source` | trilateration of the laser's mirror image from path lengths; rays choose between places that lengths leave open |
//! | `per-ray` | each scan alone: its conic, cut by its ray |
//! | `equal-distances` | the paper's, to compare with: the same, at one distance for all rays |
//!
//! Of all profiles with a mirror point lit, the strongest onset is the beam's way over the diffuser point seen there:
//! other light has been scattered first. Where the laser repeats (`repetition_ps`), whole periods are added until the
//! path is no shorter than the straight one over the diffuser point. The detour over the mirror must be less than a
//! period.
//!
//! Takes `onsets`; writes `patches`: mirror points and diffuser points, the latter as `joint` adjusts them, or as
//! given. `ambiguities` lists points that are badly determined, and another place of the virtual source. `joint` also
//! writes `patch_covariances`, and the mirror as one of `planes` (its points lie on it by construction: no distances
//! from it). Optional tables: `patches`; `calibration`, without which latencies are taken as exact. Scans that lack a
//! ray or a diffuser point's position stand in `rejects`.
//!
//! Not modelled: several mirrors, curved ones, sensors that look into the mirror, errors of the laser's period,
//! covariances between the given patches.
//!
//! ```toml
//! [patches]
//! stage = "reflect"
//! from = "onsets"
//! with = { calibration = "calibration" }
//! params = { method = "joint" }
//! ```

mod rows;
mod scans;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::campaign::keys::PatchRole;
use crate::geometry::{Point, mirror};
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::delays::Latencies;
use crate::tables::{Ambiguity, Onset, Patch, PatchCovariance, Plane, Row};
use rows::Tables;
use scans::{Context, Fields, Scans};

/// A second place of the virtual source is likely too if its contradiction exceeds that of the best one by less than
/// this. The limit is a likelihood ratio of 3,000.
const LIKELY: f64 = 16.0;

/// Parameters of `reflect`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reflect {
    method: Method,
}

impl Default for Reflect {
    fn default() -> Self {
        Self { method: Method::Joint }
    }
}

/// How mirror points come from scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Joint,
    VirtualSource,
    PerRay,
    EqualDistances,
}

impl Stage for Reflect {
    const KIND: &'static str = "reflect";
    const VERSION: u32 = 2;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "calibration", table: "calibration", required: false },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: PatchCovariance::TABLE, schema: PatchCovariance::schema },
        Side { name: Plane::TABLE, schema: Plane::schema },
        Side { name: Ambiguity::TABLE, schema: Ambiguity::schema },
    ];
    type Input = Onset;
    type Output = Patch;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| campaign.into())
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let refused = |text: &str| Err(StageError::Refused(text.to_owned()));
        let Some(first) = fields.first() else {
            return refused("no campaign is given");
        };
        if fields.values().any(|fields| !fields.is_of_scene(first)) {
            return refused(
                "the campaigns differ in dimensions, stations or patches: campaigns of one scene must share them",
            );
        }
        if first.patches.values().all(|patch| patch.role != PatchRole::Mirror) {
            return refused(
                "campaign.toml has no patch of role `mirror`; give `role = \"mirror\"` and a `ray` to those that the laser was aimed at on the mirror",
            );
        }
        let patches = beside.rows::<Patch>("patches")?.unwrap_or_default();
        let latencies = Latencies::new(&beside.rows("calibration")?.unwrap_or_default());
        Ok(Context::new(fields, &patches, latencies, beside.cancel.clone()))
    }
}

impl Apply for Reflect {
    fn apply(&self, context: &Context, group: Vec<Onset>) -> Result<Outcome<Patch>, StageError> {
        let (scans, mut reasons) = Scans::new(context, &group);
        let tables = if scans.experiment.scans.is_empty() {
            reasons.push("no scan of the mirror is left: see the reasons above".to_owned());
            Tables::default()
        } else {
            self.solved(&scans, &mut reasons)
        };
        let campaign = context.fields.first_name();
        let reject = |reason: String| Rejection::new(campaign, reason);
        Ok(Outcome {
            rows: tables.patches,
            sides: vec![
                PatchCovariance::to_batch(&tables.covariances),
                Plane::to_batch(&tables.planes),
                Ambiguity::to_batch(&tables.ambiguities),
            ],
            rejections: reasons.into_iter().map(reject).collect(),
        })
    }
}

impl Reflect {
    /// Rows by the method, and why there are none.
    fn solved(&self, scans: &Scans, reasons: &mut Vec<String>) -> Tables {
        let experiment = &scans.experiment;
        let source = experiment.stations[0].position;
        let along = |n: usize, distance_m: f64| source + experiment.scans[n].direction * distance_m;
        let points: Vec<Option<Point>> = match self.method {
            Method::Joint => match mirror::solve(experiment) {
                Ok(solution) => return Tables::joint(scans, &solution),
                Err(unsolved) => {
                    reasons.push(format!("{unsolved}; check rays, diffuser points and latency against one another"));
                    return Tables::default();
                }
            },
            Method::VirtualSource => {
                let mirrors = mirror::virtual_source(experiment);
                let Some(best) = mirrors.first() else {
                    reasons.push(format!(
                        "{} scans are too few for a virtual source; add scans until there are {}, or take method `joint`, for which one is enough",
                        experiment.scans.len(),
                        experiment.dimensions
                    ));
                    return Tables::default();
                };
                let likely = mirrors.iter().take_while(|mirror| mirror.1 < best.1 + LIKELY);
                let meets = |mirror: &mirror::Mirror| -> Vec<Option<Point>> {
                    let scans = experiment.scans.iter().enumerate();
                    scans.map(|(n, scan)| Some(along(n, mirror.meets(source, scan.direction)?))).collect()
                };
                let places: Vec<_> = likely.map(|(mirror, more)| (meets(mirror), more - best.1)).collect();
                return Tables::places(scans, &places, reasons);
            }
            Method::PerRay => {
                let distances_m = mirror::per_ray(experiment).into_iter().enumerate();
                distances_m.map(|(n, distance_m)| Some(along(n, distance_m?))).collect()
            }
            Method::EqualDistances => {
                let distance_m = mirror::equal_distances(experiment);
                (0..experiment.scans.len()).map(|n| Some(along(n, distance_m?))).collect()
            }
        };
        Tables::places(scans, &[(points, 0.0)], reasons)
    }
}

#[cfg(test)]
mod tests;
