use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::dispersion::Dispersion;
use super::field::Field;
use super::local::{Covariance, Local, Sample};
use super::way::Way;
use super::*;
use crate::neighbours::neighbours;

const SIGMA_M: f64 = 7.5e-3;
const LIT: Point = Point::new(0.3, -0.2, 0.0);

/// A wall of `side` times `side` points over a metre, with a relief.
fn wall(side: usize, relief: impl Fn(f64, f64) -> f64) -> Vec<Point> {
    let at = |n: usize| (n as f64 + 0.5) / side as f64 - 0.5;
    (0..side * side).map(|n| (at(n % side), at(n / side))).map(|(x, y)| Point::new(x, y, relief(x, y))).collect()
}

fn sphere(seen: &Point) -> Point {
    let middle = Point::new(0.05, -0.03, 0.8);
    middle + (seen - middle).normalize() * 0.2
}

/// Two planes that meet in a valley at `x = 0`: the nearest point jumps from one to the other.
fn valley(seen: &Point) -> Point {
    let foot = |normal: Vector3<f64>| seen + normal * normal.dot(&(Point::new(0.0, 0.0, 0.7) - seen));
    let sides = [-0.3_f64, 0.3].map(|slope| foot(Vector3::new(slope, 0.0, 1.0).normalize()));
    if (sides[0] - seen).norm() < (sides[1] - seen).norm() { sides[0] } else { sides[1] }
}

/// First returns, noise as steps have it, and laws of equal likelihood and length.
fn scan(wall: &[Point], lit: Lit, surface: impl Fn(&Point) -> Point, sd_m: f64, seed: u64) -> Scan {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut place = |seen: &Point| {
        let point = surface(seen);
        let noise: f64 = StandardNormal.sample(&mut random);
        let lit = if let Lit::One(lit) = lit { lit } else { *seen };
        let length_m = (point - lit).norm() + (point - seen).norm() + sd_m * noise;
        Place { seen: *seen, returns: [Return { length_m, sd_m, common_m: 0.0, log_likelihood: 0.0 }; 3] }
    };
    let places = wall.iter().map(&mut place).collect();
    Scan { lit, inwards: Vector3::z(), sigma_m: SIGMA_M, places, least: 0 }
}

/// A bent field about a place.
fn fitted(place: usize, samples: &[Sample], members: &[u32], zone_m: f64) -> Option<Field> {
    let start = Field::new(&samples[place], -Vector3::z());
    start.likeliest(samples, members)?.with_spread(samples, members, zone_m)
}

/// Points of the scan; the law of first light changes no length.
fn points(scan: &Scan) -> Vec<SurfacePoint> {
    surface_points(scan, |place, laws, _| vec![Some(scan.places[place].returns[0]); laws.len()], &Cancel::never())
}

/// Share of the points whose ellipsoid of 95 % holds the truth, and the median of their distances from it.
fn judged(scan: &Scan, surface: impl Fn(&Point) -> Point) -> (f64, f64) {
    let points = points(scan);
    assert!(points.len() * 10 > scan.places.len() * 9, "{} of {}", points.len(), scan.places.len());
    let off = |point: &SurfacePoint| point.point - surface(&scan.places[point.place].seen);
    let holds = |point: &&SurfacePoint| {
        let root = point.covariance_m2.cholesky().expect("a covariance");
        off(point).dot(&root.solve(&off(point))) < 7.815
    };
    let held = points.iter().filter(holds).count() as f64 / points.len() as f64;
    let mut offs_m: Vec<f64> = points.iter().map(|point| off(point).norm()).collect();
    offs_m.sort_by(f64::total_cmp);
    (held, offs_m[offs_m.len() / 2])
}

#[test]
fn a_sphere_is_found_on_a_flat_wall_and_on_one_with_relief() {
    for (seed, bump_m) in [(1, 0.0), (2, 0.03)] {
        let wall = wall(32, |x, y| bump_m * (9.0 * x).sin() * (7.0 * y).cos());
        let (held, median_m) = judged(&scan(&wall, Lit::Same, sphere, 1.5e-3, seed), sphere);
        // The law's error is not in these lengths, so that ellipsoids are too large.
        assert!(held > 0.95 && median_m < 3e-3, "relief {bump_m}: {held}, {median_m} m");
    }
}

/// Lengths scatter by four times what their noise says, as with jitter: bars say what they scatter by.
#[test]
fn an_error_that_each_place_has_for_itself_is_in_the_bars() {
    for (seed, said_m) in [(11, 0.5e-3), (12, 0.5e-3), (13, 2e-3)] {
        let mut scan = scan(&wall(32, |_, _| 0.0), Lit::Same, sphere, 2e-3, seed);
        scan.places.iter_mut().flat_map(|place| &mut place.returns).for_each(|one| one.sd_m = said_m);
        let points = points(&scan);
        let mut sds_m: Vec<f64> = points.iter().map(|point| point.light.sd_m).collect();
        sds_m.sort_by(f64::total_cmp);
        // Half of a way there and back.
        let sd_m = sds_m[sds_m.len() / 2];
        assert!((0.85e-3..1.15e-3).contains(&sd_m), "{said_m} m: {sd_m} m");
        assert!(points.len() * 10 > scan.places.len() * 9, "{} points", points.len());
    }
}

/// Two sloped planes 0.2 m of length apart, and places that show nothing.
#[test]
fn neighbours_show_the_same_thing() {
    let wall = wall(32, |_, _| 0.0);
    let is_near = |n: usize| wall[n].x < 0.0;
    let length_m = |n: usize| 1.4 + 0.3 * wall[n].x + 0.1 * wall[n].y + if is_near(n) { 0.0 } else { 0.2 };
    let shows = |n: usize| !n.is_multiple_of(5);
    let places: Vec<(Point, Option<f64>)> = (0..wall.len()).map(|n| (wall[n], shows(n).then(|| length_m(n)))).collect();
    let alike = alike(&places, 2.0, SIGMA_M, &Cancel::never());
    assert_eq!(alike.len(), wall.len());
    for (n, others) in alike.iter().enumerate() {
        assert_eq!(others.first().copied(), shows(n).then_some(n));
        assert!(others.iter().all(|other| shows(*other) && is_near(*other) == is_near(n)), "{n}: {others:?}");
    }
    // Within a plane, all of 49 that show it.
    let middle = 16 * 32 + 9;
    assert!(shows(middle) && alike[middle].len() > 35, "{}", alike[middle].len());
}

/// More light shows more: a wall with sixteen times as many places, each as noisy, has points nearer to the truth. When
/// windows held so many places however close these lie, points were less exact with more of them.
#[test]
fn a_dense_wall_shows_more_than_one_with_fewer_places() {
    for (name, surface, lit) in [
        ("sphere", sphere as fn(&Point) -> Point, Lit::Same),
        ("valley", valley, Lit::Same),
        ("sphere of a lit point", |seen| reflects(&LIT, seen), Lit::One(LIT)),
    ] {
        let [few, many] = [32, 128].map(|side| {
            let all = scan(&wall(side, |_, _| 0.0), lit.clone(), surface, 2e-3, 5);
            judged(&all, surface)
        });
        println!("{name}: {few:?}, {many:?}");
        assert!(many.0 > 0.93 && many.1 < 0.9 * few.1, "{name}: {many:?}, with fewer places {few:?}");
    }
}

#[test]
fn no_field_is_fitted_across_a_valley() {
    let (held, median_m) = judged(&scan(&wall(32, |_, _| 0.0), Lit::Same, valley, 1e-3, 3), valley);
    assert!(held > 0.9 && median_m < 4e-3, "{held}, {median_m} m");
}

/// A saddle of half a metre that ends, and whether its nearest point lies within.
fn saddle(seen: &Point) -> (Point, bool) {
    let place = |x: f64, y: f64| Point::new(x, y, 0.68 - 0.6 * (x * x - y * y));
    let at = |n: usize| (n as f64 / 400.0 - 0.5) * 0.5;
    let all = (0..401 * 401).map(|n| place(at(n % 401), at(n / 401)));
    let point = all.min_by(|a, b| (a - seen).norm_squared().total_cmp(&(b - seen).norm_squared())).expect("a grid");
    (point, point.x.abs() < 0.249 && point.y.abs() < 0.249)
}

/// A wall that sees the saddle, with noise; and of each place the nearest point, and whether it lies within.
fn saddle_scan() -> (Scan, Vec<(Point, bool)>) {
    let wall = wall(32, |_, _| 0.0);
    let truth: Vec<(Point, bool)> = wall.par_iter().map(saddle).collect();
    let of_place = |seen: &Point| truth[wall.iter().position(|one| one == seen).expect("a place")].0;
    (scan(&wall, Lit::Same, of_place, 2e-3, 7), truth)
}

#[test]
fn flat_faces_that_bent_fields_contradict_count_less() {
    let (scan, truth) = saddle_scan();
    let points = points(&scan);
    let holds = |point: &SurfacePoint| {
        let off = point.point - truth[point.place].0;
        off.dot(&point.covariance_m2.cholesky().expect("a covariance").solve(&off)) < 7.815
    };
    let smooth: Vec<&SurfacePoint> = points.iter().filter(|point| truth[point.place].1).collect();
    let held = smooth.iter().filter(|point| holds(point)).count();
    println!("saddle: {held} of {} smooth points hold", smooth.len());
    assert!(held * 10 > 8 * smooth.len(), "{held} of {}", smooth.len());
}

#[test]
fn faces_keep_their_share_where_they_alone_explain_a_place() {
    let (scan, _) = saddle_scan();
    let mut rounds = Rounds::new(&scan, &Cancel::never());
    rounds.fields.iter_mut().step_by(3).for_each(|field| *field = None);
    rounds.find_faces(&Cancel::never());
    let (mut alone, mut less) = (0, 0);
    for place in (0..scan.places.len()).filter(|place| rounds.flats[*place].is_some()) {
        less += usize::from(rounds.shares[place] < 0.9 * rounds.likelihoods[place]);
        if rounds.fields[place].is_none() {
            alone += 1;
            assert!(rounds.shares[place] == 1.0 && rounds.point(place).is_some());
        }
    }
    assert!(alone > 100 && less > 20, "{alone}, {less}");
}

/// Two plates with a gap; the second one is told to be a block, and few places say so of the first one, loudly.
#[test]
fn a_plate_is_no_block_because_few_places_or_others_say_so() {
    let plates = [-0.3, 0.3].map(|x| block(Point::new(x, 0.0, 0.6), [0.08, 0.12, 0.0]));
    let nearest = |seen: &Point| plates[usize::from(seen.x > 0.0)](seen);
    let scan = scan(&wall(32, |_, _| 0.0), Lit::Same, nearest, 2e-4, 11);
    let late_m = 3e-3;
    let timed = |place: usize, laws: &[Vec<Face>], _: f64| {
        let own = scan.places[place].returns[0];
        let more = match (scan.places[place].seen.x > 0.0, place % 29) {
            (true, _) => 2.0,
            (false, 0) => 500.0,
            (false, _) => -0.5,
        };
        let law = |faces: &Vec<Face>| match faces.len() {
            1 => own,
            _ => Return { length_m: own.length_m + late_m, log_likelihood: more, ..own },
        };
        laws.iter().map(|faces| Some(law(faces))).collect()
    };
    let points = surface_points(&scan, timed, &Cancel::never());
    let late = |point: &&SurfacePoint| {
        let seen = scan.places[point.place].seen;
        point.light.length_m - (nearest(&seen) - seen).norm() > 0.25 * late_m
    };
    let of_first: Vec<&SurfacePoint> = points.iter().filter(|point| scan.places[point.place].seen.x < 0.0).collect();
    let late = of_first.iter().copied().filter(late).count();
    println!("{late} of {} are late", of_first.len());
    assert!(of_first.len() > 400 && late * 20 < of_first.len(), "{late} of {}", of_first.len());
}

#[test]
fn a_fixed_lit_point_shows_the_point_that_reflects() {
    let lit = Point::new(0.3, 0.2, 0.0);
    let plane = |seen: &Point| {
        let normal = Vector3::new(0.2, -0.1, 1.0).normalize();
        let height = |point: &Point| normal.dot(&(Point::new(0.0, 0.0, 0.6) - point));
        let image = lit + normal * (2.0 * height(&lit));
        image + (seen - image) * (height(&lit) / (height(&lit) + height(seen)))
    };
    let scan = scan(&wall(32, |_, _| 0.0), Lit::One(lit), plane, 1e-3, 4);
    let (held, median_m) = judged(&scan, plane);
    assert!(held > 0.95 && median_m < 3e-3, "{held}, {median_m} m");
    let normal = -Vector3::new(0.2, -0.1, 1.0).normalize();
    let middle = points(&scan).into_iter().find(|point| point.place == 16 * 32 + 16).unwrap();
    assert!(middle.normal.angle(&normal) < 0.02, "{middle:?}");
}

/// A point that slides along a tangent has a longer way, by what the surface of equal ways bends off.
#[test]
fn points_of_one_length_lie_on_an_arc() {
    let (seen, point) = (Point::new(0.1, -0.2, 0.0), Point::new(0.3, 0.1, 0.6));
    for way in [Way::Back, Way::From(Point::new(-0.2, 0.3, 0.05))] {
        let normal = way.normal(&seen, &point, &(seen - point).normalize());
        let slope = |of: Point| way.length_over(&seen, &of).0;
        let along = (slope(point - normal * 1e-4) - slope(point + normal * 1e-4)) / 2e-4;
        let off = |across: Vector3<f64>| {
            let both = slope(point + across * 1e-3) + slope(point - across * 1e-3);
            (both - 2.0 * slope(point)) / 1e-6 / along
        };
        let bends = crate::axes::across(&normal).map(off);
        let mean = 0.5 * (bends[0] + bends[1]);
        // Of an ellipsoid the mean of both curvatures is a little larger than that of both rays.
        let bend = way.bend_per_m(&seen, &point);
        assert!((0.9..1.0 + 1e-6).contains(&(bend / mean)), "{way:?}: {bend} of {mean}");
        assert!(!matches!(way, Way::Back) || (bend / mean - 1.0).abs() < 1e-5);
    }
}

#[test]
fn edges_and_spheres_are_distinguished() {
    let edge = |seen: &Point| Point::new(0.9, seen.y, 0.5);
    for (surface, kind) in [(&edge as &dyn Fn(&Point) -> Point, Kind::Edge), (&sphere, Kind::Smooth)] {
        let mut scan = scan(&wall(32, |_, _| 0.0), Lit::Same, surface, 2e-4, 5);
        scan.sigma_m = 1e-4;
        let points = points(&scan);
        let [right, sure] = [&[kind][..], &[Kind::Smooth, Kind::Edge, Kind::Corner]]
            .map(|kinds| points.iter().filter(|point| kinds.contains(&point.kind)).count());
        assert!(right * 20 > sure * 19 && right * 2 > points.len(), "{kind:?}: {right} of {sure}, {}", points.len());
    }
}

#[test]
fn too_few_places_have_no_points() {
    assert_eq!(points(&scan(&wall(3, |_, _| 0.0), Lit::Same, sphere, 1e-3, 6)), []);
}

#[test]
fn the_error_of_the_law_spreads_as_a_sum_over_all_pairs() {
    let zone_m = 0.3;
    let places = wall(6, |_, _| 0.0);
    let sample =
        |at: &Point| Sample { at: *at, length_m: (at - sphere(at)).norm(), sd_m: 1e-3, law_m: 2e-3, weighted_m: 1e-3 };
    let samples: Vec<Sample> = places.iter().map(sample).collect();
    let members: Vec<u32> = (0..36).collect();
    let field = fitted(14, &samples, &members, zone_m).unwrap();
    let inverse = field.fitted().noise;
    let mut naive = Covariance::zeros();
    for a in &samples {
        for b in &samples {
            let apart = (a.at - b.at) - field.direction * field.direction.dot(&(a.at - b.at));
            let correlation = (-0.5 * apart.norm_squared() / (zone_m * zone_m)).exp();
            let weight = correlation * a.law_m * b.law_m / (a.sd_m * b.sd_m).powi(2);
            naive += field.length(&a.at).1 * field.length(&b.at).1.transpose() * weight;
        }
    }
    let naive = inverse * naive * inverse;
    for k in 0..3 {
        let ratio = field.fitted().law[(k, k)] / naive[(k, k)];
        assert!((0.8..1.25).contains(&ratio), "{k}: {ratio}");
    }
}

#[test]
fn covariances_are_those_of_repeated_noise() {
    let places = wall(6, |_, _| 0.0);
    let members: Vec<u32> = (0..36).collect();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let (mut sum, mut stated) = (Matrix3::zeros(), Matrix3::zeros());
    for _ in 0..400 {
        let mut sample = |at: &Point| {
            let noise: f64 = StandardNormal.sample(&mut random);
            Sample {
                at: *at,
                length_m: (at - sphere(at)).norm() + 1e-4 * noise,
                sd_m: 1e-4,
                law_m: 0.0,
                weighted_m: 1e-4,
            }
        };
        let samples: Vec<Sample> = places.iter().map(&mut sample).collect();
        let field = fitted(14, &samples, &members, 0.1).unwrap();
        let off = field.reading(&Way::Back).0 - sphere(&places[14]);
        sum += off * off.transpose() / 400.0;
        let [slopes, _] = field.reading_slopes(&Way::Back);
        stated += slopes * field.fitted().noise * slopes.transpose() / 400.0;
    }
    // Variances over 400 draws have a standard deviation of 7 %.
    for k in 0..3 {
        assert!((0.75..1.3).contains(&(sum[(k, k)] / stated[(k, k)])), "{k}: {sum} {stated}");
    }
}

proptest! {
    #[test]
    fn neighbours_are_the_nearest(points in prop::collection::vec((-1.0..1.0, -0.3..0.3, -0.1..0.1), 30..80)) {
        let points: Vec<Point> = points.into_iter().map(|(x, y, z)| Point::new(x, y, z)).collect();
        let lists = neighbours(&points, 7, &Cancel::never());
        for (n, list) in lists.iter().enumerate() {
            let mut naive: Vec<(f64, u32)> =
                points.iter().zip(0..).map(|(point, k)| ((point - points[n]).norm_squared(), k)).collect();
            naive.sort_by(|a, b| a.partial_cmp(b).unwrap());
            prop_assert_eq!(list, &naive[..7].iter().map(|one| one.1).collect::<Vec<u32>>());
        }
    }
}

/// The nearest point of a block with half axes along the coordinates; one without depth is a plate.
fn block(middle: Point, half_m: [f64; 3]) -> impl Fn(&Point) -> Point {
    let half_m = Vector3::from(half_m);
    move |seen| middle + (seen - middle).zip_map(&half_m, |off, half| off.clamp(-half, half))
}

#[test]
fn plates_and_blocks_are_found_to_their_corners() {
    for (depth_m, seed) in [(0.0, 8), (0.1, 9)] {
        let surface = block(Point::new(0.05, 0.02, 0.7), [0.2, 0.15, depth_m]);
        let scan = scan(&wall(32, |_, _| 0.0), Lit::Same, &surface, 1e-3, seed);
        let (held, median_m) = judged(&scan, &surface);
        // Without flat faces the median is 5 mm.
        assert!(held > 0.9 && median_m < 1.5e-3, "depth {depth_m}: {held}, {median_m} m");
    }
}

/// Distances of a plane with noise and a smooth error, which a field takes in part: residuals of many scans tell how
/// large the error is.
#[test]
fn residuals_show_how_large_a_smooth_error_is() {
    let wall = wall(12, |_, _| 0.0);
    let near = neighbours(&wall, 20, &Cancel::never());
    let members: Vec<u32> = (0..wall.len() as u32).collect();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let (zone_m, sd_m) = (0.15_f64, 1e-3);
    let grid: Vec<Point> = (0..400).map(|n| Point::new(f64::from(n % 20), f64::from(n / 20), 0.0) * 0.1).collect();
    let grid: Vec<Point> = grid.into_iter().map(|at| at - Vector3::new(0.95, 0.95, 0.0)).collect();
    let unit = grid.iter().map(|at| (-2.0 * at.coords.norm_squared() / zone_m.powi(2)).exp()).sum::<f64>().sqrt();
    for law_m in [0.0, 1e-3, 3e-3_f64] {
        let mut of_scan = || {
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            // Bumps of a Gaussian shape give an error whose correlation is one of twice the variance.
            let bumps: Vec<(Point, f64)> = grid.iter().map(|at| (*at, normal())).collect();
            let height = |place: &Point| -> f64 {
                let of_bump = |(at, size): &(Point, f64)| size * (-(place - at).norm_squared() / zone_m.powi(2)).exp();
                bumps.iter().map(of_bump).sum()
            };
            let sample = |seen: &Point| {
                let length_m = 0.7 + law_m * height(seen) / unit + sd_m * normal();
                Sample { at: *seen, length_m, sd_m, law_m, weighted_m: sd_m.hypot(law_m) }
            };
            let samples: Vec<Sample> = wall.iter().map(sample).collect();
            let field = fitted(66, &samples, &members, zone_m).expect("a plane");
            Dispersion::of(&field, &samples, &members, &near, zone_m).expect("an information")
        };
        let shown = (0..40).map(|_| of_scan()).fold(Dispersion::default(), Dispersion::and);
        let (shown, most) = (shown.likeliest_m(), shown.law_m(1.0));
        println!("{law_m} m: {shown} m");
        assert!((shown.powi(2) - law_m.powi(2)).abs() < 0.15 * law_m.powi(2) + 2e-7, "{shown} of {law_m}");
        assert!(most > shown && most < 2.0 * law_m + 2.0 * sd_m, "{most} for {law_m}");
    }
}

/// From places over a face, beyond edges and beyond a corner.
#[test]
fn readings_of_flat_faces_have_the_slopes_of_differences() {
    const STEP: f64 = 1e-6;
    let surface = block(Point::new(0.0, 0.0, 0.7), [0.2, 0.15, 0.0]);
    let scan = scan(&wall(16, |_, _| 0.0), Lit::Same, &surface, 1e-4, 10);
    let hints: Vec<Hint> = points(&scan).iter().map(Hint::new).collect();
    let samples: Vec<Sample> = laws::samples(&scan, &vec![[1.0, 0.0, 0.0]; scan.places.len()], 0.0);
    let members: Vec<u32> = (0..samples.len() as u32).collect();
    let sheet = Flat::starts(samples[0].at, &hints, &samples, &members, 0.07).swap_remove(0);
    for (n, flat) in (0..samples.len()).flat_map(|n| [(n, sheet.clone()), (n, sheet.other().unwrap())]) {
        let flat = flat.seen_from(samples[n].at + Vector3::new(0.0, 0.0, -0.01));
        let slopes = flat.reading_slopes(&Way::Back);
        for k in 0..local::UNKNOWNS {
            let read = |step: f64| {
                let mut steps = local::Unknowns::zeros();
                steps[k] = step;
                flat.moved(&steps).reading(&Way::Back)
            };
            let (up, down) = (read(STEP), read(-STEP));
            let differences = [(up.0 - down.0) / (2.0 * STEP), (up.1 - down.1) / (2.0 * STEP)];
            for (slopes, differences) in slopes.iter().zip(differences) {
                let off = (slopes.column(k) - differences).norm();
                assert!(off < 1e-4, "place {n}, unknown {k}: {} and {differences}", slopes.column(k));
            }
        }
    }
}

/// The point of a sphere over which light goes from one point to another: the shortest way.
fn reflects(lit: &Point, seen: &Point) -> Point {
    let middle = Point::new(0.05, -0.03, 0.8);
    let mut point = sphere(&nalgebra::center(lit, seen));
    // The normal halves the angle between both directions.
    for _ in 0..200 {
        point = middle + ((lit - point).normalize() + (seen - point).normalize()).normalize() * 0.2;
    }
    point
}

/// Lit and seen points a hand apart, turned and drawn apart over the wall.
#[test]
fn pairs_that_move_together_show_the_point_that_reflects() {
    let half = |at: &Point| Vector3::new(0.1 + 0.2 * at.y, 0.06 - 0.15 * at.x, 0.0);
    for (seed, moved) in [(11, 0.0), (12, 1.0)] {
        let wall = wall(32, |_, _| 0.0);
        let halves: Vec<Vector3<f64>> =
            wall.iter().map(|at| half(&Point::origin()) * (1.0 - moved) + half(at) * moved).collect();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut truths = Vec::new();
        let mut place = |(at, half): (&Point, &Vector3<f64>)| {
            let (lit, seen) = (at - half, at + half);
            let point = reflects(&lit, &seen);
            truths.push((point, lit, seen));
            let noise: f64 = StandardNormal.sample(&mut random);
            let length_m = (point - lit).norm() + (point - seen).norm() + 1e-3 * noise;
            Place { seen: *at, returns: [Return { length_m, sd_m: 1e-3, common_m: 0.0, log_likelihood: 0.0 }; 3] }
        };
        let places = wall.iter().zip(&halves).map(&mut place).collect();
        let scan = Scan { lit: Lit::Apart(halves.clone()), inwards: Vector3::z(), sigma_m: SIGMA_M, places, least: 0 };
        let points = points(&scan);
        let holds = |point: &&SurfacePoint| {
            let off = point.point - truths[point.place].0;
            off.dot(&point.covariance_m2.cholesky().expect("a covariance").solve(&off)) < 7.815
        };
        let held = points.iter().filter(holds).count();
        let mut offs_m: Vec<f64> = points.iter().map(|point| (point.point - truths[point.place].0).norm()).collect();
        offs_m.sort_by(f64::total_cmp);
        assert!(points.len() > 950 && held * 100 > 95 * points.len(), "{moved}: {held} of {}", points.len());
        assert!(offs_m[offs_m.len() / 2] < 3e-3, "{moved}: {} m", offs_m[offs_m.len() / 2]);
        let turned = |point: &SurfacePoint| point.normal.angle(&(point.point - Point::new(0.05, -0.03, 0.8)));
        assert!(points.iter().filter(|point| turned(point) < 0.1).count() * 10 > 9 * points.len());
    }
}

/// Lit points in any order move with nothing.
#[test]
fn pairs_in_any_order_have_no_points() {
    let wall = wall(16, |_, _| 0.0);
    let halves = (0..wall.len()).map(|n| (wall[n] - wall[n * (31 * n + 7) % wall.len()]) * 0.5).collect();
    let scan = Scan { lit: Lit::Apart(halves), ..scan(&wall, Lit::Same, sphere, 1e-3, 13) };
    assert_eq!(points(&scan), []);
}
