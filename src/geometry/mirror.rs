//! A mirror that is seen only through a diffuser (paper Fig. 8, top: missing direct reflection).
//!
//! A beam leaves the source `L` along `u`, meets the mirror in `M` after `z`, and the diffuser in `D` after `y` more; a
//! sensor `S` sees `D`. Directions and diffuser points are known with errors, and arrivals tell `z + y + x`, `x = |D -
//! S|`. The mirror `n . p = h` unfolds the path: `D` is the mirror image of the point `Q = L + (z + y) u` that the beam
//! would have come to.
//!
//! ```text
//!            Q
//!           :          |D - L'| = z + y,  L' the mirror image of L: virtual source
//!    ------M------     |D - p| = |Q - p| for all p of the mirror
//!      u  / \
//!        /   \
//!       L     D ~~> S
//! ```
//!
//! | | what it takes from the scans |
//! |---|---|
//! | [`solve`] | all of it, by maximum likelihood: the mirror, beams, folded lengths, delays and stations with an error. One scan is enough; from the second on they check each other |
//! | [`virtual_source`] | lengths alone, a trilateration of `L'`; the mirror is the perpendicular bisector of `L` and `L'`. Beams choose between places that lengths leave open |
//! | [`per_ray`] | each scan alone: the conic with foci `L` and `D`, cut by the beam, in closed form |
//! | [`equal_distances`] | the paper's: the same conics, all cut at one distance `z1 = z2 = z3` |
//!
//! The paper does not print its equations. It says "We conducted 3 raster scans and assumed z1 = z2 = z3 = z". That is
//! read as one unknown `z` that makes the three conics `z + |D - (L + z u)| = z + y` agree best by least squares. Not
//! modelled: curved mirrors, several mirrors, the width of the beam.

mod closed_forms;
mod joint;
mod unknowns;

pub use closed_forms::{equal_distances, per_ray, virtual_source};
pub use joint::{Solution, Unsolved, solve};

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::maximum_likelihood::Station;
use super::{Matrix, Point};

/// Light of a scan at a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Station of the sensor, by its place.
    pub sensor: usize,
    /// Measured length of the whole path, source to sensor.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
    /// Delay that adds to it, by its place.
    pub delay: Option<usize>,
}

/// A beam that the mirror turns onto the diffuser.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Direction in which it leaves the source, of length 1.
    pub direction: Vector3<f64>,
    /// Standard deviation of each of its angles.
    pub direction_sd_rad: f64,
    /// Where it meets the diffuser.
    pub diffuser: Point,
    /// Covariance of that point; in flatland its z counts for nothing.
    pub diffuser_covariance_m2: Matrix3<f64>,
    /// Its light at the sensors, one at least.
    pub arrivals: Vec<Arrival>,
}

/// All scans of one mirror.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// 3, or 2 for flatland, where z stays.
    pub dimensions: usize,
    /// Where light leaves, first, and arrives.
    pub stations: Vec<Station>,
    /// Beams.
    pub scans: Vec<Scan>,
    /// Prior covariance of the delays, as lengths; their means are 0.
    pub delay_covariance_m2: Matrix,
    /// Ends the solution: polled once a step.
    pub cancel: Cancel,
}

impl Experiment {
    fn source(&self) -> Point {
        self.stations[0].position
    }

    /// Standard deviation of a coordinate of a scan's diffuser point, in the mean.
    fn diffuser_sd_m(&self, scan: &Scan) -> f64 {
        let variances_m2 = (0..self.dimensions).map(|k| scan.diffuser_covariance_m2[(k, k)]);
        (variances_m2.sum::<f64>() / self.dimensions as f64).sqrt()
    }

    /// Way of a scan from the source to the diffuser, `z + y`, with its standard deviation, as its arrivals and the
    /// diffuser's given position tell.
    fn folded_m(&self, scan: &Scan) -> (f64, f64) {
        let (mut sum, mut weights) = (0.0, 0.0);
        for arrival in &scan.arrivals {
            let weight = arrival.sd_m.powi(-2);
            sum += weight * (arrival.length_m - (scan.diffuser - self.stations[arrival.sensor].position).norm());
            weights += weight;
        }
        (sum / weights, weights.sqrt().recip().hypot(self.diffuser_sd_m(scan)))
    }
}

/// A plane mirror: all points p with `normal . p = offset_m`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    /// Unit normal, away from the source.
    pub normal: Vector3<f64>,
    /// Distance from the origin along it.
    pub offset_m: f64,
}

impl Mirror {
    /// The perpendicular bisector of a source and its image; `None` where they coincide.
    #[must_use]
    pub fn between(source: Point, image: Point) -> Option<Self> {
        let normal = (image - source).try_normalize(f64::MIN_POSITIVE)?;
        Some(Self { normal, offset_m: 0.5 * normal.dot(&(image.coords + source.coords)) })
    }

    /// Mirror image of a point.
    #[must_use]
    pub fn image(&self, point: Point) -> Point {
        point - self.normal * (2.0 * (self.normal.dot(&point.coords) - self.offset_m))
    }

    /// A direction after reflection.
    #[must_use]
    pub fn turned(&self, direction: Vector3<f64>) -> Vector3<f64> {
        direction - self.normal * (2.0 * self.normal.dot(&direction))
    }

    /// How far from a point a beam meets the mirror; `None` for a beam that leads away from it or along it.
    #[must_use]
    pub fn meets(&self, from: Point, direction: Vector3<f64>) -> Option<f64> {
        let distance_m = (self.offset_m - self.normal.dot(&from.coords)) / self.normal.dot(&direction);
        (distance_m.is_finite() && distance_m > 0.0).then_some(distance_m)
    }
}

#[cfg(test)]
mod tests;
