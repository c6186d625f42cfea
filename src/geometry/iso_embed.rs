//! The paper's Algorithm 1, IsoEmbed (section 4.2), as it stands: to be compared with, not to be used.
//!
//! `h_ij = (d_0i^2 + d_0j^2 - d_ij^2) / 2`, singular value decomposition `H = U S V'`, `Z = S_3^(1/2) V_3'`.
//!
//! Two weaknesses are part of it. Every entry hangs on the one noisy point p0 (double centring, [`super::classical`],
//! does not). And singular values have no sign: a large negative eigenvalue, which noise makes, is taken for a
//! direction of space.

use faer::Mat;

use super::{Point, dense};

/// Points of patches 1..M, p0 at the origin, from the full symmetric matrix of distances over p0..pM; the frame is
/// arbitrary.
///
/// # Panics
/// When the matrix is not square or `dimensions` is neither 2 nor 3.
#[must_use]
pub fn embed(distances_m: &Mat<f64>, dimensions: usize) -> Vec<Point> {
    assert!(distances_m.nrows() == distances_m.ncols(), "distances are a square matrix");
    assert!(dimensions == 2 || dimensions == 3, "space has 2 or 3 dimensions");
    let count = distances_m.nrows() - 1;
    let square = |i: usize, j: usize| distances_m[(i, j)] * distances_m[(i, j)];
    let gram = Mat::from_fn(count, count, |i, j| 0.5 * (square(0, i + 1) + square(0, j + 1) - square(i + 1, j + 1)));
    let (values, vectors) = dense::singular_values(&gram);
    let coordinate = |i: usize, k: usize| {
        if k < dimensions.min(count) { values[k].sqrt() * vectors[(i, k)] } else { 0.0 }
    };
    (0..count).map(|i| Point::new(coordinate(i, 0), coordinate(i, 1), coordinate(i, 2))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procrustes;

    #[test]
    fn exact_distances_give_the_points_back() {
        let truth = [
            Point::new(1.0, 0.2, 0.4),
            Point::new(-0.5, 1.5, 0.3),
            Point::new(0.1, 0.7, 2.0),
            Point::new(1.2, 1.1, -0.6),
            Point::new(0.3, -1.0, 0.8),
        ];
        let all: Vec<Point> = std::iter::once(Point::origin()).chain(truth).collect();
        let distances = Mat::from_fn(6, 6, |i, j| (all[i] - all[j]).norm());
        let solution = embed(&distances, 3);
        let fit = procrustes::rotation(&solution, &truth, Point::origin(), true);
        assert!(fit.rms_m < 1e-9, "{}", fit.rms_m);
    }
}
