//! Dense symmetric systems and eigenproblems: the calls into faer that the other kernels share.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};

/// Eigenvalues in ascending order, with their vectors as columns.
///
/// # Panics
/// When the matrix is not square, or holds what is not finite.
#[must_use]
pub fn symmetric_eigen(matrix: &Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    let eigen =
        matrix.self_adjoint_eigen(Side::Lower).expect("the eigenproblem of a finite symmetric matrix converges");
    (eigen.S().column_vector().iter().copied().collect(), eigen.U().to_owned())
}

/// Singular values in descending order, with the right singular vectors as columns.
///
/// # Panics
/// When the matrix holds what is not finite.
#[must_use]
pub fn singular_values(matrix: &Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    let svd = matrix.svd().expect("the singular value decomposition of a finite matrix converges");
    (svd.S().column_vector().iter().copied().collect(), svd.V().to_owned())
}

/// Solution of a positive definite system; `None` if it is not positive definite.
#[must_use]
pub fn solve(matrix: &Mat<f64>, right: &[f64]) -> Option<Vec<f64>> {
    let factor = matrix.llt(Side::Lower).ok()?;
    let right = Mat::from_fn(right.len(), 1, |i, _| right[i]);
    let solution = factor.solve(&right);
    Some((0..solution.nrows()).map(|i| solution[(i, 0)]).collect())
}

/// Inverse of a positive definite matrix; `None` if it is not positive definite.
#[must_use]
pub fn inverse(matrix: &Mat<f64>) -> Option<Mat<f64>> {
    Some(matrix.llt(Side::Lower).ok()?.inverse())
}

/// Pseudo-inverse of a semidefinite matrix whose null space is spanned by the orthonormal columns `nulls`; `None` if it has further nulls.
///
/// With `N` the nulls, `F + s N N'` is definite and its inverse is `F+ + N N' / s`, for any scale `s`.
#[must_use]
pub fn pseudo_inverse(matrix: &Mat<f64>, nulls: &Mat<f64>) -> Option<Mat<f64>> {
    let size = matrix.nrows();
    let scale = (0..size).map(|i| matrix[(i, i)]).fold(0.0, f64::max);
    let projector = nulls * nulls.transpose();
    let full = Mat::from_fn(size, size, |i, j| matrix[(i, j)] + scale * projector[(i, j)]);
    let inverse = inverse(&full)?;
    Some(Mat::from_fn(size, size, |i, j| inverse[(i, j)] - projector[(i, j)] / scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pseudo_inverse_of_a_matrix_with_a_known_null_is_its_own() {
        // Laplacian of a path of three nodes; the constant vector is its null.
        let laplacian = [[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]];
        let matrix = Mat::from_fn(3, 3, |i, j| laplacian[i][j]);
        let nulls = Mat::from_fn(3, 1, |_, _| 1.0 / 3_f64.sqrt());
        let pinv = pseudo_inverse(&matrix, &nulls).unwrap();
        let back = &matrix * &pinv * &matrix;
        for i in 0..3 {
            for j in 0..3 {
                assert!((back[(i, j)] - matrix[(i, j)]).abs() < 1e-12);
            }
        }
        assert!(inverse(&matrix).is_none() || inverse(&matrix).unwrap()[(0, 0)].abs() > 1e9);
        let two = Mat::from_fn(2, 2, |i, j| [[4.0, 1.0], [1.0, 3.0]][i][j]);
        let solution = solve(&two, &[1.0, 2.0]).unwrap();
        assert!((solution[0] - 1.0 / 11.0).abs() < 1e-12 && (solution[1] - 7.0 / 11.0).abs() < 1e-12);
    }
}
