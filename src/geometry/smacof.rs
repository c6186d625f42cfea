//! Weighted scaling by majorisation, SMACOF: the points whose distances come nearest to the measured ones. A start of
//! [`super::placement`], which tries classical scaling with and without it; no method of the stage `embed`.
//!
//! Minimises the stress `sum_ij w_ij (d_ij - |z_i - z_j|)^2` over pairs by Guttman's transform
//!
//! ```text
//! V z' = B(z) z        V = Laplacian of w_ij        B(z) = Laplacian of w_ij d_ij / |z_i - z_j|
//! ```
//!
//! which never raises it. Row and column of p0, which stays at the origin, are left out, so that V is definite and
//! factored once; a step is O(M^2). A weight of 0 stands for a distance that is not measured. Source: de Leeuw, in
//! Recent Developments in Statistics (1977), 133; de Leeuw and Heiser (1980) for the weights. Not modelled: that
//! distances share onsets (hence it stays above the bound), outliers. It finds the minimum nearest to its start,
//! linearly, and crawls where weights differ much.

use faer::Mat;
use nalgebra::Vector3;

use super::{Point, dense};

/// Settled when a step lowers the stress by no more than this share.
const SETTLED: f64 = 1e-9;
/// Most steps.
const STEPS: usize = 1000;

/// Points with the stress that is left.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaled {
    /// Patches 1..M; p0 is the origin.
    pub points: Vec<Point>,
    /// Weighted sum of squared misfits over pairs.
    pub stress: f64,
    /// Steps taken.
    pub steps: usize,
}

/// Moves the `start` of patches 1..M to a minimum of the stress; the matrices of distances and weights are over p0..pM.
/// In flatland z stays 0 where it starts so. `None` if the weights do not connect every patch with p0.
///
/// # Panics
/// When the matrices are not square over p0 and all patches.
#[must_use]
pub fn scale(start: &[Point], distances_m: &Mat<f64>, weights: &Mat<f64>) -> Option<Scaled> {
    let count = start.len() + 1;
    assert!(
        [distances_m, weights].iter().all(|matrix| matrix.nrows() == count && matrix.ncols() == count),
        "distances and weights are square matrices over p0 and {} patches",
        start.len()
    );
    let degree = |i: usize| (0..count).filter(|&j| j != i).map(|j| weights[(i, j)]).sum::<f64>();
    let laplacian =
        Mat::from_fn(count - 1, count - 1, |i, j| if i == j { degree(i + 1) } else { -weights[(i + 1, j + 1)] });
    let laplacian = dense::Definite::new(&laplacian)?;
    let mut points: Vec<Point> = std::iter::once(Point::origin()).chain(start.iter().copied()).collect();
    let mut stress = stress_of(&points, distances_m, weights);
    let mut steps = 0;
    while steps < STEPS {
        let pulls: Vec<Vector3<f64>> = (1..count).map(|i| pull(i, &points, distances_m, weights)).collect();
        let mut next = Mat::from_fn(count - 1, 3, |i, k| pulls[i][k]);
        laplacian.solve(&mut next);
        points[1..].iter_mut().enumerate().for_each(|(i, p)| *p = Point::new(next[(i, 0)], next[(i, 1)], next[(i, 2)]));
        let before = std::mem::replace(&mut stress, stress_of(&points, distances_m, weights));
        steps += 1;
        if before - stress <= SETTLED * before {
            break;
        }
    }
    Some(Scaled { points: points.split_off(1), stress, steps })
}

/// Row i of `B(z) z`. Points that coincide pull nowhere.
fn pull(i: usize, points: &[Point], distances_m: &Mat<f64>, weights: &Mat<f64>) -> Vector3<f64> {
    let towards = |j: usize| {
        let arm = points[i] - points[j];
        let length = arm.norm();
        if length > 0.0 { arm * (weights[(i, j)] * distances_m[(i, j)] / length) } else { Vector3::zeros() }
    };
    (0..points.len()).filter(|&j| j != i && weights[(i, j)] > 0.0).map(towards).sum()
}

fn stress_of(points: &[Point], distances_m: &Mat<f64>, weights: &Mat<f64>) -> f64 {
    let misfit = |i: usize, j: usize| weights[(i, j)] * (distances_m[(i, j)] - (points[i] - points[j]).norm()).powi(2);
    let pairs = (0..points.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    pairs.filter(|&(i, j)| weights[(i, j)] > 0.0).map(|(i, j)| misfit(i, j)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{classical, procrustes, room};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn distances(points: &[Point]) -> Mat<f64> {
        let all: Vec<Point> = std::iter::once(Point::origin()).chain(points.iter().copied()).collect();
        Mat::from_fn(all.len(), all.len(), |i, j| (all[i] - all[j]).norm())
    }

    #[test]
    fn exact_distances_give_the_points_back_though_half_of_them_are_missing() {
        let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(1));
        let exact = distances(&truth);
        let mut weights = Mat::from_fn(50, 50, |i, j| if i == j { 0.0 } else { 1.0 });
        for i in 1..50 {
            for j in 1..i {
                let weight = if rng.random_bool(0.5) { 0.0 } else { rng.random_range(0.5..2.0) };
                (weights[(i, j)], weights[(j, i)]) = (weight, weight);
            }
        }
        // What is missing counts for nothing, whatever it says.
        let measured = Mat::from_fn(50, 50, |i, j| if weights[(i, j)] > 0.0 { exact[(i, j)] } else { 7.0 });
        let shake = |p: &Point| p + Vector3::from_fn(|_, _| rng.random_range(-0.1..0.1));
        let start: Vec<Point> = truth.iter().map(shake).collect();
        let scaled = scale(&start, &measured, &weights).unwrap();
        let fit = procrustes::rotation(&scaled.points, &truth, Point::origin(), true);
        assert!(fit.rms_m < 1e-3, "{} after {} steps", fit.rms_m, scaled.steps);
        let lost = Mat::from_fn(50, 50, |i, j| if i == 7 || j == 7 { 0.0 } else { weights[(i, j)] });
        assert_eq!(scale(&start, &measured, &lost), None);
    }

    #[test]
    fn the_end_lies_below_the_start_and_is_stationary() {
        let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(2));
        let exact = distances(&truth);
        let mut noisy = exact.clone();
        for i in 0..50 {
            for j in 0..i {
                let length_m: f64 = exact[(i, j)] + rng.random_range(-0.1..0.1);
                (noisy[(i, j)], noisy[(j, i)]) = (length_m, length_m);
            }
        }
        let weights = Mat::from_fn(50, 50, |i, j| 1.0 + ((i * j) % 3) as f64);
        let start = classical::embed(&noisy, 3);
        let with_p0 = |points: &[Point]| -> Vec<Point> {
            std::iter::once(Point::origin()).chain(points.iter().copied()).collect()
        };
        let scaled = scale(&start, &noisy, &weights).unwrap();
        assert!(scaled.stress < stress_of(&with_p0(&start), &noisy, &weights));
        for (patch, axis) in [(0, 0), (20, 1), (48, 2)] {
            let moved = |by: f64| {
                let mut points = with_p0(&scaled.points);
                points[patch + 1][axis] += by;
                stress_of(&points, &noisy, &weights)
            };
            let (slope, curvature) =
                ((moved(1e-4) - moved(-1e-4)) / 2e-4, (moved(1e-4) + moved(-1e-4) - 2.0 * moved(0.0)) / 1e-8);
            assert!((slope / curvature).abs() < 1e-4, "{slope} {curvature}");
        }
    }

    #[test]
    fn flatland_stays_flat() {
        let truth: Vec<Point> = room::rectangles().iter().map(|p| Point::new(p.x + 0.3 * p.z, p.y, 0.0)).collect();
        let start: Vec<Point> = truth.iter().map(|p| Point::new(1.1 * p.x, 0.9 * p.y, 0.0)).collect();
        let weights = Mat::from_fn(50, 50, |_, _| 1.0);
        let scaled = scale(&start, &distances(&truth), &weights).unwrap();
        assert!(scaled.points.iter().all(|p| p.z == 0.0));
        assert!(procrustes::rotation(&scaled.points, &truth, Point::origin(), true).rms_m < 1e-3);
    }
}
