//! Double-centred classical scaling, p0 included: a start for a fit.
//!
//! `B = -J D^2 J / 2` with `J = I - 1 1' / (M + 1)`; coordinates are the eigenvectors of the largest (algebraic)
//! eigenvalues, scaled by their roots. Source: Torgerson, Psychometrika 17, 401 (1952). About 1.35 times more exact
//! than centring on p0 alone, since no single noisy point carries all.

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
    let count = distances_m.nrows();
    let square = |i: usize, j: usize| distances_m[(i, j)] * distances_m[(i, j)];
    let row_mean: Vec<f64> = (0..count).map(|i| (0..count).map(|j| square(i, j)).sum::<f64>() / count as f64).collect();
    let mean = row_mean.iter().sum::<f64>() / count as f64;
    let gram = Mat::from_fn(count, count, |i, j| -0.5 * (square(i, j) - row_mean[i] - row_mean[j] + mean));
    let (values, vectors) = dense::symmetric_eigen(&gram);
    let coordinate = |i: usize, k: usize| {
        if k >= dimensions || k >= count {
            return 0.0;
        }
        let column = count - 1 - k;
        values[column].max(0.0).sqrt() * (vectors[(i, column)] - vectors[(0, column)])
    };
    (1..count).map(|i| Point::new(coordinate(i, 0), coordinate(i, 1), coordinate(i, 2))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procrustes;

    #[test]
    fn exact_distances_give_the_points_back_in_space_and_flatland() {
        for dimensions in [2, 3] {
            let flat = |z: f64| if dimensions == 3 { z } else { 0.0 };
            let truth = [
                Point::new(1.0, 0.2, flat(0.4)),
                Point::new(-0.5, 1.5, flat(0.3)),
                Point::new(0.1, 0.7, flat(2.0)),
                Point::new(1.2, 1.1, flat(-0.6)),
            ];
            let all: Vec<Point> = std::iter::once(Point::origin()).chain(truth).collect();
            let distances = Mat::from_fn(5, 5, |i, j| (all[i] - all[j]).norm());
            let solution = embed(&distances, dimensions);
            let fit = procrustes::rotation(&solution, &truth, Point::origin(), true);
            assert!(fit.rms_m < 1e-9, "{}", fit.rms_m);
        }
    }
}
