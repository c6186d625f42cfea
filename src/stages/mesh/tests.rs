use super::*;
use crate::cancel::Cancel;
use crate::geometry::Point;

/// A point of the wall, and the point of a plate 0.6 m behind it that it sees.
fn point(seen: i32) -> (Patch, SurfacePoint) {
    let at = |n: i32| f64::from(n) * 0.05 - 0.5;
    let wall = Point::new(at(seen % 20), at(seen / 20), 0.0);
    let on_plate = Point::new(wall.x.clamp(-0.25, 0.25), wall.y.clamp(-0.25, 0.25), 0.6);
    // Lengths are off by less than their errors, and not by a smooth function.
    let off_m = 2e-4 * f64::from((seen * 7) % 5 - 2);
    let row = SurfacePoint {
        rank: 1,
        lit: seen,
        seen,
        x_m: on_plate.x,
        y_m: on_plate.y,
        z_m: on_plate.z,
        cov_xx_m2: 1e-6,
        cov_yy_m2: 1e-6,
        cov_zz_m2: 1e-6,
        normal_z: -1.0,
        kind: "smooth".into(),
        light_m: (wall - on_plate).norm() + off_m,
        light_sd_m: 3e-4,
        light_law_sd_m: 3e-4,
        light_zone_m: 0.07,
        light_common_sd_m: 1e-4,
        ..SurfacePoint::default()
    };
    (Patch { patch: seen, x_m: wall.x, y_m: wall.y, z_m: wall.z, ..Patch::default() }, row)
}

fn applied(points: Vec<(Patch, SurfacePoint)>) -> (Vec<Mesh>, Vec<Vertex>) {
    let (patches, rows): (Vec<Patch>, Vec<SurfacePoint>) = points.into_iter().unzip();
    let context = Context { walls: Walls::new(&patches), cancel: Cancel::never() };
    let outcome = FitMeshes {}.apply(&context, rows).unwrap();
    assert!(outcome.rejections.is_empty());
    (outcome.rows, Vertex::rows(&outcome.sides[0]).unwrap())
}

#[test]
fn a_plate_is_a_flat_mesh_within_its_edges() {
    let (meshes, vertices) = applied((0..400).map(point).collect());
    let [mesh] = meshes.as_slice() else { panic!("{meshes:?}") };
    assert!(mesh.wall_points == 400 && mesh.nodes as usize == vertices.len() && vertices.len() > 100, "{mesh:?}");
    assert!(mesh.axis_z < -0.99 && mesh.median_sd_m < 2e-3, "{mesh:?}");
    for vertex in &vertices {
        assert!(vertex.x_m.abs() < 0.25 && vertex.y_m.abs() < 0.25, "{vertex:?}");
        assert!((vertex.z_m - 0.6).abs() < 3.0 * vertex.sd_m && vertex.normal_z < -0.99, "{vertex:?}");
    }
}

#[test]
fn few_points_or_lit_points_apart_have_no_mesh() {
    let apart = (0..400).map(point).map(|(wall, row)| (wall, SurfacePoint { lit: 500, ..row })).collect();
    assert!(applied(apart).0.is_empty());
    assert!(applied((0..40).map(point).collect()).0.is_empty());
    assert!(applied(Vec::new()).0.is_empty());
}
