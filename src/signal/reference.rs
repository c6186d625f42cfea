//! Time of the reference pulse in one shot: Gauss-Newton on amplitude, time and offset with a known template.
//!
//! Source: algorithm of section 5 of the paper's prototype (arrivals are relative to a reference pulse), as least
//! squares: columns `h(t - tau)`, `-a h'(t - tau)` and 1. In white noise it attains the Cramer-Rao bound. Not modelled:
//! saturated pulses, which the caller rejects.

use super::response::Response;

/// Steps after which a fit that has not settled is given up.
const STEPS: usize = 30;
/// A fit has settled when its time moves by less than this.
const SETTLED_PS: f64 = 1e-7;
/// A pulse weaker than this many of its own standard deviations is none.
const SNR_MIN: f64 = 5.0;

/// A pulse below this part of the largest sample is rounding.
const ROUNDING: f64 = 1e-12;

/// A fitted pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PulseFit {
    /// Arrival of the pulse after sample 0 (the template's time 0).
    pub time_ps: f64,
    /// Factor of the template.
    pub amplitude: f64,
    /// Constant under the pulse.
    pub offset: f64,
    /// Standard deviation of the time, from the fit's own residuals.
    pub time_sd_ps: f64,
    /// Standard deviation of the amplitude.
    pub amplitude_sd: f64,
}

/// Fits the strongest pulse of a shot, positive or negative. `None` when there is none, or too little of it lies within
/// the record.
///
/// # Panics
/// When `dt_ps` is not positive.
#[must_use]
pub fn fit_pulse(samples: &[f64], dt_ps: f64, template: &Response) -> Option<PulseFit> {
    assert!(dt_ps > 0.0, "a step is positive");
    let landmark = if template.is_step() { steepest(samples)? } else { strongest(samples)? };
    let start_ps = landmark as f64 * dt_ps - template.peak_ps();
    let mut time_ps = start_ps;
    let mut fit = None;
    for _ in 0..STEPS {
        let solved = solve(samples, dt_ps, template, time_ps)?;
        // A step of more than a sample or two leaves the region where the expansion holds.
        let step_ps = (solved.shift / solved.amplitude).clamp(-dt_ps, dt_ps);
        time_ps += step_ps;
        if (time_ps - start_ps).abs() > template.width_ps() + 2.0 * dt_ps {
            return None;
        }
        fit = Some(solved);
        if step_ps.abs() < SETTLED_PS {
            break;
        }
    }
    let Solved { amplitude, offset, residual_variance, inverse, .. } = fit?;
    let amplitude_sd = (residual_variance * inverse[0]).sqrt();
    let time_sd_ps = (residual_variance * inverse[1]).sqrt() / amplitude.abs();
    // Of a constant record the fit leaves its own rounding, on which no pulse stands out.
    let rounding = ROUNDING * samples.iter().fold(0.0, |most: f64, sample| most.max(sample.abs()));
    let stands_out = amplitude.abs() >= SNR_MIN * amplitude_sd && amplitude.abs() > rounding;
    (stands_out && time_sd_ps.is_finite()).then_some(PulseFit { time_ps, amplitude, offset, time_sd_ps, amplitude_sd })
}

/// Integral over time of a fitted pulse as it was recorded, its offset taken off: it goes with the pulse's energy. In
/// the unit of the samples, times ps.
///
/// # Panics
/// When `dt_ps` is not positive.
#[must_use]
pub fn integral(samples: &[f64], dt_ps: f64, template: &Response, fit: &PulseFit) -> f64 {
    assert!(dt_ps > 0.0, "a step is positive");
    let reach = template.reach(fit.time_ps, 0.0, dt_ps, samples.len());
    samples[reach].iter().map(|sample| sample - fit.offset).sum::<f64>() * dt_ps
}

/// The sample between two neighbours that differ most.
fn steepest(samples: &[f64]) -> Option<usize> {
    let rise = |n: usize| (samples[n + 1] - samples[n - 1]).abs();
    (1..samples.len().checked_sub(1)?).max_by(|&a, &b| rise(a).total_cmp(&rise(b)))
}

/// The sample furthest from the median.
fn strongest(samples: &[f64]) -> Option<usize> {
    let mut sorted = samples.to_vec();
    let half = sorted.len() / 2;
    let median = *sorted.get_mut(..)?.select_nth_unstable_by(half.min(samples.len().checked_sub(1)?), f64::total_cmp).1;
    (0..samples.len()).max_by(|&a, &b| (samples[a] - median).abs().total_cmp(&(samples[b] - median).abs()))
}

/// A linearised fit.
struct Solved {
    amplitude: f64,
    /// Amplitude times the shift of the time.
    shift: f64,
    offset: f64,
    residual_variance: f64,
    /// Diagonal of the inverse of the normal matrix: amplitude, shift.
    inverse: [f64; 2],
}

fn solve(samples: &[f64], dt_ps: f64, template: &Response, time_ps: f64) -> Option<Solved> {
    let reach = template.reach(time_ps, 0.0, dt_ps, samples.len());
    let count = reach.len();
    if count < 5 {
        return None;
    }
    let (mut normal, mut right, mut total) = ([[0.0; 3]; 3], [0.0; 3], 0.0);
    for n in reach {
        let (value, slope) = template.value_and_slope(n as f64 * dt_ps - time_ps);
        let columns = [value, -slope, 1.0];
        for i in 0..3 {
            right[i] += columns[i] * samples[n];
            for j in 0..3 {
                normal[i][j] += columns[i] * columns[j];
            }
        }
        total += samples[n] * samples[n];
    }
    let inverse = inverse(normal)?;
    let solution: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| inverse[i][j] * right[j]).sum());
    let explained: f64 = solution.iter().zip(right).map(|(a, b)| a * b).sum();
    let residual_variance = ((total - explained) / (count - 3) as f64).max(0.0);
    (solution[0] != 0.0).then_some(Solved {
        amplitude: solution[0],
        shift: solution[1],
        offset: solution[2],
        residual_variance,
        inverse: [inverse[0][0], inverse[1][1]],
    })
}

/// Inverse of a symmetric matrix by cofactors; `None` if it is singular.
fn inverse(m: [[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let cofactor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    let scale = m[0][0] * m[1][1] * m[2][2];
    (determinant > 1e-12 * scale)
        .then(|| std::array::from_fn(|i| std::array::from_fn(|j| cofactor(j, i) / determinant)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SIGMA_PS: f64 = 106.2;

    fn gaussian() -> Response {
        let values: Vec<f64> = (-80..=80).map(|i| (-0.5 * (f64::from(i) * 6.25 / SIGMA_PS).powi(2)).exp()).collect();
        Response::new(-500.0, 6.25, &values)
    }

    fn shot(at_ps: f64, amplitude: f64, noise: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
        (0..60)
            .map(|n| {
                let normal: f64 = StandardNormal.sample(rng);
                amplitude * (-0.5 * ((f64::from(n) * 50.0 - at_ps) / SIGMA_PS).powi(2)).exp() + 7.0 + noise * normal
            })
            .collect()
    }

    /// Cramer-Rao bound of the time with amplitude and offset unknown, from derivatives written anew.
    fn bound_ps(at_ps: f64, amplitude: f64, noise: f64) -> f64 {
        let mut fisher = nalgebra::Matrix3::<f64>::zeros();
        for n in 0..60 {
            let u = (f64::from(n) * 50.0 - at_ps) / SIGMA_PS;
            if (u * SIGMA_PS).abs() > 500.0 {
                continue;
            }
            let h = (-0.5 * u * u).exp();
            let column = nalgebra::Vector3::new(h, amplitude * h * u / SIGMA_PS, 1.0);
            fisher += column * column.transpose() / (noise * noise);
        }
        fisher.try_inverse().unwrap()[(1, 1)].sqrt()
    }

    #[test]
    fn it_attains_the_cramer_rao_bound_and_knows_its_error() {
        let (template, mut rng) = (gaussian(), ChaCha8Rng::seed_from_u64(1));
        let (draws, noise) = (2000, 1.0 / 30.0);
        let (mut squares, mut bounds, mut own) = (0.0, 0.0, 0.0);
        for _ in 0..draws {
            let at_ps = 1400.0 + rng.random_range(0.0..50.0);
            let fit = fit_pulse(&shot(at_ps, 1.0, noise, &mut rng), 50.0, &template).unwrap();
            squares += (fit.time_ps - at_ps).powi(2);
            bounds += bound_ps(at_ps, 1.0, noise).powi(2);
            own += fit.time_sd_ps.powi(2);
        }
        let ratio = (squares / bounds).sqrt();
        assert!((0.93..1.07).contains(&ratio), "rms over bound {ratio}");
        assert!((0.95..1.05).contains(&(own / bounds).sqrt()), "own sd over bound {}", (own / bounds).sqrt());
    }

    #[test]
    fn a_shift_in_is_a_shift_out_and_a_negative_pulse_is_a_pulse() {
        let (template, mut rng) = (gaussian(), ChaCha8Rng::seed_from_u64(2));
        for at_ps in [1000.0, 1233.3, 1777.7] {
            let fit = fit_pulse(&shot(at_ps, -4.0, 0.0, &mut rng), 50.0, &template).unwrap();
            assert!((fit.time_ps - at_ps).abs() < 1e-3 && (fit.amplitude + 4.0).abs() < 1e-4, "{fit:?}");
        }
    }

    #[test]
    fn noise_is_no_pulse() {
        let (template, mut rng) = (gaussian(), ChaCha8Rng::seed_from_u64(3));
        let false_pulses =
            (0..300).filter(|_| fit_pulse(&shot(0.0, 0.0, 1.0, &mut rng), 50.0, &template).is_some()).count();
        assert!(false_pulses <= 12, "{false_pulses} of 300");
        assert!(fit_pulse(&[], 50.0, &template).is_none());
        assert!(fit_pulse(&[1.0; 40], 50.0, &template).is_none());
    }
}
