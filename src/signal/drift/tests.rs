//! Drifts that are walks, lines, and steps.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const OPTIONS: DriftOptions = DriftOptions { spacing_s: 600.0, step_sigma: 5.0 };

/// A smooth drift of some ps over five hours.
fn smooth(phase: f64, time_s: f64) -> f64 {
    1e5 + 3.0 * (time_s / 6000.0 + phase).sin() + 1.5 * (time_s / 2500.0 - 2.0 * phase).cos() - time_s / 9000.0
}

/// References every three minutes or so, some of them outliers.
fn references(delay_ps: &dyn Fn(f64) -> f64, outliers: f64, rng: &mut ChaCha8Rng) -> Vec<Point> {
    (0..100)
        .map(|i| {
            let time_s = 180.0 * f64::from(i) + rng.random_range(0.0..60.0);
            let sd_ps = rng.random_range(0.3..0.8);
            let normal: f64 = StandardNormal.sample(rng);
            let wrong = if rng.random_bool(outliers) { rng.random_range(-15.0..15.0) } else { 0.0 };
            Point { time_s, delay_ps: delay_ps(time_s) + sd_ps * normal + wrong, sd_ps }
        })
        .collect()
}

#[test]
fn the_drift_is_followed_with_errors_of_the_right_size() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for outliers in [0.0, 0.05] {
        let (mut squares, mut covered, mut count, mut sds, mut refused) = (0.0, 0, 0, 0.0, 0);
        for _ in 0..50 {
            let phase = rng.random_range(0.0..6.0);
            let points = references(&|t| smooth(phase, t), outliers, &mut rng);
            let Ok(drift) = fit(&points, &OPTIONS) else {
                refused += 1;
                continue;
            };
            for k in 0..50 {
                let time_s = 100.0 + 350.0 * f64::from(k);
                let (delay_ps, sd_ps) = drift.at(time_s);
                let pull = (delay_ps - smooth(phase, time_s)) / sd_ps;
                squares += pull * pull;
                covered += i32::from(pull.abs() < 1.96);
                count += 1;
                sds += sd_ps;
            }
        }
        let count = f64::from(count);
        let (pull, coverage, sd_ps) = ((squares / count).sqrt(), f64::from(covered) / count, sds / count);
        println!("outliers {outliers}: pull {pull:.3}, 95 % covers {coverage:.3}, sd {sd_ps:.3} ps, refused {refused}");
        assert!((0.8..1.25).contains(&pull) && coverage > 0.9, "{pull} {coverage}");
        // Outliers that lie a few sd off, some together, do pass for steps.
        assert!(sd_ps < 0.2 && refused <= if outliers > 0.0 { 8 } else { 1 }, "{sd_ps} {refused}");
    }
}

#[test]
fn a_line_is_fitted_as_a_line_and_goes_on_with_growing_error() {
    let points: Vec<Point> = (0..40)
        .map(|i| Point { time_s: 100.0 * f64::from(i), delay_ps: 7.0 - 0.01 * f64::from(i), sd_ps: 0.2 })
        .collect();
    let drift = fit(&points, &OPTIONS).expect("no step");
    for time_s in [-5000.0, 0.0, 1234.0, 3900.0, 9000.0] {
        assert!((drift.at(time_s).0 - 7.0 + 1e-4 * time_s).abs() < 1e-6);
    }
    // A line through 40 points: known to a sd of 0.2 / sqrt(40) in their middle, twice that at the ends.
    assert!((drift.at(1950.0).1 * 40.0_f64.sqrt() / 0.2 - 1.0).abs() < 0.05, "{}", drift.at(1950.0).1);
    assert!((drift.at(0.0).1 * 40.0_f64.sqrt() / 0.2 - 2.0).abs() < 0.1);
    assert!(drift.at(9000.0).1 > 3.0 * drift.at(3900.0).1 && drift.at(-5100.0).1 > drift.at(-4000.0).1);
    assert_eq!(fit(&points[..2], &OPTIONS).err(), Some(DriftError::TooFew));
    assert_eq!(fit(&[points[0]; 5], &OPTIONS).err(), Some(DriftError::TooFew));
}

#[test]
fn a_step_is_refused_where_it_is_and_a_drift_is_not() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut placed, mut alarms) = (0, 0);
    for draw in 0..40 {
        let phase = rng.random_range(0.0..6.0);
        let at_s = rng.random_range(1800.0..16_000.0);
        let jump_ps = if draw % 2 == 0 { 4.0 } else { -4.0 };
        let step = |t: f64| smooth(phase, t) + if t > at_s { jump_ps } else { 0.0 };
        let points = references(&step, 0.02, &mut rng);
        if let Err(DriftError::Step { between_s, step_ps, sd_ps }) = fit(&points, &OPTIONS) {
            let near = between_s.0 - 400.0 < at_s && at_s < between_s.1 + 400.0;
            placed += i32::from(near && (step_ps - jump_ps).abs() < 4.0 * sd_ps);
        }
        alarms += i32::from(fit(&references(&|t| smooth(phase, t), 0.02, &mut rng), &OPTIONS).is_err());
    }
    println!("steps of 4 ps located {placed} of 40, false alarms {alarms} of 40");
    assert!(placed >= 36 && alarms <= 1, "{placed} {alarms}");
}
