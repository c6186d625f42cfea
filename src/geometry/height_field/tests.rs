//! Surfaces from lengths whose errors are made here: noise of each place, a smooth random function, and a common shift.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::grid::Foot;
use super::*;
use crate::first_return::{FirstLight, Kind};
use crate::shapes::tests::{COMMON_M, LAW_M, NOISE_M, ZONE_M, normal, smooth};

/// How far points are off that neighbouring places tell: those of concave surfaces are.
const OFF_M: f64 = 0.02;

/// Sightings of a square metre with 28 x 28 places.
fn sightings(seed: u64, nearest: &impl Fn(&Point) -> Point) -> Vec<Sighting> {
    sightings_with(seed, nearest, [LAW_M, COMMON_M])
}

/// The same with these errors of the law and of all lengths beside their noise.
fn sightings_with(seed: u64, nearest: &impl Fn(&Point) -> Point, [law_m, common_m]: [f64; 2]) -> Vec<Sighting> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let law = smooth(&mut random);
    let shift_m = common_m * normal(&mut random);
    let at = |n: usize| (n as f64 + 0.5) / 28.0 - 0.5;
    (0..784)
        .map(|n| {
            let seen = Point::new(at(n % 28), at(n / 28), 0.0);
            let point = nearest(&seen);
            let length_m =
                (seen - point).norm() + NOISE_M * normal(&mut random) + law_m * law(seen.x, seen.y) + shift_m;
            let light = FirstLight { length_m, sd_m: NOISE_M, law_m, zone_m: ZONE_M, common_m };
            let off = Vector3::from_fn(|_, _| OFF_M * normal(&mut random));
            let covariance_m2 = Matrix3::identity() * OFF_M.powi(2);
            Sighting { seen, light, point: point + off, covariance_m2, part: Kind::Unknown, edges: 0.0 }
        })
        .collect()
}

/// The nearest point of a square with a height, by search.
fn relief(height_m: fn(f64, f64) -> f64) -> impl Fn(&Point) -> Point {
    const HALF_M: f64 = 0.25;
    move |seen: &Point| {
        let place = |[x, y]: [f64; 2]| Point::new(x, y, 0.7 - height_m(x, y));
        let square = |at: [f64; 2]| (place(at) - seen).norm_squared();
        let along = |n: usize| HALF_M * (n as f64 / 20.0 - 1.0);
        let grid = (0..41 * 41).map(|n| [along(n % 41), along(n / 41)]);
        let mut best = grid.min_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap();
        let mut step_m = HALF_M / 20.0;
        while step_m > 1e-6 {
            let moved = |x: f64, sign: i32| (x + f64::from(sign) * step_m).clamp(-HALF_M, HALF_M);
            let tries = (0..9).map(|n| [moved(best[0], n % 3 - 1), moved(best[1], n / 3 - 1)]);
            let next = tries.min_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap();
            if square(next) < square(best) {
                best = next;
            } else {
                step_m *= 0.5;
            }
        }
        place(best)
    }
}

fn saddle(x: f64, y: f64) -> f64 {
    0.6 * (x * x - y * y)
}

fn wavy(x: f64, y: f64) -> f64 {
    0.015 * (14.0 * x).sin() * (11.0 * y).cos()
}

fn sphere(seen: &Point) -> Point {
    let middle = Point::new(0.05, -0.03, 0.8);
    middle + (seen - middle).normalize() * 0.2
}

/// A box that turns a corner to the wall: the place sees its corner and its edges, hardly its faces.
fn cuboid(seen: &Point) -> Point {
    let axes = [Vector3::new(1.0, 1.0, 1.0), Vector3::new(-1.0, 1.0, 0.0), Vector3::new(1.0, 1.0, -2.0)];
    let [a, b, c] = axes.map(|axis| axis.normalize());
    let turned = [a * 0.58 + b * 0.71 + c * 0.41, a * 0.58 - b * 0.71 + c * 0.41, a * 0.58 - c * 0.82];
    let middle = Point::new(0.0, 0.0, 0.8);
    turned.iter().fold(middle, |point, axis| {
        let axis = axis.normalize();
        point + axis * axis.dot(&(seen - middle)).clamp(-0.12, 0.12)
    })
}

/// Squared scores of nodes by their distance from the surface, and errors (m).
fn off(fields: &[HeightField], nearest: &impl Fn(&Point) -> Point) -> (Vec<f64>, Vec<f64>) {
    let nodes = || fields.iter().flat_map(|field| &field.nodes);
    let far_m: Vec<f64> = nodes().map(|node| (nearest(&node.point) - node.point).norm()).collect();
    (nodes().zip(&far_m).map(|(node, far_m)| (far_m / node.sd_m).powi(2)).collect(), far_m)
}

/// Seeds of each surface: each is one draw, since the nodes of one share errors.
const SEEDS: u64 = 6;

/// Whether bars hold, with so many nodes of a seed or more in the mean.
fn holds(name: &str, least: usize, nearest: impl Fn(&Point) -> Point) {
    let (mut within, mut nodes, mut worst_mm) = (0, 0, 0.0_f64);
    for seed in 0..SEEDS {
        let fields = height_fields(&sightings(seed, &nearest), &Cancel::never());
        let (squares, far_m) = off(&fields, &nearest);
        within += squares.iter().filter(|square| **square < 1.96 * 1.96).count();
        nodes += squares.len();
        if !far_m.is_empty() {
            worst_mm = worst_mm.max(1e3 * median(far_m));
        }
    }
    println!("{name}: {within} of {nodes} within 95 %, medians of errors to {worst_mm:.2} mm");
    assert!(nodes > least * SEEDS as usize, "{name}: {nodes} nodes");
    assert!(within * 100 >= 93 * nodes && worst_mm < 2.0, "{name}: {within} of {nodes}, {worst_mm} mm");
}

/// Points that are off by centimetres have a surface between them that is off by a millimetre.
#[test]
fn heights_of_concave_and_wavy_surfaces_lie_within_their_error_bars() {
    // The nearest point slides fast over a saddle: few of its nodes lie next to one.
    holds("saddle", 6, relief(saddle));
    holds("wavy", 40, relief(wavy));
}

#[test]
fn heights_of_spheres_and_plates_lie_within_their_error_bars() {
    holds("sphere", 40, sphere);
    holds("plate", 40, relief(|x, _| 0.3 * x));
}

/// Where lengths have noise alone, standard deviations are the root of the inverse of what lengths and the prior of
/// curvatures tell: the Cramer-Rao bound for such a prior (van Trees). Curvatures are those of the surface, not drawn
/// from the prior, and their size is not known before.
#[test]
fn heights_err_little_more_than_their_bound_allows() {
    let surfaces: [(&str, Box<dyn Fn(&Point) -> Point>); 4] = [
        ("sphere", Box::new(sphere)),
        ("plate", Box::new(relief(|x, _| 0.3 * x))),
        ("wavy", Box::new(relief(wavy))),
        ("saddle", Box::new(relief(saddle))),
    ];
    for (name, nearest) in surfaces {
        let (mut errors_m2, mut bounds_m2, mut nodes) = (0.0, 0.0, 0);
        for seed in 0..SEEDS {
            for field in height_fields(&sightings_with(seed, &nearest, [0.0; 2]), &Cancel::never()) {
                errors_m2 +=
                    field.nodes.iter().map(|one| (nearest(&one.point) - one.point).norm_squared()).sum::<f64>();
                bounds_m2 += field.nodes.iter().map(|one| one.sd_m.powi(2)).sum::<f64>();
                nodes += field.nodes.len();
            }
        }
        let ratio = (errors_m2 / bounds_m2).sqrt();
        println!("{name}: rms of {nodes} nodes {ratio:.2} of its bound");
        assert!(nodes > 40 && ratio < 1.3, "{name}: {ratio}");
    }
}

/// Edges and a corner do not say how the faces between them lie.
#[test]
fn faces_that_no_place_sees_are_not_reported() {
    for seed in 0..SEEDS {
        let fields = height_fields(&sightings(seed, &cuboid), &Cancel::never());
        let (squares, _) = off(&fields, &cuboid);
        let without = squares.iter().filter(|square| **square > 9.0).count();
        assert!(without == 0, "seed {seed}: {without} of {} nodes lie off the box", squares.len());
    }
}

/// A ring of wire: no place sees anything within it.
#[test]
fn within_a_ring_there_is_no_surface() {
    let ring = |seen: &Point| {
        let towards = Vector3::new(seen.x, seen.y, 0.0).normalize();
        Point::new(0.0, 0.0, 0.7) + towards * 0.2
    };
    for seed in 0..SEEDS {
        let fields = height_fields(&sightings(seed, &ring), &Cancel::never());
        let nodes: usize = fields.iter().map(|field| field.nodes.len()).sum();
        assert!(nodes == 0, "seed {seed}: {nodes} nodes");
    }
}

#[test]
fn two_things_have_surfaces_of_their_own() {
    let left = |seen: &Point| Point::new(-0.4, 0.0, 0.7) + (seen - Point::new(-0.4, 0.0, 0.7)).normalize() * 0.15;
    let right = |seen: &Point| Point::new(0.4, 0.0, 0.75) + (seen - Point::new(0.4, 0.0, 0.75)).normalize() * 0.15;
    let both = move |seen: &Point| {
        let [a, b] = [left(seen), right(seen)];
        if (a - seen).norm() < (b - seen).norm() { a } else { b }
    };
    let fields = height_fields(&sightings(3, &both), &Cancel::never());
    assert_eq!(fields.len(), 2);
    let sides = fields.iter().map(|field| field.nodes.iter().all(|node| node.point.x < 0.0));
    assert_eq!(sides.filter(|is_left| *is_left).count(), 1);
}

/// Lengths that no surface has: noise that is ten times what it is said to be.
#[test]
fn lengths_without_a_surface_have_none() {
    let mut all = sightings(1, &sphere);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    all.iter_mut().for_each(|one| one.light.length_m += 10.0 * NOISE_M * normal(&mut random));
    assert!(height_fields(&all, &Cancel::never()).is_empty());
}

/// Tiles that are left out hold no nearer node.
#[test]
fn the_nearest_node_is_that_of_all() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let grid = Grid::new(Vector2::new(-0.3, -0.2), Vector2::new(0.25, 0.35), 0.02);
    let heights_m: Vec<f64> = (0..grid.count()).map(|_| 0.05 * normal(&mut random)).collect();
    let nodes = grid.nodes(&heights_m);
    for n in 0..400 {
        let place = Point::new(0.4 * normal(&mut random), 0.4 * normal(&mut random), 0.3 * f64::from(n % 4));
        let far_m2 = |node: &usize| (grid.point(*node, heights_m[*node]) - place).norm_squared();
        let nearest = (0..grid.count()).min_by(|a, b| far_m2(a).total_cmp(&far_m2(b))).unwrap();
        for near in [None, Some(0), Some(nearest), Some(grid.count() - 1)] {
            assert_eq!(nodes.nearest(&place, near), nearest, "{place}, from {near:?}");
        }
    }
}

/// How far a surface lies behind each node of a grid along its axis, by search.
fn heights(frame: &Frame, grid: &Grid, height_m: fn(f64, f64) -> f64) -> Vec<f64> {
    let below = |node: usize, height: f64| {
        let at = frame.point(&grid.point(node, height));
        at.z > 0.7 - height_m(at.x.clamp(-0.25, 0.25), at.y.clamp(-0.25, 0.25))
    };
    let height = |node: usize| {
        let (mut low, mut high) = (-0.5, 0.5);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if below(node, middle) { low = middle } else { high = middle }
        }
        low
    };
    (0..grid.count()).map(height).collect()
}

/// Heights that start from a plane end where those do that start from the true surface.
#[test]
fn the_likeliest_heights_are_found_from_afar() {
    for (name, height_m) in [("saddle", saddle as fn(f64, f64) -> f64), ("wavy", wavy)] {
        let sightings = sightings(0, &relief(height_m));
        let members = groups(&sightings).into_iter().max_by_key(Vec::len).unwrap();
        let all: Vec<&Sighting> = members.iter().map(|n| &sightings[*n]).collect();
        let frame = Frame::of(&all).unwrap();
        let grid = frame.grid(&all, ZONE_M);
        let places: Vec<Point> = all.iter().map(|one| frame.local(&one.seen)).collect();
        let problem = Problem::new(&grid, &places, &all);
        let (_, fit) = Fit::loose(&problem, &Cancel::never()).unwrap();
        let truth = Fit::at(&problem, heights(&frame, &grid, height_m), &[], fit.bend_per_m);
        let near = truth.likeliest(&problem, &Cancel::never()).unwrap();
        println!("{name}: {:.1} from a plane, {:.1} from the truth", fit.loss(), near.loss());
        assert!(fit.loss() < near.loss() + 5.0, "{name}: {} and {}", fit.loss(), near.loss());
    }
}

#[test]
fn bends_of_a_distance_are_its_second_differences() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let grid = Grid::new(Vector2::new(-0.1, -0.1), Vector2::new(0.1, 0.1), 0.05);
    let (mut inside, mut on_sides) = (0, 0);
    for n in 0..60 {
        let size_m = if n % 2 == 0 { 1e-3 } else { 3e-2 };
        let heights_m: Vec<f64> = (0..grid.count()).map(|_| size_m * normal(&mut random)).collect();
        let place = Point::new(0.04 * normal(&mut random), 0.04 * normal(&mut random), 0.6);
        let at = |heights_m: &[f64]| grid.nodes(heights_m).foot(&place, None);
        let foot = at(&heights_m);
        let bends = grid.bend_per_m(&foot, &heights_m);
        let ends = |foot: &Foot| foot.shares.iter().filter(|share| **share > 0.0).count();
        for (a, b) in (0..3).flat_map(|a| (0..=a).map(move |b| (a, b))) {
            let feet = [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)].map(|(one, other)| {
                let mut moved = heights_m.clone();
                moved[foot.nodes[a] as usize] += one * 1e-5;
                moved[foot.nodes[b] as usize] += other * 1e-5;
                at(&moved)
            });
            // Where the foot leaves its triangle or its side, differences mix two bends.
            if feet.iter().any(|moved| ends(moved) != ends(&foot)) {
                continue;
            }
            let [far, near, one, other] = feet.map(|foot| foot.distance_m);
            let second = (far + near - one - other) / 4e-10;
            assert!((second - bends[a][b]).abs() < 0.02 * (1.0 + second.abs()), "{foot:?}: {second}, {}", bends[a][b]);
            inside += usize::from(ends(&foot) == 3);
            on_sides += usize::from(ends(&foot) == 2);
        }
    }
    assert!(inside > 60 && on_sides > 30, "{inside} within a triangle, {on_sides} on a side");
}

/// The right half of a sphere's light is said to come from edges: the surface has the left half alone.
#[test]
fn between_edges_that_lengths_do_not_show_there_is_no_surface() {
    let mut all = sightings(1, &sphere);
    all.iter_mut().filter(|one| one.seen.x > 0.05).for_each(|one| one.edges = 0.9);
    let fields = height_fields(&all, &Cancel::default());
    let [field] = fields.as_slice() else { panic!("{} surfaces", fields.len()) };
    assert!(field.members.iter().all(|n| all[*n].seen.x <= 0.05) && field.members.len() > 300);
    assert!(field.nodes.iter().all(|node| node.point.x < 0.08), "nodes reach into the other half");
}
