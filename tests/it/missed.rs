//! Errors of a solution, measured by the covariance that its tables claim.

use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen, Vector3};
use periscope::tables::{Patch, PatchCovariance};

/// Inverse on all but the `nulls` smallest eigenvalues.
pub fn pseudo_inverse(matrix: &DMatrix<f64>, nulls: usize) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(matrix.clone());
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let kept = &order[nulls..];
    kept.iter()
        .map(|&k| eigen.eigenvectors.column(k) * eigen.eigenvectors.column(k).transpose() / eigen.eigenvalues[k])
        .fold(DMatrix::zeros(matrix.nrows(), matrix.ncols()), |sum, term| sum + term)
}

/// Coordinates that path lengths determine: all but three turns; in flatland all in the plane but one turn.
pub fn degrees_of_freedom(truth: &[Patch]) -> usize {
    if truth.iter().all(|patch| patch.z_m == 0.0) { 2 * truth.len() - 1 } else { 3 * truth.len() - 3 }
}

/// What a solution missed the truth by, after the best rotation (or reflection) about the laser at the origin.
pub struct Missed {
    /// Sum of squared position errors.
    pub squares_m2: f64,
    /// Squared error in units of the covariance that the tables claim.
    pub normalised: f64,
}

/// Rotation or reflection about the origin that moves points closest to others, by the polar decomposition of their
/// correlation.
pub fn aligning(points: &[Vector3<f64>], targets: &[Vector3<f64>]) -> Matrix3<f64> {
    let correlation: Matrix3<f64> = points.iter().zip(targets).map(|(point, target)| target * point.transpose()).sum();
    let svd = correlation.svd(true, true);
    svd.u.expect("asked for") * svd.v_t.expect("asked for")
}

pub fn position(patch: &Patch) -> Vector3<f64> {
    Vector3::new(patch.x_m, patch.y_m, patch.z_m)
}

/// Mean squared position error of start values, which have no covariance.
pub fn squares_m2(patches: &[Patch], truth: &[Patch]) -> f64 {
    let (points, targets): (Vec<_>, Vec<_>) =
        (patches.iter().map(position).collect(), truth.iter().map(position).collect());
    let turn = aligning(&points, &targets);
    points.iter().zip(&targets).map(|(point, target)| (turn * point - target).norm_squared()).sum()
}

/// Errors of a refined solution.
pub fn missed(patches: &[Patch], covariances: &[PatchCovariance], truth: &[Patch]) -> Missed {
    assert_eq!(
        patches.iter().map(|patch| patch.patch).collect::<Vec<_>>(),
        truth.iter().map(|patch| patch.patch).collect::<Vec<_>>()
    );
    let (points, targets): (Vec<_>, Vec<_>) =
        (patches.iter().map(position).collect(), truth.iter().map(position).collect());
    let turn = aligning(&points, &targets);
    let errors: Vec<Vector3<f64>> =
        points.iter().zip(&targets).map(|(point, target)| point - turn.transpose() * target).collect();
    let covariance = covariance_m2(&patches.iter().collect::<Vec<_>>(), covariances);
    let error = DVector::from_iterator(3 * errors.len(), errors.iter().flat_map(|error| [error.x, error.y, error.z]));
    let unknown = 3 * patches.len() - degrees_of_freedom(truth);
    let normalised = (error.transpose() * pseudo_inverse(&covariance, unknown) * &error)[(0, 0)];
    Missed { squares_m2: errors.iter().map(Vector3::norm_squared).sum(), normalised }
}

/// Covariance of these patches together.
pub fn covariance_m2(patches: &[&Patch], covariances: &[PatchCovariance]) -> DMatrix<f64> {
    let mut covariance = DMatrix::zeros(3 * patches.len(), 3 * patches.len());
    let mut put = |a: usize, b: usize, block: Matrix3<f64>| {
        covariance.view_mut((3 * a, 3 * b), (3, 3)).copy_from(&block);
        covariance.view_mut((3 * b, 3 * a), (3, 3)).copy_from(&block.transpose());
    };
    for (n, row) in patches.iter().enumerate() {
        let [xx, xy, xz, yy, yz, zz] =
            [row.cov_xx_m2, row.cov_xy_m2, row.cov_xz_m2, row.cov_yy_m2, row.cov_yz_m2, row.cov_zz_m2]
                .map(|value| value.expect("refined"));
        put(n, n, Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    }
    let place = |number: i32| patches.iter().position(|patch| patch.patch == number);
    for row in covariances {
        let Some((a, b)) = place(row.a).zip(place(row.b)) else { continue };
        let block = [
            [row.cov_xx_m2, row.cov_xy_m2, row.cov_xz_m2],
            [row.cov_yx_m2, row.cov_yy_m2, row.cov_yz_m2],
            [row.cov_zx_m2, row.cov_zy_m2, row.cov_zz_m2],
        ];
        put(a, b, Matrix3::from_fn(|i, j| block[i][j]));
    }
    covariance
}
