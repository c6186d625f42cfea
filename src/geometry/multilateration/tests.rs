use super::*;
use crate::room;

const SD_M: f64 = 0.003;

/// An exact path over the patch at `z`.
fn path(from: Point, z: Point, to: Point) -> Tie {
    Tie::Path { from, to, length_m: (z - from).norm() + (z - to).norm(), sd_m: SD_M }
}

/// Ties of the last patch: to a station at the origin, over some others.
fn ties(points: &[Point], over: &[usize]) -> Vec<Tie> {
    let z = points[points.len() - 1];
    let second = |&a: &usize| path(Point::origin(), z, points[a]);
    std::iter::once(path(Point::origin(), z, Point::origin())).chain(over.iter().map(second)).collect()
}

#[test]
fn three_neighbours_place_a_patch_and_two_leave_its_mirror_image() {
    let points = room::rectangles();
    let truth = points[48];
    let three = candidates(&ties(&points, &[0, 27, 44]), 3, 0.05, Loss::Huber);
    assert!((three[0].point - truth).norm() < 1e-6 && three[0].cost < 1e-9);
    assert!(three[1..].iter().all(|other| other.cost > 10.0));
    let two = candidates(&ties(&points, &[0, 27]), 3, 0.05, Loss::Huber);
    assert!(two.len() == 2 && two.iter().all(|candidate| candidate.cost < 1e-9));
    let mirrored = {
        let normal = points[0].coords.cross(&points[27].coords).normalize();
        truth - 2.0 * normal * normal.dot(&truth.coords)
    };
    assert!(two.iter().any(|candidate| (candidate.point - truth).norm() < 1e-6));
    assert!(two.iter().any(|candidate| (candidate.point - mirrored).norm() < 1e-6));
    assert!(candidates(&ties(&points, &[0]), 3, 0.05, Loss::Huber).is_empty());
    let one = ties(&points, &[0]);
    assert!(cost(&one, somewhere(&one, 3, Loss::Huber).unwrap(), Loss::Huber) < 1e-6);
}

#[test]
fn without_a_first_bounce_four_neighbours_place_a_patch() {
    let points = room::rectangles();
    let solution = candidates(&ties(&points, &[0, 27, 30, 44])[1..], 3, 0.05, Loss::Huber);
    assert!((solution[0].point - points[48]).norm() < 1e-6 && solution[0].cost < 1e-9);
}

#[test]
fn first_bounces_to_separate_sensors_place_a_patch() {
    let truth = Point::new(0.4, 2.0, 0.7);
    let source = Point::new(0.1, 0.0, 0.0);
    let sensors = [Point::new(1.0, 0.0, 0.0), Point::new(-1.0, 0.1, 0.0), Point::new(0.0, 0.2, 1.0)];
    let solution = candidates(&sensors.map(|sensor| path(source, truth, sensor)), 3, 0.05, Loss::Huber);
    assert!(solution.iter().any(|candidate| (candidate.point - truth).norm() < 1e-6), "{solution:?}");
}

#[test]
fn paths_without_a_common_focus_place_a_patch() {
    let truth = Point::new(0.4, 2.0, 0.7);
    let at = |x: f64, y: f64, z: f64| Point::new(x, y, z);
    let ties = [
        path(at(1.0, 0.0, 0.0), truth, at(0.0, 3.0, 0.0)),
        path(at(-1.0, 0.0, 0.2), truth, at(2.0, 2.0, 1.0)),
        path(at(0.0, 0.0, 1.0), truth, at(-2.0, 2.0, -1.0)),
    ];
    let solution = candidates(&ties, 3, 0.05, Loss::Huber);
    assert!(solution.iter().any(|candidate| (candidate.point - truth).norm() < 1e-6), "{solution:?}");
}

#[test]
fn a_ray_and_a_path_place_a_patch_and_so_does_an_anchor() {
    let truth = Point::new(0.4, 2.0, 0.7);
    let (from, sensor) = (Point::new(0.0, 0.0, 0.1), Point::new(1.0, 0.0, 0.0));
    let ray = Tie::Ray { from, direction: (truth - from).normalize(), sd_rad: 1e-3 };
    let solution = candidates(&[path(from, truth, sensor), path(sensor, truth, sensor), ray], 3, 0.05, Loss::Huber);
    assert!((solution[0].point - truth).norm() < 1e-6 && solution[0].cost < 1e-6);
    let solution = candidates(&[Tie::Anchor { position: truth, sd_m: 0.01 }], 3, 0.05, Loss::Huber);
    assert!(solution.len() == 1 && solution[0].point == truth);
}

#[test]
fn a_neighbour_in_a_wrong_place_is_outvoted() {
    let points = room::rectangles();
    let mut ties = ties(&points, &[3, 11, 20, 27, 33, 44]);
    let Tie::Path { to, .. } = &mut ties[4] else { panic!("a path") };
    *to = Point::new(0.0, 1.0, 1.0);
    let solution = candidates(&ties, 3, 0.05, Loss::Huber);
    assert!((solution[0].point - points[48]).norm() < 0.01, "{:?}", solution[0]);
}

#[test]
fn in_flatland_one_neighbour_leaves_two_points_and_two_one() {
    let points: Vec<Point> =
        room::rectangles().iter().map(|p| Point::new(p.x + 0.3 * p.z, p.y + 0.2 * p.z, 0.0)).collect();
    let (one, two) = (
        candidates(&ties(&points, &[0]), 2, 0.05, Loss::Huber),
        candidates(&ties(&points, &[0, 27]), 2, 0.05, Loss::Huber),
    );
    assert!(one.len() == 2 && one.iter().all(|candidate| candidate.cost < 1e-9 && candidate.point.z.abs() < 1e-12));
    assert!((two[0].point - points[48]).norm() < 1e-6 && two[1..].iter().all(|other| other.cost > 10.0));
}

#[test]
fn ranges_place_a_patch_and_from_one_plane_its_mirror_image_too() {
    let points = room::rectangles();
    let truth = Point::new(0.3, 1.1, 0.2);
    let range = |&n: &usize| path(points[n], truth, points[n]);
    let two_walls: Vec<Tie> = [0, 4, 22, 27, 40].iter().map(range).collect();
    let solution = candidates(&two_walls, 3, 0.05, Loss::Huber);
    assert!((solution[0].point - truth).norm() < 1e-6 && solution[0].cost < 1e-9);
    assert!(solution[1..].iter().all(|other| other.cost > 10.0));
    // The wall of patches 0 to 24 stands at y = 2.6 m.
    let wall: Vec<Tie> = [0, 4, 22, 12].iter().map(range).collect();
    let solution = candidates(&wall, 3, 0.05, Loss::Huber);
    assert!(solution.len() == 2 && solution.iter().all(|candidate| candidate.cost < 1e-9), "{solution:?}");
    for place in [truth, Point::new(truth.x, 5.2 - truth.y, truth.z)] {
        assert!(solution.iter().any(|candidate| (candidate.point - place).norm() < 1e-6));
    }
    // Patches 0 to 4 stand in line.
    let line: Vec<Tie> = [0, 1, 2, 4].iter().map(range).collect();
    assert!(candidates(&line, 3, 0.05, Loss::Huber).is_empty());
    // In flatland two patches leave two places.
    let truth = Point::new(0.3, 1.1, 0.0);
    let flat = [Point::new(-1.0, 2.0, 0.0), Point::new(1.0, 2.0, 0.0)].map(|end| path(end, truth, end));
    let solution = candidates(&flat, 2, 0.05, Loss::Huber);
    assert!(solution.len() == 2 && solution.iter().all(|candidate| candidate.point.z == 0.0 && candidate.cost < 1e-9));
}
