//! Dense symmetric systems and eigenproblems: the calls into faer that the other kernels share, on one thread, since
//! the order of faer's sums depends on how many share them.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::evd::{self, ComputeEigenvectors};
use faer::linalg::matmul::matmul;
use faer::linalg::svd::{self, ComputeSvdVectors};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatRef, Par, Spec};

/// Eigenvalues in ascending order, with their vectors as columns.
///
/// # Panics
/// When the matrix is not square, or holds what is not finite.
#[must_use]
pub fn symmetric_eigen(matrix: &Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    let size = matrix.nrows();
    let (mut values, mut vectors) = (Diag::zeros(size), Mat::zeros(size, size));
    let params = Spec::default();
    let mut memory =
        MemBuffer::new(evd::self_adjoint_evd_scratch::<f64>(size, ComputeEigenvectors::Yes, Par::Seq, params));
    let stack = MemStack::new(&mut memory);
    evd::self_adjoint_evd(matrix.as_ref(), values.as_mut(), Some(vectors.as_mut()), Par::Seq, stack, params)
        .expect("the eigenproblem of a finite symmetric matrix converges");
    (values.column_vector().iter().copied().collect(), vectors)
}

/// Singular values in descending order, with the right singular vectors as columns.
///
/// # Panics
/// When the matrix is not square, or holds what is not finite.
#[must_use]
pub fn singular_values(matrix: &Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    let size = matrix.nrows();
    assert!(size == matrix.ncols(), "singular values of a square matrix");
    let (mut values, mut left, mut right) = (Diag::zeros(size), Mat::zeros(size, size), Mat::zeros(size, size));
    let (full, params) = (ComputeSvdVectors::Full, Spec::default());
    let mut memory = MemBuffer::new(svd::svd_scratch::<f64>(size, size, full, full, Par::Seq, params));
    let stack = MemStack::new(&mut memory);
    let (u, v) = (Some(left.as_mut()), Some(right.as_mut()));
    svd::svd(matrix.as_ref(), values.as_mut(), u, v, Par::Seq, stack, params)
        .expect("the singular value decomposition of a finite matrix converges");
    (values.column_vector().iter().copied().collect(), right)
}

/// Product of two matrices.
#[must_use]
pub fn product(left: MatRef<f64>, right: MatRef<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(left.nrows(), right.ncols());
    matmul(out.as_mut(), Accum::Replace, left, right, 1.0, Par::Seq);
    out
}

/// A positive definite matrix, factored: `L L'`.
pub struct Definite {
    lower: Mat<f64>,
}

impl Definite {
    /// Factors the lower triangle of a symmetric matrix; `None` if it is not positive definite.
    #[must_use]
    pub fn new(matrix: &Mat<f64>) -> Option<Self> {
        Self::of(matrix.clone())
    }

    /// The same in the room of the matrix itself.
    #[must_use]
    pub fn of(mut lower: Mat<f64>) -> Option<Self> {
        let params = Spec::default();
        let mut memory = MemBuffer::new(llt::factor::cholesky_in_place_scratch::<f64>(lower.nrows(), Par::Seq, params));
        let stack = MemStack::new(&mut memory);
        llt::factor::cholesky_in_place(
            lower.as_mut(),
            llt::factor::LltRegularization::default(),
            Par::Seq,
            stack,
            params,
        )
        .ok()?;
        Some(Self { lower })
    }

    /// Logarithm of the determinant.
    #[must_use]
    pub fn log_determinant(&self) -> f64 {
        (0..self.lower.nrows()).map(|k| 2.0 * self.lower[(k, k)].ln()).sum()
    }

    /// Solutions for several right-hand sides, as columns.
    pub fn solve(&self, right: &mut Mat<f64>) {
        let mut memory =
            MemBuffer::new(llt::solve::solve_in_place_scratch::<f64>(right.nrows(), right.ncols(), Par::Seq));
        llt::solve::solve_in_place(self.lower.as_ref(), right.as_mut(), Par::Seq, MemStack::new(&mut memory));
    }

    /// Takes columns of this covariance to columns of covariance 1: they are multiplied by the inverse of `L`.
    pub fn whiten(&self, columns: &mut Mat<f64>) {
        solve_lower_triangular_in_place(self.lower.as_ref(), columns.as_mut(), Par::Seq);
    }

    /// The inverse.
    #[must_use]
    pub fn inverse(&self) -> Mat<f64> {
        let size = self.lower.nrows();
        let mut inverse = Mat::zeros(size, size);
        let mut memory = MemBuffer::new(llt::inverse::inverse_scratch::<f64>(size, Par::Seq));
        llt::inverse::inverse(inverse.as_mut(), self.lower.as_ref(), Par::Seq, MemStack::new(&mut memory));
        // Only the lower triangle is computed.
        Mat::from_fn(size, size, |i, j| inverse[(i.max(j), i.min(j))])
    }
}

/// Solution of a positive definite system; `None` if it is not positive definite.
#[must_use]
pub fn solve(matrix: &Mat<f64>, right: &[f64]) -> Option<Vec<f64>> {
    solve_in_place(matrix.clone(), right)
}

/// The same in the room of the matrix itself.
#[must_use]
pub fn solve_in_place(matrix: Mat<f64>, right: &[f64]) -> Option<Vec<f64>> {
    let mut solution = Mat::from_fn(right.len(), 1, |i, _| right[i]);
    Definite::of(matrix)?.solve(&mut solution);
    Some(solution.col(0).iter().copied().collect())
}

/// Inverse of a positive definite matrix; `None` if it is not positive definite.
#[must_use]
pub fn inverse(matrix: &Mat<f64>) -> Option<Mat<f64>> {
    Some(Definite::new(matrix)?.inverse())
}

/// Pseudo-inverse of a semidefinite matrix whose null space is spanned by the orthonormal columns `nulls`; `None` if it
/// has further nulls.
///
/// With `N` the nulls, `F + s N N'` is definite and its inverse is `F+ + N N' / s`, for any scale `s`.
#[must_use]
pub fn pseudo_inverse(matrix: &Mat<f64>, nulls: &Mat<f64>) -> Option<Mat<f64>> {
    let size = matrix.nrows();
    let scale = (0..size).map(|i| matrix[(i, i)]).fold(0.0, f64::max);
    let projector = product(nulls.as_ref(), nulls.transpose());
    let full = Mat::from_fn(size, size, |i, j| matrix[(i, j)] + scale * projector[(i, j)]);
    let inverse = Definite::of(full)?.inverse();
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
