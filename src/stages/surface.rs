//! `surface`: planes through groups of patches (paper Figs. 4d and 6d: surface fitting, near co-planarity).
//!
//! Which patches lie on one plane is searched for ([`crate::geometry::planes`]): the plane with most patches within 3.5
//! standard deviations, then the same with the rest, as long as `least` are found. Or the groups are given by hand, in
//! `groups`; a patch may then be in several. Minimised are distances at right angles to the plane, each over its
//! variance. The errors of a plane follow from those of its patches, those of the angle between two planes from what
//! their patches do not share. `roughness_m` is how far patches may lie off a plane beyond their errors: real walls are
//! not flat, and a first solution without footprints has larger errors than stated.
//!
//! Takes `patches` (of `refine`, with their covariances; best alternative only); writes `planes`. Optional:
//! `covariances` (`patch_covariances` of the same stage). Without them the errors of patches count as independent,
//! which makes those of planes too small or too large. Not modelled: edges, curved walls, flatland.
//!
//! ```toml
//! [planes]
//! stage = "surface"
//! from = "patches"
//! with = { covariances = "patches.patch_covariances" }
//! params = { least = 5 }                                # or: groups = [[1, 2, 3, 4], [5, 6, 7]]
//! ```

use std::collections::BTreeSet;

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::{Point, planes};
use crate::parameter::{Condition, Conflict, Count, NonNegative};
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::covariances::{self, PatchCovariances};
use crate::tables::{Patch, PatchCovariance, Plane};
use crate::units::PatchId;

/// Any three points span a plane: `least` is one more.
const EXACT: usize = 3;

/// Parameters of `surface`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Surface {
    /// Least patches of a plane that is searched for.
    least: Count<4>,
    /// Standard deviation of the patches' own distance from their plane.
    roughness_m: NonNegative,
    /// Patches of each plane, in place of the search.
    groups: Option<Vec<Vec<PatchId>>>,
    /// Whether the table may be empty: patches that span no plane, or lie in flatland, are then no fault.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    optional: bool,
}

impl Default for Surface {
    fn default() -> Self {
        Self { least: Count::new(4), roughness_m: NonNegative::new(0.0), groups: None, optional: false }
    }
}

/// What campaign.toml says of the patches.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    dimensions: u8,
}

/// Campaign of the patches, and the covariances between them.
pub struct Context {
    campaign: String,
    /// Whether the patches lie in flatland, which is one plane.
    is_flat: bool,
    covariances: PatchCovariances,
    cancel: Cancel,
}

impl Stage for Surface {
    const KIND: &'static str = "surface";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[Beside { name: "covariances", table: "patch_covariances", required: false }];
    const CONDITIONS: &'static [Condition] =
        &[Condition("least", "groups", &["absent"]), Condition("optional", "groups", &["absent"])];
    type Input = Patch;
    type Output = Plane;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn conflict(&self) -> Option<Conflict> {
        let fault = |(n, group): (usize, &Vec<PatchId>)| {
            let different: BTreeSet<&PatchId> = group.iter().collect();
            let group_number = n + 1;
            if different.len() < group.len() {
                return Some(format!("group {group_number} names a patch twice; name each once"));
            }
            let is_small = group.len() < EXACT;
            is_small.then(|| format!("group {group_number} has fewer than {EXACT} patches, too few for a plane"))
        };
        self.groups.iter().flatten().enumerate().find_map(fault).map(|why| Conflict("groups", why))
    }

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields { dimensions: campaign.dimensions })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let in_flatland = fields.iter().find(|(_, fields)| fields.dimensions < 3);
        if let Some((campaign, _)) = in_flatland.filter(|_| !self.optional) {
            return Err(StageError::Refused(format!(
                "campaign `{campaign}` is in flatland, where all patches lie in one plane; leave out `surface`"
            )));
        }
        let rows = beside.rows::<PatchCovariance>("covariances")?.unwrap_or_default();
        let campaign = fields.first_name().to_owned();
        let is_flat = in_flatland.is_some();
        Ok(Context { campaign, is_flat, covariances: PatchCovariances::new(&rows), cancel: beside.cancel.clone() })
    }
}

impl Apply for Surface {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<Plane>, StageError> {
        if context.is_flat {
            return Ok(Outcome::rows(Vec::new()));
        }
        let (placed, mut reasons) = Placed::new(context, &group, self.roughness_m.get());
        let planes = match &self.groups {
            None => planes::find(&placed.points, self.least.get() as usize, |a, b| placed.covariance_m2(a, b)),
            Some(groups) => placed.through(groups, &mut reasons),
        };
        if self.groups.is_none() && planes.is_empty() {
            reasons.push(format!(
                "no {} of the {} patches lie within {} standard deviations of a plane; name those that should in `groups`: their row has their \
                 distances from it",
                self.least.get(),
                placed.points.len(),
                planes::NEAR
            ));
        }
        if self.optional {
            reasons.clear();
        }
        let reject = |reason: String| Rejection::new(&context.campaign, reason);
        let rows = planes.iter().enumerate().map(|(n, plane)| placed.row(n, plane, &planes[0])).collect();
        Ok(Outcome { rows, sides: Vec::new(), rejections: reasons.into_iter().map(reject).collect() })
    }
}

/// Patches that a plane can be laid through, by their places in the table.
struct Placed<'a> {
    ids: Vec<PatchId>,
    points: Vec<Point>,
    own: Vec<Matrix3<f64>>,
    covariances: &'a PatchCovariances,
    cancel: &'a Cancel,
}

impl<'a> Placed<'a> {
    /// Patches of the best alternative, and why others are left out.
    fn new(context: &'a Context, rows: &[Patch], roughness_m: f64) -> (Self, Vec<String>) {
        let mut placed = Self {
            ids: Vec::new(),
            points: Vec::new(),
            own: Vec::new(),
            covariances: &context.covariances,
            cancel: &context.cancel,
        };
        let mut reasons = Vec::new();
        for row in rows.iter().filter(|row| row.alternative == 0) {
            // A variance of zero would be an infinite weight.
            match covariances::of_patch(row).filter(|own| own.diagonal().min() > 0.0) {
                Some(own) => {
                    placed.ids.push(row.patch);
                    placed.points.push(Point::new(row.x_m, row.y_m, row.z_m));
                    placed.own.push(own + Matrix3::identity() * (roughness_m * roughness_m));
                }
                None => reasons.push(format!(
                    "patch {} has no covariance, so its distance from a plane cannot be judged; give patches from `refine`",
                    row.patch
                )),
            }
        }
        (placed, reasons)
    }

    /// Covariance of two patches. All loops over planes ask for it, so it polls for them.
    fn covariance_m2(&self, a: usize, b: usize) -> Matrix3<f64> {
        self.cancel.check();
        if a == b {
            return self.own[a];
        }
        self.covariances.between(self.ids[a], self.ids[b])
    }

    /// Planes through groups that were given by hand, and why some have none.
    fn through(&self, groups: &[Vec<PatchId>], reasons: &mut Vec<String>) -> Vec<planes::Plane> {
        let mut planes = Vec::new();
        for (n, group) in groups.iter().enumerate() {
            let (here, gone): (Vec<PatchId>, Vec<PatchId>) = group.iter().partition(|patch| self.ids.contains(patch));
            let group = n + 1;
            reasons.extend(gone.iter().map(|patch| {
                format!(
                    "patch {patch} of group {group} is not among the patches with a covariance: take it out of `groups`"
                )
            }));
            let mut members: Vec<usize> =
                here.iter().filter_map(|patch| self.ids.iter().position(|id| id == patch)).collect();
            members.sort_by_key(|place| self.ids[*place]);
            match planes::fit(&self.points, &members, |a, b| self.covariance_m2(a, b)) {
                Some(plane) => planes.push(plane),
                None => reasons.push(format!(
                    "the {} patches of group {group} are fewer than {EXACT} or in line, which determines no plane: add one off their line",
                    members.len()
                )),
            }
        }
        planes
    }

    /// The row of the `n`-th plane, from 0; tilted against the `first`.
    fn row(&self, n: usize, plane: &planes::Plane, first: &planes::Plane) -> Plane {
        let out = |place: usize| plane.normal.dot(&self.points[place].coords) - plane.offset_m;
        let farthest = plane.members.iter().copied().max_by(|a, b| out(*a).abs().total_cmp(&out(*b).abs()));
        let farthest = farthest.expect("a plane has patches");
        let tilt = (n > 0).then(|| planes::tilt(first, plane, |a, b| self.covariance_m2(a, b)));
        Plane {
            plane: n as i32 + 1,
            patches: plane.members.iter().map(|place| self.ids[*place]).collect(),
            normal_x: plane.normal.x,
            normal_y: plane.normal.y,
            normal_z: plane.normal.z,
            offset_m: plane.offset_m,
            normal_sd_rad: plane.normal_covariance.symmetric_eigenvalues().max().max(0.0).sqrt(),
            offset_sd_m: plane.offset_sd_m,
            rms_m: plane.rms_m,
            farthest: self.ids[farthest],
            farthest_m: out(farthest),
            chi2: plane.chi2,
            degrees_of_freedom: (plane.members.len() - EXACT) as i32,
            tilt_rad: tilt.map(|(tilt_rad, _)| tilt_rad),
            tilt_sd_rad: tilt.map(|(_, sd_rad)| sd_rad),
        }
    }
}

#[cfg(test)]
mod tests;
