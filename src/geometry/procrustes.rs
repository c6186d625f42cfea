//! The rotation, with or without reflection, about a fixed centre that brings points nearest to others.
//!
//! Source: Kabsch, Acta Cryst. A32, 922 (1976); Schönemann, Psychometrika 31, 1 (1966) for the orthogonal case.

use nalgebra::{Matrix3, SVD};

use super::Point;

/// The best rotation.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Orthogonal matrix: a point goes to `centre + matrix (point - centre)`. Its determinant is -1 for a reflection.
    pub matrix: Matrix3<f64>,
    /// Root of the mean squared distance that is left.
    pub rms_m: f64,
}

/// Best rotation of `points` onto `targets` about `centre`; a reflection where that is better and `reflect` allows it.
///
/// # Panics
/// When there are no points, or not as many targets.
#[must_use]
pub fn rotation(points: &[Point], targets: &[Point], centre: Point, reflect: bool) -> Fit {
    assert!(!points.is_empty() && points.len() == targets.len(), "{} points, {} targets", points.len(), targets.len());
    let correlation: Matrix3<f64> =
        points.iter().zip(targets).map(|(point, target)| (target - centre) * (point - centre).transpose()).sum();
    let svd = SVD::new(correlation, true, true);
    let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    let sign = if reflect { 1.0 } else { (u * v_t).determinant().signum() };
    // Without reflection, the direction of the smallest singular value pays for it.
    let smallest = svd.singular_values.imin();
    let signs = nalgebra::Vector3::from_fn(|i, _| if i == smallest { sign } else { 1.0 });
    let matrix = u * Matrix3::from_diagonal(&signs) * v_t;
    let squares: f64 = points
        .iter()
        .zip(targets)
        .map(|(point, target)| (matrix * (point - centre) - (target - centre)).norm_squared())
        .sum();
    Fit { matrix, rms_m: (squares / points.len() as f64).sqrt() }
}

/// Turns a point about the centre.
#[must_use]
pub fn turn(matrix: &Matrix3<f64>, centre: Point, point: Point) -> Point {
    centre + matrix * (point - centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn a_rotation_is_undone_and_a_reflection_only_when_allowed() {
        let points = [
            Point::new(1.0, 2.0, 0.5),
            Point::new(-1.0, 0.3, 0.8),
            Point::new(0.4, -0.7, 1.9),
            Point::new(1.3, 0.2, -0.4),
        ];
        let centre = Point::new(0.2, -0.1, 0.3);
        let turn_by = Rotation3::new(Vector3::new(0.3, -1.1, 0.7)).into_inner();
        let turned = points.map(|point| turn(&turn_by, centre, point));
        let fit = rotation(&points, &turned, centre, false);
        assert!(fit.rms_m < 1e-12 && (fit.matrix - turn_by).norm() < 1e-12);
        let mirrored = turned.map(|point| Point::new(-point.x, point.y, point.z));
        let origin = Point::origin();
        let there = points.map(|point| point - centre.coords);
        let mirrored_there = mirrored.map(|point| point - Vector3::new(-centre.x, centre.y, centre.z));
        assert!(rotation(&there, &mirrored_there, origin, true).rms_m < 1e-12);
        assert!(rotation(&there, &mirrored_there, origin, false).rms_m > 0.1);
        assert!((rotation(&there, &mirrored_there, origin, false).matrix.determinant() - 1.0).abs() < 1e-12);
    }
}
