use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::super::{FirstLight, Kind, Return};
use super::*;

const DRAWS: usize = 120;

fn normal(sd: f64, random: &mut ChaCha8Rng) -> f64 {
    let one: f64 = StandardNormal.sample(random);
    one * sd
}

/// A place of a wall of 9 x 9, 10 cm apart.
fn recorded(n: usize) -> Point {
    Point::new((n % 9) as f64 * 0.1 - 0.4, (n / 9) as f64 * 0.1 - 0.4, 0.0)
}

fn scan(lit: Lit, length_m: impl Fn(&Point) -> f64) -> Scan {
    let place = |n: usize| {
        let one = Return { length_m: length_m(&recorded(n)), sd_m: 1e-3, common_m: 0.0, log_likelihood: 0.0 };
        Place { seen: recorded(n), returns: [one; 3] }
    };
    Scan { lit, inwards: Vector3::z(), sigma_m: 0.01, places: (0..81).map(place).collect(), least: 0 }
}

fn point_at(place: usize, point: Point, length_m: f64, normal: Vector3<f64>) -> SurfacePoint {
    SurfacePoint {
        place,
        light: FirstLight { length_m, sd_m: 0.0, law_m: 0.0, zone_m: 0.1, common_m: 0.0 },
        point,
        // Products of two errors move by so much.
        covariance_m2: Matrix3::identity() * 1e-9,
        normal,
        normal_covariance: Matrix3::zeros(),
        kind: Kind::Smooth,
        curvatures_per_m: None,
        places: 13,
        misfit: 1.0,
        edges: 0.0,
    }
}

/// Chi-square over its coordinates of what a point is off.
fn square(off: Vector3<f64>, point: &SurfacePoint) -> f64 {
    off.dot(&(point.covariance_m2.try_inverse().unwrap() * off)) / 3.0
}

/// Height of light, whose logarithm is a linear function of the place.
fn height(place: &Point) -> f64 {
    (1.0 + 2.0 * place.x - 1.5 * place.y).exp()
}

/// Points of a plane by least squares over all lengths: these are linear in the place.
fn points_of_plane(scan: &Scan) -> Vec<SurfacePoint> {
    let row = |place: &Place| Vector3::new(place.seen.x, place.seen.y, 1.0);
    let squares: Matrix3<f64> = scan.places.iter().map(|place| row(place) * row(place).transpose()).sum();
    let products: Vector3<f64> = scan.places.iter().map(|place| row(place) * (0.5 * place.returns[0].length_m)).sum();
    let slopes = squares.try_inverse().unwrap() * products;
    let direction = Vector3::new(slopes.x, slopes.y, -(1.0 - slopes.x.powi(2) - slopes.y.powi(2)).sqrt());
    let point = |(n, place): (usize, &Place)| {
        let length_m = slopes.dot(&row(place));
        point_at(n, place.seen - direction * length_m, length_m, direction)
    };
    scan.places.iter().enumerate().map(point).collect()
}

/// Of a plane before a wall whose places really lie elsewhere, with a clock that walks.
#[test]
fn points_are_found_anew_where_the_grid_is_another_and_light_walks() {
    let none = Systematic::default();
    let plane = Vector3::new(0.2, -0.1, 1.0).normalize();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for (name, systematic) in [
        ("grid", Systematic { grid: 4e-3, ..none }),
        ("both", Systematic { grid: 4e-3, walk_m: 4e-3, ..none }),
        ("walk", Systematic { walk_m: 4e-3, ..none }),
    ] {
        let (mut squares, mut depths) = (0.0, 0.0);
        for _ in 0..DRAWS {
            let [xx, xy, yx, yy] = [0; 4].map(|_| normal(systematic.grid, &mut random));
            let walk_m = normal(systematic.walk_m, &mut random);
            let real = |place: &Point| {
                let Point { coords } = place;
                place + Vector3::new(xx * coords.x + xy * coords.y, yx * coords.x + yy * coords.y, 0.0)
            };
            let distance_m = |place: &Point| 0.9 - plane.dot(&place.coords);
            let scan = scan(Lit::Same, |place| 2.0 * distance_m(&real(place)) + walk_m * (height(place).ln() - 1.0));
            let heights: Vec<f64> = scan.places.iter().map(|place| height(&place.seen)).collect();
            let mut points = points_of_plane(&scan);
            systematic.add(&scan, &heights, &mut points, |moved, _| points_of_plane(moved), &Cancel::never());
            for number in [10, 40, 52] {
                let place = real(&recorded(number));
                let truth = place + plane * distance_m(&place);
                let off = points[number].point - truth;
                squares += square(off, &points[number]) / (3 * DRAWS) as f64;
                depths += off.z.powi(2) / points[number].covariance_m2[(2, 2)] / (3 * DRAWS) as f64;
                assert!(number == 40 || points[number].light.law_m > 0.0);
            }
        }
        println!("{name}: mean chi-square {squares:.2}, of depths {depths:.2}");
        // A walk has one unknown, of three coordinates.
        let most = if name == "walk" { 0.5 } else { 1.3 };
        assert!((0.2..most).contains(&squares) && (0.7..1.35).contains(&depths), "{name}: {squares}, {depths}");
    }
}

/// The point of a sphere that light from `lit` reaches `seen` over first, by descent.
fn nearest(lit: &Point, seen: &Point) -> Point {
    let middle = Point::new(0.1, -0.05, 0.9);
    let mut point = middle + (nalgebra::center(lit, seen) - middle).normalize() * 0.2;
    for _ in 0..200 {
        let away = (lit - point).normalize() + (seen - point).normalize();
        point = middle + (point + away * 0.05 - middle).normalize() * 0.2;
    }
    point
}

/// Points of a sphere from lengths and their differences over places, where wall and delay are really others.
#[test]
fn a_relief_and_a_delay_move_points_as_stated() {
    let none = Systematic::default();
    let mut random = ChaCha8Rng::seed_from_u64(6);
    for lit in [None, Some(Point::new(0.3, 0.2, 0.0))] {
        let share = if lit.is_some() { 1.0 } else { 0.5 };
        let way = lit.map_or(Way::Back, Way::From);
        let scan = scan(lit.map_or(Lit::Same, Lit::One), |_| 2.0);
        for (name, systematic) in [
            ("relief", Systematic { relief_m: Some([1e-3, 0.2]), ..none }),
            ("delay", Systematic { delay_m: 2e-3, ..none }),
        ] {
            let [relief_m, length_m] = systematic.relief_m.unwrap_or([0.0, 1.0]);
            let (mut squares, mut depths) = (0.0, 0.0);
            for number in (0..DRAWS).map(|draw| [10, 40, 52][draw % 3]) {
                let here = recorded(number);
                let delay_m = normal(systematic.delay_m, &mut random);
                let [z, x, y, lit_z] =
                    [relief_m, relief_m / length_m, relief_m / length_m, relief_m].map(|sd| normal(sd, &mut random));
                let ends = |at: &Point| {
                    let seen = Point::new(at.x, at.y, z + x * (at.x - here.x) + y * (at.y - here.y));
                    (lit.map_or(seen, |lit| lit + Vector3::z() * lit_z), seen)
                };
                let told_m = |at: &Point| {
                    let (lit, seen) = ends(at);
                    let point = nearest(&lit, &seen);
                    share * ((lit - point).norm() + (point - seen).norm() + delay_m)
                };
                let slope = |axis: Vector3<f64>| (told_m(&(here + axis * 1e-4)) - told_m(&(here - axis * 1e-4))) / 2e-4;
                let [x, y] = [slope(Vector3::x()), slope(Vector3::y())];
                let direction = Vector3::new(x, y, -(1.0 - x * x - y * y).sqrt());
                let point = way.point(&here, told_m(&here), &direction);
                let mut points = [point_at(number, point, told_m(&here), direction)];
                systematic.add(&scan, &[1.0; 81], &mut points, |_, _| unreachable!(), &Cancel::never());
                let (lit, seen) = ends(&here);
                let off = point - nearest(&lit, &seen);
                squares += square(off, &points[0]) / DRAWS as f64;
                depths += off.z.powi(2) / points[0].covariance_m2[(2, 2)] / DRAWS as f64;
            }
            println!("{name}, lit {lit:?}: mean chi-square {squares:.2}, of depths {depths:.2}");
            // A delay has one unknown, of three coordinates.
            let most = if name == "delay" { 0.5 } else { 1.3 };
            assert!((0.2..most).contains(&squares) && (0.65..1.4).contains(&depths), "{name}: {squares}, {depths}");
        }
    }
}
