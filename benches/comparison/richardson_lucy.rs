//! Richardson-Lucy deconvolution on a grid of arrivals: a method of comparison for [`periscope_signal::sparse`].
//!
//! `x <- x * H^T(y / H x) / H^T 1`, from a flat start: it raises the likelihood of Poisson counts at every step and
//! keeps `x >= 0` and the light's sum. Sources: Richardson, J. Opt. Soc. Am. 62, 55 (1972); Lucy, Astron. J. 79, 745
//! (1974). Iterations end when the residual is what the noise is, `sum ((y - H x) / sd)^2 <= N` (Morozov's discrepancy
//! principle): more of them fit the noise.
//!
//! Good for a look at what light there may be. As a timer it is biased by picoseconds at any SNR, since pulses stay
//! blurred into one another, and in strong noise it splits them. Not modelled: noise that is not Poisson (negative
//! samples are set to 0), a baseline, correlated noise.

use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

use crate::dictionary::Dictionary;
use crate::pulses::Pulses;

/// Grid step in widths of the response where none is given.
const STEP_WIDTHS: f64 = 0.04;
/// Steps of a response without negative parts in a sample: fine enough for linear interpolation.
const POSITIVE_STEPS: f64 = 16.0;

/// What is asked of a deconvolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RichardsonLucyOptions {
    /// Grid step, ps; `None` for a twenty-fifth of the response's width.
    pub step_ps: Option<f64>,
    /// Iterations at most.
    pub iterations_max: usize,
    /// Whether iterations end when the residual is as large as the noise; else `iterations_max` are made.
    pub stop_at_noise: bool,
    /// Pulses with a smaller amplitude over `sd / ||h||` are dropped.
    pub snr_min: f64,
}

impl Default for RichardsonLucyOptions {
    fn default() -> Self {
        Self { step_ps: None, iterations_max: 2000, stop_at_noise: true, snr_min: 5.0 }
    }
}

/// Light on a grid of arrivals.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// First arrival, ps.
    pub start_ps: f64,
    /// Time between arrivals, ps.
    pub step_ps: f64,
    /// Amplitude of each arrival.
    pub values: Vec<f64>,
    /// Iterations that were made.
    pub iterations: usize,
}

/// The response without the ringing below zero that averaging gives it, for [`deconvolve`] and [`fit`].
///
/// # Panics
/// If `dt_ps` is not positive.
#[must_use]
pub fn positive(response: &Response, dt_ps: f64) -> Response {
    let (first_ps, last_ps) = response.support_ps();
    let step_ps = dt_ps / POSITIVE_STEPS;
    let count = ((last_ps - first_ps) / step_ps).floor().max(1.0) as usize + 1;
    let value = |i: usize| response.value(first_ps + i as f64 * step_ps).max(0.0);
    Response::new(first_ps, step_ps, &(0..count).map(value).collect::<Vec<_>>())
}

/// Light of `profile`, whose baseline is removed.
///
/// # Panics
/// If the profile is empty, its slices differ in length, or an sd or a step is not positive. Also if the response is
/// negative somewhere.
#[must_use]
pub fn deconvolve(profile: &Profile, response: &Response, options: &RichardsonLucyOptions) -> Light {
    let dictionary = dictionary(profile, response, options);
    let counted: Vec<f64> = profile.sd_v.iter().map(|sd| f64::from(u8::from(sd.is_finite()))).collect();
    let mut sensitivity = vec![0.0; dictionary.len()];
    dictionary.apply_transposed(&counted, &mut sensitivity);
    let record: Vec<f64> = profile.mean_v.iter().zip(&counted).map(|(y, c)| y.max(0.0) * c).collect();
    let total: f64 = record.iter().sum();
    let all: f64 = sensitivity.iter().sum();
    let mut values = vec![if all > 0.0 { total / all } else { 0.0 }; dictionary.len()];
    let (mut fitted, mut back) = (vec![0.0; record.len()], vec![0.0; dictionary.len()]);
    let mut iterations = 0;
    while iterations < options.iterations_max {
        dictionary.apply(&values, &mut fitted);
        if options.stop_at_noise && explained(profile, &fitted) {
            break;
        }
        for (f, y) in fitted.iter_mut().zip(&record) {
            *f = if *f > 0.0 { y / *f } else { 0.0 };
        }
        dictionary.apply_transposed(&fitted, &mut back);
        for ((x, b), s) in values.iter_mut().zip(&back).zip(&sensitivity) {
            *x *= if *s > 0.0 { b / s } else { 0.0 };
        }
        iterations += 1;
    }
    Light { start_ps: dictionary.time_ps(0.0), step_ps: dictionary.step_ps(), values, iterations }
}

/// Pulses of `profile`, whose baseline is removed: the light between two of its minima, at its centroid. The method has
/// no covariance.
///
/// # Panics
/// As [`deconvolve`].
#[must_use]
pub fn fit(profile: &Profile, response: &Response, options: &RichardsonLucyOptions) -> Pulses {
    let light = deconvolve(profile, response, options);
    let weights: Vec<f64> = profile.sd_v.iter().map(|sd| 1.0 / sd).collect();
    let whitened = Dictionary::new(profile, response, light.step_ps, &weights);
    let (times_ps, amplitudes_v): (Vec<f64>, Vec<f64>) = lumps(&light.values)
        .into_iter()
        .filter(|(place, amplitude)| amplitude * whitened.norm(place.round() as usize) >= options.snr_min)
        .map(|(place, amplitude)| (whitened.time_ps(place), amplitude))
        .unzip();
    Pulses::with_amplitudes(profile, response, &times_ps, &amplitudes_v)
}

fn dictionary(profile: &Profile, response: &Response, options: &RichardsonLucyOptions) -> Dictionary {
    assert!(profile.sd_v.iter().all(|sd| *sd > 0.0), "the sds must be positive");
    let counted: Vec<f64> = profile.sd_v.iter().map(|sd| f64::from(u8::from(sd.is_finite()))).collect();
    let step_ps = options.step_ps.unwrap_or(STEP_WIDTHS * response.width_ps());
    Dictionary::new(profile, response, step_ps, &counted)
}

/// Whether the residual is as large as the noise.
fn explained(profile: &Profile, fitted: &[f64]) -> bool {
    let counted = profile.sd_v.iter().filter(|sd| sd.is_finite()).count() as f64;
    let residuals = profile.mean_v.iter().zip(fitted).zip(profile.sd_v);
    residuals.map(|((y, f), sd)| ((y - f) / sd).powi(2)).sum::<f64>() <= counted
}

/// Centroid (in grid steps) and sum of the light around each maximum, up to the minima on either side.
fn lumps(values: &[f64]) -> Vec<(f64, f64)> {
    let mut lumps = Vec::new();
    let mut start = 0;
    for end in 1..=values.len() {
        let minimum = end < values.len() - 1 && values[end] < values[end - 1] && values[end] <= values[end + 1];
        if minimum || end == values.len() {
            let sum: f64 = values[start..end].iter().sum();
            let moment: f64 = (start..end).map(|j| j as f64 * values[j]).sum();
            if sum > 0.0 {
                lumps.push((moment / sum, sum));
            }
            start = end;
        }
    }
    lumps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn response() -> Response {
        let values: Vec<f64> = (-65..=65).map(|i| gaussian(10.0 * f64::from(i))).collect();
        Response::new(-650.0, 10.0, &values)
    }

    fn gaussian(t_ps: f64) -> f64 {
        (-0.5 * (t_ps / 106.165_225).powi(2)).exp()
    }

    #[test]
    fn an_iteration_is_the_formula_and_keeps_the_sum_of_the_light() {
        let y: Vec<f64> = (0..80).map(|n| gaussian(50.0 * f64::from(n) - 2000.0) + 0.1).collect();
        let profile =
            Profile { mean_v: &y, sd_v: &[0.1; 80], acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
        let response = response();
        let options = |iterations_max| RichardsonLucyOptions {
            iterations_max,
            stop_at_noise: false,
            step_ps: Some(20.0),
            ..RichardsonLucyOptions::default()
        };
        let before = deconvolve(&profile, &response, &options(3));
        let after = deconvolve(&profile, &response, &options(4));
        let h = |n: usize, j: usize| response.value(50.0 * n as f64 - before.start_ps - 20.0 * j as f64);
        let grid = before.values.len();
        let fitted: Vec<f64> = (0..80).map(|n| (0..grid).map(|j| h(n, j) * before.values[j]).sum()).collect();
        for j in 0..grid {
            let ratio: f64 = (0..80).map(|n| h(n, j) * y[n] / fitted[n]).sum();
            let sensitivity: f64 = (0..80).map(|n| h(n, j)).sum();
            let expected = before.values[j] * ratio / sensitivity;
            assert!((after.values[j] - expected).abs() < 1e-12 * expected.max(1.0), "arrival {j}");
        }
        // sum_n (H x)_n = sum_n y_n after every step.
        let total: f64 = (0..80).map(|n| (0..grid).map(|j| h(n, j) * after.values[j]).sum::<f64>()).sum();
        assert!((total / y.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn far_pulses_are_found_with_their_amplitudes_and_iterations_end_at_the_noise() {
        // No noise but its claim: the residual falls below it after few iterations, the more of them the less noise is
        // claimed.
        let y: Vec<f64> = (0..120)
            .map(|n| gaussian(50.0 * f64::from(n) - 2013.0) + 0.3 * gaussian(50.0 * f64::from(n) - 3477.0))
            .collect();
        let at = |sd: f64| {
            let sd_v = vec![sd; 120];
            let profile =
                Profile { mean_v: &y, sd_v: &sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
            let options = RichardsonLucyOptions::default();
            (fit(&profile, &response(), &options), deconvolve(&profile, &response(), &options).iterations)
        };
        let (solution, iterations) = at(0.01);
        assert_eq!(solution.times_ps.len(), 2);
        assert!(
            (solution.times_ps[0] - 2013.0).abs() < 2.0 && (solution.times_ps[1] - 3477.0).abs() < 2.0,
            "{solution:?}"
        );
        assert!(
            (solution.amplitudes_v[0] - 1.0).abs() < 0.02 && (solution.amplitudes_v[1] - 0.3).abs() < 0.02,
            "{solution:?}"
        );
        let more = at(0.004).1;
        assert!(iterations > 3 && more > iterations && more < 2000, "{iterations}, {more}");
    }
}
