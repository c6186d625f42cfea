//! Onsets by classical timing: threshold, leading edge, constant fraction.
//!
//! The paper's "first non-zero response" (section 4.1) is a threshold. A fixed level walks with amplitude (tens of ps); a fraction of the
//! pulse's own maximum does not. On an extended bounce the leading edge dates the earliest light, the near rim of the patch, where a fit of
//! pulses ([`super::sparse`]) dates the centroid. Source: Gedcke and McDonald, Nucl. Instrum. Methods 58, 253 (1968), for the
//! constant fraction.
//!
//! Every function looks for one onset in the samples that it is given: pass the stretch of a record that holds one pulse, baseline removed.
//! Positions are in samples from the first one. Not modelled: overlap of pulses, noise that moves the place of the maximum.

/// An upward crossing of a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Place, in samples after the first, interpolated linearly between two samples.
    pub position: f64,
    /// Standard deviation of the place, in samples, to first order: noise over slope.
    pub sd: f64,
    /// Level that was crossed, in the unit of the samples.
    pub level: f64,
}

/// First upward crossing of a fixed `level`, given the samples' noise. `None` if no sample below the level is followed by one at or above it.
#[must_use]
pub fn threshold(samples: &[f64], level: f64, noise_sd: f64) -> Option<Crossing> {
    let i = samples.windows(2).position(|pair| pair[0] < level && pair[1] >= level)?;
    Some(interpolate(samples, i, level, noise_sd))
}

/// Crossing of `fraction` of the maximum on the way up to it: walking back from the (first) maximum, between the first sample below the
/// level and its successor. `None` if the maximum is not positive or nothing before it is below the level.
///
/// The level carries the maximum's noise, independent of the noise at the crossing.
///
/// # Panics
/// If `fraction` is not between 0 and 1.
#[must_use]
pub fn leading_edge(samples: &[f64], fraction: f64, noise_sd: f64) -> Option<Crossing> {
    assert!(fraction > 0.0 && fraction < 1.0, "the fraction must lie between 0 and 1, got {fraction}");
    let peak = first_maximum(samples)?;
    let level = fraction * samples[peak];
    if level <= 0.0 {
        return None;
    }
    let i = samples[..peak].iter().rposition(|v| *v < level)?;
    let sd = noise_sd * (1.0 + fraction * fraction).sqrt();
    Some(interpolate(samples, i, level, sd))
}

/// Constant fraction discriminator: zero of `y(t - delay) - fraction * y(t)` on the way up to its maximum, less the delay, so that the
/// position lies on the pulse's own rising edge. `delay` is in samples, at least 1; values between samples are interpolated linearly.
/// `None` if the difference does not rise through zero.
///
/// # Panics
/// If `fraction` is not between 0 and 1, or `delay` below 1.
#[must_use]
pub fn constant_fraction(samples: &[f64], fraction: f64, delay: f64, noise_sd: f64) -> Option<Crossing> {
    assert!(fraction > 0.0 && fraction < 1.0, "the fraction must lie between 0 and 1, got {fraction}");
    assert!(delay >= 1.0, "the delay must be at least one sample, got {delay}");
    let whole = delay.ceil() as usize;
    let part = whole as f64 - delay;
    // Sample j of the difference belongs to sample j + whole of the record.
    let difference: Vec<f64> = (whole..samples.len())
        .map(|n| {
            let before = samples[n - whole];
            before + part * (samples[n - whole + 1] - before) - fraction * samples[n]
        })
        .collect();
    let peak = first_maximum(&difference)?;
    if difference[peak] <= 0.0 {
        return None;
    }
    let i = difference[..peak].iter().rposition(|v| *v < 0.0)?;
    let sd = noise_sd * (1.0 + fraction * fraction).sqrt();
    let zero = interpolate(&difference, i, 0.0, sd);
    Some(Crossing { position: zero.position + part, ..zero })
}

/// The line between samples `i` and `i + 1`, `samples[i] < level <= samples[i + 1]`, where it meets the level.
fn interpolate(samples: &[f64], i: usize, level: f64, sd: f64) -> Crossing {
    let slope = samples[i + 1] - samples[i];
    Crossing { position: i as f64 + (level - samples[i]) / slope, sd: sd / slope, level }
}

fn first_maximum(samples: &[f64]) -> Option<usize> {
    let mut best = 0;
    for (i, v) in samples.iter().enumerate() {
        if *v > samples[best] {
            best = i;
        }
    }
    (!samples.is_empty()).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

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
            let found = leading_edge(&samples, 0.4, 0.1);
            assert_eq!(found.map(|c| c.position), naive.filter(|_| largest > 0.0));
        }
    }

    #[test]
    fn fractions_ignore_amplitude_and_follow_a_shift_but_a_fixed_level_walks() {
        let weak = pulse(100, 40.3, 1.0);
        let strong = pulse(100, 40.3, 7.0);
        let later = pulse(100, 45.3, 1.0);
        let edge = |s: &[f64]| leading_edge(s, 0.2, 0.01).expect("edge").position;
        let cfd = |s: &[f64]| constant_fraction(s, 0.5, 3.5, 0.01).expect("zero").position;
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
        let zero = constant_fraction(&samples, 0.3, 10.0, 0.1).expect("zero");
        assert!((zero.position - 13.0).abs() < 1e-12);
        let half = constant_fraction(&samples, 0.3, 12.5, 0.1).expect("zero");
        assert!((half.position - 13.0).abs() < 1e-12);
    }

    #[test]
    fn the_sd_bounds_the_scatter_in_white_noise() {
        // Interpolation averages two samples' noise, so the scatter is between 1/sqrt(2) of the sd and the sd.
        let normal = Normal::new(0.0, 0.001).expect("positive");
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let clean = pulse(80, 40.0, 1.0);
        for fraction in [0.3, 0.5] {
            let timing: [&Timing<'_>; 3] =
                [&|s| leading_edge(s, fraction, 0.001), &|s| constant_fraction(s, fraction, 8.0, 0.001), &|s| {
                    threshold(s, fraction, 0.001)
                }];
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
                assert!((0.65..1.05).contains(&ratio), "ratio {ratio}");
            }
        }
    }

    #[test]
    fn no_crossing_is_none() {
        assert_eq!(leading_edge(&[], 0.5, 1.0), None);
        assert_eq!(leading_edge(&[3.0, 2.0, 1.0], 0.5, 1.0), None);
        assert_eq!(leading_edge(&[-3.0, -1.0, -2.0], 0.5, 1.0), None);
        assert_eq!(threshold(&[1.0, 1.0, 0.0], 0.5, 1.0), None);
        assert_eq!(constant_fraction(&[1.0, 1.0], 0.5, 4.0, 1.0), None);
        assert_eq!(constant_fraction(&[0.0; 20], 0.5, 4.0, 1.0), None);
    }
}
