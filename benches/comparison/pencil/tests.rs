//! Poles without noise, errors to first order, numbers of pulses, threads.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn gaussian(t_ps: f64) -> f64 {
    (-0.5 * (t_ps / 106.165_225).powi(2)).exp()
}

fn response() -> Response {
    Response::new(-650.0, 10.0, &(-65..=65).map(|i| gaussian(10.0 * f64::from(i))).collect::<Vec<_>>())
}

#[test]
fn poles_without_noise_are_the_times() {
    let truth = [(1800.0, 1.0), (1950.0, 0.4), (2333.0, 0.7), (4000.0, 0.2)];
    for len in [99, 100] {
        let y: Vec<f64> = (0..len)
            .map(|n| truth.iter().map(|(at, a)| a * gaussian(-130.0 + 50.0 * f64::from(n) - at)).sum())
            .collect();
        let sd_v = vec![1e-6; y.len()];
        let profile =
            Profile { mean_v: &y, sd_v: &sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: -130.0, dt_ps: 50.0 };
        let solution = fit(&profile, &response(), &PencilOptions { pulses: Some(4), ..PencilOptions::default() });
        for (k, (at_ps, a)) in truth.iter().enumerate() {
            assert!((solution.times_ps[k] - at_ps).abs() < 0.05, "{len}: {solution:?}");
            assert!((solution.amplitudes_v[k] - a).abs() < 1e-3, "{len}: {solution:?}");
        }
    }
}

/// The response to a change of one sample, by difference.
#[test]
fn the_covariance_is_what_a_change_of_the_samples_does() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut y: Vec<f64> = (0..80)
        .map(|n| gaussian(50.0 * f64::from(n) - 1500.0) + 0.6 * gaussian(50.0 * f64::from(n) - 1700.0))
        .collect();
    for y in &mut y {
        let normal: f64 = StandardNormal.sample(&mut rng);
        *y += 1e-4 * normal;
    }
    let sd_v: Vec<f64> = (0..80).map(|_| rng.random_range(0.005..0.02)).collect();
    let two = PencilOptions { pulses: Some(2), ..PencilOptions::default() };
    let times = |y: &[f64]| {
        fit(
            &Profile { mean_v: y, sd_v: &sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 },
            &response(),
            &two,
        )
    };
    let solution = times(&y);
    let mut expected = [0.0; 4];
    for n in 0..80 {
        let step = 1e-6;
        y[n] += step;
        let moved = times(&y);
        y[n] -= step;
        let slope: Vec<f64> = (0..2).map(|k| (moved.times_ps[k] - solution.times_ps[k]) / step * sd_v[n]).collect();
        (0..4).for_each(|e| expected[e] += slope[e / 2] * slope[e % 2]);
    }
    for (solution, expected) in solution.covariance_ps2.expect("has one").iter().zip(expected) {
        assert!((solution / expected - 1.0).abs() < 0.02, "{solution} {expected}");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let y: Vec<f64> = (0..800)
        .map(|n| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            (1..20).map(|k| gaussian(50.0 * f64::from(n) - 2000.0 * f64::from(k))).sum::<f64>() + 0.01 * normal
        })
        .collect();
    let profile =
        Profile { mean_v: &y, sd_v: &[0.01; 800], acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
    let options = PencilOptions { pulses: Some(19), ..PencilOptions::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| fit(&profile, &response(), &options))
    };
    let one = on(1);
    assert_eq!(one.times_ps.len(), 19);
    assert_eq!(one, on(3));
}

#[test]
fn noise_has_no_pulse_and_far_pulses_are_counted() {
    let (response, mut rng) = (response(), ChaCha8Rng::seed_from_u64(4));
    let (mut false_pulses, mut counted) = (0, 0);
    for draw in 0..200 {
        let light = f64::from(u8::from(draw % 2 == 1));
        let y: Vec<f64> = (0..120)
            .map(|n| {
                let (t, normal): (f64, f64) = (50.0 * f64::from(n), StandardNormal.sample(&mut rng));
                light * (gaussian(t - 2000.0) + gaussian(t - 2400.0) + gaussian(t - 3500.0)) + 0.02 * normal
            })
            .collect();
        let profile = Profile {
            mean_v: &y,
            sd_v: &[0.02; 120],
            acf: &[1.0],
            slow_v2: &[],
            jitter: None,
            t0_ps: 0.0,
            dt_ps: 50.0,
        };
        let count = fit(&profile, &response, &PencilOptions::default()).times_ps.len();
        false_pulses += usize::from(light == 0.0 && count > 0);
        counted += usize::from(light > 0.0 && count == 3);
    }
    assert!(false_pulses <= 1 && counted >= 97, "{false_pulses} false, {counted} right, of 100 each");
}

#[test]
fn the_response_wraps_around_the_record() {
    let response = Response::new(-100.0, 10.0, &(0..120).map(|i| f64::from(i % 17)).collect::<Vec<_>>());
    let wrapped = wrapped_response(&response, 23.0, 31);
    let naive = |b: i64| (-10..10).map(|r| response.value(23.0 * (b + 31 * r) as f64)).sum::<f64>();
    assert!((0..31).all(|b| (wrapped[b as usize] - naive(b)).abs() < 1e-12));
}
