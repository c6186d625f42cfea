//! Errors of a set-up that all points of a scan have in common: of the wall's grid, of its relief, of delays.
//!
//! No fit takes such errors from a scan: a surface elsewhere has the same lengths. So they are added to covariances.
//! Where the grid is another or light walks, points are found anew: windows that reach far take up a part of such an
//! error as curvature. A point explains a length and its slopes over the wall; a delay and a relief move it by what
//! brings these back to what was measured, to first order.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::way::Way;
use super::{Lit, Place, Scan, SurfacePoint};
use crate::Point;
use crate::axes::across;
use crate::neighbours::neighbours;

/// Places that show how pairs move together.
const NEIGHBOURS: usize = 13;
/// Step of a difference, over what is moved.
const STEP: f64 = 1e-5;

/// Standard deviations of errors of a set-up; 0 where there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Systematic {
    /// Of the places along the wall, over their distance from its middle: both scales, shear and turn, each.
    pub grid: f64,
    /// Of the wall's height over its places, and the length over which it changes.
    pub relief_m: Option<[f64; 2]>,
    /// Delay of all light, as the length of a way.
    pub delay_m: f64,
    /// Delay, as the length of a way, for each factor of e by which light is stronger than in the mean of the scan.
    pub walk_m: f64,
}

/// What a wall's places have in common.
struct Frame {
    middle: Point,
    inwards: Vector3<f64>,
    along: [Vector3<f64>; 2],
}

impl Systematic {
    /// Adds these errors to points of a scan. `heights` are those of first light at its places, on any scale.
    /// `points_of` finds the points of a scan whose first light comes later by so much at each place.
    ///
    /// # Panics
    /// If heights are not as many as places.
    pub fn add(
        &self,
        scan: &Scan,
        heights: &[f64],
        points: &mut [SurfacePoint],
        points_of: impl Fn(&Scan, &[f64]) -> Vec<SurfacePoint>,
        cancel: &Cancel,
    ) {
        assert_eq!(heights.len(), scan.places.len(), "each place has a height");
        if *self == Self::default() || points.is_empty() {
            return;
        }
        let frame = Frame::of(scan);
        let before = points.to_vec();
        if self.grid > 0.0 {
            let on_time = vec![0.0; heights.len()];
            for [row, column] in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                let stretch = frame.along[row] * frame.along[column].transpose() * self.grid;
                add_difference(points, &before, points_of(&frame.stretched(scan, &stretch), &on_time));
                // For what is fitted to lengths, it is these that are off.
                for point in points.iter_mut() {
                    let at = scan.places[point.place].seen;
                    let off_m = (at - point.point).normalize().dot(&(stretch * (at - frame.middle)));
                    point.light.law_m = point.light.law_m.hypot(off_m);
                }
            }
        }
        if self.walk_m > 0.0 {
            let logs: Vec<f64> = heights.iter().map(|height| height.max(f64::MIN_POSITIVE).ln()).collect();
            let mean = logs.iter().sum::<f64>() / logs.len() as f64;
            let later_m: Vec<f64> = logs.iter().map(|log| self.walk_m * (log - mean)).collect();
            let mut moved = scan.clone();
            for (place, later_m) in moved.places.iter_mut().zip(&later_m) {
                place.returns.iter_mut().for_each(|one| one.length_m += later_m);
            }
            add_difference(points, &before, points_of(&moved, &later_m));
        }
        if self.delay_m > 0.0 || self.relief_m.is_some() {
            let seen: Vec<Point> = scan.places.iter().map(|place| place.seen).collect();
            let ways = Way::all(scan, &neighbours(&seen, NEIGHBOURS, cancel));
            points.par_iter_mut().for_each(|point| {
                if let Some(way) = &ways[point.place] {
                    self.add_to(point, &frame, (&seen[point.place], way), scan.share());
                }
            });
        }
    }

    /// Adds delay and relief.
    fn add_to(&self, point: &mut SurfacePoint, frame: &Frame, (at, way): (&Point, &Way), share: f64) {
        let of_point = |x: &Point| frame.length_over(at, way, x, [0.0; 4]);
        let step_m = STEP * (at - point.point).norm();
        let steps = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| axis * step_m);
        let x = point.point;
        let slopes = steps.map(|step| (of_point(&(x + step)) - of_point(&(x - step))) / (2.0 * step_m));
        let Some(back) = Matrix3::from_columns(&slopes).try_inverse() else { return };
        let normal = |x: &Point| way.normal(at, x, &(at - x).normalize());
        let turns = steps.map(|step| (normal(&(x + step)) - normal(&(x - step))) / (2.0 * step_m));
        let turns = Matrix3::from_columns(&turns);
        let mut add = |told: Vector3<f64>| {
            let off = -back * told;
            let turn = turns * off;
            point.covariance_m2 += off * off.transpose();
            point.normal_covariance += turn * turn.transpose();
        };
        let delay_m = share * self.delay_m;
        add(Vector3::x() * delay_m);
        point.light.common_m = point.light.common_m.hypot(delay_m);
        let [sd_m, length_m] = self.relief_m.unwrap_or([0.0, 1.0]);
        for (k, sd) in [sd_m, sd_m / length_m, sd_m / length_m, sd_m].into_iter().enumerate() {
            let told = |share: f64| {
                let mut relief = [0.0; 4];
                relief[k] = share * sd;
                frame.length_over(at, way, &x, relief)
            };
            let told = (told(STEP) - told(-STEP)) / (2.0 * STEP);
            add(told);
            point.light.law_m = point.light.law_m.hypot(told.x);
        }
    }
}

/// Adds by what points differ from others of the same places. Those without another are as sure as the rest is in the
/// mean.
fn add_difference(points: &mut [SurfacePoint], before: &[SurfacePoint], others: Vec<SurfacePoint>) {
    let others: BTreeMap<usize, SurfacePoint> = others.into_iter().map(|other| (other.place, other)).collect();
    let of_point = |point: &SurfacePoint| {
        let other = others.get(&point.place)?;
        Some((other.point - point.point, other.normal - point.normal, other.light.length_m - point.light.length_m))
    };
    let off: Vec<Option<(Vector3<f64>, Vector3<f64>, f64)>> = before.iter().map(of_point).collect();
    let known: Vec<(Matrix3<f64>, Matrix3<f64>, f64)> = off
        .iter()
        .flatten()
        .map(|(off, turn, later_m)| (off * off.transpose(), turn * turn.transpose(), later_m * later_m))
        .collect();
    let count = known.len().max(1) as f64;
    let mean = known.iter().fold((Matrix3::zeros(), Matrix3::zeros(), 0.0), |sum, one| {
        (sum.0 + one.0 / count, sum.1 + one.1 / count, sum.2 + one.2 / count)
    });
    let mut known = known.into_iter();
    for (point, off) in points.iter_mut().zip(off) {
        let (square_m2, turn, later_m2) = off.and_then(|_| known.next()).unwrap_or(mean);
        point.covariance_m2 += square_m2;
        point.normal_covariance += turn;
        point.light.law_m = (point.light.law_m.powi(2) + later_m2).sqrt();
    }
}

impl Frame {
    fn of(scan: &Scan) -> Self {
        let sum: Vector3<f64> = scan.places.iter().map(|place| place.seen.coords).sum();
        let middle = Point::from(sum / scan.places.len() as f64);
        Self { middle, inwards: scan.inwards, along: across(&scan.inwards) }
    }

    /// A scan whose places lie elsewhere by a share of their distance from the middle.
    fn stretched(&self, scan: &Scan, stretch: &Matrix3<f64>) -> Scan {
        let moved = |place: &Point| place + stretch * (place - self.middle);
        let lit = match &scan.lit {
            Lit::Same => Lit::Same,
            Lit::One(lit) => Lit::One(moved(lit)),
            Lit::Apart(halves) => Lit::Apart(halves.iter().map(|half| half + stretch * half).collect()),
        };
        let places = scan.places.iter().map(|place| Place { seen: moved(&place.seen), ..*place }).collect();
        Scan { lit, places, ..*scan }
    }

    /// What a point explains where the wall has a relief, its slopes along both axes, and a relief at the lit point:
    /// length, and its slopes along both axes.
    fn length_over(
        &self,
        at: &Point,
        way: &Way,
        x: &Point,
        [relief_m, slopes @ .., lit_relief_m]: [f64; 4],
    ) -> Vector3<f64> {
        let way = match way {
            Way::From(lit) => Way::From(lit + self.inwards * lit_relief_m),
            other => *other,
        };
        let (length_m, gradient) = way.length_over(&(at + self.inwards * relief_m), x);
        let slope = |k: usize| (self.along[k] + self.inwards * slopes[k]).dot(&gradient);
        Vector3::new(length_m, slope(0), slope(1))
    }
}

#[cfg(test)]
mod tests;
