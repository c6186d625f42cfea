//! Pulses that other records predict: blends are resolved, and priors of times and widths do not count again.

use super::extended::spread;
use super::*;
use crate::sparse::Prediction;

/// Two bounces 40 ps apart, a sixth of the response, and a third 300 ps later: time and width of each.
const BLEND: [(f64, f64); 3] = [(3000.0, 20.0), (3040.0, 25.0), (3300.0, 15.0)];

/// Standard deviations of what is expected: of a time, and of a width over what it is.
const TIME_SD_PS: f64 = 8.0;
const WIDTH_SD: f64 = 0.05;

fn blend(shape: &Shape, later_ps: f64, len: usize) -> Vec<f64> {
    let each = BLEND.map(|(at, width)| spread(shape, at + later_ps, width, 0.0, len));
    (0..len).map(|n| each.iter().map(|pulse| pulse[n]).sum()).collect()
}

/// What is expected of each, its time and width so many standard deviations off.
fn predicted(later_ps: f64, off: [[f64; 2]; 3]) -> Vec<Prediction> {
    let pulse = |((at, width_ps), off): (&(f64, f64), [f64; 2])| Prediction {
        time_ps: at + later_ps + TIME_SD_PS * off[0],
        time_sd_ps: TIME_SD_PS,
        width_ps: width_ps * (1.0 + WIDTH_SD * off[1]),
        width_sd_ps: width_ps * WIDTH_SD,
    };
    BLEND.iter().zip(off).map(pulse).collect()
}

fn options(predictions: Vec<Prediction>) -> SparseOptions {
    SparseOptions { extent_max_ps: 100.0, predictions, ..SparseOptions::default() }
}

/// Squared errors over their covariance are chi-square: the times of the blend are right with all that they share, and
/// no narrower for what was expected of them.
#[test]
fn own_times_of_a_blend_are_as_sure_as_they_say() {
    let mut rng = ChaCha8Rng::seed_from_u64(81);
    let (sd, len, draws) = (1.0 / 200.0, 120, 300);
    let normal = Normal::new(0.0, 1.0).expect("positive");
    for shape in [gaussian(), exponential()] {
        let (mut chi2, mut sums, mut found) = (Vec::new(), Vec::new(), 0);
        for _ in 0..draws {
            let later_ps = rng.random_range(0.0..DT_PS);
            let y = with_noise(&blend(&shape, later_ps, len), sd, &mut rng);
            let off = [0, 1, 2].map(|_| [0, 1].map(|_| normal.sample(&mut rng)));
            let fit = fit_white(&shape, &y, sd, &options(predicted(later_ps, off)));
            if fit.pulses.len() != 3 {
                continue;
            }
            found += 1;
            let errors: Vec<f64> =
                fit.pulses.iter().zip(BLEND).map(|(pulse, (at, _))| pulse.own_time_ps - at - later_ps).collect();
            chi2.push(mahalanobis(&fit.covariance_ps2, &errors) / 3.0);
            let variance: f64 = [0, 1].iter().flat_map(|i| [0, 1].map(|j| fit.covariance_ps2[3 * i + j])).sum();
            sums.push((errors[0] + errors[1]) / variance.sqrt());
        }
        let mean = chi2.iter().sum::<f64>() / chi2.len() as f64;
        println!("{}: {found} of {draws}, chi2 over freedom {mean:.3}, sums / sd {:.3}", shape.name, rms(&sums));
        assert!(found > draws * 9 / 10, "{}: {found}", shape.name);
        assert!((0.8..1.25).contains(&mean), "{}: {mean}", shape.name);
        assert!((0.85..1.15).contains(&rms(&sums)), "{}: {}", shape.name, rms(&sums));
    }
}

/// The same record with another expectation has the same own times, but for what is not linear.
#[test]
fn what_was_predicted_of_a_time_is_taken_out_again() {
    let mut rng = ChaCha8Rng::seed_from_u64(82);
    let (sd, len) = (1.0 / 400.0, 120);
    let shape = gaussian();
    let y = with_noise(&blend(&shape, 0.0, len), sd, &mut rng);
    let [one, other] = [0.0, 1.0].map(|off| fit_white(&shape, &y, sd, &options(predicted(0.0, [[off, 0.0]; 3]))));
    let moved = |time: fn(&Pulse) -> f64| -> Vec<f64> {
        one.pulses.iter().zip(&other.pulses).map(|(a, b)| (time(a) - time(b)).abs()).collect()
    };
    let (with, own) = (moved(|pulse| pulse.time_ps), moved(|pulse| pulse.own_time_ps));
    println!("with what was expected {with:.2?} ps, own {own:.2?} ps, sds {:.2} ps", one.time_sd_ps(0));
    assert!(with[0] > 1.0 && own[0] < 0.25 * with[0] && own[1] < 0.25 * with[1], "{with:?} {own:?}");
    assert!(one.pulses[0].time_sd_ps < one.time_sd_ps(0));
}

/// A width that is predicted two standard deviations too large is found larger than it is, but its own variance is not.
#[test]
fn what_was_predicted_of_a_width_is_taken_out_again() {
    let mut rng = ChaCha8Rng::seed_from_u64(83);
    let (sd, len, draws) = (1.0 / 200.0, 120, 300);
    let (at, width_ps): (f64, f64) = (3000.0, 25.0);
    let width_sd_ps = 0.15 * width_ps;
    for shape in [gaussian(), exponential()] {
        let (mut with, mut own) = (Vec::new(), Vec::new());
        for _ in 0..draws {
            let at = at + rng.random_range(0.0..DT_PS);
            let y = with_noise(&spread(&shape, at, width_ps, 0.0, len), sd, &mut rng);
            let wider =
                Prediction { time_ps: at, time_sd_ps: TIME_SD_PS, width_ps: width_ps + 2.0 * width_sd_ps, width_sd_ps };
            let fit = fit_white(&shape, &y, sd, &options(vec![wider]));
            let pulse = fit.pulses[0];
            let sd_ps2 = 2.0 * pulse.width_ps * pulse.width_sd_ps;
            with.push((pulse.width_ps.powi(2) - width_ps.powi(2)) / sd_ps2);
            own.push((pulse.own_variance_ps2 - width_ps.powi(2)) / sd_ps2);
        }
        let mean = |pulls: &[f64]| pulls.iter().sum::<f64>() / pulls.len() as f64;
        println!(
            "{}: {:.2} with what was expected, own {:.2}, rms {:.2}",
            shape.name,
            mean(&with),
            mean(&own),
            rms(&own)
        );
        assert!(mean(&with) > 0.2, "{}: {}", shape.name, mean(&with));
        assert!(mean(&own).abs() < 0.15 && (0.85..1.15).contains(&rms(&own)), "{}: {}", shape.name, mean(&own));
    }
}

/// Squared errors over their covariance: Gaussian elimination.
fn mahalanobis(covariance: &[f64], errors: &[f64]) -> f64 {
    let n = errors.len();
    let mut rows: Vec<Vec<f64>> = (0..n).map(|i| [&covariance[i * n..(i + 1) * n], &errors[i..=i]].concat()).collect();
    for p in 0..n {
        let pivot = rows[p].clone();
        for row in &mut rows[p + 1..] {
            let factor = row[p] / pivot[p];
            row.iter_mut().zip(&pivot).for_each(|(value, of_pivot)| *value -= factor * of_pivot);
        }
    }
    rows.iter().enumerate().map(|(p, row)| row[n] * row[n] / row[p]).sum()
}
