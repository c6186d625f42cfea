//! Normals and footprints of the patches: sizes from campaign.toml, normals from planes that were found, else from campaign.toml.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;

use crate::campaign::Campaign;
use crate::geometry::footprint::{Footprint, Footprints};
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

/// Footprints of patches with a known size and one of the [`normals`].
pub fn of(told: &BTreeMap<PatchId, Told>, normals: &BTreeMap<PatchId, Vector3<f64>>) -> Footprints {
    let footprint = |(patch, normal): (&PatchId, &Vector3<f64>)| {
        Some((*patch, Footprint { normal: *normal, size_m: told.get(patch)?.size_m? }))
    };
    Footprints(normals.iter().filter_map(footprint).collect())
}
