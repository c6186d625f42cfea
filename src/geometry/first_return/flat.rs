//! A local field of lengths to flat faces that end at right angles: a rectangle, or a block.
//!
//! Both are a rigid body with three axes at right angles and two widths. A rectangle has no thickness along the third
//! axis; a block goes on behind it. The nearest point slides as the body moves, but only across the direction of sight:
//! the length changes as that to a point of the body. Edges that no length shows lie where they were thought to be.

use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3, SMatrix, Vector3};

use super::field::Kind;
use super::local::{Fitted, Local, Sample, UNKNOWNS, Unknowns};
use super::odds;
use super::way::Way;
use super::{Face, SurfacePoint};
use crate::Point;
use crate::axes::across;

/// Standard deviations of what is thought of a body before there is light: of its edges, in radii of the zone, and of
/// its turns.
const EDGES_SD: f64 = 3.0;
const TURNS_SD: f64 = 0.7;
/// How far beyond the points that are known edges are thought to be, in radii of the zone.
const BEYOND: f64 = 0.3;
/// Turns of the edges that are tried in a quarter, and starts that are followed.
const AZIMUTHS: usize = 6;
const FOLLOWED: usize = 3;
/// Standard deviation of an edge that is shown, and the most by which one counts as unsure, in radii of the zone.
const SHOWN: f64 = 1.0;
const MOST_UNSURE: f64 = 4.0;

/// A point of the surface that is known roughly.
#[derive(Clone, Copy, Debug)]
pub struct Hint {
    point: Point,
    sd_m: f64,
    /// Unit vector away from the surface, and whether it is its normal.
    away: Vector3<f64>,
    is_smooth: bool,
}

impl Hint {
    pub fn new(point: &SurfacePoint) -> Self {
        let sd_m = point.covariance_m2.trace().sqrt();
        Self { point: point.point, sd_m, away: point.normal, is_smooth: point.kind == Kind::Smooth }
    }
}

/// How far beyond an edge a place lies, in radii of the zone.
#[derive(Clone, Copy, Debug)]
pub struct Beyond {
    pub place: f64,
    pub sd: f64,
    /// Whether lengths show the edge; else there is none as far as they tell.
    pub is_shown: bool,
}

impl Beyond {
    pub fn likeliest(&self) -> f64 {
        if self.is_shown { self.place } else { f64::NEG_INFINITY }
    }

    /// Where the edge may be otherwise: one standard deviation farther, and nearer too where that is much.
    pub fn otherwise(&self) -> impl Iterator<Item = f64> {
        let sd = self.sd.min(MOST_UNSURE);
        let nearer = (sd > SHOWN).then_some(self.place - sd);
        [self.place + sd].into_iter().chain(nearer)
    }
}

/// A rectangle or a block. Its unknowns are shifts along its axes, turns about them, and widths.
#[derive(Clone, Debug)]
pub struct Flat {
    at: Point,
    corner: Point,
    /// Directions in which it ends at its corner; the third is the normal of a rectangle.
    axes: [Vector3<f64>; 3],
    /// Along the first two axes, before the corner.
    widths_m: [f64; 2],
    pub is_block: bool,
    zone_m: f64,
    /// About which it turns.
    pivot: Point,
    /// Changes since the start, and the precision of the start.
    off: Unknowns,
    precision: Unknowns,
    fitted: Arc<Fitted>,
}

impl Flat {
    /// The likeliest sheets through known points, by chi-square before they are fitted.
    pub fn starts(at: Point, hints: &[Hint], samples: &[Sample], members: &[u32], zone_m: f64) -> Vec<Self> {
        let mut starts = Vec::new();
        let mean = mean(hints);
        for normal in normals(hints) {
            let normal = if normal.dot(&(at - mean)) < 0.0 { -normal } else { normal };
            let [x, y] = across(&normal);
            for turn in 0..AZIMUTHS {
                let (sin, cos) = (std::f64::consts::FRAC_PI_2 * turn as f64 / AZIMUTHS as f64).sin_cos();
                let [a, b] = [x * cos + y * sin, y * cos - x * sin];
                let reach = |axis: Vector3<f64>| end(hints, &axis) + BEYOND * zone_m;
                let corner = Point::from(a * reach(a) + b * reach(b) + normal * normal.dot(&mean.coords));
                let widths_m = [a, b].map(|axis| reach(axis) + reach(-axis));
                let flat = Self::new(at, corner, [a, b, normal], widths_m, zone_m);
                starts.push((flat.square(samples, members), flat));
            }
        }
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts.into_iter().take(FOLLOWED).map(|(_, flat)| flat).collect()
    }

    fn new(at: Point, corner: Point, axes: [Vector3<f64>; 3], widths_m: [f64; 2], zone_m: f64) -> Self {
        let [edges, turns] = [EDGES_SD * zone_m, TURNS_SD].map(|sd| 1.0 / (sd * sd));
        let precision = Unknowns::from([edges, edges, 0.0, turns, turns, turns, edges, edges]);
        let (off, fitted) = (Unknowns::zeros(), Fitted::none());
        let mut flat = Self { at, corner, axes, widths_m, is_block: false, zone_m, pivot: at, off, precision, fitted };
        flat.pivot = flat.nearest(&at);
        flat
    }

    /// The same body as another place sees it.
    pub fn seen_from(&self, at: Point) -> Self {
        Self { at, ..self.clone() }
    }

    /// Where a place is along the axes, from the corner; negative before an edge.
    fn along(&self, place: &Point) -> [f64; 3] {
        self.axes.map(|axis| axis.dot(&(place - self.corner)))
    }

    /// The nearest point of the body, both along the axes from the corner.
    fn nearest_along(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let within = |k: usize, along: f64| along.max(-self.widths_m[k].max(0.0)).min(0.0);
        [within(0, x), within(1, y), if self.is_block { z.min(0.0) } else { 0.0 }]
    }

    fn nearest(&self, place: &Point) -> Point {
        let [x, y, z] = self.nearest_along(self.along(place));
        self.corner + self.axes[0] * x + self.axes[1] * y + self.axes[2] * z
    }

    /// How far beyond each edge its place lies: at the corner along each axis, then at the other ends of the first two;
    /// and the standard deviations.
    fn beyond_m(&self) -> [[f64; 2]; 5] {
        let along_m = self.along(&self.at);
        let arm = self.pivot - self.at;
        let covariance = self.fitted.noise + self.fitted.law;
        [0, 1, 2, 3, 4].map(|end| {
            let k = end % 3;
            // By shifts along the axis, by turns of the axis about the pivot, and by widths.
            let mut slopes = Unknowns::zeros();
            slopes[k] = 1.0;
            (0..3).for_each(|turn| slopes[3 + turn] = self.axes[turn].cross(&self.axes[k]).dot(&arm));
            if end < 3 {
                return [along_m[k], slopes.dot(&(covariance * slopes)).sqrt()];
            }
            slopes[6 + k] = -1.0;
            [-along_m[k] - self.widths_m[k], slopes.dot(&(covariance * slopes)).sqrt()]
        })
    }

    /// The same, in radii of the zone of a length.
    pub fn beyond(&self, zone_m: f64) -> [Beyond; 5] {
        self.beyond_m().map(|end| {
            let [place, sd] = end.map(|end_m| end_m / zone_m);
            let is_shown = sd <= SHOWN || place >= 0.0;
            Beyond { place, sd, is_shown }
        })
    }

    /// The faces that a place sees which lies so far beyond its edges, in radii of its zone.
    pub fn faces(&self, beyond: [f64; 5]) -> Vec<Face> {
        let [x, y, z, left, below] = beyond;
        let behind = f64::INFINITY;
        let [across_x, across_y, across_z] = [[-x, -left], [-y, -below], [-z, behind]];
        if !self.is_block {
            return vec![Face { weight: 1.0, ends: [across_x, across_y] }];
        }
        let faces =
            [(z, [across_x, across_y]), (x.max(left), [across_y, across_z]), (y.max(below), [across_x, across_z])];
        let seen: Vec<Face> = faces
            .into_iter()
            .filter(|(height, _)| *height > 0.0)
            .map(|(height, ends)| Face { weight: height * height, ends })
            .collect();
        let sum: f64 = seen.iter().map(|face| face.weight).sum();
        seen.into_iter().map(|face| Face { weight: face.weight / sum, ..face }).collect()
    }

    /// Shares of a smooth point, an edge and a corner.
    pub fn kinds(&self) -> [f64; 3] {
        let within = |z: f64| odds::probability(odds::OF_SD * z);
        let [x, y, z, left, below] = self.beyond(self.zone_m).map(|end| within(end.likeliest() / end.sd.max(1e-9)));
        let [a, b] = [(x + left).min(1.0), (y + below).min(1.0)];
        let c = if self.is_block { z } else { 1.0 };
        let one = a * (1.0 - b) * (1.0 - c) + b * (1.0 - a) * (1.0 - c) + c * (1.0 - a) * (1.0 - b);
        let three = a * b * c;
        [one, 1.0 - one - three - (1.0 - a) * (1.0 - b) * (1.0 - c), three]
    }
}

impl Local for Flat {
    fn at(&self) -> Point {
        self.at
    }

    fn length_m(&self, place: &Point) -> f64 {
        let [x, y, z] = self.along(place);
        let beyond = |k: usize, along: f64| along.max(0.0).max(-along - self.widths_m[k]);
        let z = if self.is_block { z.max(0.0) } else { z };
        (beyond(0, x).powi(2) + beyond(1, y).powi(2) + z * z).sqrt()
    }

    fn length(&self, place: &Point) -> (f64, Unknowns) {
        // All along the axes, from the corner.
        let (place, pivot) = (self.along(place), self.along(&self.pivot));
        let nearest = self.nearest_along(place);
        let way: [f64; 3] = std::array::from_fn(|k| place[k] - nearest[k]);
        let length_m = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt().max(1e-9);
        let share = 1.0 / length_m;
        let shifts = way.map(|way| way * share);
        let wider = [0, 1].map(|k| if place[k] < -self.widths_m[k] { -shifts[k] } else { 0.0 });
        let arm: [f64; 3] = std::array::from_fn(|k| nearest[k] - pivot[k]);
        let turn = |a: usize, b: usize| arm[a] * shifts[b] - arm[b] * shifts[a];
        let turns = [turn(1, 2), turn(2, 0), turn(0, 1)];
        let slopes = [shifts[0], shifts[1], shifts[2], turns[0], turns[1], turns[2], wider[0], wider[1]];
        (length_m, -Unknowns::from(slopes))
    }

    fn moved(&self, step: &Unknowns) -> Self {
        let [a, b, n] = self.axes;
        let shift = a * step[0] + b * step[1] + n * step[2];
        let turn = Rotation3::from_scaled_axis(a * step[3] + b * step[4] + n * step[5]);
        Self {
            corner: self.pivot + turn * (self.corner - self.pivot) + shift,
            axes: self.axes.map(|axis| turn * axis),
            widths_m: [0, 1].map(|k| self.widths_m[k] + step[6 + k]),
            pivot: self.pivot + shift,
            off: self.off + step,
            ..self.clone()
        }
    }

    fn prior(&self) -> (Unknowns, Unknowns) {
        (self.off, self.precision)
    }

    fn is_possible(&self) -> bool {
        self.corner.coords.iter().all(|value| value.is_finite()) && self.widths_m.iter().all(|width_m| *width_m > 0.0)
    }

    fn read(&self) -> usize {
        UNKNOWNS
    }

    fn reading(&self, _: &Way) -> (Point, Vector3<f64>) {
        let point = self.nearest(&self.at);
        (point, (self.at - point).normalize())
    }

    fn reading_slopes(&self, _: &Way) -> [SMatrix<f64, 3, UNKNOWNS>; 2] {
        // Along the axes: what is bound to the body moves with it, the rest stays next to the place.
        let (place, pivot) = (self.along(&self.at), self.along(&self.pivot));
        let nearest = self.nearest_along(place);
        let is_free = [0, 1, 2].map(|k| place[k] == nearest[k] && (k < 2 || self.is_block));
        let [at, of_place] = [nearest, place].map(|point| Vector3::from_fn(|k, _| point[k] - pivot[k]));
        let mut slopes = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        for k in 0..3 {
            let axis = Vector3::ith(k, 1.0);
            let free = |moved: Vector3<f64>| Vector3::from_fn(|k, _| if is_free[k] { moved[k] } else { 0.0 });
            slopes.set_column(k, &(axis - free(axis)));
            slopes.set_column(3 + k, &(axis.cross(&at) - free(axis.cross(&of_place))));
            if k < 2 && place[k] < -self.widths_m[k] {
                slopes[(k, 6 + k)] = -1.0;
            }
        }
        let slopes = Matrix3::from_columns(&self.axes) * slopes;
        let way = self.at - self.nearest(&self.at);
        let away = way.normalize();
        let turned = (away * away.transpose() - Matrix3::identity()) * (1.0 / way.norm());
        [slopes, turned * slopes]
    }

    fn fitted(&self) -> &Arc<Fitted> {
        &self.fitted
    }

    fn with(self, fitted: Arc<Fitted>) -> Self {
        Self { fitted, ..self }
    }

    fn other(&self) -> Option<Self> {
        Some(Self { is_block: !self.is_block, ..self.clone() })
    }
}

fn mean(hints: &[Hint]) -> Point {
    let sum: f64 = hints.iter().map(|one| one.sd_m.powi(-2)).sum();
    Point::from(hints.iter().map(|one| one.point.coords * one.sd_m.powi(-2)).sum::<Vector3<f64>>() / sum)
}

/// Normals that a sheet through the points may have: that of the surest point of a smooth surface, and that of the
/// plane of least squares.
fn normals(hints: &[Hint]) -> Vec<Vector3<f64>> {
    let mean = mean(hints);
    let arms = hints.iter().map(|one| (one.point - mean, one.sd_m.powi(-2)));
    let eigen = arms.map(|(arm, weight)| arm * arm.transpose() * weight).sum::<Matrix3<f64>>().symmetric_eigen();
    let across: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    let surest = hints.iter().filter(|one| one.is_smooth).min_by(|a, b| a.sd_m.total_cmp(&b.sd_m));
    surest.map(|one| one.away).into_iter().chain([across]).collect()
}

/// How far known points reach along an axis: all but a twentieth.
fn end(hints: &[Hint], axis: &Vector3<f64>) -> f64 {
    let mut places: Vec<f64> = hints.iter().map(|one| axis.dot(&one.point.coords)).collect();
    let last = (places.len() - 1) * 19 / 20;
    *places.select_nth_unstable_by(last, f64::total_cmp).1
}
