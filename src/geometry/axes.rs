//! Directions that points, or another direction, set.

use nalgebra::{Matrix3, Vector3};

use super::Point;

/// How points scatter about their middle.
pub struct Scatter {
    pub middle: Point,
    /// Unit vectors along which they scatter most, less and least.
    pub axes: [Vector3<f64>; 3],
    /// Sums of squares along these.
    pub squares_m2: [f64; 3],
}

impl Scatter {
    pub fn of(points: &[Point]) -> Self {
        let middle = points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let arms = points.iter().map(|point| point.coords - middle);
        let eigen = arms.map(|arm| arm * arm.transpose()).sum::<Matrix3<f64>>().symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let axes = order.map(|k| eigen.eigenvectors.column(k).into_owned());
        Self { middle: middle.into(), axes, squares_m2: order.map(|k| eigen.eigenvalues[k]) }
    }
}

/// Two unit vectors across another.
pub fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let axis = Vector3::ith(direction.iamin(), 1.0);
    let first = (axis - direction * direction.dot(&axis)).normalize();
    [first, direction.cross(&first)]
}
