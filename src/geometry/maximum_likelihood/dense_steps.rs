//! Steps and covariances with the normal matrix in memory: for up to some thousand unknowns.

use faer::Mat;

use super::problem::Node;
use super::rows::{Rows, Values};
use crate::dense;

/// A coordinate whose variance is this many times what it would be with all others held is not determined.
const UNDETERMINED: f64 = 1e9;
/// Of a normal matrix scaled to ones on its diagonal, eigenvalues below this belong to directions that nothing
/// determines.
const NULL: f64 = 1e-9;
/// Unknowns beyond which directions that nothing determines are not searched for: all eigenvectors come out of a single
/// call, which a cancel cannot end midway.
const SEARCHED_MAX: usize = 1500;

/// Normal matrix and its right-hand side.
fn normal_equations(rows: &Rows, values: &Values) -> (Mat<f64>, Vec<f64>) {
    sums(rows, values, |_| true)
}

/// The same of some terms.
fn sums(rows: &Rows, values: &Values, counts: impl Fn(usize) -> bool) -> (Mat<f64>, Vec<f64>) {
    let size = rows.layout.size;
    let (mut normal, mut right) = (Mat::zeros(size, size), vec![0.0; size]);
    let mut terms = Vec::new();
    for n in (0..rows.count).filter(|n| counts(*n)) {
        let residual = rows.residual(values, n, Some(&mut terms));
        let weight = rows.loss(n, residual).1;
        for &(i, a) in &terms {
            right[i] += weight * a * residual;
            for &(j, b) in &terms {
                normal[(i, j)] += weight * a * b;
            }
        }
    }
    (normal, right)
}

/// A damped Gauss-Newton step; `None` if the matrix is not definite.
pub fn step(rows: &Rows, values: &Values, damping: f64) -> Option<Vec<f64>> {
    let (mut normal, right) = normal_equations(rows, values);
    let scale = (0..normal.nrows()).map(|i| normal[(i, i)]).fold(0.0, f64::max);
    // The floor keeps rotations, which have no stiffness of their own, from blowing up.
    let floor = 1e-9 * damping.max(1e-3) * scale;
    (0..normal.nrows()).for_each(|i| normal[(i, i)] += damping * normal[(i, i)] + floor);
    dense::solve_in_place(normal, &right)
}

/// Pseudo-inverse of the normal matrix of all paths that avoid the patches `open`, without `nulls` (orthonormal columns
/// that avoid them too). Open patches have no covariance here.
///
/// # Errors
/// When more is undetermined than `nulls`: how much, and orthonormal columns that span it together with them. `None`
/// where there are too many unknowns to search.
pub fn covariance(
    rows: &Rows,
    values: &Values,
    nulls: &Mat<f64>,
    open: &[usize],
) -> Result<Mat<f64>, Option<(usize, Mat<f64>)>> {
    let is_open = |node: &Node| matches!(node, Node::Patch(patch) if open.contains(patch));
    let meets = |n: usize| rows.problem.observations[n].nodes.iter().any(is_open);
    let avoids = |n: usize| {
        let mut avoids = true;
        if n < rows.problem.observations.len() {
            rows.for_parts(n, |part, _| avoids &= !meets(part));
        }
        avoids
    };
    let (mut normal, _) = sums(rows, values, avoids);
    let size = normal.nrows();
    let stiff = (0..size).map(|i| normal[(i, i)]).fold(0.0, f64::max);
    open.iter().flat_map(|&patch| rows.layout.patch(patch)).for_each(|i| normal[(i, i)] += stiff);
    let is_determined = |covariance: &Mat<f64>| {
        (0..size).all(|i| {
            let inflation = covariance[(i, i)] * normal[(i, i)];
            inflation.is_finite() && inflation < UNDETERMINED
        })
    };
    if let Some(covariance) = dense::pseudo_inverse(&normal, nulls).filter(is_determined) {
        return Ok(covariance);
    }
    if size > SEARCHED_MAX {
        return Err(None);
    }
    let scale: Vec<f64> =
        (0..size).map(|i| if normal[(i, i)] > 0.0 { normal[(i, i)].powf(-0.5) } else { 1.0 }).collect();
    let (values, vectors) =
        dense::symmetric_eigen(&Mat::from_fn(size, size, |i, j| scale[i] * normal[(i, j)] * scale[j]));
    let count = values.iter().take_while(|value| **value < NULL).count();
    let spanned = Mat::from_fn(size, count, |i, k| scale[i] * vectors[(i, k)]);
    Err(Some((count.saturating_sub(nulls.ncols()), spanned)))
}
