//! What throws light back from out of sight, and the way of light over it.

use nalgebra::{Matrix3, Vector3};

use super::Focus;
use crate::Point;

/// What lies at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// A patch: light goes to it and on.
    Patch,
    /// A plane that reaches far: a floor, a ceiling, a wall, a mirror. Its light begins with the shortest way over it,
    /// that of a mirror, whatever it scatters later.
    Plane {
        /// The place of a plane is the foot of the perpendicular from here.
        middle: Point,
    },
}

impl Surface {
    /// Unit normal of a plane at `at`, towards the middle; `None` for a patch.
    #[must_use]
    pub fn normal(&self, at: Point) -> Option<Vector3<f64>> {
        match self {
            Self::Patch => None,
            Self::Plane { middle } => Some((middle - at).normalize()),
        }
    }

    /// Length of the way from one focus over the surface at `at` to the other, and how it changes as `at` moves; `None`
    /// where no light goes there.
    ///
    /// Over a plane `s^2 = |a - b|^2 + 4 h_a h_b` with heights h: the way to the mirror image. Between patches of one
    /// wall it may run along that wall, so walls say nothing of it.
    #[must_use]
    pub fn way(&self, foci: [&Focus; 2], at: Point) -> Option<(f64, Vector3<f64>)> {
        let Self::Plane { middle } = self else {
            let arms = foci.map(|focus| at - focus.point);
            let lengths_m = arms.map(|arm| arm.norm().max(f64::MIN_POSITIVE));
            let slope = arms[0] / lengths_m[0] + arms[1] / lengths_m[1];
            return foci.iter().all(|focus| focus.faces(at, 0.0)).then_some((lengths_m[0] + lengths_m[1], slope));
        };
        let depth_m = (at - middle).norm();
        let outward = (at - middle) / depth_m;
        let heights_m = foci.map(|focus| -outward.dot(&(focus.point - at)));
        if depth_m == 0.0 || heights_m.iter().any(|height_m| *height_m <= 0.0) {
            return None;
        }
        // The plane moves outward as `at` does, and leans as it moves across.
        let across = |focus: &Focus| {
            let arm = focus.point - middle;
            outward - (arm - outward * outward.dot(&arm)) / depth_m
        };
        let length_m = ((foci[0].point - foci[1].point).norm_squared() + 4.0 * heights_m[0] * heights_m[1]).sqrt();
        let slope = 2.0 * (heights_m[1] * across(foci[0]) + heights_m[0] * across(foci[1])) / length_m;
        Some((length_m, slope))
    }

    /// Profiles that must have been able to record a surface, as a share: a plane may lie in the wall of every second
    /// patch, over which no light comes.
    pub(super) const fn share(&self) -> f64 {
        match self {
            Self::Patch => 0.5,
            Self::Plane { .. } => 0.25,
        }
    }
}

/// Inverse of the information of some slopes of lengths that vary by `variance_m2`; `None` where they leave a direction
/// open. In flatland nothing moves along z.
pub(super) fn covariance(
    slopes: impl Iterator<Item = Vector3<f64>>,
    variance_m2: f64,
    dimensions: usize,
) -> Option<Matrix3<f64>> {
    let mut information: Matrix3<f64> = slopes.map(|slope| slope * slope.transpose() / variance_m2).sum();
    if dimensions == 2 {
        information[(2, 2)] = 1e12 * information.trace();
    }
    information.try_inverse().filter(|covariance| covariance.iter().all(|value| value.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Compared with the shortest of many ways over points of the plane, and with finite differences.
    #[test]
    fn the_way_over_a_plane_is_the_shortest() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut point = |reach_m: f64| Point::from(Vector3::from_fn(|_, _| rng.random_range(-reach_m..reach_m)));
        let mut count = 0;
        while count < 20 {
            let focus = |point: Point| Focus { point, normal: None };
            let (a, b, at, middle) = (focus(point(1.0)), focus(point(1.0)), point(2.0), point(0.2));
            let plane = Surface::Plane { middle };
            let Some((length_m, slope)) = plane.way([&a, &b], at) else { continue };
            count += 1;
            let out = (at - middle).normalize();
            let one = out.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
            let grid = |k: i32| f64::from(k) * 0.05;
            let over = |i: i32, k: i32| at + one * grid(i) + out.cross(&one) * grid(k);
            let ways = (-100..=100).flat_map(|i| (-100..=100).map(move |k| (i, k)));
            let shortest_m = ways
                .map(|(i, k)| (over(i, k) - a.point).norm() + (over(i, k) - b.point).norm())
                .fold(f64::INFINITY, f64::min);
            assert!(shortest_m >= length_m - 1e-9 && shortest_m < length_m + 0.02, "{shortest_m} {length_m}");
            for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                let moved = |by: f64| plane.way([&a, &b], at + by * axis).expect("nearly the same plane").0;
                let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((difference - slope.dot(&axis)).abs() < 1e-5, "{difference} {slope}");
            }
        }
    }
}
