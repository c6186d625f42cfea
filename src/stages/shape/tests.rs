use super::*;
use crate::cancel::Cancel;
use crate::geometry::Point;

/// A point of the wall, and the point of a plate 0.6 m behind it that it sees.
fn point(seen: i32) -> (Patch, SurfacePoint) {
    let at = |n: i32| f64::from(n) * 0.05 - 0.2;
    let wall = Point::new(at(seen % 10), at(seen / 10), 0.0);
    // Lengths are off by less than their errors, and not by a smooth function.
    let off_m = 2e-4 * f64::from((seen * 7) % 5 - 2);
    let row = SurfacePoint {
        rank: 1,
        lit: seen,
        seen,
        x_m: wall.x,
        y_m: wall.y,
        z_m: 0.6,
        cov_xx_m2: 1e-6,
        cov_yy_m2: 1e-6,
        cov_zz_m2: 1e-6,
        normal_z: -1.0,
        kind: "smooth".into(),
        light_m: 0.6 + off_m,
        light_sd_m: 3e-4,
        light_law_sd_m: 3e-4,
        light_zone_m: 0.07,
        light_common_sd_m: 1e-4,
        ..SurfacePoint::default()
    };
    (Patch { patch: seen, x_m: wall.x, y_m: wall.y, ..Patch::default() }, row)
}

fn applied(points: Vec<(Patch, SurfacePoint)>) -> Outcome<Shape> {
    let (patches, rows): (Vec<Patch>, Vec<SurfacePoint>) = points.into_iter().unzip();
    let context = Context { walls: Walls::new(&patches), cancel: Cancel::never() };
    FitShapes {}.apply(&context, rows).unwrap()
}

#[test]
fn points_of_a_plate_are_said_by_their_plane() {
    let outcome = applied((0..100).map(point).collect());
    let [plane] = outcome.rows.as_slice() else { panic!("{:?}", outcome.rows) };
    assert!(*plane.kind == *"plane" && plane.wall_points == 100 && plane.radius_m.is_none(), "{plane:?}");
    assert!((plane.z_m - 0.6).abs() < 3.0 * plane.cov_zz_m2.sqrt() && plane.axis_z.unwrap() < -0.999, "{plane:?}");
    let points = SurfacePoint::rows(&outcome.sides[0]).unwrap();
    assert!(points.len() == 100 && points.iter().all(|point| point.shape == Some(1)));
    assert!(outcome.rejections.is_empty());
}

#[test]
fn points_without_a_shape_stay_as_they_were() {
    // The lit point is another one: nothing says a distance.
    let apart: Vec<(Patch, SurfacePoint)> =
        (0..100).map(point).map(|(wall, row)| (wall, SurfacePoint { lit: 200, ..row })).collect();
    let before: Vec<SurfacePoint> = apart.iter().map(|(_, row)| row.clone()).collect();
    let outcome = applied(apart);
    assert_eq!(SurfacePoint::rows(&outcome.sides[0]).unwrap(), before);
    assert!(outcome.rows.is_empty() && outcome.rejections.is_empty());
    assert!(applied(Vec::new()).rows.is_empty());
}
