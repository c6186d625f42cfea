//! Known coefficients, and what intervals cover with few shots.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const LEN: usize = 400;
const DT_PS: f64 = 50.0;
/// 1 mV; 2 mV at 0.5 V; 0.4 %; 3 ps.
const TRUTH: [f64; TERMS] = [1e-6, 8e-6, 1.6e-5, 9.0];

fn light(t_ps: f64) -> f64 {
    let pulse = |at_ps: f64, a: f64| a * (-0.5 * ((t_ps - at_ps) / 150.0).powi(2)).exp();
    pulse(3000.0, 0.9) + pulse(7000.0, 0.4) + pulse(7600.0, 0.2) + pulse(14_000.0, 0.6)
}

fn slope(t_ps: f64) -> f64 {
    light(t_ps + 0.5) - light(t_ps - 0.5)
}

fn true_sd(n: usize, values: &[f64; TERMS]) -> f64 {
    let (v, slope) = (light(DT_PS * n as f64), slope(DT_PS * n as f64));
    (values[0] + values[1] * v + values[2] * v * v + values[3] * slope * slope).sqrt()
}

/// Mean and variance over shots with noise of the model.
fn capture(shots: usize, values: &[f64; TERMS], rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
    (0..LEN)
        .map(|n| {
            let (v, sd) = (light(DT_PS * n as f64), true_sd(n, values));
            let normals: Vec<f64> = (0..shots).map(|_| StandardNormal.sample(rng)).collect();
            let mean = normals.iter().sum::<f64>() / shots as f64;
            let squares: f64 = normals.iter().map(|x| (x - mean).powi(2)).sum();
            (v + sd * mean, sd * sd * squares / (shots - 1) as f64)
        })
        .unzip()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn known_coefficients_are_recovered_with_errors_of_the_right_size() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for shots in [16, 64, 1000] {
        let (mut pulls, mut chi2) = (vec![Vec::new(); TERMS], 0.0);
        for _ in 0..200 {
            let (mean_v, variance_v2) = capture(shots, &TRUTH, &mut rng);
            let spread = Spread { mean_v: &mean_v, variance_v2: &variance_v2, shots, dt_ps: DT_PS };
            let model = fit(&spread).expect("varies");
            chi2 += model.chi2_per_dof / 200.0;
            for k in 0..TERMS {
                if model.covariance[k][k] > 0.0 {
                    pulls[k].push((model.values[k] - TRUTH[k]) / model.covariance[k][k].sqrt());
                }
            }
        }
        for (k, pulls) in pulls.iter().enumerate() {
            let bias = pulls.iter().sum::<f64>() / pulls.len() as f64;
            println!("{shots} shots, term {k}: {} not zero, pull {:.3}, bias {bias:.3}", pulls.len(), rms(pulls));
        }
        println!("chi2 {chi2:.3}");
        // A bounded coefficient that is 0 in some draws is biased by what they lack.
        for pulls in pulls.iter().filter(|pulls| pulls.len() > 195) {
            let bias = pulls.iter().sum::<f64>() / pulls.len() as f64;
            assert!((0.85..1.2).contains(&rms(pulls)) && bias.abs() < 0.45, "{shots}: {} {bias}", rms(pulls));
        }
        assert!((chi2 - 1.0).abs() < 0.15, "{shots}: {chi2}");
    }
}

#[test]
fn terms_that_are_not_there_are_zero_within_their_errors() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let truth = [4e-6, 0.0, 0.0, 25.0];
    for _ in 0..20 {
        let (mean_v, variance_v2) = capture(200, &truth, &mut rng);
        let spread = Spread { mean_v: &mean_v, variance_v2: &variance_v2, shots: 200, dt_ps: DT_PS };
        let model = fit(&spread).expect("varies");
        for k in 0..TERMS {
            let sd = model.covariance[k][k].sqrt();
            assert!(model.values[k] >= 0.0 && (model.values[k] - truth[k]).abs() <= 4.5 * sd + 1e-30, "{k} {model:?}");
        }
    }
    let constant = Spread { mean_v: &[0.0; 9], variance_v2: &[0.0; 9], shots: 4, dt_ps: 1.0 };
    assert_eq!(fit(&constant), None);
}

/// Coverage of 95 % intervals of the mean from 16 shots, by each sample's own spread and by the model.
#[test]
fn intervals_from_sixteen_shots_are_too_narrow_until_the_variance_is_smoothed() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut own, mut model, mut count, mut errors) = (0, 0, 0, Vec::new());
    for _ in 0..200 {
        let (mean_v, variance_v2) = capture(16, &TRUTH, &mut rng);
        let spread = Spread { mean_v: &mean_v, variance_v2: &variance_v2, shots: 16, dt_ps: DT_PS };
        let sd_v = fit(&spread).expect("varies").sd_v(&mean_v, 16, DT_PS);
        for n in 0..LEN {
            let error = (mean_v[n] - light(DT_PS * n as f64)).abs() * 4.0;
            own += i32::from(error < 1.96 * variance_v2[n].sqrt());
            model += i32::from(error < 1.96 * sd_v[n]);
            count += 1;
            errors.push(sd_v[n] / true_sd(n, &TRUTH) - 1.0);
        }
    }
    let share = |covered: i32| f64::from(covered) / f64::from(count);
    println!(
        "own spread covers {:.4}, model {:.4} of {count}; rms error of the sd {:.3}",
        share(own),
        share(model),
        rms(&errors)
    );
    // Student's t of 15 degrees of freedom: 1.96 covers 0.931. 80,000 samples: known to 0.001.
    assert!((share(own) - 0.931).abs() < 0.004, "{}", share(own));
    assert!((share(model) - 0.95).abs() < 0.005, "{}", share(model));
    assert!(rms(&errors) < 0.09, "{}", rms(&errors));
}
