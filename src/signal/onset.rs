//! Onsets by classical timing: first response, threshold, leading edge, constant fraction, Akaike's criterion.
//!
//! The paper's "first non-zero response" (section 4.1) is the first sample above the noise. A fixed level walks with
//! amplitude (tens of ps); a fraction of the pulse's own maximum does not. On an extended bounce the leading edge dates
//! the earliest light, from the near rim of the patch; a fit of pulses ([`super::sparse`]) dates the centroid. Sources:
//! Gedcke and McDonald, Nucl. Instrum. Methods 58, 253 (1968), for the constant fraction; Maeda, Zisin 38, 365 (1985),
//! for Akaike's criterion of the record itself.
//!
//! [`responses`] and [`thresholds`] find every onset of a record. Every other function looks for one in the samples
//! that it is given: pass the stretch of a record that holds one pulse, baseline removed. Positions are in samples from
//! the first one. Not modelled: overlap of pulses, noise that moves the place of the maximum.

use super::largest::largest;

/// Noise of a record's samples, independent from sample to sample: `sd^2 + per_level v` at a sample that is v.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation without signal.
    pub sd: f64,
    /// Variance that each unit of signal adds: 1 for counts, by Poisson's law; 0 where noise is even.
    pub per_level: f64,
}

impl Noise {
    /// Of one standard deviation everywhere.
    #[must_use]
    pub fn even(sd: f64) -> Self {
        Self { sd, per_level: 0.0 }
    }

    fn variance(&self, sample: f64) -> f64 {
        self.sd * self.sd + self.per_level * sample.max(0.0)
    }
}

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

/// First upward crossing of a fixed `level`, given the samples' noise. `None` if no sample below the level is followed
/// by one at or above it.
#[must_use]
pub fn threshold(samples: &[f64], level: f64, noise_sd: f64) -> Option<Crossing> {
    let i = samples.windows(2).position(|pair| pair[0] < level && pair[1] >= level)?;
    Some(interpolate(samples, i, level, noise_sd))
}

/// Every sample that is the first above `threshold_sigma * noise_sd` since one below `rearm_sigma * noise_sd`; a record
/// is armed at its start. The first of them is the paper's "first non-zero response".
///
/// The position is a whole number of samples: on average half a sample after the level is crossed, scattering by
/// `1 / sqrt(12)` sample, which is added in quadrature to noise over slope. It walks: on a Gaussian edge of sd `s` the
/// level is crossed `s sqrt(2 ln(a / level))` before the maximum. An onset that is `e` times stronger therefore comes
/// `s / sqrt(2 ln(a / level))` earlier.
///
/// # Panics
/// If the thresholds are not positive, or the record re-arms above the threshold.
#[must_use]
pub fn responses(samples: &[f64], threshold_sigma: f64, rearm_sigma: f64, noise_sd: f64) -> Vec<Crossing> {
    assert!(rearm_sigma > 0.0 && rearm_sigma <= threshold_sigma, "a record re-arms between 0 and the threshold");
    let level = threshold_sigma * noise_sd;
    let at = |i: usize| {
        let slope = if i == 0 { f64::INFINITY } else { samples[i] - samples[i - 1] };
        Crossing { position: i as f64, sd: (1.0 / 12.0 + (noise_sd / slope).powi(2)).sqrt(), level }
    };
    armed(samples, level, rearm_sigma * noise_sd, true).map(at).collect()
}

/// Every upward crossing of a fixed `level`, interpolated, with a sample below `rearm` since the one before it.
///
/// # Panics
/// If the record re-arms above the level.
#[must_use]
pub fn thresholds(samples: &[f64], level: f64, rearm: f64, noise_sd: f64) -> Vec<Crossing> {
    assert!(rearm <= level, "a record re-arms below the level");
    let starts_below = samples.first().is_some_and(|first| *first < level);
    armed(samples, level, rearm, starts_below).map(|i| interpolate(samples, i - 1, level, noise_sd)).collect()
}

/// Samples at or above `level` that are the first since one below `rearm`, or since the start.
fn armed(samples: &[f64], level: f64, rearm: f64, mut is_armed: bool) -> impl Iterator<Item = usize> {
    samples.iter().enumerate().filter_map(move |(i, v)| {
        let fires = is_armed && *v >= level;
        is_armed = if fires { false } else { is_armed || *v < rearm };
        fires.then_some(i)
    })
}

/// Onset between noise and signal by Akaike's criterion, in the window from `before` samples before the (first) maximum
/// to the maximum: the `k` that minimises `k ln var(y[..k]) + (N - k - 1) ln var(y[k..])`. `None` if the window holds
/// fewer than six samples or the maximum is not positive.
///
/// Variances are not taken below the noise's: two or three samples that happen to agree are no onset. The position is
/// that of the first sample of the signal. The criterion takes the signal for noise of another variance, which a rising
/// edge is not: it has no sd of its own, and it walks with amplitude almost as a fixed level does.
///
/// # Panics
/// If `noise_sd` is not positive.
#[must_use]
pub fn akaike(samples: &[f64], before: usize, noise_sd: f64) -> Option<f64> {
    assert!(noise_sd > 0.0, "the noise must be positive");
    let peak = first_maximum(samples).filter(|peak| samples[*peak] > 0.0)?;
    let start = peak.saturating_sub(before);
    let window = &samples[start..=peak];
    let len = window.len();
    if len < 6 {
        return None;
    }
    // Sums before each k; about the noise's mean, so that differences lose nothing.
    let mut sums = vec![(0.0, 0.0); len + 1];
    for (k, v) in window.iter().enumerate() {
        sums[k + 1] = (sums[k].0 + v, sums[k].1 + v * v);
    }
    let criterion = |from: usize, to: usize, factor: usize| {
        let count = (to - from) as f64;
        let (sum, squares) = (sums[to].0 - sums[from].0, sums[to].1 - sums[from].1);
        let variance = squares / count - (sum / count).powi(2);
        factor as f64 * variance.max(noise_sd * noise_sd).ln()
    };
    let total = |k: usize| criterion(0, k, k) + criterion(k, len, len - k - 1);
    (2..len - 1).min_by(|a, b| total(*a).total_cmp(&total(*b))).map(|k| (start + k) as f64)
}

/// Crossing of `fraction` of the maximum on the way up to it: walking back from the (first) maximum, between the first
/// sample below the level and its successor. `None` if the maximum is not positive or nothing before it is below the
/// level.
///
/// The level carries the maximum's noise, the crossing that of the two samples beside it, each by its weight.
///
/// # Panics
/// If `fraction` is not between 0 and 1.
#[must_use]
pub fn leading_edge(samples: &[f64], fraction: f64, noise: Noise) -> Option<Crossing> {
    assert!(fraction > 0.0 && fraction < 1.0, "the fraction must lie between 0 and 1, got {fraction}");
    let peak = first_maximum(samples)?;
    let level = fraction * samples[peak];
    if level <= 0.0 {
        return None;
    }
    let i = samples[..peak].iter().rposition(|v| *v < level)?;
    let crossing = interpolate(samples, i, level, 1.0);
    let later = crossing.position - i as f64;
    // The largest of several samples that noise alone tells apart scatters less than one of them: about as their number
    // to the power of -1/4.
    let top_sd = noise.variance(samples[peak]).sqrt();
    let top = &samples[i..(2 * peak - i).min(samples.len())];
    let rivals = top.iter().filter(|sample| **sample > samples[peak] - top_sd).count() as f64;
    // Noise that is as large as a step also decides between which two samples the crossing lies: their weights are then
    // those of a mean crossing.
    let slope = slope(samples, i, combined_sd(samples, &[(i, -1.0), (i + 1, 1.0)], noise));
    let mixed = (2.0 * noise.variance(level).sqrt() / slope).min(1.0);
    let weight = |own: f64| ((1.0 - mixed) * own * own + mixed / 3.0).sqrt();
    let weights = [(i, weight(1.0 - later)), (i + 1, weight(later)), (peak, -fraction * rivals.powf(-0.25))];
    Some(Crossing { sd: combined_sd(samples, &weights, noise) / slope, ..crossing })
}

/// Constant fraction discriminator: zero of `y(t - delay) - fraction * y(t)` on the way up to its maximum, less the
/// delay, so that the position lies on the pulse's own rising edge. `delay` is in samples, at least 1; values between
/// samples are interpolated linearly. `None` if the difference does not rise through zero.
///
/// # Panics
/// If `fraction` is not between 0 and 1, or `delay` below 1.
#[must_use]
pub fn constant_fraction(samples: &[f64], fraction: f64, delay: f64, noise: Noise) -> Option<Crossing> {
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
    let zero = interpolate(&difference, i, 0.0, 1.0);
    let later = zero.position - i as f64;
    let of_difference =
        |j: usize, weight: f64| [(j, weight * (1.0 - part)), (j + 1, weight * part), (j + whole, -weight * fraction)];
    let weights = [of_difference(i, 1.0 - later), of_difference(i + 1, later)].concat();
    let step_sd = combined_sd(samples, &[of_difference(i, -1.0), of_difference(i + 1, 1.0)].concat(), noise);
    Some(Crossing {
        position: zero.position + part,
        sd: combined_sd(samples, &weights, noise) / slope(&difference, i, step_sd),
        ..zero
    })
}

/// Slope from sample `i` to the next, for an error bar. The more of the step is noise, of this standard deviation, the
/// more it is the slope over three steps, where the edge is that long: the inverse of a single step is all noise where
/// bins are fine.
fn slope(samples: &[f64], i: usize, step_sd: f64) -> f64 {
    /// Share of the single step from which the edge counts as long.
    const LONG: f64 = 0.6;
    /// Share of noise in a step at which both slopes count alike.
    const NOISY: f64 = 0.25;
    let own = samples[i + 1] - samples[i];
    let around = (i > 0 && i + 2 < samples.len()).then(|| (samples[i + 2] - samples[i - 1]) / 3.0);
    let Some(around) = around.filter(|around| *around > LONG * own) else { return own };
    let share = (step_sd / own).powi(2);
    own + (around - own) * share / (share + NOISY * NOISY)
}

/// Standard deviation of a sum of samples, each with its weight; samples may come more than once.
fn combined_sd(samples: &[f64], weights: &[(usize, f64)], noise: Noise) -> f64 {
    let of_sample = |n: usize| weights.iter().filter(|(other, _)| *other == n).map(|(_, weight)| weight).sum::<f64>();
    let is_first = |k: usize| weights[..k].iter().all(|(other, _)| *other != weights[k].0);
    let once = (0..weights.len()).filter(|k| is_first(*k)).map(|k| weights[k].0);
    once.map(|n| of_sample(n).powi(2) * noise.variance(samples[n])).sum::<f64>().sqrt()
}

/// The line between samples `i` and `i + 1`, `samples[i] < level <= samples[i + 1]`, where it meets the level.
fn interpolate(samples: &[f64], i: usize, level: f64, sd: f64) -> Crossing {
    let slope = samples[i + 1] - samples[i];
    Crossing { position: i as f64 + (level - samples[i]) / slope, sd: sd / slope, level }
}

fn first_maximum(samples: &[f64]) -> Option<usize> {
    let most = largest(samples, f64::NEG_INFINITY, |sample| sample);
    (!samples.is_empty()).then(|| samples.iter().position(|sample| *sample == most).unwrap_or(0))
}

#[cfg(test)]
mod tests;
