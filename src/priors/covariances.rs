//! Covariances of patches as matrices, from their tables and into them.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use crate::tables::{Patch, PatchCovariance};
use crate::units::PatchId;

/// Covariance of a patch's position, in m^2; `None` for a start value.
pub fn of_patch(row: &Patch) -> Option<Matrix3<f64>> {
    let [xx, xy, xz] = [row.cov_xx_m2?, row.cov_xy_m2?, row.cov_xz_m2?];
    let [yy, yz, zz] = [row.cov_yy_m2?, row.cov_yz_m2?, row.cov_zz_m2?];
    Some(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// Covariance of the positions of patch `a` (rows) and patch `b` (columns), in m^2.
pub fn between(row: &PatchCovariance) -> Matrix3<f64> {
    Matrix3::new(
        row.cov_xx_m2,
        row.cov_xy_m2,
        row.cov_xz_m2,
        row.cov_yx_m2,
        row.cov_yy_m2,
        row.cov_yz_m2,
        row.cov_zx_m2,
        row.cov_zy_m2,
        row.cov_zz_m2,
    )
}

/// The row of such a covariance.
pub fn row(a: PatchId, b: PatchId, cov_m2: &Matrix3<f64>) -> PatchCovariance {
    PatchCovariance {
        a,
        b,
        cov_xx_m2: cov_m2[(0, 0)],
        cov_xy_m2: cov_m2[(0, 1)],
        cov_xz_m2: cov_m2[(0, 2)],
        cov_yx_m2: cov_m2[(1, 0)],
        cov_yy_m2: cov_m2[(1, 1)],
        cov_yz_m2: cov_m2[(1, 2)],
        cov_zx_m2: cov_m2[(2, 0)],
        cov_zy_m2: cov_m2[(2, 1)],
        cov_zz_m2: cov_m2[(2, 2)],
    }
}

/// Covariances of the positions of patches with one another.
#[derive(Clone, Debug, Default)]
pub struct PatchCovariances(BTreeMap<(PatchId, PatchId), Matrix3<f64>>);

impl PatchCovariances {
    /// From the rows of `patch_covariances`, which has each pair once.
    pub fn new(rows: &[PatchCovariance]) -> Self {
        let both = |row: &PatchCovariance| {
            let cov_m2 = between(row);
            [((row.a, row.b), cov_m2), ((row.b, row.a), cov_m2.transpose())]
        };
        Self(rows.iter().flat_map(both).collect())
    }

    /// Covariance of patch `a` (rows) and patch `b` (columns), in m^2: zero for patches without a row.
    pub fn between(&self, a: PatchId, b: PatchId) -> Matrix3<f64> {
        self.0.get(&(a, b)).copied().unwrap_or_else(Matrix3::zeros)
    }
}
