//! Hidden patches behind and in front of walls.

use super::*;
use crate::hidden::{Hidden, Surface};

const HIDDEN: [f64; 3] = [0.3, 1.0, 0.2];
const SD_PS: f64 = 25.0;

/// Visible patches 1 to 8 near the wall y = 2 m, exactly `relief_m` off it to either side in turn. The laser is at the
/// origin.
fn wall(relief_m: f64) -> Vec<Point> {
    let at = [(-0.8, -0.5), (-0.5, 0.6), (-0.1, -0.2), (0.2, 0.5), (0.5, -0.6), (0.8, 0.1), (1.1, 0.7), (1.2, -0.3)];
    let side = |n: usize| if n.is_multiple_of(2) { relief_m } else { -relief_m };
    at.iter().enumerate().map(|(n, (x, z))| Point::new(*x, 2.0 + side(n), *z)).collect()
}

/// Arrivals of direct light and of one path over another surface, whose legs between lit and seen patch are given.
fn made(points: &[Point], seed: u64, other_m: impl Fn(Point, Point) -> f64) -> Vec<Made> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut made = Vec::new();
    for (lit, a) in (1..).zip(points) {
        for (seen, b) in (1..).zip(points) {
            let ends_m = a.coords.norm() + b.coords.norm();
            for between_m in [(a - b).norm(), other_m(*a, *b)] {
                let noise: f64 = StandardNormal.sample(&mut rng);
                let time_ps = units::time_ps(ends_m + between_m, 1.0) + SD_PS * noise;
                made.push(Made { lit, seen, arrival: Arrival::point(time_ps, SD_PS, 10.0), path: None, turns: 0 });
            }
        }
    }
    made
}

fn searched(points: &[Point], made: &[Made]) -> Solution {
    let options = Options { bounces: 3, ..OPTIONS };
    label(&[PLAIN.sensor((0.0, 0.0), made)], Some(&scene(points, 1e-4)), &options, &Cancel::never())
}

/// With one hidden patch.
fn with_hidden(points: &[Point]) -> Solution {
    let over = Point::from(HIDDEN);
    searched(points, &made(points, 4, |a, b| (a - over).norm() + (b - over).norm()))
}

/// The place of the only hidden patch, and the other one that it may have.
fn places(solution: &Solution) -> (Point, Option<Hidden>) {
    let patches: Vec<&Hypothesis> = solution.hypotheses.iter().filter(|one| one.patch == Some(9)).collect();
    assert_eq!(patches.len(), 1, "{solution:?}");
    (patches[0].surface.point, patches[0].rival)
}

fn apart_m(point: Point, from: [f64; 3]) -> f64 {
    (point - Point::from(from)).norm()
}

/// The arrivals distinguish the two places the better the rougher the wall is.
#[test]
fn of_two_places_on_either_side_of_a_wall_the_laser_s_comes_first_and_the_other_is_its_rival() {
    let [x, y, z] = HIDDEN;
    let (place, rival) = places(&with_hidden(&wall(0.0)));
    // Flat: what lies behind is no choice.
    assert!(apart_m(place, HIDDEN) < 0.02 && rival.is_none(), "{place} {rival:?}");
    let solution = with_hidden(&wall(0.0012));
    let (place, rival) = places(&solution);
    let rival = rival.expect("a rival");
    assert!(apart_m(place, HIDDEN) < 0.02 && apart_m(rival.point, [x, 4.0 - y, z]) < 0.03, "{solution:?}");
    assert!((solution.hypotheses[0].surface.evidence - rival.evidence).abs() < 9.0, "{solution:?}");
    let (place, rival) = places(&with_hidden(&wall(0.1)));
    assert!(apart_m(place, HIDDEN) < 0.02 && rival.is_none(), "{place} {rival:?}");
}

#[test]
fn about_visible_patches_in_line_nothing_is_looked_for_and_that_is_said() {
    let line: Vec<Point> = (0..8).map(|n| Point::new(-0.8 + 0.25 * f64::from(n), 2.0, 0.1 * f64::from(n))).collect();
    let solution = with_hidden(&line);
    assert_eq!((solution.hypotheses.len(), solution.visible_in_line), (0, Some(8)));
    let is_direct = |label: &Verdict| label.path.as_ref().is_some_and(|path| path.len() <= 2);
    let direct = verdicts(solution).iter().filter(|verdicts| is_direct(&verdicts[0])).count();
    assert!(direct > 50, "{direct} of 64");
}

/// An undeclared floor throws light from each patch to each other.
#[test]
fn a_floor_is_a_plane_and_no_patches() {
    let points = wall(0.3);
    let solution = searched(&points, &made(&points, 5, |a, b| (Point::new(a.x, a.y, -3.0 - a.z) - b).norm()));
    let is_plane = |one: &&Hypothesis| one.surface.surface != Surface::Patch;
    let planes: Vec<&Hypothesis> = solution.hypotheses.iter().filter(is_plane).collect();
    assert!(planes.len() == 1 && solution.hypotheses.iter().all(|one| one.patch.is_none()), "{solution:?}");
    let floor = planes[0].surface;
    let up = floor.surface.normal(floor.point).expect("a plane has a normal");
    assert!((floor.point.z + 1.5).abs() < 0.02 && up.z > 0.999, "{planes:?}");
}
