//! Normals and footprints of the patches. Sizes come from campaign.toml, normals from fitted planes, else from
//! campaign.toml.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use crate::campaign::Campaign;
use crate::geometry::footprint::{Footprint, Footprints};
use crate::tables::{PatchFootprint, Plane};
use crate::units::PatchId;

/// Size and direction of a patch in campaign.toml.
#[derive(Clone, Debug, Serialize)]
pub struct Extent {
    size_m: Option<f64>,
    normal: Option<[f64; 3]>,
}

impl Extent {
    /// Whether campaign.toml gives both its size and its normal.
    pub fn is_whole(&self) -> bool {
        self.size_m.is_some() && self.normal.is_some()
    }
}

/// Of all patches of a campaign.
pub fn extents(campaign: &Campaign) -> BTreeMap<PatchId, Extent> {
    campaign.patches.iter().map(|(id, patch)| (*id, Extent { size_m: patch.size_m, normal: patch.normal })).collect()
}

/// Unit normals of the patches on one of the `planes`, in the frame of the patches that these were fitted to. Where
/// campaign.toml's frame `is_fixed`, also of others with a normal there.
pub fn normals(
    extents: &BTreeMap<PatchId, Extent>,
    planes: &[Plane],
    is_fixed: bool,
) -> BTreeMap<PatchId, Vector3<f64>> {
    let from_file =
        extents.iter().filter(|_| is_fixed).filter_map(|(patch, extent)| Some((*patch, Vector3::from(extent.normal?))));
    let of_plane = |plane: &Plane| {
        let normal = Vector3::new(plane.normal_x, plane.normal_y, plane.normal_z);
        plane.patches.iter().map(|patch| (*patch, normal)).collect::<Vec<_>>()
    };
    let all = from_file.chain(planes.iter().flat_map(of_plane));
    all.filter_map(|(patch, normal)| Some((patch, normal.try_normalize(f64::MIN_POSITIVE)?))).collect()
}

/// Footprints of patches with a known size and one of the [`normals`].
pub fn of(extents: &BTreeMap<PatchId, Extent>, normals: &BTreeMap<PatchId, Vector3<f64>>) -> Footprints {
    let footprint = |(patch, normal): (&PatchId, &Vector3<f64>)| {
        Some((*patch, Footprint::exact(*normal, extents.get(patch)?.size_m?)))
    };
    Footprints(normals.iter().filter_map(footprint).collect())
}

/// Footprints of the table.
pub fn of_table(rows: &[PatchFootprint]) -> Footprints {
    let footprint = |row: &PatchFootprint| {
        let normal = Vector3::new(row.normal_x, row.normal_y, row.normal_z);
        let [xy, xz, yz] = [row.cov_xy_m2, row.cov_xz_m2, row.cov_yz_m2];
        let covariance_m2 = Matrix3::new(row.cov_xx_m2, xy, xz, xy, row.cov_yy_m2, yz, xz, yz, row.cov_zz_m2);
        (row.patch, Footprint::with_covariance(normal, row.size_m, covariance_m2))
    };
    Footprints(rows.iter().map(footprint).collect())
}

/// The row of a footprint.
pub fn row(patch: PatchId, footprint: &Footprint, source: &str) -> PatchFootprint {
    let cov_m2 = footprint.covariance_m2();
    PatchFootprint {
        patch,
        size_m: footprint.size_m,
        normal_x: footprint.normal.x,
        normal_y: footprint.normal.y,
        normal_z: footprint.normal.z,
        normal_sd_rad: footprint.normal_sd_rad(),
        size_sd_m: footprint.size_sd_m(),
        cov_xx_m2: cov_m2[(0, 0)],
        cov_xy_m2: cov_m2[(0, 1)],
        cov_xz_m2: cov_m2[(0, 2)],
        cov_yy_m2: cov_m2[(1, 1)],
        cov_yz_m2: cov_m2[(1, 2)],
        cov_zz_m2: cov_m2[(2, 2)],
        source: source.into(),
    }
}
