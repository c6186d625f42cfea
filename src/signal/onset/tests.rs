//! Timing against naive scans, and its walk and scatter.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};

type Timing<'a> = dyn Fn(&[f64]) -> Option<Crossing> + 'a;

fn pulse(len: usize, at: f64, amplitude: f64) -> Vec<f64> {
    (0..len).map(|n| amplitude * (-0.5 * ((n as f64 - at) / 6.0).powi(2)).exp()).collect()
}

#[test]
fn leading_edge_equals_a_naive_scan() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..200 {
        let samples: Vec<f64> = (0..30).map(|_| rng.random_range(-1.0..1.0)).collect();
        let largest = samples.iter().copied().fold(f64::MIN, f64::max);
        let peak = samples.iter().position(|v| *v == largest).expect("present");
        let level = 0.4 * largest;
        let mut naive = None;
        for i in 0..peak {
            if samples[i] < level {
                let (a, b) = (samples[i], samples[i + 1]);
                naive = Some(i as f64 + (level - a) / (b - a));
            }
        }
        let onset = leading_edge(&samples, 0.4, Noise::even(0.1));
        assert_eq!(onset.map(|c| c.position), naive.filter(|_| largest > 0.0));
    }
}

#[test]
fn fractions_ignore_amplitude_and_follow_a_shift_but_a_fixed_level_walks() {
    let weak = pulse(100, 40.3, 1.0);
    let strong = pulse(100, 40.3, 7.0);
    let later = pulse(100, 45.3, 1.0);
    let edge = |s: &[f64]| leading_edge(s, 0.2, Noise::even(0.01)).expect("edge").position;
    let cfd = |s: &[f64]| constant_fraction(s, 0.5, 3.5, Noise::even(0.01)).expect("zero").position;
    let level = |s: &[f64]| threshold(s, 0.5, 0.01).expect("level").position;
    for timing in [&edge as &dyn Fn(&[f64]) -> f64, &cfd] {
        assert!((timing(&weak) - timing(&strong)).abs() < 1e-9);
        assert!((timing(&later) - timing(&weak) - 5.0).abs() < 1e-9);
    }
    assert!(level(&weak) - level(&strong) > 1.0);
    assert!((level(&later) - level(&weak) - 5.0).abs() < 1e-9);
}

#[test]
fn constant_fraction_with_the_full_rise_as_delay_is_the_leading_edge() {
    // A straight rise from 10 to 20, then flat: y(t - 10) = 0.3 y(t) at 13 + 10, for any amplitude.
    let samples: Vec<f64> = (0..60).map(|n| 2.0 * (f64::from(n) - 10.0).clamp(0.0, 10.0)).collect();
    let zero = constant_fraction(&samples, 0.3, 10.0, Noise::even(0.1)).expect("zero");
    assert!((zero.position - 13.0).abs() < 1e-12);
    let half = constant_fraction(&samples, 0.3, 12.5, Noise::even(0.1)).expect("zero");
    assert!((half.position - 13.0).abs() < 1e-12);
}

#[test]
fn the_sd_is_the_scatter_in_white_noise() {
    let normal = Normal::new(0.0, 0.001).expect("positive");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let clean = pulse(80, 40.0, 1.0);
    for fraction in [0.3, 0.5] {
        let timing: [&Timing<'_>; 3] = [
            &|s| leading_edge(s, fraction, Noise::even(0.001)),
            &|s| constant_fraction(s, fraction, 8.4, Noise::even(0.001)),
            &|s| threshold(s, fraction, 0.001),
        ];
        for find in timing {
            let truth = find(&clean).expect("clean onset");
            let errors: Vec<f64> = (0..2000)
                .map(|_| {
                    let noisy: Vec<f64> = clean.iter().map(|v| v + normal.sample(&mut rng)).collect();
                    find(&noisy).expect("onset").position - truth.position
                })
                .collect();
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / 2000.0).sqrt();
            let ratio = rms / truth.sd;
            // A fixed level states the noise of one sample; interpolation averages two.
            let is_fixed = find(&pulse(80, 40.0, 2.0)).is_some_and(|twice| twice.level == fraction);
            let least = if is_fixed { 0.65 } else { 0.94 };
            assert!((least..1.06).contains(&ratio), "ratio {ratio}");
        }
    }
}

/// Counts of a pulse on a dark level: the scatter over draws is what Poisson's law says of the edge.
#[test]
fn edges_of_counts_scatter_as_they_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for (height, dark) in [(2000.0, 20.0), (400.0, 1.0), (30_000.0, 300.0)] {
        let noise = Noise { sd: f64::sqrt(dark), per_level: 1.0 };
        let timings: [&Timing<'_>; 2] = [&|s| leading_edge(s, 0.5, noise), &|s| constant_fraction(s, 0.5, 7.3, noise)];
        for find in timings {
            let crossings: Vec<Crossing> = (0..2000)
                .map(|_| {
                    let at = rng.random_range(0.0..1.0);
                    let means = pulse(80, 40.0 + at, height).into_iter().map(|v| v + dark);
                    let count = |mean: f64| Poisson::new(mean).expect("positive").sample(&mut rng) - dark;
                    let crossing = find(&means.map(count).collect::<Vec<_>>()).expect("an edge");
                    Crossing { position: crossing.position - at, ..crossing }
                })
                .collect();
            let mean = crossings.iter().map(|c| c.position).sum::<f64>() / 2000.0;
            let seen = (crossings.iter().map(|c| (c.position - mean).powi(2)).sum::<f64>() / 1999.0).sqrt();
            let stated = (crossings.iter().map(|c| c.sd * c.sd).sum::<f64>() / 2000.0).sqrt();
            assert!((0.9..1.1).contains(&(stated / seen)), "{height} {dark}: stated {stated}, seen {seen}");
        }
    }
}

/// A pulse with a steep front and a slow tail, whose slope changes from bin to bin, as counters have it.
#[test]
fn edges_of_counts_scatter_as_they_state_where_the_slope_changes() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let bin = |n: usize| {
        let late = n as f64 - 40.3;
        if late < 0.0 {
            (-0.5 * (late / 2.6_f64).powi(2)).exp()
        } else {
            (-late / 4.0).exp() * 0.7 + 0.3 * (-late / 25.0).exp()
        }
    };
    let shape: Vec<f64> = (0..120).map(bin).collect();
    for height in [100.0, 1_000.0, 30_000.0] {
        let noise = Noise { sd: 0.1, per_level: 1.0 };
        for fraction in [0.2, 0.5, 0.8] {
            let crossings: Vec<Crossing> = (0..2000)
                .map(|_| {
                    let count = |share: &f64| Poisson::new(height * share + 1e-9).expect("positive").sample(&mut rng);
                    leading_edge(&shape.iter().map(count).collect::<Vec<_>>(), fraction, noise).expect("an edge")
                })
                .collect();
            let mean = crossings.iter().map(|c| c.position).sum::<f64>() / 2000.0;
            let seen = (crossings.iter().map(|c| (c.position - mean).powi(2)).sum::<f64>() / 1999.0).sqrt();
            let stated = (crossings.iter().map(|c| c.sd * c.sd).sum::<f64>() / 2000.0).sqrt();
            println!("{height} {fraction}: stated {stated:.4}, seen {seen:.4}, {:.2}", stated / seen);
            assert!((0.88..1.12).contains(&(stated / seen)), "{height} {fraction}: stated {stated}, seen {seen}");
        }
    }
}

#[test]
fn a_record_re_arms_below_its_level() {
    let samples = [0.0, 6.0, 7.0, 3.0, 6.0, 0.5, 5.0, 9.0, 0.0, 4.9, 2.0, 5.1];
    let places = |crossings: Vec<Crossing>| crossings.iter().map(|c| c.position).collect::<Vec<_>>();
    assert_eq!(places(responses(&samples, 5.0, 2.0, 1.0)), [1.0, 6.0, 11.0]);
    assert_eq!(places(responses(&samples, 5.0, 5.0, 1.0)), [1.0, 4.0, 6.0, 11.0]);
    assert_eq!(places(responses(&samples[1..], 5.0, 2.0, 1.0)), [0.0, 5.0, 10.0]);
    let crossings = thresholds(&samples, 5.0, 2.0, 1.0);
    assert_eq!(crossings[0], threshold(&samples, 5.0, 1.0).expect("crossed"));
    assert_eq!(crossings.len(), 3);
    assert!((crossings[2].position - (10.0 + 3.0 / 3.1)).abs() < 1e-12);
    // What begins above the level has not crossed it.
    assert_eq!(thresholds(&samples[1..], 5.0, 2.0, 1.0)[0].position, crossings[1].position - 1.0);
    assert!(responses(&[], 5.0, 2.0, 1.0).is_empty() && thresholds(&[], 1.0, 1.0, 1.0).is_empty());
}

#[test]
fn akaike_finds_the_change_of_variance_that_a_naive_scan_finds() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for _ in 0..200 {
        let mut samples: Vec<f64> =
            (0..40).map(|n| rng.random_range(-1.0..1.0) * if n < 22 { 0.1 } else { 3.0 }).collect();
        samples[39] = 3.5;
        let variance = |part: &[f64]| {
            let mean = part.iter().sum::<f64>() / part.len() as f64;
            part.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / part.len() as f64
        };
        let total = |k: usize| {
            let logarithm = |part: &[f64]| variance(part).max(0.0025).ln();
            k as f64 * logarithm(&samples[5..5 + k]) + (34 - k) as f64 * logarithm(&samples[5 + k..])
        };
        let naive = (2..34).min_by(|a, b| total(*a).total_cmp(&total(*b))).expect("some");
        let onset = akaike(&samples, 34, 0.05).expect("a maximum");
        assert_eq!(onset, (naive + 5) as f64);
        assert!((onset - 22.0).abs() <= 4.0, "{onset}");
    }
    assert_eq!(akaike(&[0.0, 0.1, 0.0, 0.1, 9.0], 10, 0.1), None);
}

/// Scatter and walk (position by the logarithm of the amplitude) in ps of a pulse that is 250 ps wide. Amplitudes are
/// from 0.3 to 1.7, sampled five times a width. The values are those of independent prototypes (section 3 of the method
/// notes).
#[test]
fn levels_and_akaike_walk_with_amplitude_by_what_is_known_of_them() {
    let (sigma, dt_ps) = (106.165_225 / 50.0, 50.0);
    let statistics = |snr: f64, find: &dyn Fn(&[f64]) -> f64| {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let normal = Normal::new(0.0, 1.0 / snr).expect("positive");
        let points: Vec<(f64, f64)> = (0..2000)
            .map(|_| {
                let (at, a) = (40.0 + rng.random_range(0.0..1.0), rng.random_range(0.3..1.7_f64));
                let y: Vec<f64> = (0..80)
                    .map(|n| a * (-0.5 * ((f64::from(n) - at) / sigma).powi(2)).exp() + normal.sample(&mut rng))
                    .collect();
                (a.ln(), (find(&y) - at) * dt_ps)
            })
            .collect();
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / 2000.0;
        let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
        let walk = mean(&|p| (p.0 - x) * (p.1 - y)) / mean(&|p| (p.0 - x).powi(2));
        (mean(&|p| (p.1 - y).powi(2)).sqrt(), walk)
    };
    let level = |y: &[f64]| threshold(y, 0.2, 0.01).expect("level").position;
    let (sd_ps, walk_ps) = statistics(100.0, &level);
    println!("fixed level: {sd_ps:.1} ps, walk {walk_ps:.1} ps");
    assert!((25.0..36.0).contains(&sd_ps) && (-70.0..-50.0).contains(&walk_ps), "{sd_ps} {walk_ps}");
    let akaike = |y: &[f64]| akaike(y, 30, 0.01).expect("a maximum");
    let (sd_ps, walk_ps) = statistics(100.0, &akaike);
    println!("akaike: {sd_ps:.1} ps, walk {walk_ps:.1} ps");
    assert!((18.0..40.0).contains(&sd_ps) && (-50.0..-20.0).contains(&walk_ps), "{sd_ps} {walk_ps}");
    // The first response at 5 sigma: s / sqrt(2 ln(a / level)) an e-fold, some 44 ps here; and a sample's width.
    let first = |y: &[f64]| responses(y, 5.0, 2.0, 0.01)[0].position;
    let (sd_ps, walk_ps) = statistics(100.0, &first);
    println!("first response: {sd_ps:.1} ps, walk {walk_ps:.1} ps");
    assert!((20.0..32.0).contains(&sd_ps) && (-50.0..-38.0).contains(&walk_ps), "{sd_ps} {walk_ps}");
}

#[test]
fn no_crossing_is_none() {
    assert_eq!(leading_edge(&[], 0.5, Noise::even(1.0)), None);
    assert_eq!(leading_edge(&[3.0, 2.0, 1.0], 0.5, Noise::even(1.0)), None);
    assert_eq!(leading_edge(&[-3.0, -1.0, -2.0], 0.5, Noise::even(1.0)), None);
    assert_eq!(threshold(&[1.0, 1.0, 0.0], 0.5, 1.0), None);
    assert_eq!(constant_fraction(&[1.0, 1.0], 0.5, 4.0, Noise::even(1.0)), None);
    assert_eq!(constant_fraction(&[0.0; 20], 0.5, 4.0, Noise::even(1.0)), None);
}
