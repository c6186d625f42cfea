//! One pulse in a mean record: amplitude, time, baseline and width, with the errors that correlated noise makes.
//!
//! Least squares on the columns `h`, `-a h'` and 1 ([`super::reference`] locates the pulse). Then Gauss-Newton with a
//! fourth column, for a response that is stretched by `1 + w` about its maximum. All samples weigh the same, which is
//! best for white noise. The covariance is that of noise with the given autocorrelation, `(A'A)^-1 A' C A (A'A)^-1`, so
//! that a smooth front end does not make errors look small. Not modelled: errors of the response itself, and pulses
//! that overlap.

use super::reference::PulseFit;
use super::regression::{Regression, least_squares};
use super::response::Response;

/// Steps after which a width that has not settled is given up.
const STEPS: usize = 20;
/// A width has settled when it changes by less than this share.
const SETTLED: f64 = 1e-9;
/// Stretches beyond these are no pulse of this response.
const STRETCH_LIMITS: (f64, f64) = (0.25, 4.0);

/// A mean record, and the noise of its samples.
#[derive(Clone, Copy, Debug)]
pub struct MeanRecord<'a> {
    /// Samples.
    pub samples: &'a [f64],
    /// Time between samples.
    pub dt_ps: f64,
    /// Standard deviation of the noise of a sample; positive.
    pub noise: f64,
    /// Autocorrelation of the noise at lags 0, 1, 2...; zero beyond.
    pub acf: &'a [f64],
}

impl MeanRecord<'_> {
    /// Standard deviation of the sum of the samples with these weights.
    #[must_use]
    pub fn sd_of_sum(&self, weights: &[f64]) -> f64 {
        let at_lag = |(lag, r): (usize, &f64)| {
            let products: f64 = weights.iter().zip(weights.iter().skip(lag)).map(|(a, b)| a * b).sum();
            r * products * if lag == 0 { 1.0 } else { 2.0 }
        };
        // An autocorrelation that is estimated may leave a negative variance for weights that alternate.
        let least = 0.01 * weights.iter().map(|weight| weight * weight).sum::<f64>();
        self.noise * self.acf.iter().enumerate().map(at_lag).sum::<f64>().max(least).sqrt()
    }
}

/// A fitted pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanPulse {
    /// Factor of the response.
    pub amplitude: f64,
    /// Standard deviation of the amplitude, from noise alone.
    pub amplitude_sd: f64,
    /// Arrival after sample 0.
    pub time_ps: f64,
    /// Standard deviation of the time, from noise alone.
    pub time_sd_ps: f64,
    /// Constant under the pulse.
    pub baseline: f64,
    /// Factor by which the response is stretched in time, and its standard deviation; `None` where it does not settle.
    pub width: Option<(f64, f64)>,
}

/// Errors and width of the pulse that [`super::reference::fit_pulse`] located; `None` when too little of it lies within
/// the record.
///
/// # Panics
/// When the noise is not positive.
#[must_use]
pub fn fit(record: &MeanRecord<'_>, response: &Response, start: &PulseFit) -> Option<MeanPulse> {
    assert!(record.noise > 0.0, "noise is positive");
    let columns = columns(record, response, start.time_ps, start.amplitude, None)?;
    let solved = solve(record, response, start.time_ps, &columns)?;
    let sd = |k: usize| record.sd_of_sum(&solved.influence(&columns, record.noise, k));
    Some(MeanPulse {
        amplitude: start.amplitude,
        amplitude_sd: sd(0),
        time_ps: start.time_ps,
        time_sd_ps: sd(1),
        baseline: start.offset,
        width: width(record, response, start.time_ps, start.amplitude),
    })
}

/// Stretch of the response that fits best, with amplitude, time and baseline fitted too; its standard deviation.
fn width(record: &MeanRecord<'_>, response: &Response, mut time_ps: f64, mut amplitude: f64) -> Option<(f64, f64)> {
    let mut stretch = 1.0;
    for _ in 0..STEPS {
        let columns = columns(record, response, time_ps, amplitude, Some(stretch))?;
        let solved = solve(record, response, time_ps, &columns)?;
        amplitude = solved.values[0];
        time_ps += solved.values[1].clamp(-record.dt_ps, record.dt_ps);
        stretch += solved.values[3];
        if !(STRETCH_LIMITS.0..STRETCH_LIMITS.1).contains(&stretch) || amplitude == 0.0 {
            return None;
        }
        if solved.values[3].abs() < SETTLED && solved.values[1].abs() < SETTLED * response.width_ps() {
            return Some((stretch, record.sd_of_sum(&solved.influence(&columns, record.noise, 3))));
        }
    }
    None
}

/// Derivatives of the model by amplitude, time, baseline and, where a stretch is given, by it.
fn columns(
    record: &MeanRecord<'_>,
    response: &Response,
    time_ps: f64,
    amplitude: f64,
    stretch: Option<f64>,
) -> Option<Vec<Vec<f64>>> {
    let reach = response.reach(time_ps, 0.0, record.dt_ps, record.samples.len());
    let mut columns = vec![Vec::with_capacity(reach.len()); if stretch.is_some() { 4 } else { 3 }];
    let factor = stretch.unwrap_or(1.0);
    for n in reach {
        let u_ps = n as f64 * record.dt_ps - time_ps;
        let (value, slope) = response.value_and_slope(u_ps / factor);
        columns[0].push(value);
        columns[1].push(-amplitude * slope / factor);
        columns[2].push(1.0);
        if stretch.is_some() {
            columns[3].push(-amplitude * slope * u_ps / (factor * factor));
        }
    }
    (columns[0].len() > columns.len()).then_some(columns)
}

/// Amplitude and baseline as they are, time and stretch as steps from where the columns were taken.
fn solve(record: &MeanRecord<'_>, response: &Response, time_ps: f64, columns: &[Vec<f64>]) -> Option<Regression> {
    let reach = response.reach(time_ps, 0.0, record.dt_ps, record.samples.len());
    let sd = vec![record.noise; reach.len()];
    least_squares(columns, &record.samples[reach], &sd)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::fit_pulse;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SIGMA_PS: f64 = 106.2;
    const DT_PS: f64 = 50.0;

    fn gaussian() -> Response {
        let values: Vec<f64> = (-96..=96).map(|i| (-0.5 * (f64::from(i) * 6.25 / SIGMA_PS).powi(2)).exp()).collect();
        Response::new(-600.0, 6.25, &values)
    }

    fn pulse(at_ps: f64, width: f64) -> Vec<f64> {
        (0..80)
            .map(|n| 3.0 * (-0.5 * ((f64::from(n) * DT_PS - at_ps) / SIGMA_PS / width).powi(2)).exp() + 0.5)
            .collect()
    }

    fn fitted(record: &MeanRecord<'_>) -> MeanPulse {
        let response = gaussian();
        fit(record, &response, &fit_pulse(record.samples, record.dt_ps, &response).unwrap()).unwrap()
    }

    #[test]
    fn a_pulse_without_noise_is_found_exactly_where_it_is() {
        for (at_ps, width) in [(1900.0, 1.0), (2017.3, 1.0), (1833.0, 1.04), (2100.0, 0.97)] {
            let samples = pulse(at_ps, width);
            let fit = fitted(&MeanRecord { samples: &samples, dt_ps: DT_PS, noise: 1e-3, acf: &[1.0] });
            let (stretch, _) = fit.width.unwrap();
            assert!((fit.time_ps - at_ps).abs() < 1e-2 && (stretch / width - 1.0).abs() < 1e-3, "{fit:?}");
            assert!(width != 1.0 || (fit.amplitude - 3.0).abs() < 1e-4 && (fit.baseline - 0.5).abs() < 1e-4, "{fit:?}");
        }
    }

    /// Spread of the fits over draws, over what the fit says of itself: amplitude, time, width.
    fn calibration(smoothed: bool) -> [f64; 3] {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut squares, mut own) = ([0.0; 3], [0.0; 3]);
        let acf: &[f64] = if smoothed { &[1.0, 0.5] } else { &[1.0] };
        for _ in 0..1500 {
            let at_ps = 1900.0 + rng.random_range(0.0..50.0);
            let white: Vec<f64> = (0..81).map(|_| StandardNormal.sample(&mut rng)).collect();
            let noise = |n: usize| if smoothed { (white[n] + white[n + 1]) / 2_f64.sqrt() } else { white[n] };
            let samples: Vec<f64> =
                pulse(at_ps, 1.0).iter().enumerate().map(|(n, value)| value + 0.05 * noise(n)).collect();
            let fit = fitted(&MeanRecord { samples: &samples, dt_ps: DT_PS, noise: 0.05, acf });
            let (width, width_sd) = fit.width.unwrap();
            let errors = [fit.amplitude - 3.0, fit.time_ps - at_ps, width - 1.0];
            let sds = [fit.amplitude_sd, fit.time_sd_ps, width_sd];
            for k in 0..3 {
                squares[k] += errors[k] * errors[k];
                own[k] += sds[k] * sds[k];
            }
        }
        std::array::from_fn(|k| (squares[k] / own[k]).sqrt())
    }

    #[test]
    fn its_errors_are_what_it_says_also_in_smooth_noise() {
        for smoothed in [false, true] {
            let ratios = calibration(smoothed);
            assert!(ratios.iter().all(|ratio| (0.93..1.07).contains(ratio)), "smoothed {smoothed}: {ratios:?}");
        }
    }

    #[test]
    fn the_sd_of_a_sum_is_that_of_the_naive_double_sum() {
        let record = MeanRecord { samples: &[], dt_ps: DT_PS, noise: 2.0, acf: &[1.0, 0.4, -0.1] };
        let weights = [0.3, -1.0, 2.0, 0.7];
        let rho = |lag: usize| record.acf.get(lag).copied().unwrap_or(0.0);
        let mut naive = 0.0;
        for (i, a) in weights.iter().enumerate() {
            for (j, b) in weights.iter().enumerate() {
                naive += a * b * rho(i.abs_diff(j));
            }
        }
        assert!((record.sd_of_sum(&weights) - 2.0 * naive.sqrt()).abs() < 1e-12);
    }
}
