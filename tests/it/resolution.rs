//! Time resolution of the kernels, in short: the claims of docs/time-resolution.md at loose limits.

#[allow(dead_code, reason = "the study uses more of it")]
#[path = "../../benches/resolution/mod.rs"]
pub mod study;

use study::coverage::{self, Coverage};
use study::information::resolution_limit_ps;
use study::shape::{Sensor, erfc};
use study::{false_pulses, pairs, single};

#[test]
fn a_pulse_is_timed_at_its_bound() {
    for sensor in Sensor::both() {
        let timing = single::timing(&sensor, 100.0, 400);
        eprintln!("{}: {timing:?}", sensor.name);
        assert!(timing.detected.hits >= 399);
        assert!((0.88..1.12).contains(&timing.ratio.value), "{timing:?}");
    }
}

#[test]
fn pairs_far_closer_than_the_response_are_resolved_at_their_bound() {
    for sensor in Sensor::both() {
        let apart_ps = pairs::LIMITS * resolution_limit_ps(&sensor.shape, 100.0);
        let found = pairs::separation(&sensor, apart_ps, 100.0, 300);
        eprintln!("{} {apart_ps:.1} ps: {found:?}", sensor.name);
        assert!(found.two.share() >= 0.98 && found.ratio.value < 1.25, "{found:?}");
    }
    // Of 30 ps behind the fast response, one record in ten shows one pulse; two reciprocal records together show two.
    let joint = pairs::joint_separation(&Sensor::exponential(), 30.0, 100.0, true, 200);
    assert!(joint.two.share() >= 0.97 && joint.ratio.value < 1.25, "{joint:?}");
}

#[test]
fn one_pulse_stays_one_and_noise_none() {
    for sensor in Sensor::both() {
        assert_eq!(false_pulses::split(&sensor, 1, 100.0, 200, 500).hits, 0);
        assert_eq!(false_pulses::split(&sensor, 0, 1.0, 200, 500).hits, 0);
    }
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    let check = |coverage: &Coverage, short: f64| {
        assert!(coverage.detected.share() > 0.99, "{coverage:?}");
        for (rate, level) in coverage.within[1..3].iter().zip([0.6827, 0.95]) {
            let sd = (level * (1.0 - level) / rate.of as f64).sqrt();
            assert!(
                rate.share() > level - short - 3.5 * sd && rate.share() < level + 3.5 * sd,
                "{level}: {coverage:?}"
            );
        }
    };
    for sensor in Sensor::both() {
        check(&coverage::single(&sensor, 100.0, 600), 0.0);
        // Beyond the bound's own order, blended pairs have wider tails.
        let apart_ps = pairs::LIMITS * resolution_limit_ps(&sensor.shape, 100.0);
        check(&coverage::blended(&sensor, apart_ps, 100.0, 600), 0.03);
    }
}

/// Checks of the study's own tools: derivatives by differences, the resolution limit by its law for Gaussians, a
/// function by its table.
#[test]
fn the_rulers_are_straight() {
    for (x, expected) in
        [(0.5, 0.479_500_122), (1.99, 4.888_587e-3), (2.01, 4.475_151e-3), (3.0, 2.209_050e-5), (-1.0, 1.842_700_79)]
    {
        assert!((erfc(x) / expected - 1.0_f64).abs() < 1e-5, "{x}");
    }
    for sensor in Sensor::both() {
        let shapes = [sensor.shape.clone(), sensor.shape.with_echo(700.0, 0.01), sensor.shape.with_tail(1000.0, 0.02)];
        for (shape, t) in shapes.iter().flat_map(|shape| [-60.0, 5.0, 80.0, 400.0].map(|t| (shape, t))) {
            let ([before, ..], [_, slope, curvature], [behind, ..]) =
                (shape.at(t - 0.1), shape.at(t), shape.at(t + 0.1));
            assert!(((behind - before) / 0.2 - slope).abs() < 2e-7, "{} at {t}", sensor.name);
            assert!(
                ((behind + before - 2.0 * shape.at(t)[0]) / 0.01 - curvature).abs() < 1e-7,
                "{} at {t}",
                sensor.name
            );
        }
        // A decay from the height asked for, smeared: higher by what lies before it.
        let tail = |t: f64| shapes[2].at(t)[0] - shapes[0].at(t)[0];
        assert!((tail(2000.0) / tail(3000.0) / 1_f64.exp() - 1.0).abs() < 1e-3);
        assert!((1.0..1.2).contains(&(tail(2000.0) / (0.02 * (-2_f64).exp()))), "{}", sensor.name);
    }
    let gaussian = Sensor::gaussian();
    assert!((resolution_limit_ps(&gaussian.shape, 10.0) / 149.0 - 1.0).abs() < 0.03);
}
