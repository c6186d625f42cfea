//! Positions of patches and their covariances, as points and matrices, from their tables and into them; covariances of
//! onsets.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use crate::geometry::Point;
use crate::tables::{Hypothesis, Onset, Patch, PatchCovariance};
use crate::units::PatchId;

/// Covariance of a patch's position, in m^2; `None` for a start value.
pub fn of_patch(row: &Patch) -> Option<Matrix3<f64>> {
    let [xx, xy, xz] = [row.cov_xx_m2?, row.cov_xy_m2?, row.cov_xz_m2?];
    let [yy, yz, zz] = [row.cov_yy_m2?, row.cov_yz_m2?, row.cov_zz_m2?];
    Some(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// The six numbers of a covariance that rows have: xx, xy, xz, yy, yz, zz.
pub fn upper(matrix: &Matrix3<f64>) -> [f64; 6] {
    [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|place: (usize, usize)| matrix[place])
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

/// Covariance of an onset's time with those of all onsets of its profile, ps^2, the jitter that they share included.
pub fn of_onset_ps2(onset: &Onset) -> Vec<f64> {
    onset.covariance.iter().map(|own_ps2| own_ps2 + onset.jitter_ps.powi(2)).collect()
}

/// The row of a patch by its position and covariance in m^2 (`None`: a start value), without onsets, chi-square and
/// likelihood.
pub fn patch_row(patch: PatchId, kind: &str, point: Point, cov_m2: Option<&Matrix3<f64>>) -> Patch {
    let entry = |i: usize, k: usize| cov_m2.map(|cov_m2| cov_m2[(i, k)]);
    Patch {
        patch,
        kind: kind.into(),
        x_m: point.x,
        y_m: point.y,
        z_m: point.z,
        cov_xx_m2: entry(0, 0),
        cov_xy_m2: entry(0, 1),
        cov_xz_m2: entry(0, 2),
        cov_yy_m2: entry(1, 1),
        cov_yz_m2: entry(1, 2),
        cov_zz_m2: entry(2, 2),
        sd_m: cov_m2.map(|cov_m2| cov_m2.trace().sqrt()),
        onsets: 0,
        chi2_dof: None,
        alternative: 0,
        log_likelihood: None,
        probability: None,
    }
}

/// The row of a possible hidden patch, of layer 1 and without number. `evidence` is its own and that needed; `seen` is
/// the share of profiles that show it.
pub fn hypothesis_row(
    hypothesis: i32,
    point: Point,
    cov_m2: &Matrix3<f64>,
    [evidence, evidence_needed]: [f64; 2],
    seen: f64,
) -> Hypothesis {
    Hypothesis {
        hypothesis,
        kind: "patch".into(),
        layer: 1,
        patch: None,
        alternative: 0,
        x_m: point.x,
        y_m: point.y,
        z_m: point.z,
        cov_xx_m2: cov_m2[(0, 0)],
        cov_xy_m2: cov_m2[(0, 1)],
        cov_xz_m2: cov_m2[(0, 2)],
        cov_yy_m2: cov_m2[(1, 1)],
        cov_yz_m2: cov_m2[(1, 2)],
        cov_zz_m2: cov_m2[(2, 2)],
        sd_m: cov_m2.trace().sqrt(),
        normal_x: None,
        normal_y: None,
        normal_z: None,
        evidence,
        evidence_needed,
        seen,
        onsets: 0.0,
        shots_needed: None,
        hours_needed: None,
    }
}

/// The row of a covariance [`between`] two patches of the best solution.
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
        alternative: 0,
    }
}

/// Covariances of the positions of patches with one another.
#[derive(Clone, Debug, Default)]
pub struct PatchCovariances(BTreeMap<(PatchId, PatchId), Matrix3<f64>>);

impl PatchCovariances {
    /// From the rows of `patch_covariances`, which has each pair of the best solution once.
    pub fn new(rows: &[PatchCovariance]) -> Self {
        let both = |row: &PatchCovariance| {
            let cov_m2 = between(row);
            [((row.a, row.b), cov_m2), ((row.b, row.a), cov_m2.transpose())]
        };
        Self(rows.iter().filter(|row| row.alternative == 0).flat_map(both).collect())
    }

    /// Covariance of patch `a` (rows) and patch `b` (columns), in m^2: zero for patches without a row.
    pub fn between(&self, a: PatchId, b: PatchId) -> Matrix3<f64> {
        self.0.get(&(a, b)).copied().unwrap_or_else(Matrix3::zeros)
    }
}
