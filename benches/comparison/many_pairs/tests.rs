use super::*;
use crate::room;
use periscope_geometry::{maximum_likelihood as exact, procrustes};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SD_M: f64 = 0.0075;

/// Patches on the three rectangles, at random.
fn measurements(count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let on = |n: usize, u: f64, v: f64| match n % 3 {
        0 => Point::new(-1.2 + 2.0 * u, 2.6, -0.8 + 1.6 * v),
        1 => Point::new(1.1, 1.0 + 1.4 * u, -0.8 + 1.6 * v),
        _ => Point::new(-1.0 + 1.8 * u, 1.6 + 0.7 * v, -0.9),
    };
    (0..count).map(|n| on(n, rng.random_range(0.0..1.0), rng.random_range(0.0..1.0))).collect()
}

struct Measured {
    first_m: Vec<f64>,
    second_m: Vec<f32>,
    sds: Vec<f32>,
}

impl Measured {
    /// Lengths with noise, a delay, and pairs missing.
    fn new(truth: &[Point], missing: f64, delay_m: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut noisy = |length_m: f64| -> f64 {
            let noise: f64 = StandardNormal.sample(rng);
            length_m + delay_m + SD_M * noise
        };
        let first_m = (0..truth.len()).map(|i| noisy(room::first_m(truth, i))).collect();
        let second_m: Vec<f32> =
            room::all_pairs(truth.len()).into_iter().map(|(j, i)| noisy(room::second_m(truth, i, j)) as f32).collect();
        let sd = |_: &f32| if rng.random_bool(missing) { f32::INFINITY } else { SD_M as f32 };
        let sds = second_m.iter().map(sd).collect();
        Self { first_m, second_m, sds }
    }

    fn lengths(&self, delay_sd_m: f64) -> Lengths<'_> {
        Lengths {
            first_m: &self.first_m,
            first_sd_m: SD_M,
            second_m: &self.second_m,
            second_sd_m: Sds::Each(&self.sds),
            delay_sd_m,
            dimensions: 3,
        }
    }

    /// The same by the dense method, from a start.
    fn exactly(&self, start: &[Point], delay_sd_m: f64) -> exact::Solution {
        let origin = exact::Node::Station(0);
        let observation = |patches: &[usize], length_m: f64| {
            exact::Observation::new(
                std::iter::once(origin).chain(patches.iter().map(|&p| exact::Node::Patch(p))).chain([origin]).collect(),
                length_m,
                SD_M,
            )
        };
        let first = self.first_m.iter().enumerate().map(|(i, length_m)| observation(&[i], *length_m));
        let second = room::all_pairs(start.len()).into_iter().zip(self.second_m.iter().zip(&self.sds));
        let second = second.filter(|(_, (_, sd_m))| sd_m.is_finite());
        let observations =
            first.chain(second.map(|((j, i), (length_m, _))| observation(&[i, j], f64::from(*length_m))));
        let problem = exact::Problem::new(start.to_vec(), 3, &[Point::origin()], observations.collect());
        exact::solve(&if delay_sd_m > 0.0 { problem.with_common_delay(delay_sd_m) } else { problem }).unwrap()
    }
}

#[test]
fn it_agrees_with_the_dense_method() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let truth = measurements(100, &mut rng);
    for (missing, delay_sd_m) in [(0.0, 0.0), (0.0, 0.01), (0.3, 0.01)] {
        let mut measured = Measured::new(&truth, missing, 0.5 * delay_sd_m, &mut rng);
        measured.second_m[700] += 1.0;
        let solution = solve(&measured.lengths(delay_sd_m)).unwrap();
        let exact = measured.exactly(&solution.points, delay_sd_m);
        let apart = procrustes::rotation(&solution.points, &exact.points, Point::origin(), true).rms_m;
        let sd_m = ((0..100).map(|i| exact.patch_covariance_m2(i, i).trace()).sum::<f64>() / 100.0).sqrt();
        eprintln!("apart {apart:.2e} m of {sd_m:.2e} m, {} passes", solution.passes);
        assert!(apart < 0.03 * sd_m);
        assert_eq!(solution.degrees_of_freedom, exact.degrees_of_freedom);
        if delay_sd_m > 0.0 {
            let delay_sd_m = exact.delay_variance_m2(0).sqrt();
            assert!((solution.delay_m - exact.delays_m[0]).abs() < 0.03 * delay_sd_m);
            assert!((solution.delay_variance_m2.sqrt() / delay_sd_m - 1.0).abs() < 0.02);
        }
    }
}

#[test]
fn its_covariances_are_within_three_percent_of_the_exact_ones() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = measurements(300, &mut rng);
    for delay_sd_m in [0.0, 0.03] {
        let measured = Measured::new(&truth, 0.0, 0.0, &mut rng);
        let solution = solve(&measured.lengths(delay_sd_m)).unwrap();
        let exact = measured.exactly(&solution.points, delay_sd_m);
        let ratio = |i: usize| (solution.covariances_m2[i].trace() / exact.patch_covariance_m2(i, i).trace()).sqrt();
        let ratios: Vec<f64> = (0..truth.len()).map(ratio).collect();
        let worst = ratios.iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, f64::max);
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        eprintln!("delay {delay_sd_m} m: sd over exact sd {mean:.4}, at worst off by {worst:.4}");
        assert!(worst < 0.03);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let truth = measurements(150, &mut rng);
    let measured = Measured::new(&truth, 0.2, 0.001, &mut rng);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| solve(&measured.lengths(0.01)).unwrap())
    };
    let one = with(1);
    for threads in [2, 5] {
        let other = with(threads);
        assert!(other.points == one.points && other.loss.to_bits() == one.loss.to_bits());
        assert_eq!(other.covariances_m2, one.covariances_m2);
    }
}

#[test]
fn products_are_the_change_of_the_slope() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let truth = measurements(21, &mut rng);
    let mut measured = Measured::new(&truth, 0.1, 0.0, &mut rng);
    // Exact lengths, so that second derivatives have no residual to weigh.
    measured.first_m = (0..21).map(|i| room::first_m(&truth, i)).collect();
    measured.second_m = room::all_pairs(21).iter().map(|&(j, i)| room::second_m(&truth, i, j) as f32).collect();
    let lengths = measured.lengths(0.02);
    let measurements = Measurements::new(&lengths);
    let mut motion =
        measurements.gather(|i| Vector3::new((i as f64).sin(), (2.0 * i as f64).cos(), (3.0 * i as f64).sin()));
    motion[3 * measurements.stride] = 0.7;
    let at = measurements.values(&truth, 0.0);
    let product = measurements.product(&at, &motion);
    let right = |share: f64| measurements.slope(&measurements.moved(&at, &motion, share)).right;
    let (up, down) = (right(1e-5), right(-1e-5));
    let size = product.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    for (i, product) in product.iter().enumerate() {
        let change = (down[i] - up[i]) / 2e-5;
        assert!((change - product).abs() < 1e-4 * size, "{i}: {change} {product}");
    }
}

#[test]
fn flatland_stays_flat() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let truth: Vec<Point> =
        measurements(40, &mut rng).iter().map(|p| Point::new(p.x + 0.3 * p.z, p.y - 0.5 * p.z, 0.0)).collect();
    let measured = Measured::new(&truth, 0.0, 0.0, &mut rng);
    let solution = solve(&Lengths { dimensions: 2, ..measured.lengths(0.0) }).unwrap();
    assert!(solution.points.iter().all(|p| p.z == 0.0) && solution.covariances_m2.iter().all(|c| c[(2, 2)] == 0.0));
    assert!(procrustes::rotation(&solution.points, &truth, Point::origin(), true).rms_m < SD_M);
}
