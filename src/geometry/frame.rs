//! The frame of a solution that path lengths leave free.
//!
//! With source and camera in one point p0, path lengths are the same for any rotation about p0 and for the mirror
//! image. In the canonical frame p0 is where its station lies and the first patch is on the +x axis. The next patch
//! that is clearly not in line with it is in the xy plane with y > 0. The next that is clearly not in that plane is at
//! z > 0. That also picks one of the two mirror images: the data do not say which is the true one. Clearly means by
//! more than a tenth of its range, so that noise does not choose; where no patch is, the one farthest off is taken.
//!
//! With stations in line, path lengths are the same for any rotation about that line, and for the mirror image in any
//! plane through it. There the first patch off the line lies in the half plane through the line and +y (for a line
//! along y: +z), the next off that plane on the side of the line's direction crossed with that half plane's.

use nalgebra::{Matrix3, Vector3};

use super::Point;

/// Directions closer than this (as a sine) count as in line, or in plane, while there are others.
const IN_LINE: f64 = 0.1;
/// Closer than this they always do.
const EXACTLY: f64 = 1e-9;

/// The first direction that is off by more than [`IN_LINE`], else the one that is farthest off; `None` if none is off
/// at all. `off` gives what of it is off.
fn first_off<T>(arms: &[Vector3<f64>], off: impl Fn(&Vector3<f64>) -> (f64, T)) -> Option<T> {
    let all: Vec<(f64, T)> =
        arms.iter().filter(|arm| arm.norm() > 0.0).map(|arm| (off(arm).0.abs() / arm.norm(), off(arm).1)).collect();
    let most = all.iter().map(|(sine, _)| *sine).fold(0.0, f64::max);
    all.into_iter().find(|(sine, _)| *sine > EXACTLY && *sine >= most.min(IN_LINE)).map(|(_, value)| value)
}

/// What of a direction is at a right angle to `axis`: its length, and its direction.
fn aside(arm: &Vector3<f64>, axis: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let off = arm - axis * arm.dot(axis);
    (off.norm(), off.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros))
}

/// Orthogonal matrix that turns points (in order of their ids) about `centre` into the canonical frame; a reflection
/// where need be.
#[must_use]
pub fn canonical(points: &[Point], centre: Point) -> Matrix3<f64> {
    let arms: Vec<Vector3<f64>> = points.iter().map(|point| point - centre).collect();
    let Some(x) = arms.iter().find_map(|arm| arm.try_normalize(f64::MIN_POSITIVE)) else {
        return Matrix3::identity();
    };
    let y = first_off(&arms, |arm| aside(arm, &x)).unwrap_or_else(|| any_normal(x));
    let z = x.cross(&y);
    let height = first_off(&arms, |arm| (arm.dot(&z), arm.dot(&z)));
    let z = if height.is_some_and(|height| height < 0.0) { -z } else { z };
    Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()])
}

/// Orthogonal matrix that turns points about the line through `centre` along `axis` into the frame of stations in line;
/// a reflection where need be.
#[must_use]
pub fn about(points: &[Point], centre: Point, axis: Vector3<f64>) -> Matrix3<f64> {
    let Some(along) = axis.try_normalize(f64::MIN_POSITIVE) else {
        return Matrix3::identity();
    };
    let arms: Vec<Vector3<f64>> = points.iter().map(|point| point - centre).collect();
    let Some(from) = first_off(&arms, |arm| aside(arm, &along)) else {
        return Matrix3::identity();
    };
    let to = [Vector3::y(), Vector3::z()].into_iter().find_map(|up| (up - along * up.dot(&along)).try_normalize(0.1));
    let to = to.expect("a line is not along both y and z");
    let (side_from, side_to) = (along.cross(&from), along.cross(&to));
    let height = first_off(&arms, |arm| (arm.dot(&side_from), arm.dot(&side_from)));
    let sign = if height.is_some_and(|height| height < 0.0) { -1.0 } else { 1.0 };
    along * along.transpose() + to * from.transpose() + sign * side_to * side_from.transpose()
}

/// Some unit vector at a right angle to `x`.
fn any_normal(x: Vector3<f64>) -> Vector3<f64> {
    let least = x.iamin();
    let axis = Vector3::from_fn(|i, _| if i == least { 1.0 } else { 0.0 });
    (axis - x * axis.dot(&x)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procrustes::turn;
    use nalgebra::Rotation3;

    #[test]
    fn every_rotation_and_mirror_image_gives_the_same_canonical_points() {
        let centre = Point::new(0.3, 0.1, -0.2);
        let points = [
            Point::new(1.0, 2.0, 0.5),
            Point::new(-1.0, 0.3, 0.8),
            Point::new(0.4, -0.7, 1.9),
            Point::new(1.3, 0.2, -0.4),
        ];
        let in_frame = |points: &[Point]| -> Vec<Point> {
            let matrix = canonical(points, centre);
            points.iter().map(|point| turn(&matrix, centre, *point)).collect()
        };
        let expected = in_frame(&points);
        assert!(
            (expected[0].y - centre.y).abs() < 1e-12
                && (expected[0].z - centre.z).abs() < 1e-12
                && expected[0].x > centre.x
        );
        assert!((expected[1].z - centre.z).abs() < 1e-12 && expected[1].y > centre.y && expected[2].z > centre.z);
        for mirror in [1.0, -1.0] {
            let by = Rotation3::new(Vector3::new(0.9, 0.4, -1.3)).into_inner()
                * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror));
            let turned: Vec<Point> = points.iter().map(|point| turn(&by, centre, *point)).collect();
            let solution = in_frame(&turned);
            assert!(solution.iter().zip(&expected).all(|(a, b)| (a - b).norm() < 1e-12));
        }
    }

    #[test]
    fn every_turn_about_a_line_and_mirror_image_through_it_gives_the_same_points() {
        let (centre, axis) = (Point::new(0.3, 0.1, -0.2), Vector3::new(0.8, 0.1, 0.0));
        let points = [Point::new(1.0, 2.0, 0.5), Point::new(-1.0, 0.3, 0.8), Point::new(0.4, -0.7, 1.9)];
        let in_frame = |points: &[Point]| -> Vec<Point> {
            let matrix = about(points, centre, axis);
            points.iter().map(|point| turn(&matrix, centre, *point)).collect()
        };
        let expected = in_frame(&points);
        let along = axis.normalize();
        assert!(points.iter().zip(&expected).all(|(a, b)| ((a - b).dot(&along)).abs() < 1e-12));
        let mirror = Matrix3::identity() - 2.0 * along.cross(&Vector3::z()) * along.cross(&Vector3::z()).transpose();
        let rotation = Rotation3::new(along * 1.3).into_inner();
        for by in [rotation, rotation * mirror] {
            let turned: Vec<Point> = points.iter().map(|point| turn(&by, centre, *point)).collect();
            assert!(in_frame(&turned).iter().zip(&expected).all(|(a, b)| (a - b).norm() < 1e-12));
        }
    }

    #[test]
    fn points_in_line_or_at_the_centre_have_a_frame() {
        let line = [Point::origin(), Point::new(0.0, 0.0, 2.0), Point::new(0.0, 0.0, 3.0)];
        let matrix = canonical(&line, Point::origin());
        assert!((matrix * matrix.transpose() - Matrix3::identity()).norm() < 1e-12);
        assert!((turn(&matrix, Point::origin(), line[1]) - Point::new(2.0, 0.0, 0.0)).norm() < 1e-12);
        assert_eq!(canonical(&[Point::origin()], Point::origin()), Matrix3::identity());
    }
}
