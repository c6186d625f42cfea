//! Accuracy against bounds computed here from the responses' formulas, resolution, false pulses.

mod blended;
mod correlated;
mod counts;
mod extended;
mod joint;
mod own_response;
mod predictions;
mod scatter;
mod tones;

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

const DT_PS: f64 = 50.0;
const T0_PS: f64 = -130.0;

/// A response of maximum 1: its formula and its spline.
struct Shape {
    name: &'static str,
    formula: fn(f64) -> f64,
    response: Response,
}

/// Gaussian, full width at half maximum 250 ps.
fn gaussian() -> Shape {
    let formula = |t: f64| (-0.5 * (t / 106.165_225).powi(2)).exp();
    let values: Vec<f64> = (-65..=65).map(|i| formula(10.0 * f64::from(i))).collect();
    Shape { name: "Gaussian", formula, response: Response::new(-650.0, 10.0, &values) }
}

/// Gaussian of sd 33 ps, convolved with an exponential decay of 112 ps: Simpson's rule over the decay.
fn exponential() -> Shape {
    let formula = |t: f64| -> f64 {
        let (from, to) = ((t - 250.0).max(0.0), (t + 250.0).max(0.0));
        let step = (to - from) / 60.0;
        let sum: f64 = (0..=60)
            .map(|i| {
                let weight = [2.0, 4.0][i % 2] - f64::from(u8::from(i % 60 == 0));
                let u = from + step * i as f64;
                weight * (-u / 112.0 - 0.5 * ((t - u) / 33.0).powi(2)).exp()
            })
            .sum();
        sum * step / 3.0 / 52.196
    };
    let values: Vec<f64> = (-30..=240).map(|i| formula(5.0 * f64::from(i))).collect();
    Shape { name: "exponential", formula, response: Response::new(-150.0, 5.0, &values) }
}

/// Samples of pulses `(time, amplitude)` on `baseline`, without noise.
fn clean(shape: &Shape, pulses: &[(f64, f64)], baseline: f64, len: usize) -> Vec<f64> {
    let sample = |n: usize| {
        let t = T0_PS + DT_PS * n as f64;
        pulses.iter().map(|(at, a)| a * (shape.formula)(t - at)).sum::<f64>() + baseline
    };
    (0..len).map(sample).collect()
}

fn with_noise(clean: &[f64], sd: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let normal = Normal::new(0.0, sd).expect("positive");
    clean.iter().map(|v| v + normal.sample(rng)).collect()
}

fn fit_white(shape: &Shape, mean_v: &[f64], sd: f64, options: &SparseOptions) -> SparseFit {
    let profile = Profile {
        mean_v,
        sd_v: &vec![sd; mean_v.len()],
        acf: &[],
        slow_v2: &[],
        jitter: None,
        t0_ps: T0_PS,
        dt_ps: DT_PS,
    };
    fit(&profile, &shape.response, options)
}

/// Cramer-Rao bound of the sds of times, with unknown amplitudes and baseline: Gauss-Jordan inverse of the information.
fn bound_ps(shape: &Shape, pulses: &[(f64, f64)], sd: f64, len: usize) -> Vec<f64> {
    let k = pulses.len();
    let n = 2 * k + 1;
    let mut m = vec![vec![0.0; 2 * n]; n];
    for i in 0..len {
        let t = T0_PS + DT_PS * i as f64;
        let mut row = vec![1.0; n];
        for (j, (at, a)) in pulses.iter().enumerate() {
            let h = |dt: f64| (shape.formula)(t - at + dt);
            row[j] = -a * (h(0.5) - h(-0.5));
            row[k + j] = h(0.0);
        }
        for (p, line) in m.iter_mut().enumerate() {
            for q in 0..n {
                line[q] += row[p] * row[q] / (sd * sd);
            }
        }
    }
    for (p, line) in m.iter_mut().enumerate() {
        line[n + p] = 1.0;
    }
    for p in 0..n {
        let pivot = m[p][p];
        m[p].iter_mut().for_each(|v| *v /= pivot);
        let pivot_row = m[p].clone();
        for (q, line) in m.iter_mut().enumerate() {
            let factor = line[p];
            if q != p {
                line.iter_mut().zip(&pivot_row).for_each(|(v, r)| *v -= factor * r);
            }
        }
    }
    (0..k).map(|p| m[p][n + p].sqrt()).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn a_single_pulse_is_timed_at_the_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for shape in [gaussian(), exponential()] {
        for snr in [10.0, 30.0, 100.0] {
            let (mut errors, mut pulls) = (Vec::new(), Vec::new());
            for _ in 0..600 {
                let truth = [(3000.0 + rng.random_range(0.0..DT_PS), 1.0)];
                let y = with_noise(&clean(&shape, &truth, 0.3, 120), 1.0 / snr, &mut rng);
                let solution = fit_white(&shape, &y, 1.0 / snr, &SparseOptions::default());
                assert_eq!(solution.pulses.len(), 1, "{} at {snr} {truth:?} {solution:?}", shape.name);
                let error = solution.pulses[0].time_ps - truth[0].0;
                errors.push(error / bound_ps(&shape, &truth, 1.0 / snr, 120)[0]);
                pulls.push(error / solution.covariance_ps2[0].sqrt());
            }
            let (ratio, pull) = (rms(&errors), rms(&pulls));
            println!("{} SNR {snr}: rms / bound {ratio:.3}, rms / own sd {pull:.3}", shape.name);
            assert!((0.9..1.1).contains(&ratio), "{} at {snr}: {ratio}", shape.name);
            assert!((0.8..1.1).contains(&pull), "{} at {snr}: {pull}", shape.name);
        }
    }
}

#[test]
fn pairs_closer_than_the_response_are_separated_at_the_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let sd = 0.01;
    for shape in [gaussian(), exponential()] {
        for distance in [100.0, 200.0] {
            let (mut errors, mut pulls) = (Vec::new(), Vec::new());
            for _ in 0..300 {
                let first = 3000.0 + rng.random_range(0.0..DT_PS);
                let truth = [(first, 1.0), (first + distance, 1.0)];
                let y = with_noise(&clean(&shape, &truth, 0.0, 120), sd, &mut rng);
                let solution = fit_white(&shape, &y, sd, &SparseOptions::default());
                if solution.pulses.len() == 2 {
                    let bound = bound_ps(&shape, &truth, sd, 120);
                    let error = |k: usize| solution.pulses[k].time_ps - truth[k].0;
                    let c = &solution.covariance_ps2;
                    errors.extend([error(0) / bound[0], error(1) / bound[1]]);
                    // The distance scatters far less than either time: the covariance must know.
                    pulls.push((error(1) - error(0)) / (c[0] + c[3] - 2.0 * c[1]).sqrt());
                }
            }
            let separated = errors.len() as f64 / 600.0;
            let (ratio, pull) = (rms(&errors), rms(&pulls));
            println!(
                "{} {distance} ps: two {separated:.3}, rms / bound {ratio:.3}, distance / own sd {pull:.3}",
                shape.name
            );
            assert!(separated >= 0.98, "{} {distance}: {separated}", shape.name);
            assert!((0.9..1.1).contains(&ratio), "{} {distance}: {ratio}", shape.name);
            assert!((0.8..1.1).contains(&pull), "{} {distance}: {pull}", shape.name);
        }
    }
}

#[test]
fn one_pulse_never_becomes_two() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    for shape in [gaussian(), exponential()] {
        for _ in 0..500 {
            let truth = [(rng.random_range(500.0..48_000.0), 1.0)];
            let y = with_noise(&clean(&shape, &truth, 0.0, 1000), 0.01, &mut rng);
            let solution = fit_white(&shape, &y, 0.01, &SparseOptions::default());
            assert_eq!(solution.pulses.len(), 1, "{} at {truth:?} {solution:?}", shape.name);
        }
    }
}

#[test]
fn noise_gives_false_pulses_at_the_rate_that_the_threshold_promises() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let len = 1000;
    for shape in [gaussian(), exponential()] {
        let record_ps = DT_PS * len as f64;
        // What the default asks for, and what would let one record in five have a false pulse.
        let strict = evidence_min(&shape.response, record_ps, 1e-4);
        let loose = strict - 2.0 * (0.2_f64 / 1e-4).ln();
        let mut records = [0, 0];
        for _ in 0..1000 {
            let y = with_noise(&vec![0.0; len], 1.0, &mut rng);
            for (count, threshold) in records.iter_mut().zip([loose, strict]) {
                let options =
                    SparseOptions { evidence_min: Some(threshold), pulses_max: 1, ..SparseOptions::default() };
                *count += fit_white(&shape, &y, 1.0, &options).pulses.len();
            }
        }
        println!("{}: {records:?} of 1000, threshold {strict:.1}", shape.name);
        assert!((100..240).contains(&records[0]), "{}: {records:?}", shape.name);
        assert!(records[1] <= 1, "{}: {records:?}", shape.name);
    }
}

#[test]
fn shift_in_is_shift_out() {
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    let shape = exponential();
    let truth = [(2000.0, 1.0), (2140.0, 0.5), (6000.0, 0.2)];
    let y = with_noise(&clean(&shape, &truth, 0.0, 200), 0.01, &mut rng);
    // A slope is not what it was when the record is turned.
    let options = SparseOptions { baseline: Baseline::Constant, ..SparseOptions::default() };
    let solution = fit_white(&shape, &y, 0.01, &options);
    assert_eq!(solution.pulses.len(), 3);
    let mut later = y;
    later.rotate_right(17);
    let shifted = fit_white(&shape, &later, 0.01, &options);
    for (a, b) in solution.pulses.iter().zip(&shifted.pulses) {
        assert!((b.time_ps - a.time_ps - 17.0 * DT_PS).abs() < 0.01);
        assert!((b.amplitude_v - a.amplitude_v).abs() < 1e-4);
    }
}

#[test]
fn many_pulses_on_a_baseline_are_all_found() {
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    for shape in [gaussian(), exponential()] {
        let truth: Vec<(f64, f64)> =
            (0..12).map(|k| (2000.0 + 330.0 * f64::from(k), 1.0 - 0.06 * f64::from(k))).collect();
        let y = with_noise(&clean(&shape, &truth, -0.7, 2048), 0.01, &mut rng);
        let solution = fit_white(&shape, &y, 0.01, &SparseOptions::default());
        assert_eq!(solution.pulses.len(), 12, "{}", shape.name);
        for (k, ((at, a), pulse)) in truth.iter().zip(&solution.pulses).enumerate() {
            let sd = solution.covariance_ps2[13 * k].sqrt();
            assert!((pulse.time_ps - at).abs() < 4.0 * sd, "{} pulse {k}", shape.name);
            assert!((pulse.amplitude_v - a).abs() < 4.0 * pulse.amplitude_sd_v);
            assert!(pulse.evidence > solution.evidence_min);
        }
        assert!((solution.baseline_v + 0.7).abs() < 0.002);
        assert!((solution.chi2_per_dof - 1.0).abs() < 0.1);
    }
}

#[test]
fn evidence_of_a_lone_pulse_is_its_energy() {
    let shape = gaussian();
    let y = clean(&shape, &[(3000.0, 1.0)], 0.0, 120);
    let options = SparseOptions { baseline: Baseline::None, ..SparseOptions::default() };
    let solution = fit_white(&shape, &y, 0.1, &options);
    let energy = y.iter().map(|v| v * v).sum::<f64>() / 0.01;
    assert!((solution.pulses[0].evidence / energy - 1.0).abs() < 1e-6);
    assert_eq!(solution.baseline_v, 0.0);
}

#[test]
fn ignored_samples_do_not_count_and_noisy_ones_count_less() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let shape = gaussian();
    let truth = [(3000.0, 1.0)];
    let mut y = with_noise(&clean(&shape, &truth, 0.0, 120), 0.01, &mut rng);
    let mut sd_v = vec![0.01; 120];
    for n in 66..75 {
        (y[n], sd_v[n]) = (0.4, f64::INFINITY); // clipped
    }
    for n in 20..30 {
        (y[n], sd_v[n]) = (0.5, 1.0);
    }
    let profile = Profile { mean_v: &y, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: T0_PS, dt_ps: DT_PS };
    let solution = fit(&profile, &shape.response, &SparseOptions::default());
    assert_eq!(solution.pulses.len(), 1);
    let sd = solution.covariance_ps2[0].sqrt();
    assert!((solution.pulses[0].time_ps - 3000.0).abs() < 4.0 * sd);
    // Nothing but ignored samples: no pulse, no panic.
    let nothing = Profile { sd_v: &[f64::INFINITY; 120], ..profile };
    assert!(fit(&nothing, &shape.response, &SparseOptions::default()).pulses.is_empty());
}

#[test]
fn an_inexact_response_shows_in_chi2_and_is_borne_by_its_own_variance() {
    let mut rng = ChaCha8Rng::seed_from_u64(18);
    let shape = gaussian();
    // An echo of 2 % after 180 ps.
    let echoing = Shape {
        formula: |t| (-0.5 * (t / 106.17).powi(2)).exp() + 0.02 * (-0.5 * ((t - 180.0) / 106.17).powi(2)).exp(),
        ..gaussian()
    };
    let y = with_noise(&clean(&echoing, &[(3000.0, 1.0)], 0.0, 120), 0.002, &mut rng);
    let one = SparseOptions { pulses_max: 1, ..SparseOptions::default() };
    assert!(fit_white(&shape, &y, 0.002, &one).pulses[0].chi2_per_dof > 2.0);
    assert!(fit_white(&shape, &y, 0.002, &SparseOptions::default()).pulses.len() > 1);
    let mut sd_v = vec![0.002; 120];
    sd_v[50..80].fill(0.02); // from 350 ps before the maximum to 400 ps behind
    let profile = Profile { mean_v: &y, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: T0_PS, dt_ps: DT_PS };
    let solution = fit(&profile, &shape.response, &SparseOptions::default());
    assert_eq!(solution.pulses.len(), 1);
    assert!((solution.pulses[0].time_ps - 3000.0).abs() < 4.0 * solution.covariance_ps2[0].sqrt());
}

/// Records that tell little of the width each: together they tell the true one, without a pull to the calibration's.
#[test]
fn widths_of_weak_records_add_up_to_the_true_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(19);
    let wider = Shape { formula: |t| (-0.5 * (t / (1.04 * 106.17)).powi(2)).exp(), ..gaussian() };
    let (mut sum, mut weights, mut count) = (0.0, 0.0, 0);
    for _ in 0..400 {
        let y = with_noise(&clean(&wider, &[(3000.0 + rng.random_range(0.0..DT_PS), 1.0)], 0.0, 120), 0.03, &mut rng);
        let fit = fit_white(&gaussian(), &y, 0.03, &SparseOptions::default());
        if let Some([width, sd]) = fit.width {
            (sum, weights, count) = (sum + width / (sd * sd), weights + 1.0 / (sd * sd), count + 1);
        }
    }
    let (width, sd) = (sum / weights, 1.0 / f64::sqrt(weights));
    println!("{count} records: {width:.4}, sd {sd:.4}");
    assert!(count > 350 && sd < 0.003 && (width - 1.04).abs() < 4.0 * sd + 0.002, "{count}: {width} {sd}");
}
