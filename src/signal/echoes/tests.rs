use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::fft::RealFft;

const OPTIONS: EchoOptions = EchoOptions { threshold_sigma: 5.0, share_min: 0.01 };
const FLOOR: f64 = 200.0;

/// An outgoing pulse with a steep front and a slow tail, its maximum at 0.
fn pulse(time: f64) -> f64 {
    let sigma = if time < 0.0 { 3.5 } else { 5.0 };
    (-0.5 * (time / sigma).powi(2)).exp()
        + if time > 0.0 { 0.05 * (1.0 - (-time / 6.0).exp()) * (-time / 12.0).exp() } else { 0.0 }
}

/// The pulse, widened by a Gaussian of this standard deviation.
fn widened(time: f64, sigma: f64) -> f64 {
    if sigma == 0.0 {
        return pulse(time);
    }
    let weight = |x: f64| (-0.5 * x * x).exp();
    let points = (-60..=60).map(|i| f64::from(i) / 12.0);
    let (sum, all) =
        points.fold((0.0, 0.0), |(sum, all), x| (sum + weight(x) * pulse(time - sigma * x), all + weight(x)));
    sum / all
}

fn outgoing() -> Outgoing {
    let record: Vec<f64> = (0..120).map(|n| 7.0 + 600.0 * pulse(f64::from(n) - 30.3)).collect();
    Outgoing::of(&record).unwrap()
}

/// A record of echoes (time of the maximum, strength, width) with white noise, rounded to whole codes.
fn record(samples: usize, echoes: &[[f64; 3]], noise: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let light = |n: usize| echoes.iter().map(|[t, a, w]| a * widened(n as f64 - t, *w)).sum::<f64>();
    let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
    (0..samples).map(|n| (FLOOR + light(n) + noise * normal(rng)).round()).collect()
}

fn echoes_of(samples: &[f64]) -> Echoes {
    decompose(&Stretch { samples, step: 1.0 }, &outgoing(), &OPTIONS, &mut RealFft::new()).unwrap()
}

/// Where the widened pulse rises through half of its height, before its maximum.
fn true_edge(width: f64) -> f64 {
    let grid = |i: i32| f64::from(i) * 0.01;
    let top = (-4000..4000).map(|i| widened(grid(i), width)).fold(0.0, f64::max);
    let at = (-4000..4000).find(|i| widened(grid(*i), width) > 0.5 * top).unwrap();
    grid(at) - 0.005
}

#[test]
fn the_outgoing_pulse_has_a_place_and_a_width() {
    let outgoing = outgoing();
    assert!((outgoing.peak - 30.3).abs() < 0.5, "{}", outgoing.peak);
    assert!((outgoing.sigma - 4.3).abs() < 0.3, "{}", outgoing.sigma);
    let gaussian = Outgoing::gaussian(10.0);
    assert!((gaussian.sigma - 4.2466).abs() < 1e-3);
    assert_eq!(Outgoing::of(&[1.0; 40]), None);
    assert_eq!(Outgoing::of(&[0.0, 1.0, f64::NAN, 4.0, 3.0, 2.0, 1.0, 0.0]), None);
    let cut: Vec<f64> = (0..20).map(|n| pulse(f64::from(n) - 20.0)).collect();
    assert_eq!(Outgoing::of(&cut), None, "the maximum is not in the record");
}

/// Times, edges, heights and widths of 1, 2 and 3 echoes lie within their errors: root mean square of (found - true) /
/// sd over 600 records of each.
#[test]
fn errors_have_the_size_of_the_standard_deviations() {
    let mut rng = ChaCha8Rng::seed_from_u64(36);
    let zero = outgoing().peak - 30.3;
    let widths = [2.0, 4.0, 7.0];
    let edges = widths.map(true_edge);
    for count in 1..=3 {
        let mut z = [const { Vec::new() }; 4];
        let mut missed = 0;
        for _ in 0..600 {
            let light: Vec<[f64; 3]> = (0..count)
                .map(|k| {
                    [45.0 + 50.0 * k as f64 + rng.random_range(-5.0..5.0), rng.random_range(60.0..400.0), widths[k]]
                })
                .collect();
            let echoes = echoes_of(&record(90 + 50 * count, &light, 2.0, &mut rng)).echoes;
            if echoes.len() != count {
                missed += 1;
                continue;
            }
            for (k, (echo, [time, strength, width])) in echoes.iter().zip(&light).enumerate() {
                let (edge, edge_sd) = echo.edge.unwrap();
                z[0].push((echo.time - time - zero) / echo.time_sd);
                z[1].push((edge - time - edges[k]) / edge_sd);
                z[2].push((echo.height - strength * widened_top(*width)) / echo.height_sd);
                z[3].push((echo.width - width) / echo.width_sd);
            }
        }
        let rms = z.map(|z| (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt());
        println!("{count} echoes: {missed} of 600 otherwise, rms z of time, edge, height, width {rms:.2?}");
        assert!(missed <= 12, "{count} echoes: {missed} of 600 records have another number");
        assert!(rms[..2].iter().all(|rms| (0.85..1.2).contains(rms)), "{count} echoes: {rms:?}");
    }
}

fn widened_top(width: f64) -> f64 {
    (-200..200).map(|i| widened(f64::from(i) * 0.05, width)).fold(0.0, f64::max)
}

#[test]
fn noise_alone_is_no_echo() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for noise in [0.1, 2.0] {
        let alarms = (0..500).filter(|_| !echoes_of(&record(160, &[], noise, &mut rng)).echoes.is_empty()).count();
        println!("noise {noise}: {alarms} of 500 records have an echo");
        assert!(alarms <= 5, "{alarms} of 500");
    }
}

#[test]
fn a_weak_echo_before_a_strong_one_is_found() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let both =
        |rng: &mut ChaCha8Rng| echoes_of(&record(160, &[[50.0, 15.0, 3.0], [90.0, 400.0, 3.0]], 1.0, rng)).echoes;
    let hits = (0..100).filter(|_| both(&mut rng).len() == 2).count();
    assert!(hits >= 95, "{hits} of 100");
}

#[test]
fn two_echoes_with_one_maximum_are_one_wide_echo() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let echoes = echoes_of(&record(140, &[[60.0, 200.0, 0.0], [66.0, 200.0, 0.0]], 1.0, &mut rng)).echoes;
    assert_eq!(echoes.len(), 1, "{echoes:?}");
    assert!(echoes[0].width > 2.0 && (echoes[0].time - 63.0).abs() < 1.0, "{echoes:?}");
}

/// Samples at the rails do not count: time and height come from the flanks.
#[test]
fn a_clipped_echo_is_fitted_on_its_flanks() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let zero = outgoing().peak - 30.3;
    let mut z = Vec::new();
    for _ in 0..200 {
        let time = rng.random_range(55.0..65.0);
        let clip = |value: &f64| if *value < 450.0 { *value } else { f64::NAN };
        let samples: Vec<f64> = record(140, &[[time, 400.0, 3.0]], 2.0, &mut rng).iter().map(clip).collect();
        let echoes = echoes_of(&samples).echoes;
        assert_eq!(echoes.len(), 1, "{echoes:?}");
        assert!((echoes[0].height / (400.0 * widened_top(3.0)) - 1.0).abs() < 0.3, "{echoes:?}");
        z.push((echoes[0].time - time - zero) / echoes[0].time_sd);
    }
    let rms = (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
    assert!((0.8..1.25).contains(&rms), "{rms}");
}

#[test]
fn too_few_samples_have_no_echoes() {
    let few = Stretch { samples: &[1.0, 2.0, 5.0, 2.0], step: 1.0 };
    assert_eq!(decompose(&few, &outgoing(), &OPTIONS, &mut RealFft::new()), None);
}
