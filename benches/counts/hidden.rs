//! Kernels that find what is hidden behind a wall.

use std::hint::black_box;

use nalgebra::Vector3;
use periscope_geometry::Point;
use periscope_geometry::first_return::{Lit, Place, Return, Scan, surface_points};
use periscope_geometry::joint::{Histogram, Noise, Problem, Pulse, joint_search};
use periscope_signal::Cancel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Kernel;

/// Points of a side of the walls.
const SIDE: usize = 6;

/// Points of a square wall of this width.
fn wall(width_m: f64) -> impl Iterator<Item = Point> {
    let along = move |n: usize| width_m * ((n as f64 + 0.5) / SIDE as f64 - 0.5);
    (0..SIDE * SIDE).map(move |n| Point::new(along(n % SIDE), along(n / SIDE), 0.0))
}

/// Points of a sphere from first returns of a wall.
pub fn first_returns() -> Kernel {
    let (mut rng, middle, sd_m) = (ChaCha8Rng::seed_from_u64(4), Point::new(0.05, -0.03, 0.8), 1.5e-3);
    let place = |seen: Point| {
        let length_m = 2.0 * ((middle - seen).norm() - 0.2) + rng.random_range(-1.7..1.7) * sd_m;
        Place { seen, returns: [Return { length_m, sd_m, common_m: 0.0, log_likelihood: 0.0 }; 3] }
    };
    let places = wall(0.3).map(place).collect();
    let scan = Scan { lit: Lit::Same, inwards: Vector3::z(), sigma_m: 7.5e-3, places, least: 0 };
    Box::new(move || {
        let timed = |place: usize, laws: &[_], _| vec![Some(scan.places[place].returns[0]); laws.len()];
        assert!(!surface_points(black_box(&scan), timed, &Cancel::never()).is_empty(), "the sphere is seen");
    })
}

/// A small thing from the histograms of a wall.
pub fn small_thing() -> Kernel {
    const STEP_M: f64 = 0.0024;
    const FIRST_M: f64 = 0.24;
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let response = |after_m: f64| (-0.5 * (after_m / 7.6e-3).powi(2)).exp();
    let thing = Point::new(0.1, -0.05, 0.35);
    let histogram = |lit: Point| {
        let seen = lit + Vector3::x() * 0.05;
        let legs_m = [(thing - lit).norm(), (thing - seen).norm()];
        let value = |bin: usize| {
            let after_m = FIRST_M + (bin as f64 + 0.5) * STEP_M - legs_m[0] - legs_m[1];
            (40.0 * response(after_m) + rng.random_range(0.0..2.0_f64)).floor() as f32
        };
        Histogram { lit, seen, first_m: FIRST_M, values: (0..300).map(value).collect(), ends: [[0.0; 2]; 2] }
    };
    let histograms = wall(0.6).map(histogram).collect();
    let values: Vec<f64> = (-40..40).map(|n| response(f64::from(n) * 1e-3)).collect();
    let light = (STEP_M, Pulse::new(-0.04, 1e-3, &values, STEP_M), Noise::Counts);
    let room = (Point::new(0.0, 0.0, 1.0), 0.45);
    let problem = Problem::new(histograms, light, room, 0.01, Cancel::never()).expect("a wall");
    Box::new(move || assert!(!joint_search(black_box(&problem)).points.is_empty(), "the thing is found"))
}
