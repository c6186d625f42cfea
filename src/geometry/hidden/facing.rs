//! Which way the walls of visible patches face, and whether these tell where a hidden patch is.

use nalgebra::{Matrix3, Vector3};

use super::Focus;
use crate::{Point, planes};

/// A plane through points that are off it by less than this share of its extent has two sides, and so has a line.
const FLAT: f64 = 1e-3;

/// Standard deviations of points along three axes at right angles, least first, with the first of the axes; in flatland
/// nothing lies across it.
fn extents_m(points: &[Point]) -> ([f64; 3], Vector3<f64>) {
    let middle = points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let spread = |point: &Point| (point.coords - middle) * (point.coords - middle).transpose();
    let axes = points.iter().map(spread).sum::<Matrix3<f64>>().symmetric_eigen();
    let mut extents_m: [f64; 3] = axes.eigenvalues.map(|value| (value.max(0.0) / points.len() as f64).sqrt()).into();
    extents_m.sort_by(f64::total_cmp);
    (extents_m, axes.eigenvectors.column(axes.eigenvalues.imin()).into())
}

/// Whether points lie in no line (in flatland in no point): else a hidden patch may turn about it.
#[must_use]
pub fn spans(points: &[Point], dimensions: usize) -> bool {
    if points.is_empty() {
        return false;
    }
    let ([_, middle_m, most_m], _) = extents_m(points);
    if dimensions == 2 { most_m > 0.0 } else { middle_m > FLAT * most_m }
}

/// Visible patches with the sides of their walls that are lit: of known normals, or of the one plane that all lie on
/// (in flatland one line).
#[must_use]
pub fn fronts(points: &[Point], normals: &[Option<Vector3<f64>>], source: Point, dimensions: usize) -> Vec<Focus> {
    let wall = one_wall(points, dimensions);
    let front = |(point, normal): (&Point, &Option<Vector3<f64>>)| {
        let to_source = (source - point).try_normalize(f64::MIN_POSITIVE)?;
        let normal = normal.or(wall)?;
        let side = normal.dot(&to_source);
        (side.abs() > FLAT).then(|| normal * side.signum())
    };
    points.iter().zip(normals).map(|at| Focus { point: *at.0, normal: front(at) }).collect()
}

/// Whether two patches exchange light as far as their walls say: not if either lies behind the other's wall, or in its
/// plane.
#[must_use]
pub fn exchange_light(a: &Focus, b: &Focus) -> bool {
    let slack_m = -FLAT * (a.point - b.point).norm();
    a.faces(b.point, slack_m) && b.faces(a.point, slack_m)
}

/// Normal of the plane (in flatland the line) on which all points lie.
fn one_wall(points: &[Point], dimensions: usize) -> Option<Vector3<f64>> {
    let ([least_m, middle_m, most_m], across) = extents_m(points);
    if dimensions == 2 {
        // Nothing lies across flatland: of its two axes the middle one.
        let (_, normal) = planes::nearest(points, dimensions);
        return (middle_m <= FLAT * most_m).then_some(normal);
    }
    (least_m <= FLAT * most_m).then_some(across)
}
