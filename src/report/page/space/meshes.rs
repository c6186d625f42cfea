//! Bodies and faces of the scene: error ellipsoids, disks, planes, walls. Those of one kind are one mesh.

use plotly::common::{ColorScale, ColorScalePalette};
use plotly::{Mesh3D, Trace};

use super::super::plot::{PALE, short};
use super::coordinates;
use crate::exchange::ply;
use crate::report::scene::Placed;
use crate::tables::{Hypothesis, PatchFootprint, Plane, Vertex};

/// Rings and sectors of a drawn ellipsoid.
const RINGS: usize = 6;
const SECTORS: usize = 10;
/// Corners of a drawn disk.
const CORNERS: usize = 20;
/// Ellipsoids that are drawn at most: beyond, points alone.
const ELLIPSOIDS: usize = 600;
/// Margin of a plane around its patches, as a share of its extent.
const MARGIN: f64 = 0.1;
/// How much of what lies behind a surface it hides.
const MESH: f64 = 0.85;
/// Side of a drawn wall, in extents of the patches.
const WALL: f64 = 0.8;

/// How a mesh looks.
struct Look<'a> {
    name: &'a str,
    group: &'a str,
    colour: &'a str,
    opacity: f64,
}

/// One mesh; none without faces.
fn mesh(corners: &[[f64; 3]], faces: &[[usize; 3]], look: Look<'_>) -> Vec<Box<dyn Trace>> {
    if faces.is_empty() {
        return Vec::new();
    }
    let [x, y, z] = coordinates(corners.iter().copied());
    let corner = |k: usize| -> Vec<usize> { faces.iter().map(|face| face[k]).collect() };
    let mesh = Mesh3D::new(x, y, z, Some(corner(0)), Some(corner(1)), Some(corner(2)));
    let mesh = mesh.color(look.colour.to_owned()).opacity(look.opacity).hover_info(plotly::common::HoverInfo::Skip);
    vec![mesh.name(look.name).legend_group(look.group).show_legend(true)]
}

/// All ellipsoids of one kind as one mesh: a sphere's corners, stretched by each covariance.
pub fn ellipsoids(patches: &[&Placed], factor: f64, kind: &str, colour: &str) -> Vec<Box<dyn Trace>> {
    let (mut corners, mut faces): (Vec<[f64; 3]>, Vec<[usize; 3]>) = (Vec::new(), Vec::new());
    for placed in patches.iter().take(ELLIPSOIDS) {
        let Some(axes) = placed.semi_axes_m else { continue };
        let first = corners.len();
        for ring in 0..=RINGS {
            let polar = std::f64::consts::PI * ring as f64 / RINGS as f64;
            for sector in 0..SECTORS {
                let azimuth = std::f64::consts::TAU * sector as f64 / SECTORS as f64;
                let unit = [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()];
                let along = |axis: usize| (0..3).map(|k| unit[k] * axes[k][axis]).sum::<f64>();
                corners.push(std::array::from_fn(|axis| placed.at()[axis] + 2.0 * factor * along(axis)));
            }
        }
        for (ring, sector) in (0..RINGS).flat_map(|ring| (0..SECTORS).map(move |sector| (ring, sector))) {
            let corner = |ring: usize, sector: usize| first + ring * SECTORS + sector % SECTORS;
            let [a, b] = [corner(ring, sector), corner(ring, sector + 1)];
            let [c, d] = [corner(ring + 1, sector), corner(ring + 1, sector + 1)];
            faces.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh(&corners, &faces, Look { name: &format!("{kind}: 2 sd"), group: kind, colour, opacity: 0.3 })
}

/// Disks of the patches whose size and direction are known, true to scale.
pub fn disks(patches: &[&Placed], footprints: &[PatchFootprint], kind: &str, colour: &str) -> Vec<Box<dyn Trace>> {
    let (mut corners, mut faces): (Vec<[f64; 3]>, Vec<[usize; 3]>) = (Vec::new(), Vec::new());
    for footprint in footprints {
        let Some(placed) = patches.iter().find(|placed| placed.patch.patch == footprint.patch) else { continue };
        let normal = [footprint.normal_x, footprint.normal_y, footprint.normal_z];
        let first = corners.len();
        corners.push(placed.at());
        corners.extend(circle(placed.at(), normal, footprint.size_m / 2.0));
        faces.extend((0..CORNERS).map(|n| [first, first + 1 + n, first + 1 + (n + 1) % CORNERS]));
    }
    mesh(&corners, &faces, Look { name: &format!("{kind}: disks"), group: kind, colour, opacity: 0.75 })
}

/// Corners of a circle.
fn circle(middle: [f64; 3], normal: [f64; 3], radius_m: f64) -> Vec<[f64; 3]> {
    let [along, up] = across(normal);
    let corner = |n: usize| {
        let (sin, cos) = (std::f64::consts::TAU * n as f64 / CORNERS as f64).sin_cos();
        std::array::from_fn(|axis| middle[axis] + radius_m * (cos * along[axis] + sin * up[axis]))
    };
    (0..CORNERS).map(corner).collect()
}

/// Two unit vectors at right angles to a unit vector and to each other.
fn across(normal: [f64; 3]) -> [[f64; 3]; 2] {
    // The axis that the normal has least of makes the safest product.
    let least = (0..3).min_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs())).unwrap_or(0);
    let axis: [f64; 3] = std::array::from_fn(|k| f64::from(u8::from(k == least)));
    let along = cross(normal, axis);
    let length = crate::report::scene::norm(along).max(f64::MIN_POSITIVE);
    let along = along.map(|value| value / length);
    [along, cross(normal, along)]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

/// Planes through patches, each as a rectangle around its patches.
pub fn planes(planes: &[Plane], patches: &[Placed]) -> Vec<Box<dyn Trace>> {
    let rectangle = |plane: &Plane| {
        let normal = [plane.normal_x, plane.normal_y, plane.normal_z];
        let members: Vec<[f64; 3]> =
            patches.iter().filter(|placed| plane.patches.contains(&placed.patch.patch)).map(Placed::at).collect();
        (!members.is_empty()).then(|| rectangle(normal, plane.offset_m, &members))
    };
    let corners: Vec<[f64; 3]> = planes.iter().filter_map(rectangle).flatten().collect();
    mesh(
        &corners,
        &halves(corners.len()),
        Look { name: "planes through patches", group: "planes", colour: PALE, opacity: 0.2 },
    )
}

/// Corners of the rectangle around points, in their plane.
fn rectangle(normal: [f64; 3], offset_m: f64, members: &[[f64; 3]]) -> [[f64; 3]; 4] {
    let axes = across(normal);
    let bounds = axes.map(|axis| {
        let along = || members.iter().map(|member| dot(*member, axis));
        let (from, to) = (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
        (from, to)
    });
    let beside = MARGIN * bounds.iter().map(|(from, to)| to - from).fold(0.0, f64::max);
    let [(left, right), (low, high)] = bounds.map(|(from, to)| (from - beside, to + beside));
    [(left, low), (right, low), (right, high), (left, high)]
        .map(|(along, up)| std::array::from_fn(|k| offset_m * normal[k] + along * axes[0][k] + up * axes[1][k]))
}

/// Two triangles for each four corners.
fn halves(corners: usize) -> Vec<[usize; 3]> {
    (0..corners / 4).flat_map(|n| [[4 * n, 4 * n + 1, 4 * n + 2], [4 * n, 4 * n + 2, 4 * n + 3]]).collect()
}

/// Hidden surfaces between points, coloured by their standard deviation up to one that is large.
pub fn surfaces(vertices: &[Vertex], [least_mm, most_mm]: [f64; 2]) -> Vec<Box<dyn Trace>> {
    let faces = ply::faces(vertices);
    if faces.is_empty() {
        return Vec::new();
    }
    let [x, y, z] = coordinates(vertices.iter().map(|vertex| [vertex.x_m, vertex.y_m, vertex.z_m]));
    let corner = |k: usize| -> Vec<usize> { faces.iter().map(|face| face[k]).collect() };
    let sds_mm: Vec<f64> = vertices.iter().map(|vertex| short(1e3 * vertex.sd_m, 3)).collect();
    let mesh = Mesh3D::new(x, y, z, Some(corner(0)), Some(corner(1)), Some(corner(2)));
    let mesh = mesh.intensity(sds_mm).c_min(least_mm).c_max(most_mm).show_scale(false);
    let mesh = mesh.color_scale(ColorScale::Palette(ColorScalePalette::Viridis)).opacity(MESH);
    vec![mesh.name("surface between the points").show_legend(true).hover_template("sd %{intensity} mm<extra></extra>")]
}

/// Planes that reflect light and are no patches, each as a square; how far they reach is not known.
pub fn walls(walls: &[Hypothesis], extent_m: f64) -> Vec<Box<dyn Trace>> {
    let square = |wall: &Hypothesis| {
        let normal = [wall.normal_x?, wall.normal_y?, wall.normal_z?];
        let foot = [wall.x_m, wall.y_m, wall.z_m];
        let ends = across(normal).map(|axis| axis.map(|value| value * WALL * extent_m));
        let corner = |(a, b): (f64, f64)| std::array::from_fn(|k| foot[k] + a * ends[0][k] + b * ends[1][k]);
        Some([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(corner))
    };
    let corners: Vec<[f64; 3]> = walls.iter().filter_map(square).flatten().collect();
    mesh(
        &corners,
        &halves(corners.len()),
        Look { name: "walls that reflect", group: "walls", colour: PALE, opacity: 0.15 },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_has_its_size_and_faces_its_normal() {
        let (middle, normal) = ([1.0, 2.0, 3.0], [0.6, 0.0, 0.8]);
        for corner in circle(middle, normal, 0.05) {
            let from_middle: [f64; 3] = std::array::from_fn(|k| corner[k] - middle[k]);
            assert!((crate::report::scene::norm(from_middle) - 0.05).abs() < 1e-12);
            assert!(dot(from_middle, normal).abs() < 1e-12);
        }
    }

    #[test]
    fn a_plane_is_a_rectangle_around_its_patches() {
        let members = [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.3, 0.5, 2.0]];
        let corners = rectangle([0.0, 0.0, 1.0], 2.0, &members);
        let along = |axis: usize| {
            let values = || corners.iter().map(|corner| corner[axis]);
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
        };
        let near = |(a, b): (f64, f64), (c, d): (f64, f64)| (a - c).abs() < 1e-12 && (b - d).abs() < 1e-12;
        assert!(near(along(0), (-0.1, 1.1)) && near(along(1), (-0.1, 0.6)) && near(along(2), (2.0, 2.0)));
    }
}
