//! A local field of lengths about a place of the wall.

use std::sync::Arc;

use nalgebra::{Matrix2, Vector3};

use super::local::{Fitted, Local, Sample, Unknowns};
use super::way::Way;
use crate::Point;
use crate::axes::across;

/// Standard deviation of a curvature before there is light, over one over the length.
const BEND_SD: f64 = 7.0;
/// A surface faces the wall where its curvature is below that of an edge by so many standard deviations. An edge needs
/// a curvature known to this share: a sphere of a fifth of its distance has five sixths of the curvature of a point.
const APART: f64 = 2.5;
const SURE: f64 = 0.07;
/// Of the radius of a window, how far a point lies from the edge that it is on, where a field shows none.
const BETWEEN: f64 = 0.5;
/// Share by which the curvature of lengths to a concave surface changes over a window.
const CHANGE: f64 = 0.3;

/// What part of a surface a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A surface that faces the wall's point.
    Smooth,
    /// An edge.
    Edge,
    /// A corner, or a thing that is small in all directions.
    Corner,
    /// Curvatures are not known well enough.
    Unknown,
}

/// Lengths about a place: `(1 + round (L - length))^2 = 1 + 2 round n.u + (round n.u)^2 + round u.K u` at `u` from it,
/// exact for a plane, a straight edge and a corner, and with the right `round` for a sphere and a cylinder.
#[derive(Clone, Debug)]
pub struct Field {
    /// The place about which it is.
    pub at: Point,
    /// Length there.
    pub length_m: f64,
    /// Direction in which lengths grow.
    pub direction: Vector3<f64>,
    /// Two directions across it.
    across: [Vector3<f64>; 2],
    /// Curvature of the lengths along these.
    bend: Matrix2<f64>,
    round: f64,
    /// The place from which it is read.
    seen: Point,
    fitted: Arc<Fitted>,
}

impl Field {
    /// Before there are neighbours.
    pub fn new(sample: &Sample, direction: Vector3<f64>) -> Self {
        Self {
            at: sample.at,
            seen: sample.at,
            length_m: sample.length_m,
            direction,
            across: across(&direction),
            bend: Matrix2::zeros(),
            round: 0.0,
            fitted: Fitted::none(),
        }
    }

    /// A place along the direction and across it.
    fn towards(&self, place: &Point) -> [f64; 3] {
        let from = place - self.at;
        [self.direction.dot(&from), self.across[0].dot(&from), self.across[1].dot(&from)]
    }

    /// Half of what the square of the length grows by, and the root of that square, where lengths count from
    /// `1 / round`.
    fn growth(&self, [along, x, y]: [f64; 3]) -> (f64, f64) {
        let [xx, xy, yy] = [self.bend[(0, 0)], self.bend[(0, 1)], self.bend[(1, 1)]];
        let bent = xx * x * x + 2.0 * xy * x * y + yy * y * y;
        let q = along + 0.5 * self.round * along * along + 0.5 * bent;
        (q, (1.0 + 2.0 * self.round * q).max(0.01).sqrt())
    }

    fn turn(&mut self, first: f64, second: f64) {
        self.direction = (self.direction + self.across[0] * first + self.across[1] * second).normalize();
        let across = (self.across[0] - self.direction * self.direction.dot(&self.across[0])).normalize();
        self.across = [across, self.direction.cross(&across)];
    }

    /// The same, read from another place.
    pub fn seen_from(&self, seen: Point) -> Self {
        Self { seen, ..self.clone() }
    }

    /// Length at the place from which it is read, and the direction in which lengths grow there.
    fn here(&self) -> (f64, Vector3<f64>) {
        if self.seen == self.at {
            return (self.length_m, self.direction);
        }
        let [along, x, y] = self.towards(&self.seen);
        let [xx, xy, yy] = [self.bend[(0, 0)], self.bend[(0, 1)], self.bend[(1, 1)]];
        let [first, second] = self.across;
        let grows =
            self.direction * (1.0 + self.round * along) + first * (xx * x + xy * y) + second * (xy * x + yy * y);
        (self.length_m(&self.seen), grows.normalize())
    }

    fn point(&self, way: &Way) -> Point {
        way.point(&self.at, self.length_m, &self.direction)
    }

    /// Distance from the place to the point of the surface.
    pub fn distance_m(&self, way: &Way) -> f64 {
        (self.at - self.point(way)).norm()
    }

    /// Whether a point of the surface explains it.
    pub fn has_point(&self, way: &Way) -> bool {
        way.is_solved(&self.at, self.length_m, &self.direction)
    }

    /// Curvatures of the lengths over those where the surface ends, larger one first, and their standard deviations.
    pub fn bends(&self, way: &Way) -> [[f64; 2]; 2] {
        let Some(of_end) = way.of_end(&self.at, &self.point(way), &self.across) else { return [[0.0, f64::MAX]; 2] };
        let eigen = (of_end.transpose() * self.bend * of_end).symmetric_eigen();
        let covariance = (self.fitted.noise + self.fitted.law).fixed_view::<3, 3>(3, 3).into_owned();
        let mut bends = [0, 1].map(|k| {
            let axis = of_end * eigen.eigenvectors.column(k);
            let slopes = Vector3::new(axis.x * axis.x, 2.0 * axis.x * axis.y, axis.y * axis.y);
            [eigen.eigenvalues[k], slopes.dot(&(covariance * slopes)).sqrt()]
        });
        bends.sort_by(|a, b| b[0].total_cmp(&a[0]));
        bends
    }

    /// Directions along the surface, and variances of the nearest point along them, where the mean square distance of
    /// members is this one, and the field explains the place with the probability `bent`. On concave surfaces the point
    /// slides several times as far as the wall's point, over parts that are curved otherwise: the curvature of the
    /// lengths changes by a share of itself. If there are `edges`, with this probability, it rests on one and jumps to
    /// the next.
    pub fn slides(&self, way: &Way, radius_m2: f64, [bent, edges]: [f64; 2]) -> [(Vector3<f64>, f64); 2] {
        let eigen = self.bend.symmetric_eigen();
        let distance_m = self.distance_m(way);
        [0, 1].map(|k| {
            let direction = self.across[0] * eigen.eigenvectors[(0, k)] + self.across[1] * eigen.eigenvectors[(1, k)];
            let bend = eigen.eigenvalues[k] * distance_m;
            let [moves, hollow] = [1.0 - bend, -bend].map(|value| value.max(0.0));
            let of_edges = edges * (BETWEEN * moves).powi(2);
            (direction, radius_m2 * (bent * (CHANGE * hollow).powi(2) + of_edges))
        })
    }

    /// What part of the surface it shows.
    pub fn kind(&self, way: &Way) -> Kind {
        let [first, second] = self.bends(way).map(|[bend, sd]| {
            let faces = 1.0 - bend > APART * sd;
            let ends = (1.0 - bend).abs() <= APART * sd && sd < SURE;
            (faces, ends)
        });
        match (first, second) {
            ((true, _), _) => Kind::Smooth,
            ((_, true), (true, _)) => Kind::Edge,
            ((_, true), (_, true)) => Kind::Corner,
            _ => Kind::Unknown,
        }
    }
}

impl Local for Field {
    fn at(&self) -> Point {
        self.at
    }

    fn length_m(&self, place: &Point) -> f64 {
        let (q, root) = self.growth(self.towards(place));
        self.length_m + 2.0 * q / (1.0 + root)
    }

    fn length(&self, place: &Point) -> (f64, Unknowns) {
        let [along, x, y] = self.towards(place);
        let (q, root) = self.growth([along, x, y]);
        let [xx, xy, yy] = [self.bend[(0, 0)], self.bend[(0, 1)], self.bend[(1, 1)]];
        let grow = 1.0 + self.round * along;
        let turns = [x * grow - along * (xx * x + xy * y), y * grow - along * (xy * x + yy * y)];
        let share = 1.0 / root;
        let bends = [0.5 * share * x * x, share * x * y, 0.5 * share * y * y];
        let slopes = [1.0, share * turns[0], share * turns[1], bends[0], bends[1], bends[2], 0.0, 0.0];
        (self.length_m + 2.0 * q / (1.0 + root), Unknowns::from(slopes))
    }

    fn moved(&self, step: &Unknowns) -> Self {
        let mut field = self.clone();
        field.length_m += step[0];
        field.turn(step[1], step[2]);
        field.bend += Matrix2::new(step[3], step[4], step[4], step[5]);
        let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|place| field.bend[place]);
        let most = 0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy);
        field.round = most.clamp(0.0, 1.0 / field.length_m.max(1e-3));
        field
    }

    fn prior(&self) -> (Unknowns, Unknowns) {
        let precision = (self.length_m / BEND_SD).powi(2);
        let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|place| self.bend[place]);
        let off = Unknowns::from([0.0, 0.0, 0.0, xx, xy, yy, 0.0, 0.0]);
        (off, Unknowns::from([0.0, 0.0, 0.0, precision, precision, precision, 1.0, 1.0]))
    }

    fn is_possible(&self) -> bool {
        self.length_m > 0.0
    }

    fn read(&self) -> usize {
        if self.seen == self.at { 3 } else { 6 }
    }

    fn reading(&self, way: &Way) -> (Point, Vector3<f64>) {
        let (length_m, direction) = self.here();
        let point = way.point(&self.seen, length_m, &direction);
        (point, way.normal(&self.seen, &point, &direction))
    }

    fn fitted(&self) -> &Arc<Fitted> {
        &self.fitted
    }

    fn with(self, fitted: Arc<Fitted>) -> Self {
        Self { fitted, ..self }
    }
}
