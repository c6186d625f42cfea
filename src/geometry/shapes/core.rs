//! A plane, a sphere or a cylinder, and the distance from a point to it.

use nalgebra::{Matrix3, SMatrix, SVector, Unit, Vector3};

use super::Kind;
use crate::Point;
use crate::axes::across;

/// Most unknowns of a shape: those of a cylinder.
pub const UNKNOWNS: usize = 5;
pub type Unknowns = SVector<f64, UNKNOWNS>;
pub type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// A point, a line or a plane, and a radius about it. Unknowns are shifts, turns, and the radius last; a shape that has
/// fewer leaves the others at zero.
#[derive(Clone, Debug)]
pub struct Core {
    pub kind: Kind,
    /// On the plane or the line; the middle of a sphere.
    pub at: Point,
    /// Of a plane its normal, towards the wall; of a line its direction.
    pub axis: Vector3<f64>,
    /// Two directions across it.
    across: [Vector3<f64>; 2],
    pub radius_m: f64,
}

impl Core {
    pub fn new(kind: Kind, at: Point, axis: Vector3<f64>, radius_m: f64) -> Self {
        let axis = axis.normalize();
        Self { kind, at, axis, across: across(&axis), radius_m }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        match self.kind {
            Kind::Plane => 3,
            Kind::Sphere => 4,
            Kind::Cylinder => 5,
        }
    }

    /// The point of the shape next to a place, and the unit vector from there to the place.
    pub fn foot(&self, place: &Point) -> (Point, Unit<Vector3<f64>>) {
        let arm = place - self.at;
        if self.kind == Kind::Plane {
            return (place - self.axis * self.axis.dot(&arm), Unit::new_unchecked(self.axis));
        }
        let along = if self.kind == Kind::Cylinder { self.axis * self.axis.dot(&arm) } else { Vector3::zeros() };
        let away = Unit::try_new(arm - along, 0.0).unwrap_or(Vector3::z_axis());
        (self.at + along + away.into_inner() * self.radius_m, away)
    }

    /// Distance of a place, negative behind a plane or within a radius.
    pub fn distance_m(&self, place: &Point) -> f64 {
        let (foot, away) = self.foot(place);
        away.dot(&(place - foot))
    }

    /// Slopes of the distance by the unknowns.
    pub fn slopes(&self, place: &Point) -> Unknowns {
        let (_, away) = self.foot(place);
        let mut slopes = Unknowns::zeros();
        let arm = place - self.at;
        match self.kind {
            Kind::Plane => {
                slopes[0] = -1.0;
                (0..2).for_each(|k| slopes[1 + k] = self.across[k].dot(&arm));
            }
            Kind::Sphere => (0..3).for_each(|k| slopes[k] = -away[k]),
            Kind::Cylinder => {
                let along_m = self.axis.dot(&arm);
                for k in 0..2 {
                    slopes[k] = -away.dot(&self.across[k]);
                    slopes[2 + k] = along_m * slopes[k];
                }
            }
        }
        if self.kind.has_radius() {
            slopes[self.unknowns() - 1] = -1.0;
        }
        slopes
    }

    /// With the unknowns changed.
    pub fn moved(&self, step: &Unknowns) -> Self {
        let [a, b] = self.across;
        let (shift, turn) = match self.kind {
            Kind::Plane => (self.axis * step[0], a * step[1] + b * step[2]),
            Kind::Sphere => (Vector3::new(step[0], step[1], step[2]), Vector3::zeros()),
            Kind::Cylinder => (a * step[0] + b * step[1], a * step[2] + b * step[3]),
        };
        let radius_m = if self.kind.has_radius() { self.radius_m + step[self.unknowns() - 1] } else { 0.0 };
        Self::new(self.kind, self.at + shift, self.axis + turn, radius_m)
    }

    /// The same shape, held at the point of its plane or line that is next to a place.
    pub fn held_at(&self, place: &Point) -> Self {
        let arm = place - self.at;
        let along = self.axis * self.axis.dot(&arm);
        let at = match self.kind {
            Kind::Plane => place - along,
            Kind::Cylinder => self.at + along,
            Kind::Sphere => self.at,
        };
        Self { at, ..self.clone() }
    }

    /// Covariances of `at` (across the plane or line), of the axis, and the variance of the radius.
    pub fn covariances(&self, covariance: &Covariance) -> (Matrix3<f64>, Matrix3<f64>, f64) {
        let (mut shifts, mut turns) = (SMatrix::<f64, 3, UNKNOWNS>::zeros(), SMatrix::<f64, 3, UNKNOWNS>::zeros());
        match self.kind {
            Kind::Plane => {
                shifts.set_column(0, &self.axis);
                (0..2).for_each(|k| turns.set_column(1 + k, &self.across[k]));
            }
            Kind::Sphere => (0..3).for_each(|k| shifts[(k, k)] = 1.0),
            Kind::Cylinder => {
                (0..2).for_each(|k| shifts.set_column(k, &self.across[k]));
                (0..2).for_each(|k| turns.set_column(2 + k, &self.across[k]));
            }
        }
        let last = self.unknowns() - 1;
        let radius_m2 = if self.kind.has_radius() { covariance[(last, last)] } else { 0.0 };
        (shifts * covariance * shifts.transpose(), turns * covariance * turns.transpose(), radius_m2)
    }
}
