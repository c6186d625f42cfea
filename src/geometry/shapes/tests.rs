//! Shapes from lengths whose errors are made here: noise of each place, a smooth random function, and a common shift.

use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

pub const NOISE_M: f64 = 5e-4;
pub const LAW_M: f64 = 8e-4;
pub const COMMON_M: f64 = 2e-4;
pub const ZONE_M: f64 = 0.07;

/// What a place sees: its nearest point, and what part that is.
type Seen = (Point, Part);

pub fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// A smooth random function of standard deviation 1: waves of random directions, as many as make it nearly Gaussian.
pub fn smooth(random: &mut ChaCha8Rng) -> impl Fn(f64, f64) -> f64 + use<> {
    let waves: Vec<[f64; 3]> = (0..300)
        .map(|_| [normal(random) / ZONE_M, normal(random) / ZONE_M, random.random::<f64>() * std::f64::consts::TAU])
        .collect();
    move |x, y| {
        let sum: f64 = waves.iter().map(|[along, up, phase]| (along * x + up * y + phase).cos()).sum();
        sum * (2.0 / 300.0_f64).sqrt()
    }
}

/// Sightings of a square metre with 24 x 24 places.
fn sightings(seed: u64, nearest: impl Fn(&Point) -> Seen) -> Vec<Sighting> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let law = smooth(&mut random);
    let shift_m = COMMON_M * normal(&mut random);
    let at = |n: usize| (n as f64 + 0.5) / 24.0 - 0.5;
    (0..576)
        .map(|n| {
            let seen = Point::new(at(n % 24), at(n / 24), 0.0);
            let (point, part) = nearest(&seen);
            let length_m =
                (seen - point).norm() + NOISE_M * normal(&mut random) + LAW_M * law(seen.x, seen.y) + shift_m;
            let light = FirstLight { length_m, sd_m: NOISE_M, law_m: LAW_M, zone_m: ZONE_M, common_m: COMMON_M };
            let off = Vector3::from_fn(|_, _| 3e-3 * normal(&mut random));
            Sighting { seen, light, point: point + off, covariance_m2: Matrix3::identity() * 9e-6, part, edges: 0.0 }
        })
        .collect()
}

fn sphere(seen: &Point) -> Seen {
    let middle = Point::new(0.05, -0.03, 0.8);
    (middle + (seen - middle).normalize() * 0.2, Part::Smooth)
}

/// An upright cylinder behind a plate that stands out of it to one side.
fn cylinder(seen: &Point) -> Seen {
    let axis = Point::new(0.1, seen.y, 0.9);
    (axis + (seen - axis).normalize() * 0.15, Part::Smooth)
}

/// A plate of 40 x 30 cm that faces the wall.
fn plate(seen: &Point) -> Seen {
    let point = Point::new(seen.x.clamp(-0.2, 0.2), seen.y.clamp(-0.15, 0.15), 0.6);
    let beyond = usize::from(seen.x.abs() > 0.2) + usize::from(seen.y.abs() > 0.15);
    (point, [Part::Smooth, Part::Edge, Part::Corner][beyond])
}

/// A surface whose height over the wall is a saddle: its nearest point by Newton's method.
fn saddle(seen: &Point) -> Seen {
    let height_m = |x: f64, y: f64| 0.7 + 0.1 * (x * x - y * y);
    let (mut x, mut y) = (seen.x, seen.y);
    for _ in 0..50 {
        let deep = height_m(x, y) - seen.z;
        (x, y) = (seen.x - 0.2 * x * deep, seen.y + 0.2 * y * deep);
    }
    (Point::new(x, y, height_m(x, y)), Part::Smooth)
}

/// The crest of a wave, which is curved by 3 per metre along and 1.8 per metre across; beyond it no point is known to
/// be smooth.
fn crest(seen: &Point) -> Seen {
    let height_m = |x: f64, y: f64| 0.65 + 1.5 * x * x + 0.9 * y * y;
    let (mut x, mut y) = (seen.x, seen.y);
    for _ in 0..200 {
        let deep = height_m(x, y) - seen.z;
        (x, y) = (0.7 * x + 0.3 * (seen.x - 3.0 * x * deep), 0.7 * y + 0.3 * (seen.y - 1.8 * y * deep));
    }
    let part = if x.abs() < 0.05 && y.abs() < 0.06 { Part::Smooth } else { Part::Unknown };
    (Point::new(x, y, height_m(x, y)), part)
}

fn of_seed(seed: u64, nearest: impl Fn(&Point) -> Seen) -> Vec<Shape> {
    shapes(&sightings(seed, nearest), &Cancel::never())
}

#[test]
fn radii_of_spheres_and_cylinders_err_as_they_say() {
    for (nearest, kind, true_m) in [(sphere as fn(&Point) -> Seen, Kind::Sphere, 0.2), (cylinder, Kind::Cylinder, 0.15)]
    {
        let mut squares = Vec::new();
        for seed in 0..16 {
            let shapes = of_seed(seed, nearest);
            assert!(shapes.iter().all(|shape| shape.kind() == kind), "{shapes:?}");
            // What is not sure is not reported.
            let Some(shape) = shapes.first().filter(|shape| shape.members.len() > 500) else { continue };
            let [radius_m, sd_m] = shape.radius_m().unwrap();
            assert!(sd_m < 8e-3, "{sd_m}");
            squares.push(((radius_m - true_m) / sd_m).powi(2));
        }
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        println!("{kind:?}: {} of 16 told, mean squared score {mean:.2}", squares.len());
        // Means of 12 squared scores lie in this range but for 1 of 100.
        assert!(squares.len() >= 12 && (0.25..2.4).contains(&mean), "{kind:?}: {mean}");
    }
}

#[test]
fn planes_err_as_they_say() {
    // All points of a plane share its three unknowns: each plane is one draw.
    let squares: Vec<f64> = (0..24)
        .map(|seed| {
            let all = sightings(seed, plate);
            let shapes = shapes(&all, &Cancel::never());
            let [shape] = shapes.as_slice() else { panic!("{shapes:?}") };
            assert!(shape.kind() == Kind::Plane && shape.members.len() > 60, "{shape:?}");
            let axis = shape.axis().unwrap();
            let [at_m2, axis_m2] = shape.covariances();
            let off_m = axis.z * (shape.at().z - 0.6);
            let turn = axis.xy();
            let turn_m2 = axis_m2.fixed_view::<2, 2>(0, 0).into_owned();
            let turned = turn.dot(&(turn_m2.try_inverse().expect("two turns have errors") * turn));
            (off_m * off_m / axis.dot(&(at_m2 * axis)) + turned) / 3.0
        })
        .collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    println!("24 planes: mean squared score {mean:.2}");
    // Of 72 degrees of freedom: but for 1 of 1,000.
    assert!((0.5..1.6).contains(&mean), "{mean}");
}

#[test]
fn a_bent_surface_has_no_shape() {
    for seed in 0..6 {
        let shapes = of_seed(seed, saddle);
        assert!(shapes.is_empty(), "{shapes:?}");
    }
}

#[test]
fn the_crest_of_a_wave_is_no_sphere() {
    for seed in 0..6 {
        let shapes = of_seed(seed, crest);
        assert!(shapes.is_empty(), "{shapes:?}");
    }
}

/// Across a strip of three columns lengths do not show how a surface is curved: it may be a sphere, or a saddle.
#[test]
fn a_narrow_strip_of_a_sphere_has_no_shape() {
    let strip = |seen: &Point| {
        let (point, _) = sphere(seen);
        (point, if seen.x.abs() < 0.07 { Part::Smooth } else { Part::Unknown })
    };
    for seed in 0..6 {
        let shapes = of_seed(seed, strip);
        assert!(shapes.is_empty(), "seed {seed}: {:?} of {} places", shapes[0].kind(), shapes[0].members.len());
    }
}

#[test]
fn few_places_have_no_shape() {
    let all = sightings(1, sphere);
    assert!(shapes(&all[..LEAST - 1], &Cancel::never()).is_empty());
    assert!(shapes(&[], &Cancel::never()).is_empty());
}

/// Waves make the covariance that a Gaussian process has.
#[test]
fn errors_are_those_of_a_dense_covariance() {
    let all: Vec<Sighting> = sightings(3, sphere).into_iter().step_by(3).collect();
    let wall = Wall::new(&all, &Cancel::never()).unwrap();
    let members: Vec<u32> = (0..all.len() as u32).collect();
    let law = Smooth { length_m: 0.1, sd_m: Box::new(|_| LAW_M) };
    let errors = Errors::new(&wall.members(&members), 1.0, &[law]).unwrap();
    let dense = Mat::from_fn(all.len(), all.len(), |i, j| {
        let square = (all[i].seen - all[j].seen).norm_squared() / 0.01;
        COMMON_M * COMMON_M + LAW_M * LAW_M * (-0.5 * square).exp() + if i == j { NOISE_M * NOISE_M } else { 0.0 }
    });
    let dense = Definite::new(&dense).unwrap();
    let core = Core::new(Kind::Sphere, Point::new(0.05, -0.03, 0.8), Vector3::z(), 0.2);
    let (residuals_m, slopes) = wall.residuals(&core, &members);
    let (square, information, _) = errors.information(&residuals_m, &slopes);
    let mut columns =
        Mat::from_fn(all.len(), UNKNOWNS + 1, |i, j| if j < UNKNOWNS { slopes[i][j] } else { residuals_m[i] });
    dense.whiten(&mut columns);
    let whole = crate::dense::product(columns.transpose(), columns.as_ref());
    assert!((square / whole[(UNKNOWNS, UNKNOWNS)] - 1.0).abs() < 0.05, "{square} and {}", whole[(UNKNOWNS, UNKNOWNS)]);
    for k in 0..4 {
        let ratio = information[(k, k)] / whole[(k, k)];
        assert!((ratio - 1.0).abs() < 0.1, "unknown {k}: {ratio}");
    }
    assert!((errors.log_determinant - dense.log_determinant()).abs() < 0.02 * errors.log_determinant.abs());
}

proptest! {
    /// Slopes are those of differences, for any shape and place.
    #[test]
    fn slopes_are_differences(
        kind in 0..3_usize,
        at in prop::array::uniform3(-0.3..0.3_f64),
        axis in prop::array::uniform3(-1.0..1.0_f64),
        seen in prop::array::uniform2(-0.5..0.5_f64),
        radius_m in 0.01..0.3_f64,
    ) {
        let axis = Vector3::from(axis) + Vector3::z() * 1.5;
        let kind = Kind::ALL[kind];
        let radius_m = if kind.has_radius() { radius_m } else { 0.0 };
        let core = Core::new(kind, Point::new(at[0], at[1], 1.0 + at[2]), axis, radius_m);
        let seen = Point::new(seen[0], seen[1], 0.0);
        let slopes = core.slopes(&seen);
        for k in 0..core.unknowns() {
            let moved = |step: f64| {
                core.moved(&Unknowns::from_fn(|j, _| if j == k { step } else { 0.0 })).distance_m(&seen)
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            prop_assert!((slope - slopes[k]).abs() < 1e-6, "{kind:?}, unknown {k}: {slope} and {}", slopes[k]);
        }
        let (foot, away) = core.foot(&seen);
        prop_assert!((foot + away.into_inner() * core.distance_m(&seen) - seen).norm() < 1e-12);
    }
}
