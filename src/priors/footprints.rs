//! Normals and footprints of the patches: sizes from campaign.toml, normals from planes that were found, else from campaign.toml.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;

use crate::campaign::Campaign;
use crate::geometry::Point;
use crate::geometry::footprint::{self, Footprint};
use crate::tables::Plane;
use crate::units::PatchId;

/// What a campaign says of how a patch lies.
#[derive(Clone, Debug, Serialize)]
pub struct Told {
    size_m: Option<f64>,
    normal: Option<[f64; 3]>,
}

impl Told {
    /// Whether campaign.toml gives both its size and its normal.
    pub fn is_whole(&self) -> bool {
        self.size_m.is_some() && self.normal.is_some()
    }
}

/// Of all patches.
pub fn told(campaign: &Campaign) -> BTreeMap<PatchId, Told> {
    campaign.patches.iter().map(|(id, patch)| (*id, Told { size_m: patch.size_m, normal: patch.normal })).collect()
}

/// Unit normals of patches that lie on one of the `planes`, which hold in the frame of the patches they were fitted to; where campaign.toml's frame `is_fixed`, also of
/// others with a normal there.
pub fn normals(told: &BTreeMap<PatchId, Told>, planes: &[Plane], is_fixed: bool) -> BTreeMap<PatchId, Vector3<f64>> {
    let from_file =
        told.iter().filter(|_| is_fixed).filter_map(|(patch, told)| Some((*patch, Vector3::from(told.normal?))));
    let of_plane = |plane: &Plane| {
        let normal = Vector3::new(plane.normal_x, plane.normal_y, plane.normal_z);
        plane.patches.iter().map(|patch| (*patch, normal)).collect::<Vec<_>>()
    };
    let all = from_file.chain(planes.iter().flat_map(of_plane));
    all.filter_map(|(patch, normal)| Some((patch, normal.try_normalize(f64::MIN_POSITIVE)?))).collect()
}

/// Footprints by patch; a patch without one is a point.
#[derive(Clone, Debug, Default)]
pub struct Footprints(BTreeMap<PatchId, Footprint>);

impl Footprints {
    /// Of patches with a known size and one of the [`normals`].
    pub fn new(told: &BTreeMap<PatchId, Told>, normals: &BTreeMap<PatchId, Vector3<f64>>) -> Self {
        let footprint = |(patch, normal): (&PatchId, &Vector3<f64>)| {
            Some((*patch, Footprint { normal: *normal, size_m: told.get(patch)?.size_m? }))
        };
        Self(normals.iter().filter_map(footprint).collect())
    }

    /// Whether all patches are points.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Diameter of the largest, 0 of points.
    pub fn largest_m(&self) -> f64 {
        self.0.values().map(|footprint| footprint.size_m).fold(0.0, f64::max)
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
