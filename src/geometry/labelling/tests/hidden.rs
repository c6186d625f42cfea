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

/// Labels where the last of the wall's patches has no place.
fn without_last(points: &[Point], made: &[Made]) -> Solution {
    let options = Options { bounces: 3, ..OPTIONS };
    let scene = scene(&points[..points.len() - 1], 1e-4);
    label(&[PLAIN.sensor((0.0, 0.0), made)], Some(&scene), &options, &Cancel::never())
}

fn paths(solution: Solution) -> Vec<Vec<PatchId>> {
    verdicts(solution).into_iter().filter_map(|mut verdicts| verdicts.swap_remove(0).path).collect()
}

/// Third bounces over it place it, and it is no hidden one; its direct light is labelled as that of others.
#[test]
fn a_visible_patch_without_a_place_is_found_by_its_later_light() {
    let points = wall(0.3);
    let last = points[7];
    let made = made(&points[..7], 6, |a, b| (a - last).norm() + (b - last).norm());
    // Of its own profiles only the first bounce was captured.
    let own = Arrival::point(units::time_ps(2.0 * last.coords.norm(), 1.0), SD_PS, 10.0);
    let own = Made { lit: 8, seen: 8, arrival: own, path: None, turns: 0 };
    let made: Vec<Made> = made.into_iter().chain([own]).collect();
    let solution = without_last(&points, &made);
    let [(patch, place)] = &solution.places[..] else { panic!("one patch is found: {solution:?}") };
    assert!(*patch == 8 && (place.point - last).norm() < 0.02, "{solution:?}");
    assert!(solution.hypotheses.iter().all(|one| one.patch.is_none()), "{solution:?}");
    let paths = paths(solution);
    assert!(paths.contains(&vec![8]) && paths.iter().filter(|path| path.get(1) == Some(&8)).count() > 30, "{paths:?}");
}

/// Without later light it stays without a place, but its direct light keeps its labels. A hidden patch has a new
/// number.
#[test]
fn direct_light_of_a_patch_without_a_place_is_labelled_by_first_light() {
    let points = wall(0.3);
    let over = Point::from(HIDDEN);
    let solution = without_last(&points, &made(&points, 7, |a, b| (a - over).norm() + (b - over).norm()));
    assert!(solution.places.is_empty());
    assert!(solution.hypotheses.iter().filter_map(|one| one.patch).eq([9]), "{solution:?}");
    let paths = paths(solution);
    for direct in [vec![8], vec![1, 8], vec![8, 1], vec![3, 8]] {
        assert!(paths.contains(&direct), "{direct:?} of {paths:?}");
    }
}
