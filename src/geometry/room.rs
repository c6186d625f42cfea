//! Scenes for tests and studies, and what path lengths among their patches tell at best. Shares no code with the
//! estimators but the linear algebra.

use std::iter;

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

/// Fisher matrix of all coordinates, three a patch, from all first bounces and the second bounces over `pairs`. Their
/// sds are `sd_m` (first, second); a delay common to all is known to `delay_sd_m`.
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

/// Root of the mean squared error after alignment that no estimator goes below: from the pseudo-inverse without its
/// three rotations. Infinite if more than those are open.
#[must_use]
pub fn bound_m(points: &[Point], pairs: &[(usize, usize)], sd_m: [f64; 2], delay_sd_m: f64) -> f64 {
    bound_of_m(&fisher(points, pairs, sd_m, delay_sd_m), 3)
}

/// All pairs of patches.
#[must_use]
pub fn all_pairs(count: usize) -> Vec<(usize, usize)> {
    (0..count).flat_map(|i| (0..i).map(move |j| (j, i))).collect()
}

/// A path from a source over patches to a sensor: positions among stations and patches.
#[derive(Clone, Debug)]
pub struct Way {
    /// Station that light leaves.
    pub source: usize,
    /// Patches in the order light meets them.
    pub patches: Vec<usize>,
    /// Station where it arrives.
    pub sensor: usize,
}

impl Way {
    /// Stops of the path, and the patch that each is.
    fn stops(&self, points: &[Point], stations: &[Point]) -> Vec<(Point, Option<usize>)> {
        let inner = self.patches.iter().map(|&patch| (points[patch], Some(patch)));
        iter::once((stations[self.source], None)).chain(inner).chain([(stations[self.sensor], None)]).collect()
    }

    /// Length of the path.
    #[must_use]
    pub fn length_m(&self, points: &[Point], stations: &[Point]) -> f64 {
        self.stops(points, stations).windows(2).map(|ends| (ends[1].0 - ends[0].0).norm()).sum()
    }
}

/// What lengths tell of all coordinates, three a patch, and of a delay common to all: the blocks of their Fisher
/// matrix.
#[derive(Clone, Debug)]
pub struct Information {
    positions: Mat<f64>,
    coupling: Vec<f64>,
    delay: f64,
}

impl Information {
    /// Of the lengths of `ways` with sds `sds_m`, for a delay that is known to `delay_sd_m` beforehand (0: exactly).
    ///
    /// # Panics
    /// When there is not one sd a way.
    #[must_use]
    pub fn of_ways(points: &[Point], stations: &[Point], ways: &[Way], sds_m: &[f64], delay_sd_m: f64) -> Self {
        assert_eq!(ways.len(), sds_m.len(), "a length has an sd");
        let size = 3 * points.len();
        let (mut positions, mut coupling): (Mat<f64>, _) = (Mat::zeros(size, size), vec![0.0; size]);
        let mut delay = 1.0 / (delay_sd_m * delay_sd_m);
        for (way, sd_m) in ways.iter().zip(sds_m) {
            let weight = 1.0 / (sd_m * sd_m);
            // A patch that is met twice stands here twice.
            let mut slope: Vec<(usize, f64)> = Vec::new();
            for ends in way.stops(points, stations).windows(2) {
                let along = (ends[1].0 - ends[0].0).normalize();
                let mut pull = |patch: Option<usize>, sign: f64| {
                    slope.extend(patch.iter().flat_map(|patch| (0..3).map(move |k| (3 * patch + k, sign * along[k]))));
                };
                pull(ends[0].1, -1.0);
                pull(ends[1].1, 1.0);
            }
            for &(i, u) in &slope {
                coupling[i] += weight * u;
                slope.iter().for_each(|&(k, v)| positions[(i, k)] += weight * u * v);
            }
            delay += weight;
        }
        Self { positions, coupling, delay }
    }

    /// With directions from a station to all patches, each of two angles known to `sd_rad`.
    #[must_use]
    pub fn with_rays(mut self, points: &[Point], from: Point, sd_rad: f64) -> Self {
        for (patch, point) in points.iter().enumerate() {
            let (range_m, along) = ((point - from).norm(), (point - from).normalize());
            for (i, k) in (0..3).flat_map(|i| (0..3).map(move |k| (i, k))) {
                let across = f64::from(u8::from(i == k)) - along[i] * along[k];
                self.positions[(3 * patch + i, 3 * patch + k)] += across / (range_m * sd_rad).powi(2);
            }
        }
        self
    }

    /// Fisher matrix of all coordinates, what the delay takes taken off.
    #[must_use]
    pub fn of_positions(&self) -> Mat<f64> {
        let (size, coupling) = (self.coupling.len(), &self.coupling);
        Mat::from_fn(size, size, |i, k| self.positions[(i, k)] - coupling[i] * coupling[k] / self.delay)
    }

    /// Standard deviation of the delay that no estimator goes below, with `free` rotations of the whole that no length
    /// depends on.
    #[must_use]
    pub fn delay_sd_m(&self, free: usize) -> f64 {
        let (values, vectors) = dense::symmetric_eigen(&self.positions);
        let along = |k: usize| self.coupling.iter().enumerate().map(|(i, c)| c * vectors[(i, k)]).sum::<f64>();
        let taken: f64 = (free..values.len()).map(|k| along(k).powi(2) / values[k]).sum();
        1.0 / (self.delay - taken).sqrt()
    }
}

/// Root of the mean squared error, what `free` rotations of the whole bring apart, that no estimator goes below.
/// Infinite if more is open.
#[must_use]
pub fn bound_of_m(fisher: &Mat<f64>, free: usize) -> f64 {
    let (values, _) = dense::symmetric_eigen(fisher);
    if values[free] < 1e-9 * values[values.len() - 1] {
        return f64::INFINITY;
    }
    (values[free..].iter().map(|value| 1.0 / value).sum::<f64>() / (values.len() / 3) as f64).sqrt()
}
