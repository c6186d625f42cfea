use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::loss::Loss;
use crate::maximum_likelihood::matrix_free::Matrix;
use crate::maximum_likelihood::tests::{observations, problem};
use crate::maximum_likelihood::{Anchor, Means, solve, solve_by};
use crate::room;

/// What the shares make of the covariance of two numbers.
fn made(shares: &[Vec<(usize, f64)>], a: usize, b: usize) -> f64 {
    product(&shares[a], &shares[b])
}

#[test]
fn shares_make_up_the_covariance_of_each_group() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for count in [2, 5, 9] {
        // Numbers of the first half have errors in common, those of the second half others.
        let factors = Mat::from_fn(count, 4, |i, k| {
            let is_first = k < 2;
            if is_first == (i < count / 2) { StandardNormal.sample(&mut rng) } else { 0.0 }
        });
        let own: Vec<f64> = (0..count).map(|_| rng.random_range(0.1..1.0)).collect();
        let covariance = Mat::from_fn(count, count, |i, j| {
            let common: f64 = (0..4).map(|k| factors[(i, k)] * factors[(j, k)]).sum();
            if i == j { common + own[i] } else { common }
        });
        let shares = shares(&covariance);
        for (a, b) in (0..count).flat_map(|a| (0..a).map(move |b| (a, b))) {
            let size = (covariance[(a, a)] * covariance[(b, b)]).sqrt();
            let is_told = shares[a].iter().any(|(error, _)| shares[b].iter().any(|(other, _)| error == other));
            let expected = if is_told { covariance[(a, b)] } else { 0.0 };
            assert!((made(&shares, a, b) - expected).abs() < 1e-9 * size, "{count}: {a} {b}");
            assert!(is_told || covariance[(a, b)].abs() <= CORRELATED * size, "{count}: {a} {b}");
        }
        assert!((0..count).all(|n| made(&shares, n, n) < covariance[(n, n)]), "{count}: each has errors of its own");
    }
}

#[test]
fn weak_correlations_share_nothing_and_what_is_no_covariance_keeps_its_variances() {
    let weak = Mat::from_fn(3, 3, |i, j| if i == j { 4.0 } else { 0.19 });
    assert!(shares(&weak).iter().all(Vec::is_empty));
    // Each of three opposes both others by 0.9: no errors do that.
    let none = shares(&Mat::from_fn(3, 3, |i, j| if i == j { 4.0 } else { -3.6 }));
    for n in 0..3 {
        assert!(made(&none, n, n) <= 4.0 && made(&none, n, (n + 1) % 3) < -1.5, "{none:?}");
    }
}

/// Errors that are unknowns with a prior of 1, and the same as shares: the one likelihood maximised, and integrated.
#[test]
fn shared_errors_weigh_as_those_that_are_unknowns() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(2));
    let mut common = problem(truth.clone(), observations(&truth, 1e-4, &mut rng), 1e-3);
    common.loss = Loss::Squared;
    common.anchors = (0..4).map(|patch| Anchor { patch, position: truth[patch], sd_m: 1e-5 }).collect();
    for (n, observation) in common.observations.iter_mut().enumerate() {
        // Some oppose one another, and some have two.
        let each_m = if n % 2 == 0 { 3e-4 } else { -2e-4 };
        observation.common = vec![(n / 3 % 40, each_m)];
        observation.common.extend((n % 7 == 0).then_some((40 + n / 12 % 10, 1e-4)));
        let error: f64 = StandardNormal.sample(&mut rng);
        observation.length_m += 3e-4 * error;
    }
    let mut shared = common.clone();
    for observation in &mut shared.observations {
        observation.shared = std::mem::take(&mut observation.common);
        let sizes_m = observation.shared.iter().map(|(_, each_m)| *each_m);
        observation.sd_m = sizes_m.fold(observation.sd_m, f64::hypot);
    }
    let one = solve(&common).unwrap();
    for (means, equal_m) in [(Means::Dense, 1e-9), (Means::MatrixFree(Matrix::Normal), 1e-7)] {
        let other = solve_by(&shared, means).unwrap();
        let off_m = one.points.iter().zip(&other.points).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(off_m < equal_m, "{off_m}");
        assert!((one.chi2 - other.chi2).abs() < 1e-5 * one.chi2, "{} {}", one.chi2, other.chi2);
        assert_eq!(one.degrees_of_freedom, other.degrees_of_freedom);
    }
    let other = solve(&shared).unwrap();
    for patch in 0..truth.len() {
        let both = [&one, &other].map(|solution| solution.patch_covariance_m2(patch, patch));
        assert!((both[0] - both[1]).norm() < 1e-6 * both[0].norm(), "{patch}");
    }
}
