//! Where the light of a strip comes from: over a glossy one it moves with the lit point.
//!
//! A lobe throws most light back from those points of a strip whose mirror direction is nearest to the exit. The
//! light's mean way then differs from the way over the strip's centre; the difference grows as the strip is turned away
//! from the mirror law. At the mirror law itself the way is stationary (Fermat), and nothing changes to first order.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::Point;

/// Rings and spokes of points that stand for a strip.
const RINGS: usize = 4;
const SPOKES: usize = 12;
/// Somebody who turns a mirror until the signal is largest stops within this share of its lobe.
const ALIGNED: f64 = 0.25;

/// How a strip reflects.
#[derive(Clone, Copy, Debug)]
pub enum Surface {
    /// Diffusely, or from a point: from its centre.
    Diffuse,
    /// Unknown: light may come from anywhere on the strip, from other parts of it for other lit points.
    Unknown {
        /// Diameter.
        size_m: f64,
    },
    /// Into a lobe about the mirror direction.
    Glossy {
        /// Diameter.
        size_m: f64,
        /// Standard deviation of the angle from the mirror direction.
        lobe_rad: f64,
        /// Unit normal; absent: turned to where it throws most light, as far as a person can see that.
        normal: Option<Vector3<f64>>,
    },
}

impl Surface {
    /// Standard deviation of the normal's unknown tilt, rad; `None` where there is none to find.
    pub(super) fn tilt_sd_rad(&self) -> Option<f64> {
        match self {
            Self::Glossy { lobe_rad, normal: None, .. } => Some(ALIGNED * lobe_rad),
            _ => None,
        }
    }

    /// The normal before any tilt: as given, or the mean of the bisectors between the ways to the lit points and to the
    /// exit.
    pub(super) fn normal(&self, centre: Point, lit: &[Point], exit: Point) -> Vector3<f64> {
        if let Self::Glossy { normal: Some(normal), .. } = self {
            return *normal;
        }
        let bisector = |lit: &Point| ((lit - centre).normalize() + (exit - centre).normalize()).normalize();
        lit.iter().map(bisector).sum::<Vector3<f64>>().normalize()
    }

    /// How much longer the mean way of the light is than that over the centre, m.
    pub(super) fn shift_m(&self, centre: Point, normal: Vector3<f64>, lit: Point, exit: Point) -> f64 {
        let Self::Glossy { size_m, lobe_rad, .. } = *self else { return 0.0 };
        let way_m = |at: Point| (lit - at).norm() + (exit - at).norm();
        let [u, v] = tangents(normal);
        let (mut weights, mut ways_m) = (0.0, 0.0);
        for ring in 0..RINGS {
            // Rings of equal area.
            let radius_m = 0.5 * size_m * ((ring as f64 + 0.5) / RINGS as f64).sqrt();
            for spoke in 0..SPOKES {
                let (sin, cos) = (TAU * (spoke as f64 + 0.5) / SPOKES as f64).sin_cos();
                let at = centre + radius_m * (cos * u + sin * v);
                let (to_lit, to_exit) = ((lit - at).normalize(), (exit - at).normalize());
                let mirrored = 2.0 * normal.dot(&to_lit) * normal - to_lit;
                let off = mirrored.angle(&to_exit) / lobe_rad;
                let weight = (-0.5 * off * off).exp();
                weights += weight;
                ways_m += weight * way_m(at);
            }
        }
        // Far off the lobe all weights underflow to 0, and no mean is defined.
        if weights > 0.0 { ways_m / weights - way_m(centre) } else { 0.0 }
    }

    /// Variance of the way, m^2, for light from an unknown point of the strip.
    pub(super) fn variance_m2(&self, centre: Point, normal: Vector3<f64>, lit: Point, exit: Point) -> f64 {
        let Self::Unknown { size_m } = self else { return 0.0 };
        let slope = (lit - centre).normalize() + (exit - centre).normalize();
        let along = slope - normal * normal.dot(&slope);
        (0.5 * size_m).powi(2) * along.norm_squared()
    }
}

/// Two unit vectors at right angles to a normal; in flatland the first lies in the plane.
pub(super) fn tangents(normal: Vector3<f64>) -> [Vector3<f64>; 2] {
    let up = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let u = up.cross(&normal).normalize();
    [u, normal.cross(&u)]
}
