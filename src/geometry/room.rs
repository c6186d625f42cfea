//! Scenes for tests and studies, and what path lengths among their patches tell at best. Shares no code with the estimators but the linear algebra.

use faer::Mat;
use nalgebra::Vector3;

use super::{Point, dense};

/// 49 patches on three rectangles (25 + 16 + 8), as in the paper's Fig. 4; dimensions chosen here.
#[must_use]
pub fn rectangles() -> Vec<Point> {
    let grid = |n: usize, m: usize, f: &dyn Fn(f64, f64) -> Point| -> Vec<Point> {
        (0..n)
            .flat_map(|i| (0..m).map(move |j| (i, j)))
            .map(|(i, j)| f(i as f64 / (n - 1) as f64, j as f64 / (m - 1) as f64))
            .collect()
    };
    let mut points = grid(5, 5, &|u, v| Point::new(-1.2 + 2.0 * u, 2.6, -0.8 + 1.6 * v));
    points.extend(grid(4, 4, &|u, v| Point::new(1.1, 1.0 + 1.4 * u, -0.8 + 1.6 * v)));
    points.extend(grid(4, 2, &|u, v| Point::new(-1.0 + 1.8 * u, 1.6 + 0.7 * v, -0.9)));
    points
}

/// Length of the first bounce of a patch, source and camera at the origin.
#[must_use]
pub fn first_m(points: &[Point], patch: usize) -> f64 {
    2.0 * points[patch].coords.norm()
}

/// Length of the second bounce over a pair of patches.
#[must_use]
pub fn second_m(points: &[Point], a: usize, b: usize) -> f64 {
    points[a].coords.norm() + (points[a] - points[b]).norm() + points[b].coords.norm()
}

/// Fisher matrix of all coordinates, three a patch, of all first bounces and the second bounces over `pairs`, with sds `sd_m` (first, second), for a
/// delay common to all that is known to `delay_sd_m`.
#[must_use]
pub fn fisher(points: &[Point], pairs: &[(usize, usize)], sd_m: [f64; 2], delay_sd_m: f64) -> Mat<f64> {
    let size = 3 * points.len();
    let weights = sd_m.map(|sd_m| 1.0 / (sd_m * sd_m));
    let (mut fisher, mut coupling): (Mat<f64>, _) = (Mat::zeros(size, size), vec![0.0; size]);
    let out = |patch: usize| points[patch].coords.normalize();
    let mut add = |weight: f64, terms: &[(usize, Vector3<f64>)]| {
        for (a, u) in terms {
            (0..3).for_each(|i| coupling[3 * a + i] += weight * u[i]);
            for (b, v) in terms {
                for (i, k) in (0..3).flat_map(|i| (0..3).map(move |k| (i, k))) {
                    fisher[(3 * a + i, 3 * b + k)] += weight * u[i] * v[k];
                }
            }
        }
    };
    (0..points.len()).for_each(|patch| add(weights[0], &[(patch, 2.0 * out(patch))]));
    for &(a, b) in pairs {
        let across = (points[a] - points[b]).normalize();
        add(weights[1], &[(a, out(a) + across), (b, out(b) - across)]);
    }
    // A known delay has infinite stiffness.
    let stiffness =
        weights[0] * points.len() as f64 + weights[1] * pairs.len() as f64 + 1.0 / (delay_sd_m * delay_sd_m);
    Mat::from_fn(size, size, |i, j| fisher[(i, j)] - coupling[i] * coupling[j] / stiffness)
}

/// Root of the mean squared error after alignment that no estimator goes below: from the pseudo-inverse without its three rotations. Infinite if more
/// than those are open.
#[must_use]
pub fn bound_m(points: &[Point], pairs: &[(usize, usize)], sd_m: [f64; 2], delay_sd_m: f64) -> f64 {
    let (values, _) = dense::symmetric_eigen(&fisher(points, pairs, sd_m, delay_sd_m));
    if values[3] < 1e-9 * values[values.len() - 1] {
        return f64::INFINITY;
    }
    (values[3..].iter().map(|value| 1.0 / value).sum::<f64>() / points.len() as f64).sqrt()
}

/// All pairs of patches.
#[must_use]
pub fn all_pairs(count: usize) -> Vec<(usize, usize)> {
    (0..count).flat_map(|i| (0..i).map(move |j| (j, i))).collect()
}
