//! Points of hidden surfaces, with covariances and normals, from the first light that comes back to points of a wall.
//!
//! `d(p)` is the distance from a point `p` of the wall to the nearest point `x` of the surface. Its gradient in space
//! is the unit vector from `x` to `p`, so that value and gradient give `x = p - d grad d`; on a smooth surface the
//! gradient is the normal too. Where the lit point is fixed, the same holds for the length of the way from there over
//! the surface to the seen point. Neighbouring points of the wall tell value, gradient and curvature: a field is
//! fitted to them, which is exact for planes, spheres, cylinders, straight edges and corners.
//!
//! | module | does |
//! |---|---|
//! | `field` | a local field: value, direction, curvature; their covariance; the point that they give |
//! | `windows` | which neighbours a field is fitted to |
//! | `laws` | under which law light begins at each point of the wall |
//!
//! Where the nearest point jumps from one place to another, the gradient jumps too, and no field may be fitted across.
//! A window of neighbours starts where one field explains them, on one side if need be, and grows by neighbours that
//! the field predicts, as long as it explains all of them and agrees with what smaller windows said.
//!
//! Covariances have three parts: noise; the error of the law of first light, which is a smooth random function over the
//! wall ([`Scan::sigma_m`] sets its size and its length); and what the next smaller and the next larger window say
//! otherwise. The latter two are common to neighbours and do not average out.
//!
//! Source: Tsai et al., The Geometry of First-Returning Photons, CVPR 2017; Xin et al., A Theory of Fermat Paths,
//! CVPR 2019. Windows by agreement: Lepski, Theory Probab. Appl. 35:454, 1990.
//!
//! Not modelled: pairs of lit and seen point that move together apart, errors of the wall's places, later returns.

mod field;
mod laws;
mod windows;

#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;
pub use field::Kind;

/// Least number of places of the wall.
pub const LEAST: usize = 16;

/// Points of a wall lie in a line where their squares across it are below this share of those along it.
const IN_LINE: f64 = 1e-6;

/// A first return under one law of how light begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Length of its way.
    pub length_m: f64,
    /// Standard deviation.
    pub sd_m: f64,
    /// Logarithm of the likelihood of this law.
    pub log_likelihood: f64,
}

/// A point of the wall, with its first return as a step, an edge and a corner make it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The seen point.
    pub seen: Point,
    /// The first return. Its lengths are there and back where the lit point is the seen point, else from the lit point
    /// over the surface to the seen point.
    pub returns: [Return; 3],
}

/// First returns of a wall.
#[derive(Clone, Debug)]
pub struct Scan {
    /// The lit point; `None` where each seen point is lit itself.
    pub lit: Option<Point>,
    /// Unit normal of the wall, towards what is hidden.
    pub inwards: Vector3<f64>,
    /// Standard deviation of the response, as length of a way.
    pub sigma_m: f64,
    /// Points of the wall.
    pub places: Vec<Place>,
}

/// A point of a hidden surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Number of the place that it is nearest to.
    pub place: usize,
    /// Position.
    pub point: Point,
    /// Its covariance.
    pub covariance_m2: Matrix3<f64>,
    /// Unit vector away from the surface; the normal where the kind is [`Kind::Smooth`].
    pub normal: Vector3<f64>,
    /// Its covariance.
    pub normal_covariance: Matrix3<f64>,
    /// What part of the surface it is.
    pub kind: Kind,
    /// Curvatures of the surface, larger one first: positive where it is convex towards the wall. Of a smooth point.
    pub curvatures_per_m: Option<[f64; 2]>,
    /// Places of the wall that entered.
    pub places: usize,
    /// Chi-square over its degrees of freedom.
    pub misfit: f64,
}

/// The point of the surface that each place of the wall sees first, where its neighbours tell it. Places are fewer
/// than points where neighbours do not agree on one field.
///
/// # Panics
/// If a standard deviation is not positive, or `sigma_m` is not.
#[must_use]
pub fn surface_points(scan: &Scan, cancel: &Cancel) -> Vec<SurfacePoint> {
    assert!(scan.sigma_m > 0.0, "a response of some width");
    assert!(
        scan.places.iter().flat_map(|place| &place.returns).all(|one| one.sd_m > 0.0),
        "first returns have standard deviations"
    );
    if scan.places.len() < LEAST {
        return Vec::new();
    }
    let points: Vec<Point> = scan.places.iter().map(|place| place.seen).collect();
    let near = windows::neighbours(&points, windows::MOST, cancel);
    let likely = laws::by_likelihood(scan, &near);
    let fields = windows::fields(scan, &laws::samples(scan, &likely), &near, cancel);
    let shares = laws::by_curvature(scan, &near, &likely, &fields);
    let fields = windows::fields(scan, &laws::samples(scan, &shares), &near, cancel);
    let of_place = |(place, chosen): (usize, &Option<windows::Chosen>)| Some(chosen.as_ref()?.surface_point(place));
    fields.par_iter().enumerate().filter_map(of_place).collect()
}

/// Unit normal of the plane next to points of a wall, towards the side of `front`; `None` where they lie in a line.
#[must_use]
pub fn wall_normal(points: &[Point], front: &Point) -> Option<Vector3<f64>> {
    let middle = points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let arms = points.iter().map(|point| point.coords - middle);
    let eigen = arms.map(|arm| arm * arm.transpose()).sum::<Matrix3<f64>>().symmetric_eigen();
    let mut squares = eigen.eigenvalues;
    squares.as_mut_slice().sort_by(f64::total_cmp);
    let normal: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    let normal = if normal.dot(&(front.coords - middle)) < 0.0 { -normal } else { normal };
    (squares[1] > IN_LINE * squares[2]).then_some(normal)
}

impl Scan {
    /// Share of a way's length that is the field's: half of a way there and back.
    fn share(&self) -> f64 {
        if self.lit.is_some() { 1.0 } else { 0.5 }
    }

    /// Radius of the part of the surface that returns light within the response's width, at a distance.
    fn zone_m(&self, distance_m: f64) -> f64 {
        (self.sigma_m * distance_m.abs()).sqrt()
    }
}
