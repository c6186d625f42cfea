//! Footprints of the patches: sizes from campaign.toml, normals from planes that were found, else from campaign.toml.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;

use crate::campaign::Campaign;
use crate::geometry::Point;
use crate::geometry::footprint::{self, Footprint};
use crate::tables::Plane;
use crate::units::PatchId;

/// What a campaign says of a patch's footprint.
#[derive(Clone, Debug, Serialize)]
pub struct Told {
    size_m: f64,
    normal: Option<[f64; 3]>,
}

impl Told {
    /// Whether campaign.toml gives its normal.
    pub fn has_normal(&self) -> bool {
        self.normal.is_some()
    }
}

/// Of all patches with a size.
pub fn told(campaign: &Campaign) -> BTreeMap<PatchId, Told> {
    let patches = campaign.patches.iter();
    patches.filter_map(|(id, patch)| Some((*id, Told { size_m: patch.size_m?, normal: patch.normal }))).collect()
}

/// Footprints by patch; a patch without one is a point.
#[derive(Clone, Debug, Default)]
pub struct Footprints(BTreeMap<PatchId, Footprint>);

impl Footprints {
    /// Of patches with a known size that lie on one of the `planes`, whose normals hold in the frame of the patches they were fitted to; where campaign.toml's
    /// frame `is_fixed`, also of others with a normal there.
    pub fn new(told: &BTreeMap<PatchId, Told>, planes: &[Plane], is_fixed: bool) -> Self {
        let found = |patch: PatchId| {
            let plane = planes.iter().find(|plane| plane.patches.contains(&patch))?;
            Some(Vector3::new(plane.normal_x, plane.normal_y, plane.normal_z))
        };
        let footprint = |(patch, told): (&PatchId, &Told)| {
            let normal = found(*patch).or_else(|| told.normal.filter(|_| is_fixed).map(Vector3::from))?;
            Some((*patch, Footprint { normal: normal.try_normalize(f64::MIN_POSITIVE)?, size_m: told.size_m }))
        };
        Self(told.iter().filter_map(footprint).collect())
    }

    /// Whether all patches are points.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// What the mean way of the light over finite patches is longer than that over their centres.
    pub fn shift_m(&self, source: Point, path: &[PatchId], centre: impl Fn(&PatchId) -> Point, sensor: Point) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let bounces: Vec<(Point, Option<Footprint>)> =
            path.iter().map(|patch| (centre(patch), self.0.get(patch).copied())).collect();
        footprint::shift_m(source, &bounces, sensor)
    }
}
