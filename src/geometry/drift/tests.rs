//! Rooms whose delay walks while their lengths are measured.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::loss::Loss;
use crate::maximum_likelihood::{Node, Observation, Problem, solve};
use crate::{Point, procrustes};

/// Metres of path in a picosecond.
const C: f64 = 2.997_924_58e-4;
const SD_M: f64 = 2.0 * C;
/// Each length has its time.
const STEPS: usize = 64;

/// Eight patches; first and second bounces of all pairs, both ways, one after the other.
struct Day {
    truth: Vec<Point>,
    observations: Vec<Observation>,
    walk_m: Vec<f64>,
}

/// With errors of single lengths that are `factor` times as large as they say.
fn day(drift_m: f64, factor: f64, seed: u64) -> Day {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut place = || Point::new(rng.random_range(-1.0..1.0), rng.random_range(0.6..2.2), rng.random_range(-0.9..0.9));
    let truth: Vec<Point> = (0..8).map(|_| place()).collect();
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (mut observations, mut walk_m, mut at_m) = (Vec::new(), Vec::new(), 0.0);
    for pair in 0..64 {
        at_m += drift_m * normal() / 8.0;
        walk_m.push(at_m);
        let (lit, seen) = (pair / 8, pair % 8);
        let between_m = (truth[lit] - truth[seen]).norm();
        let length_m = truth[lit].coords.norm() + between_m + truth[seen].coords.norm() + at_m;
        let mut nodes = vec![Node::Station(0), Node::Patch(lit), Node::Patch(seen), Node::Station(0)];
        nodes.dedup();
        let length_m = length_m + factor * SD_M * normal();
        observations.push(Observation::new(nodes, length_m, SD_M));
    }
    Day { truth, observations, walk_m }
}

/// Through the times of all lengths.
fn walk() -> Walk {
    let times: Vec<f64> = (0..=64).map(|n| f64::from(n) / 64.0).collect();
    Walk::through(&times).expect("several times")
}

/// With a walk of this standard deviation at its end.
fn problem(day: &Day, walk_sd_m: f64) -> Problem {
    let mut observations = day.observations.clone();
    let walk = walk();
    for (n, observation) in observations.iter_mut().enumerate() {
        let terms = walk.terms((n as f64 + 1.0) / 64.0);
        observation.common.extend(terms.into_iter().map(|term| term * walk_sd_m).enumerate());
    }
    Problem::new(day.truth.clone(), 3, &[Point::origin()], observations).with_common_delay(C)
}

/// The size of the walk, and its gain.
fn size(day: &Day) -> (f64, f64) {
    let (mut sd_m, mut gain) = (30.0 * C, 0.0);
    for _ in 0..4 {
        let solution = solve(&problem(day, sd_m)).unwrap();
        let scale;
        (scale, gain) = Evidence::new(&solution, 0..STEPS).unwrap().size();
        sd_m *= scale;
    }
    (sd_m, gain)
}

/// Covariances of a walk are the smaller of both times, also between knots that are fewer than times.
#[test]
fn the_terms_are_those_of_a_walk() {
    let times: Vec<f64> = (0..=4 * KNOTS).map(|n| (n as f64 / (4 * KNOTS) as f64).powi(2)).collect();
    let (few, all) = (Walk::through(&times).unwrap(), walk());
    assert_eq!((few.knots().len(), few.knots()[0], few.knots()[KNOTS - 1]), (KNOTS, 0.0, 1.0));
    assert_eq!(all.knots().len(), STEPS + 1);
    assert!(Walk::through(&[3.0, 3.0]).is_none());
    let product =
        |walk: &Walk, a: f64, b: f64| -> f64 { walk.terms(a).iter().zip(walk.terms(b)).map(|(a, b)| a * b).sum() };
    for walk in [&few, &all] {
        for (a, b) in [(0.0, 1.0), (0.2, 0.7), (0.31, 0.93), (0.5, 1.0)] {
            assert!((product(walk, a, b) - a).abs() < 1e-9, "{a} {b}");
            for time in [a, b] {
                let variance = product(walk, time, time) + walk.variance_left(time);
                assert!((variance - time).abs() < 1e-9, "{time}: {variance}");
            }
        }
    }
    assert!(all.variance_left(0.5) == 0.0 && few.variance_left(0.5) < 0.01);
}

/// The gain is what the likelihood says when it is computed from the covariance of all lengths at once.
#[test]
fn the_gain_of_a_size_is_that_of_a_solution_with_it() {
    let day = day(20.0 * C, 1.0, 3);
    let solution = solve(&Problem { loss: Loss::Squared, ..problem(&day, 20.0 * C) }).unwrap();
    let evidence = Evidence::new(&solution, 0..STEPS).unwrap();
    // Without the walk.
    let mut none = problem(&day, 20.0 * C);
    none.observations.iter_mut().for_each(|observation| observation.common.clear());
    none.loss = Loss::Squared;
    let none = solve(&none).unwrap();
    assert_eq!(none.degrees_of_freedom, solution.degrees_of_freedom);
    assert!((none.chi2 / evidence.chi2 - 1.0).abs() < 0.02, "{} {}", none.chi2, evidence.chi2);
    assert!(evidence.gain(1e-6).abs() < 1e-3 && evidence.gain(1.0) > 7.0);
}

/// Sum of squared distances from the true places, turned onto them.
fn squares_m2(points: &[Point], truth: &[Point]) -> f64 {
    let fit = procrustes::rotation(points, truth, Point::origin(), true);
    let turned = points.iter().map(|point| procrustes::turn(&fit.matrix, Point::origin(), *point));
    turned.zip(truth).map(|(a, b)| (a - b).norm_squared()).sum()
}

/// Walks of 20 ps on 60 days. Rooms of eight patches check little: on some days larger errors of all lengths are about
/// as likely.
#[test]
fn a_walk_is_recovered_with_errors_of_the_right_size() {
    let days: Vec<Day> = (0..60).map(|seed| day(20.0 * C, 1.0, seed)).collect();
    let sizes = days.iter().map(|day| (day, size(day)));
    let walks: Vec<(&Day, f64)> =
        sizes.filter(|(_, (_, gain))| *gain > 7.0).map(|(day, (sd_m, _))| (day, sd_m)).collect();
    let count = walks.len() as f64;
    let (mut logs, mut of_walks, mut squares, mut stated, mut without) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (day, sd_m) in &walks {
        logs += (sd_m / (20.0 * C)).ln() / count;
        let problem = problem(day, *sd_m);
        let solution = solve(&problem).unwrap();
        for (n, walk_m) in day.walk_m.iter().enumerate() {
            let (sum_m, variance_m2) = solution.addition_m(Some(0), &problem.observations[n].common);
            of_walks += (sum_m - walk_m).powi(2) / (solution.misfit * variance_m2) / (count * 64.0);
        }
        squares += squares_m2(&solution.points, &day.truth);
        let variances_m2 = (0..8).map(|patch| solution.patch_covariance_m2(patch, patch).trace());
        stated += solution.misfit * variances_m2.sum::<f64>();
        let mut steady = Problem::new(day.truth.clone(), 3, &[Point::origin()], day.observations.clone());
        steady.loss = Loss::Squared;
        without += squares_m2(&solve(&steady.with_common_delay(C)).unwrap().points, &day.truth);
    }
    let (size, of_walks, ratio) = (logs.exp(), of_walks.sqrt(), (squares / stated).sqrt());
    let gain = (without / squares).sqrt();
    eprintln!(
        "{count} of 60 days: size {size:.2} of the true one; errors over stated: walk {of_walks:.2}, patches {ratio:.2}; {gain:.2} times as large without a walk"
    );
    assert!(count >= 54.0, "{count}");
    assert!((0.75..1.4).contains(&size), "{size}");
    assert!((0.75..1.3).contains(&of_walks), "{of_walks}");
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    assert!(gain > 1.2, "{gain}");
}

/// Neither noise nor noise that is larger than it says is taken for a walk.
#[test]
fn scatter_is_no_walk() {
    for factor in [1.0, 3.0] {
        let gains: Vec<f64> = (100..160).map(|seed| size(&day(0.0, factor, seed)).1).collect();
        let most = gains.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        eprintln!("errors {factor} times as large as stated: largest gain of 60 days {most:.2}");
        assert!(most < 7.0, "{factor}: {most}");
    }
}

#[test]
fn nothing_is_said_where_nothing_checks() {
    let mut day = day(0.0, 1.0, 1);
    day.truth.truncate(1);
    day.observations.truncate(1);
    let solution = solve(&problem(&day, C));
    assert!(solution.is_err() || Evidence::new(&solution.unwrap(), 0..STEPS).is_none());
}
