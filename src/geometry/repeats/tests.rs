//! Pairs measured in both directions, with errors that are larger than stated or walk.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

const SD_M: f64 = 1e-4;

/// Both directions of all pairs of ten patches, one after the other; errors of so many standard deviations, and a walk
/// of this standard deviation at its end.
fn lengths(factor: f64, walk_m: f64, seed: u64) -> (Vec<Observation>, Vec<Option<f64>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (mut observations, mut times, mut at_m) = (Vec::new(), Vec::new(), 0.0);
    for capture in 0..100 {
        let (lit, seen) = (capture / 10, capture % 10);
        at_m += walk_m * normal() / 10.0;
        let nodes = vec![Node::Station(0), Node::Patch(lit), Node::Patch(seen), Node::Station(0)];
        let length_m = (lit + seen) as f64 + at_m + factor * SD_M * normal();
        observations.push(Observation::new(nodes, length_m, SD_M));
        times.push(Some(capture as f64 / 100.0));
    }
    (observations, times)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn errors_larger_than_stated_are_seen_in_both_directions() {
    let scatter = |factor: f64, seed| Repeats::of(&lengths(factor, 0.0, seed).0).scatter();
    let factors: Vec<f64> = (0..50).map(|seed| scatter(5.0, seed).expect("five times as large")).collect();
    let factor = mean(factors.iter().copied());
    assert!((factor / 25.0 - 1.0).abs() < 0.15, "{factor}");
    let stated = (0..200).filter(|seed| scatter(1.0, *seed).is_some()).count();
    assert!(stated <= 4, "{stated} of 200 by chance");
}

#[test]
fn a_walk_is_as_large_as_it_was() {
    let walk = |walk_m: f64, seed| {
        let (observations, times) = lengths(1.0, walk_m, seed);
        Repeats::of(&observations).walk_m2(&times)
    };
    let walks = (0..200).map(|seed| walk(3e-3, seed).expect("a walk"));
    let variance_m2 = mean(walks);
    assert!((variance_m2.sqrt() / 3e-3 - 1.0).abs() < 0.2, "{}", variance_m2.sqrt());
    assert!(mean((0..50).map(|seed| walk(0.0, seed).unwrap_or(0.0))).sqrt() < 3e-4);
}

/// A few wrong paths change little; few pairs, other paths and other delays are no repeats.
#[test]
fn wrong_paths_do_not_count_and_few_pairs_say_nothing() {
    let (mut observations, times) = lengths(1.0, 0.0, 3);
    for n in [12, 13, 24, 57] {
        observations[n].length_m += 0.3;
    }
    assert!(Repeats::of(&observations).scatter().is_none());
    assert!(Repeats::of(&observations[..14]).scatter().is_none());
    observations.iter_mut().enumerate().for_each(|(n, observation)| observation.delay = Some(n));
    assert!(Repeats::of(&observations).walk_m2(&times).is_none());
}
