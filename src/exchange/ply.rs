//! Patches, points of surfaces and surfaces between them: PLY, the format of MeshLab, CloudCompare and Open3D.
//!
//! Patches: one vertex for each patch of the best solution: place in metres, a colour for the eye (visible grey,
//! hidden orange, mirror blue), number, kind (0, 1, 2). Then the standard deviation and the six numbers of the
//! covariance; these are NaN for start values, which have none.
//!
//! Points of a surface: place, normal (the direction to the wall where it is no normal), a colour by the standard
//! deviation (blue the surest, red from twice the median on), lit and seen patch of the wall, kind (0 smooth, 1 edge,
//! 2 corner, 3 unknown), then standard deviation and covariance, standard deviation of the normal, and number of the
//! shape that it lies on (0: none).
//!
//! Surfaces: their nodes with place, normal, a colour by the standard deviation as above, number of the mesh, standard
//! deviation along the normal and of the normal's direction; and triangles between neighbouring nodes, whose corners
//! turn as the normal does.
//!
//! Echoes of a lidar: place in the frame of the file, standard deviation along the beam, height, width and its standard
//! deviation, number of the echo and of the echoes of its pulse, GPS time.

use std::collections::BTreeMap;
use std::io::{self, Write};

use crate::tables::{Echo, Patch, SurfacePoint, Vertex};

/// Kinds of patches by their numbers, with the colour of each.
const KINDS: [(&str, [u8; 3]); 3] =
    [("visible", [160, 160, 160]), ("hidden", [230, 120, 20]), ("mirror", [40, 110, 220])];

/// Kinds of points of a surface by their numbers.
const SURFACE_KINDS: [&str; 4] = ["smooth", "edge", "corner", "unknown"];

/// Writes the best alternative of the patches; says how many.
///
/// # Errors
/// When `out` cannot be written.
pub fn write(out: &mut impl Write, patches: &[Patch]) -> io::Result<usize> {
    let best: Vec<&Patch> = patches.iter().filter(|patch| patch.alternative == 0).collect();
    writeln!(out, "ply\nformat ascii 1.0\ncomment kind: 0 visible, 1 hidden, 2 mirror; lengths in metres")?;
    writeln!(out, "element vertex {}", best.len())?;
    ["x", "y", "z"].iter().try_for_each(|name| writeln!(out, "property double {name}"))?;
    ["red", "green", "blue"].iter().try_for_each(|name| writeln!(out, "property uchar {name}"))?;
    writeln!(out, "property int patch\nproperty uchar kind")?;
    let cov = ["xx", "xy", "xz", "yy", "yz", "zz"].map(|pair| format!("cov_{pair}_m2"));
    std::iter::once("sd_m")
        .chain(cov.iter().map(String::as_str))
        .try_for_each(|name| writeln!(out, "property double {name}"))?;
    writeln!(out, "end_header")?;
    for patch in &best {
        let kind = KINDS.iter().position(|(kind, _)| **kind == *patch.kind).unwrap_or(0);
        let [red, green, blue] = KINDS[kind].1;
        write!(out, "{} {} {} {red} {green} {blue} {} {kind}", patch.x_m, patch.y_m, patch.z_m, patch.patch)?;
        let of_cov =
            [patch.cov_xx_m2, patch.cov_xy_m2, patch.cov_xz_m2, patch.cov_yy_m2, patch.cov_yz_m2, patch.cov_zz_m2];
        for value in std::iter::once(patch.sd_m).chain(of_cov) {
            match value {
                Some(value) => write!(out, " {value:e}")?,
                None => write!(out, " nan")?,
            }
        }
        writeln!(out)?;
    }
    Ok(best.len())
}

/// Writes points of a surface.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_surface(out: &mut impl Write, points: &[SurfacePoint]) -> io::Result<()> {
    writeln!(out, "ply\nformat ascii 1.0\ncomment kind: 0 smooth, 1 edge, 2 corner, 3 unknown; lengths in metres")?;
    writeln!(out, "element vertex {}", points.len())?;
    ["x", "y", "z", "nx", "ny", "nz"].iter().try_for_each(|name| writeln!(out, "property double {name}"))?;
    ["red", "green", "blue"].iter().try_for_each(|name| writeln!(out, "property uchar {name}"))?;
    writeln!(out, "property int lit\nproperty int seen\nproperty uchar kind\nproperty double sd_m")?;
    ["xx", "xy", "xz", "yy", "yz", "zz"].iter().try_for_each(|pair| writeln!(out, "property double cov_{pair}_m2"))?;
    writeln!(out, "property double normal_sd_rad\nproperty int shape\nend_header")?;
    let colour = colours(points.iter().map(|point| point.sd_m).collect());
    for point in points {
        let kind = SURFACE_KINDS.iter().position(|kind| **kind == *point.kind).unwrap_or(3);
        let [red, green, blue] = colour(point.sd_m);
        let [x, y, z, nx, ny, nz] = [point.x_m, point.y_m, point.z_m, point.normal_x, point.normal_y, point.normal_z];
        write!(
            out,
            "{x} {y} {z} {nx} {ny} {nz} {red} {green} {blue} {} {} {kind} {:e}",
            point.lit, point.seen, point.sd_m
        )?;
        for value in covariance_m2(point) {
            write!(out, " {value:e}")?;
        }
        let normal_sd_rad = (point.normal_cov_xx + point.normal_cov_yy + point.normal_cov_zz).sqrt();
        writeln!(out, " {normal_sd_rad:e} {}", point.shape.unwrap_or(0))?;
    }
    Ok(())
}

/// The colour of a standard deviation among these.
fn colours(mut sds_m: Vec<f64>) -> impl Fn(f64) -> [u8; 3] {
    sds_m.sort_by(f64::total_cmp);
    let median_m = sds_m.get(sds_m.len() / 2).copied().unwrap_or(1.0);
    move |sd_m| {
        let red = (127.5 * sd_m / median_m).min(255.0) as u8;
        [red, 60, 255 - red]
    }
}

/// Writes surfaces; says how many faces.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_mesh(out: &mut impl Write, vertices: &[Vertex]) -> io::Result<usize> {
    let faces = faces(vertices);
    writeln!(
        out,
        "ply\nformat ascii 1.0\ncomment surfaces from first light; lengths in metres, sd_m along the normal"
    )?;
    writeln!(out, "element vertex {}", vertices.len())?;
    ["x", "y", "z", "nx", "ny", "nz"].iter().try_for_each(|name| writeln!(out, "property double {name}"))?;
    ["red", "green", "blue"].iter().try_for_each(|name| writeln!(out, "property uchar {name}"))?;
    writeln!(out, "property int mesh\nproperty double sd_m\nproperty double normal_sd_rad")?;
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", faces.len())?;
    let colour = colours(vertices.iter().map(|vertex| vertex.sd_m).collect());
    for vertex in vertices {
        let Vertex { x_m, y_m, z_m, normal_x, normal_y, normal_z, sd_m, normal_sd_rad, mesh, .. } = vertex;
        let [red, green, blue] = colour(*sd_m);
        write!(out, "{x_m} {y_m} {z_m} {normal_x} {normal_y} {normal_z} {red} {green} {blue} ")?;
        writeln!(out, "{mesh} {sd_m:e} {normal_sd_rad:e}")?;
    }
    faces.iter().try_for_each(|[a, b, c]| writeln!(out, "3 {a} {b} {c}"))?;
    Ok(faces.len())
}

/// Triangles between neighbouring nodes: two where four nodes are there, one where three are. Columns and rows turn
/// into the normal as x and y turn into z.
#[must_use]
pub fn faces(vertices: &[Vertex]) -> Vec<[usize; 3]> {
    let place = |vertex: &Vertex| (vertex.mesh, vertex.grid_row, vertex.grid_column);
    let numbers: BTreeMap<_, usize> = vertices.iter().enumerate().map(|(n, vertex)| (place(vertex), n)).collect();
    let cells: std::collections::BTreeSet<_> = numbers
        .keys()
        .flat_map(|(mesh, row, column)| [0, 1].map(|up| [0, 1].map(|right| (*mesh, row - up, column - right))))
        .flatten()
        .collect();
    let mut faces = Vec::new();
    for (mesh, row, column) in cells {
        let at = |right: i32, up: i32| numbers.get(&(mesh, row + up, column + right)).copied();
        // Around the cell.
        let corners = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
        match corners.iter().flatten().copied().collect::<Vec<usize>>()[..] {
            [a, b, c, d] => faces.extend([[a, b, c], [a, c, d]]),
            [a, b, c] => faces.push([a, b, c]),
            _ => {}
        }
    }
    faces
}

/// Numbers of a node in a row of an array: place, normal, standard deviations along the normal and of its direction.
#[must_use]
pub fn mesh_numbers(vertex: &Vertex) -> [f64; 8] {
    let Vertex { x_m, y_m, z_m, normal_x, normal_y, normal_z, sd_m, normal_sd_rad, .. } = *vertex;
    [x_m, y_m, z_m, normal_x, normal_y, normal_z, sd_m, normal_sd_rad]
}

/// Writes echoes of a lidar.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_echoes(out: &mut impl Write, echoes: &[Echo]) -> io::Result<()> {
    writeln!(out, "ply\nformat ascii 1.0\ncomment echoes of a lidar; sd_m is along the beam")?;
    writeln!(out, "element vertex {}", echoes.len())?;
    let numbers = ["x", "y", "z", "sd_m", "amplitude", "width_ps", "width_sd_ps"];
    numbers.iter().try_for_each(|name| writeln!(out, "property double {name}"))?;
    writeln!(out, "property int echo\nproperty int echoes\nproperty double gps_time_s\nend_header")?;
    for echo in echoes {
        let Echo { x_m, y_m, z_m, range_sd_m, height, width_ps, width_sd_ps, echo: number, echoes, gps_time_s, .. } =
            echo;
        writeln!(
            out,
            "{x_m} {y_m} {z_m} {range_sd_m:e} {height} {width_ps} {width_sd_ps} {number} {echoes} {gps_time_s}"
        )?;
    }
    Ok(())
}

/// Numbers of a point of a surface in a row of an array: place, normal, covariance of the place from xx to zz.
#[must_use]
pub fn surface_numbers(point: &SurfacePoint) -> [f64; 12] {
    let [xx, xy, xz, yy, yz, zz] = covariance_m2(point);
    let SurfacePoint { x_m, y_m, z_m, normal_x, normal_y, normal_z, .. } = *point;
    [x_m, y_m, z_m, normal_x, normal_y, normal_z, xx, xy, xz, yy, yz, zz]
}

fn covariance_m2(point: &SurfacePoint) -> [f64; 6] {
    [point.cov_xx_m2, point.cov_xy_m2, point.cov_xz_m2, point.cov_yy_m2, point.cov_yz_m2, point.cov_zz_m2]
}
