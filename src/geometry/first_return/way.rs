//! How light goes to a place of the wall, and the point of the surface that value and gradient of its length show.
//!
//! Where lit and seen point move together apart, lengths are half of the way, over the places midway. With `h` from
//! there to the seen point, `H` its slopes as the place moves, and unit vectors `u` from the surface to the lit point
//! and `v` to the seen point, the length has the gradient
//!
//! ```text
//! ((1 - H)^T u + (1 + H)^T v) / 2
//! ```
//!
//! over the wall, since the way is stationary on the surface. Length and gradient are three equations for the point.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::{Lit, Scan};
use crate::Point;
use crate::axes::across;

/// Places to which the slopes of a pair are fitted.
const NEIGHBOURS: usize = 13;
/// Most that neighbours may be off these slopes, over the standard deviation of the response.
const SMOOTH: f64 = 0.1;
/// Newton steps, and the most that is left of the equations.
const STEPS: usize = 30;
const SOLVED_M: f64 = 1e-9;

/// How light goes to a place.
#[derive(Clone, Copy, Debug)]
pub enum Way {
    /// There and back.
    Back,
    /// From a point.
    From(Point),
    /// From a point to another, the place midway.
    Apart(Pair),
}

/// A lit and a seen point that move together.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// From the place midway to the seen point, and its slopes as the place moves.
    half: Vector3<f64>,
    slopes: Matrix3<f64>,
    /// Two directions along the wall.
    along: [Vector3<f64>; 2],
}

impl Way {
    /// Of each place; `None` where pairs of neighbours do not move together.
    pub fn all(scan: &Scan, near: &[Vec<u32>]) -> Vec<Option<Self>> {
        match &scan.lit {
            Lit::Same => vec![Some(Self::Back); near.len()],
            Lit::One(lit) => vec![Some(Self::From(*lit)); near.len()],
            Lit::Apart(halves) => near.iter().map(|near| Pair::of(scan, halves, near).map(Self::Apart)).collect(),
        }
    }

    /// The point of the surface, from the length at a place and the unit vector along the wall's part of its gradient.
    pub fn point(&self, at: &Point, length_m: f64, direction: &Vector3<f64>) -> Point {
        match self {
            Self::Back => at - direction * length_m,
            Self::From(lit) => {
                let apart = at - lit;
                let distance_m = (length_m.powi(2) - apart.norm_squared()) / (2.0 * (length_m - apart.dot(direction)));
                at - direction * distance_m
            }
            Self::Apart(pair) => pair.point(at, length_m, direction),
        }
    }

    /// The length at a place whose light comes over a point, and its gradient there.
    pub fn length_over(&self, at: &Point, point: &Point) -> (f64, Vector3<f64>) {
        let way = at - point;
        match self {
            Self::Back => (way.norm(), way.normalize()),
            Self::From(lit) => ((lit - point).norm() + way.norm(), way.normalize()),
            Self::Apart(pair) => pair.length_over(at, point),
        }
    }

    /// Unit normal of a surface that reflects at the point.
    pub fn normal(&self, at: &Point, point: &Point, direction: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Back => *direction,
            Self::From(lit) => (direction + (lit - point).normalize()).normalize(),
            Self::Apart(pair) => {
                let [from, to] = pair.ways(at, point);
                (from.normalize() + to.normalize()).normalize()
            }
        }
    }

    /// Mean curvature at a point of the surface of all points that have its length.
    pub fn bend_per_m(&self, at: &Point, point: &Point) -> f64 {
        let [from, to] = match self {
            Self::Back => [at - point; 2],
            Self::From(lit) => [lit - point, at - point],
            Self::Apart(pair) => pair.ways(at, point),
        };
        0.5 * (from.norm().recip() + to.norm().recip())
    }

    /// Curvature of lengths over a place whose light comes over one point: of which a field across a direction has this
    /// part, as the inverse of a root. Curvatures between it and its transpose are 1 where the surface ends.
    pub fn of_end(&self, at: &Point, point: &Point, across: &[Vector3<f64>; 2]) -> Option<Matrix2<f64>> {
        let Self::Apart(pair) = self else { return Some(Matrix2::identity() * (at - point).norm().sqrt()) };
        let bend = pair.bend(at, point);
        let [along, part] = [
            Matrix2::from_fn(|row, column| pair.along[row].dot(&across[column])),
            Matrix2::from_fn(|row, column| pair.along[row].dot(&(bend * pair.along[column]))),
        ];
        let back = along.try_inverse()?;
        let root = (back * part * back.transpose()).cholesky()?.l();
        root.try_inverse().map(|inverse| inverse.transpose())
    }

    /// Whether the point explains length and gradient.
    pub fn is_solved(&self, at: &Point, length_m: f64, direction: &Vector3<f64>) -> bool {
        let Self::Apart(pair) = self else { return true };
        let point = pair.point(at, length_m, direction);
        pair.off(at, &point, length_m, direction).norm() < SOLVED_M
    }
}

impl Pair {
    /// By least squares over neighbours, the place first.
    fn of(scan: &Scan, halves: &[Vector3<f64>], near: &[u32]) -> Option<Self> {
        let along = across(&scan.inwards);
        let here = near[0] as usize;
        let from = |n: u32| along.map(|axis| axis.dot(&(scan.places[n as usize].seen - scan.places[here].seen)));
        let moved = |n: u32| halves[n as usize] - halves[here];
        let near = &near[..NEIGHBOURS.min(near.len())];
        let (mut squares, mut products) = (Matrix2::zeros(), [Vector3::zeros(); 2]);
        for n in near {
            let from = from(*n);
            squares += Matrix2::from_fn(|row, column| from[row] * from[column]);
            (0..2).for_each(|k| products[k] += moved(*n) * from[k]);
        }
        let inverse = squares.try_inverse()?;
        let slopes = [0, 1].map(|k| products[0] * inverse[(0, k)] + products[1] * inverse[(1, k)]);
        let off_m = |n: &u32| {
            let [x, y] = from(*n);
            (moved(*n) - slopes[0] * x - slopes[1] * y).norm()
        };
        let is_smooth = near.iter().all(|n| off_m(n) < SMOOTH * scan.sigma_m);
        let slopes = slopes[0] * along[0].transpose() + slopes[1] * along[1].transpose();
        is_smooth.then_some(Self { half: halves[here], slopes, along })
    }

    /// From a point of the surface to the lit and to the seen point.
    fn ways(&self, at: &Point, point: &Point) -> [Vector3<f64>; 2] {
        let midway = at - point;
        [midway - self.half, midway + self.half]
    }

    /// How both points move with the place.
    fn moves(&self) -> [Matrix3<f64>; 2] {
        [Matrix3::identity() - self.slopes, Matrix3::identity() + self.slopes]
    }

    /// What is left of length and gradient.
    fn off(&self, at: &Point, point: &Point, length_m: f64, direction: &Vector3<f64>) -> Vector3<f64> {
        let (told_m, gradient) = self.length_over(at, point);
        let along = self.along.map(|axis| axis.dot(&(gradient - direction)));
        Vector3::new(told_m - length_m, along[0], along[1])
    }

    fn length_over(&self, at: &Point, point: &Point) -> (f64, Vector3<f64>) {
        let (ways, moves) = (self.ways(at, point), self.moves());
        let gradient = (moves[0].tr_mul(&ways[0].normalize()) + moves[1].tr_mul(&ways[1].normalize())) * 0.5;
        (0.5 * (ways[0].norm() + ways[1].norm()), gradient)
    }

    fn point(&self, at: &Point, length_m: f64, direction: &Vector3<f64>) -> Point {
        let least = 0.01 * length_m * length_m;
        let mut point = at - direction * (length_m * length_m - self.half.norm_squared()).max(least).sqrt();
        for _ in 0..STEPS {
            let off = self.off(at, &point, length_m, direction);
            if off.norm() < 0.01 * SOLVED_M {
                break;
            }
            let (ways, moves) = (self.ways(at, &point), self.moves());
            let mut slopes = Matrix3::zeros();
            for (way, moves) in ways.iter().zip(moves) {
                let unit = way.normalize();
                let turn = moves.transpose() * ((unit * unit.transpose() - Matrix3::identity()) / way.norm());
                let rows = [-unit, turn.tr_mul(&self.along[0]), turn.tr_mul(&self.along[1])];
                slopes += Matrix3::from_rows(&rows.map(|row| row.transpose() * 0.5));
            }
            let Some(step) = slopes.lu().solve(&off) else { break };
            point -= step * (0.3 * length_m / step.norm()).min(1.0);
        }
        point
    }

    /// Curvature of the length as the place moves and the point of the surface does not.
    fn bend(&self, at: &Point, point: &Point) -> Matrix3<f64> {
        let of_one = |(way, moves): (&Vector3<f64>, Matrix3<f64>)| {
            let unit = way.normalize();
            moves.transpose() * ((Matrix3::identity() - unit * unit.transpose()) / way.norm()) * moves * 0.5
        };
        self.ways(at, point).iter().zip(self.moves()).map(of_one).sum()
    }
}
