//! Noise that is correlated from sample to sample: bound, error bars, false pulses.

use super::*;
use crate::{noise, slow_noise};

/// Noise that is white up to a single pole at 6 GHz, sampled every 25 ps: `r_l = phi^l`.
const PHI: f64 = 0.389_66;
const STEP_PS: f64 = 25.0;

/// `x_n = phi x_{n-1} + e_n` of variance `sd^2`.
fn pole_noise(sd: f64, len: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let normal = Normal::new(0.0, sd).expect("positive");
    let mut x = normal.sample(rng);
    (0..len)
        .map(|_| {
            let this = x;
            x = PHI * x + (1.0 - PHI * PHI).sqrt() * normal.sample(rng);
            this
        })
        .collect()
}

/// `sd_t` of a single pulse with unknown amplitude and baseline: the inverse of R is the known tridiagonal one, so that
/// `a^T R^-1 b = (a_0 b_0 (1 - phi^2) + sum (a_n - phi a_{n-1}) (b_n - phi b_{n-1})) / (1 - phi^2)`.
fn pole_bound_ps(shape: &Shape, at_ps: f64, sd: f64, len: usize) -> f64 {
    let rows: Vec<[f64; 3]> = (0..len)
        .map(|n| {
            let h = |dt: f64| (shape.formula)(T0_PS + STEP_PS * n as f64 - at_ps + dt);
            [h(0.5) - h(-0.5), h(0.0), 1.0]
        })
        .collect();
    let rest = 1.0 - PHI * PHI;
    let product = |p: usize, q: usize| {
        let inner: f64 = rows.windows(2).map(|w| (w[1][p] - PHI * w[0][p]) * (w[1][q] - PHI * w[0][q])).sum();
        (rows[0][p] * rows[0][q] * rest + inner) / (rest * sd * sd)
    };
    // What amplitude and baseline can imitate of the slope is lost.
    let (aa, ab, bb) = (product(1, 1), product(1, 2), product(2, 2));
    let (sa, sb) = (product(0, 1), product(0, 2));
    let lost = (sa * sa * bb - 2.0 * sa * sb * ab + sb * sb * aa) / (aa * bb - ab * ab);
    (product(0, 0) - lost).sqrt().recip()
}

fn samples_of(shape: &Shape, at_ps: f64, len: usize) -> Vec<f64> {
    (0..len).map(|n| (shape.formula)(T0_PS + STEP_PS * n as f64 - at_ps)).collect()
}

/// Fits with the exact autocorrelation, or one estimated from 1,000 stretches of 40 samples.
#[test]
fn onsets_in_correlated_noise_are_at_its_bound_with_honest_errors() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let (sd, len, draws) = (0.02, 240, 600);
    let stretches: Vec<Vec<f64>> = (0..1000).map(|_| pole_noise(sd, 40, &mut rng)).collect();
    let estimate = noise::estimate(&stretches, 16);
    let exact: Vec<f64> = (0..16).map(|lag| PHI.powi(lag)).collect();
    for shape in [gaussian(), exponential()] {
        for (acf, sd_v) in [(exact.clone(), sd), (noise::autoregressive(&estimate.acf, 40_000), estimate.sd)] {
            let (mut errors, mut within) = (Vec::new(), [0, 0]);
            for _ in 0..draws {
                let at = 3000.0 + rng.random_range(0.0..STEP_PS);
                let noise = pole_noise(sd, len, &mut rng);
                let y: Vec<f64> = samples_of(&shape, at, len).iter().zip(noise).map(|(y, w)| y + w).collect();
                let profile = Profile {
                    mean_v: &y,
                    sd_v: &vec![sd_v; len],
                    acf: &acf,
                    slow_v2: &[],
                    jitter: None,
                    t0_ps: T0_PS,
                    dt_ps: STEP_PS,
                };
                let solution = fit(&profile, &shape.response, &SparseOptions::default());
                assert_eq!(solution.pulses.len(), 1, "{}", shape.name);
                let error = solution.pulses[0].time_ps - at;
                errors.push(error / pole_bound_ps(&shape, at, sd, len));
                let pull = error.abs() / solution.covariance_ps2[0].sqrt();
                within[0] += usize::from(pull < 0.9945);
                within[1] += usize::from(pull < 1.96);
            }
            let ratio = rms(&errors);
            println!("{}: rms / bound {ratio:.3}, within {within:?} of {draws}", shape.name);
            assert!((0.9..1.1).contains(&ratio), "{}: {ratio}", shape.name);
            // Four standard deviations of a binomial about 68 % and 95 % of 600.
            assert!((362..455).contains(&within[0]) && (549..592).contains(&within[1]), "{within:?}");
        }
    }
}

/// A tenth of the records has a false pulse at a threshold made for that; taken as white, most have.
#[test]
fn false_pulses_in_correlated_noise_are_as_rare_as_promised() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let (len, records) = (2000, 400);
    let shape = exponential();
    let acf = [1.0, PHI, PHI * PHI];
    let mut counts = [0, 0];
    for _ in 0..records {
        let y = pole_noise(1.0, len, &mut rng);
        let correlated = Profile {
            mean_v: &y,
            sd_v: &vec![1.0; len],
            acf: &acf,
            slow_v2: &[],
            jitter: None,
            t0_ps: T0_PS,
            dt_ps: STEP_PS,
        };
        for (count, profile) in counts.iter_mut().zip([correlated, Profile { acf: &[1.0], ..correlated }]) {
            let threshold = evidence_min_of(&profile, &shape.response, 1e-4) - 2.0 * 1000_f64.ln();
            let options = SparseOptions { evidence_min: Some(threshold), pulses_max: 1, ..SparseOptions::default() };
            *count += fit(&profile, &shape.response, &options).pulses.len();
        }
    }
    println!("{counts:?} of {records}");
    assert!((20..64).contains(&counts[0]) && counts[1] > 150, "{counts:?}");
}

/// Ignored samples split the record: nothing is carried over them.
#[test]
fn samples_to_be_ignored_do_not_matter_in_correlated_noise() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let (shape, len, sd) = (gaussian(), 240, 0.01);
    let mut y: Vec<f64> = samples_of(&shape, 3000.0, len);
    y.iter_mut().zip(pole_noise(sd, len, &mut rng)).for_each(|(y, w)| *y += w);
    let mut sd_v = vec![sd; len];
    sd_v[124..130].fill(f64::INFINITY);
    let fit_of = |y: &[f64]| {
        let profile = Profile {
            mean_v: y,
            sd_v: &sd_v,
            acf: &[1.0, PHI],
            slow_v2: &[],
            jitter: None,
            t0_ps: T0_PS,
            dt_ps: STEP_PS,
        };
        fit(&profile, &shape.response, &SparseOptions::default())
    };
    let before = fit_of(&y);
    y[124..130].fill(7.0);
    assert_eq!(before, fit_of(&y));
    assert_eq!(before.pulses.len(), 1);
    assert!((before.pulses[0].time_ps - 3000.0).abs() < 4.0 * before.covariance_ps2[0].sqrt());
}

/// Wander of three turns a record, in the mean of 64 shots, of which few components are known: no end shows a pulse.
#[test]
fn wander_makes_no_pulses_at_the_ends_of_a_record() {
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let (len, sd, height, components) = (600, 1.0 / 8.0, 0.5, 17);
    let normal = Normal::new(0.0, height).expect("positive");
    let mut wander = || -> Vec<f64> {
        let [cos, sin] = [0, 1].map(|_| normal.sample(&mut rng));
        let turn = |n: usize| std::f64::consts::TAU * 3.0 * n as f64 / len as f64;
        (0..len).map(|n| cos * turn(n).cos() + sin * turn(n).sin()).collect()
    };
    let along = |samples: &[f64], k: usize| -> f64 {
        samples.iter().enumerate().map(|(n, v)| v * slow_noise::component(k, n as f64, len)).sum::<f64>() / len as f64
    };
    let drawn: Vec<Vec<f64>> = (0..200).map(|_| wander()).collect();
    let variance = |k: usize| drawn.iter().map(|one| along(one, k).powi(2)).sum::<f64>() / drawn.len() as f64;
    let slow_v2: Vec<f64> = (0..components).map(variance).collect();
    let records: Vec<Vec<f64>> = (0..1000).map(|_| wander()).collect();
    let shape = exponential();
    let sd_v = vec![sd; len];
    let found = records.iter().filter(|wander| {
        let mean_v = with_noise(wander, sd, &mut rng);
        let profile = Profile {
            mean_v: &mean_v,
            sd_v: &sd_v,
            acf: &[],
            slow_v2: &slow_v2,
            jitter: None,
            t0_ps: 0.0,
            dt_ps: DT_PS,
        };
        !fit(&profile, &shape.response, &SparseOptions::default()).pulses.is_empty()
    });
    let found = found.count();
    assert!(found <= 1, "{found} of 1000");
}
