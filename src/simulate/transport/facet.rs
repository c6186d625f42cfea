//! Facets: flat pieces of surface, and the points that represent their areas.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use crate::simulate::keys::{Disk, Lobe, Rectangle};
use crate::units::PatchId;

/// A point or direction.
pub type Vector = Vector3<f64>;

/// A point that represents a share of a facet's area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Element {
    /// Where it is.
    pub at: Vector,
    /// Its share of the area.
    pub share: f64,
}

/// Edge of a facet.
#[derive(Clone, Copy, Debug)]
pub enum Outline {
    /// Round, of this radius about the centre.
    Disk {
        /// Radius.
        radius_m: f64,
    },
    /// A corner, and the edges from there, at right angles.
    Rectangle {
        /// Corner.
        corner: Vector,
        /// Edges.
        edges: [Vector; 2],
    },
}

/// A flat piece of surface.
#[derive(Clone, Debug)]
pub struct Facet {
    /// Number of the patch; 0 for objects that are no patch.
    pub id: PatchId,
    /// Centre.
    pub centre: Vector,
    /// Unit vector towards the lit side.
    pub normal: Vector,
    /// Area.
    pub area_m2: f64,
    /// Reflected share of the light.
    pub reflectance: f64,
    /// Glossy part, if any.
    pub lobe: Option<Lobe>,
    /// Whether it reflects like a perfect mirror.
    pub mirror: bool,
    /// Edge.
    pub outline: Outline,
    /// Points for integrals over the area.
    pub elements: Vec<Element>,
}

impl Facet {
    /// A patch, with `rings` rings of elements.
    pub fn patch(id: PatchId, disk: &Disk, mirror: bool, rings: usize) -> Self {
        let radius_m = 0.5 * disk.size_m;
        let normal = Vector::from(disk.normal).normalize();
        let centre = Vector::from(disk.position_m);
        Self {
            id,
            centre,
            normal,
            area_m2: PI * radius_m * radius_m,
            reflectance: disk.reflectance,
            lobe: disk.lobe,
            mirror,
            outline: Outline::Disk { radius_m },
            elements: round_elements(centre, normal, radius_m, rings),
        }
    }

    /// A whole rectangle, without elements: it only blocks.
    pub fn blocker(rectangle: &Rectangle) -> Self {
        let (corner, edges) = (Vector::from(rectangle.corner_m), rectangle.edges_m.map(Vector::from));
        Self::rectangle(corner, edges, 0.0, Vec::new())
    }

    /// The cells of a rectangle that reflects light.
    pub fn cells(rectangle: &Rectangle) -> Vec<Self> {
        let Some(cell_m) = rectangle.cell_m.filter(|_| rectangle.reflectance > 0.0) else {
            return Vec::new();
        };
        let (corner, [u, v]) = (Vector::from(rectangle.corner_m), rectangle.edges_m.map(Vector::from));
        let count = |edge: Vector| (edge.norm() / cell_m).ceil().max(1.0) as usize;
        let (columns, rows) = (count(u), count(v));
        let edges = [u / columns as f64, v / rows as f64];
        let cell = |k: usize| {
            let corner = corner + edges[0] * (k % columns) as f64 + edges[1] * (k / columns) as f64;
            // Gauss and Legendre's two points along each edge.
            let nodes = [0.5 - 0.5 / 3_f64.sqrt(), 0.5 + 0.5 / 3_f64.sqrt()];
            let point = |a: f64, b: f64| Element { at: corner + edges[0] * a + edges[1] * b, share: 0.25 };
            let elements = nodes.iter().flat_map(|&a| nodes.map(|b| point(a, b))).collect();
            Self::rectangle(corner, edges, rectangle.reflectance, elements)
        };
        (0..columns * rows).map(cell).collect()
    }

    fn rectangle(corner: Vector, edges: [Vector; 2], reflectance: f64, elements: Vec<Element>) -> Self {
        let across = edges[0].cross(&edges[1]);
        Self {
            id: 0,
            centre: corner + 0.5 * (edges[0] + edges[1]),
            normal: across.normalize(),
            area_m2: across.norm(),
            reflectance,
            lobe: None,
            mirror: false,
            outline: Outline::Rectangle { corner, edges },
            elements,
        }
    }

    /// Where a line from `from` through `to` meets the facet, as a multiple of the way to `to`; `None` if it misses the
    /// facet or is parallel to it.
    pub fn hit(&self, from: Vector, to: Vector) -> Option<f64> {
        let along = self.normal.dot(&(to - from));
        if along == 0.0 {
            return None;
        }
        let share = self.normal.dot(&(self.centre - from)) / along;
        self.covers(from + share * (to - from)).then_some(share)
    }

    /// Whether a point of its plane is within its outline.
    pub fn covers(&self, point: Vector) -> bool {
        match self.outline {
            Outline::Disk { radius_m } => (point - self.centre).norm_squared() <= radius_m * radius_m,
            Outline::Rectangle { corner, edges } => edges.iter().all(|edge| {
                let along = (point - corner).dot(edge) / edge.norm_squared();
                (0.0..=1.0).contains(&along)
            }),
        }
    }

    /// Radius around the centre that contains it.
    pub fn radius_m(&self) -> f64 {
        match self.outline {
            Outline::Disk { radius_m } => radius_m,
            Outline::Rectangle { edges, .. } => 0.5 * (edges[0] + edges[1]).norm(),
        }
    }

    /// Mirror image of a point in its plane.
    pub fn image(&self, point: Vector) -> Vector {
        point - 2.0 * self.normal.dot(&(point - self.centre)) * self.normal
    }

    /// Light that the facet reflects per solid angle and cosine, over the incident light (1/sr), from one point to
    /// another.
    pub fn reflection(&self, from: Vector, at: Vector, to: Vector) -> f64 {
        let diffuse = self.reflectance / PI;
        let Some(Lobe { share, width_rad }) = self.lobe else {
            return diffuse;
        };
        let (incoming, outgoing) = ((at - from).normalize(), (to - at).normalize());
        let cosines = (-self.normal.dot(&incoming)).max(0.0) * self.normal.dot(&outgoing).max(0.0);
        if cosines == 0.0 {
            return 0.0;
        }
        let mirrored = incoming - 2.0 * self.normal.dot(&incoming) * self.normal;
        let angle = (mirrored - outgoing).norm().min(2.0) * 0.5;
        let off = 2.0 * angle.asin() / width_rad;
        let lobe = (-0.5 * off * off).exp() / (TAU * width_rad * width_rad);
        (1.0 - share) * diffuse + share * self.reflectance * lobe / cosines.sqrt()
    }
}

/// Points of a disk: Gauss-Legendre nodes in the square of the radius, each a ring of equal angles. Exact for
/// polynomials of degree `4 rings - 1` or the number of spokes minus one. Symmetric about the centre, so that their
/// mean is the centre.
fn round_elements(centre: Vector, normal: Vector, radius_m: f64, rings: usize) -> Vec<Element> {
    let least = normal.iamin();
    let u = (Vector::ith(least, 1.0) - normal * normal[least]).normalize();
    let v = normal.cross(&u);
    let spokes = 2 * rings + 2;
    let ring = |(node, weight): (f64, f64)| {
        let radius_m = radius_m * node.sqrt();
        let spoke = move |k: usize| {
            let (sin, cos) = (TAU * (k as f64 + 0.5) / spokes as f64).sin_cos();
            Element { at: centre + radius_m * (cos * u + sin * v), share: weight / spokes as f64 }
        };
        (0..spokes).map(spoke)
    };
    legendre(rings).into_iter().flat_map(ring).collect()
}

/// Nodes and weights of the Gauss-Legendre rule on 0 to 1, by Newton's method on the polynomial.
fn legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    let node = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 0.0;
        for _ in 0..100 {
            let (mut before, mut value) = (1.0, x);
            for k in 2..=count {
                let k = k as f64;
                (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
            }
            slope = n * (x * value - before) / (x * x - 1.0);
            let step = value / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        (0.5 * (x + 1.0), 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_is_exact_for_polynomials() {
        for count in 1..9 {
            let rule = legendre(count);
            for power in 0..2 * count {
                let sum: f64 = rule.iter().map(|(x, weight)| weight * x.powi(power as i32)).sum();
                assert!((sum - 1.0 / (power as f64 + 1.0)).abs() < 1e-13, "{count} nodes, power {power}: {sum}");
            }
        }
    }

    #[test]
    fn elements_have_the_disks_moments() {
        let (centre, normal) = (Vector::new(0.1, 0.2, 0.3), Vector::new(0.6, 0.0, 0.8));
        for rings in 1..6 {
            let elements = round_elements(centre, normal, 0.5, rings);
            let mean: Vector = elements.iter().map(|element| element.at * element.share).sum();
            let square: f64 = elements.iter().map(|element| element.share * (element.at - centre).norm_squared()).sum();
            assert!((mean - centre).norm() < 1e-14 && (square - 0.125).abs() < 1e-14);
            assert!(elements.iter().all(|element| normal.dot(&(element.at - centre)).abs() < 1e-14));
        }
    }

    #[test]
    fn a_narrow_lobe_gives_back_what_the_reflectance_says() {
        let disk = Disk {
            position_m: [0.0; 3],
            normal: [0.0, 0.0, 1.0],
            size_m: 0.01,
            reflectance: 0.7,
            role: crate::campaign::keys::PatchRole::Visible,
            lobe: Some(Lobe { share: 0.4, width_rad: 0.08 }),
        };
        let facet = Facet::patch(1, &disk, false, 1);
        let from = Vector::new(-1.0, 0.0, 2.0);
        let (steps, mut sum) = (2000, 0.0);
        for i in 0..steps {
            let cosine = (f64::from(i) + 0.5) / f64::from(steps);
            let sine = (1.0 - cosine * cosine).sqrt();
            for k in 0..steps {
                let turn = TAU * f64::from(k) / f64::from(steps);
                let to = Vector::new(sine * turn.cos(), sine * turn.sin(), cosine);
                sum += facet.reflection(from, Vector::zeros(), to) * cosine * TAU / f64::from(steps * steps);
            }
        }
        assert!((sum - 0.7).abs() < 2e-3, "{sum}");
    }
}
