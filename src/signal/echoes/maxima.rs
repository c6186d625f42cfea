//! Maxima of a record that noise does not explain.

use super::{EchoOptions, Stretch};

/// Smoothing, as a share of the outgoing pulse's width: little enough that echoes a width apart stay apart.
const SMOOTHING: f64 = 0.4;
/// Standard deviations to each side of the smoothing weights.
const REACH: f64 = 4.0;
/// Share of the samples that stand for the level.
const LEVEL_SHARE: f64 = 0.2;
/// Share of the samples whose mean is the level where the record is quiet, and how far that lies below it, in standard
/// deviations of the smoothed noise, where half of the record is quiet.
const QUIET_SHARE: f64 = 0.1;
const QUIET_SIGMA: f64 = 1.4;
/// Median of the magnitudes of a normal variable, over its standard deviation.
const MEDIAN: f64 = 0.674_489_750_196_081_7;

/// A maximum: where echoes are looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Maximum {
    /// Place, in samples.
    pub place: f64,
    /// Height above the level.
    pub height: f64,
}

/// Weights of the smoothing, from its middle to one side; their sum over both sides is 1.
pub fn weights(sigma: f64) -> Vec<f64> {
    let sigma = SMOOTHING * sigma;
    let half: Vec<f64> =
        (0..=(REACH * sigma).ceil() as usize).map(|i| (-0.5 * (i as f64 / sigma.max(1e-3)).powi(2)).exp()).collect();
    let sum = 2.0 * half.iter().sum::<f64>() - half[0];
    half.iter().map(|weight| weight / sum).collect()
}

/// Samples smoothed with these weights; near ends and next to samples that are no numbers, the others count more.
pub fn smooth(samples: &[f64], weights: &[f64]) -> Vec<f64> {
    let reach = weights.len() - 1;
    let at = |n: usize| {
        let near = n.saturating_sub(reach)..(n + reach + 1).min(samples.len());
        let (mut sum, mut weight) = (0.0, 0.0);
        for i in near.filter(|i| samples[*i].is_finite()) {
            sum += weights[n.abs_diff(i)] * samples[i];
            weight += weights[n.abs_diff(i)];
        }
        if weight > 0.0 { sum / weight } else { f64::NAN }
    };
    (0..samples.len()).map(at).collect()
}

/// Standard deviation of the fast noise of a sample, from fourth differences, which a smooth signal does not reach; at
/// least that of rounding.
pub fn fast_noise(stretch: &Stretch<'_>) -> f64 {
    let fourth = |x: &[f64]| (x[0] - 4.0 * x[1] + 6.0 * x[2] - 4.0 * x[3] + x[4]).abs();
    let mut sizes: Vec<f64> = stretch.samples.windows(5).map(fourth).filter(|size| size.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    (median / MEDIAN / 70.0_f64.sqrt()).max(stretch.step / 12.0_f64.sqrt())
}

/// Level of the record where it is quiet: the mean of the lowest smoothed values, less what noise makes them too low.
pub fn quiet_level(stretch: &Stretch<'_>, sigma: f64) -> f64 {
    let weights = weights(sigma);
    let mut low = smooth(stretch.samples, &weights);
    low.retain(|value| value.is_finite());
    low.sort_by(f64::total_cmp);
    let count = ((QUIET_SHARE * low.len() as f64) as usize).max(1);
    low[..count].iter().sum::<f64>() / count as f64 + QUIET_SIGMA * smoothed_noise(stretch, &weights)
}

/// Standard deviation of fast noise after smoothing.
fn smoothed_noise(stretch: &Stretch<'_>, weights: &[f64]) -> f64 {
    let power = 2.0 * weights.iter().map(|weight| weight * weight).sum::<f64>() - weights[0] * weights[0];
    fast_noise(stretch) * power.sqrt()
}

/// The maxima of a stretch in order of time, and its level.
pub fn find(stretch: &Stretch<'_>, sigma: f64, options: &EchoOptions) -> (Vec<Maximum>, f64) {
    let weights = weights(sigma);
    let mut smoothed = smooth(stretch.samples, &weights);
    fill(&mut smoothed);
    let mut low: Vec<f64> = smoothed.iter().copied().filter(|value| value.is_finite()).collect();
    if low.is_empty() {
        return (Vec::new(), 0.0);
    }
    low.sort_by(f64::total_cmp);
    let level = low[(LEVEL_SHARE * low.len() as f64) as usize / 2];
    let noise = smoothed_noise(stretch, &weights);
    let highest = low[low.len() - 1] - level;
    let least = (options.threshold_sigma * noise).max(options.share_min * highest);
    let mut maxima = Vec::new();
    let mut first = 0;
    while first < smoothed.len() {
        let value = smoothed[first];
        let last = (first..smoothed.len()).take_while(|i| smoothed[*i] == value).last().unwrap_or(first);
        if prominence(&smoothed, first, last).is_some_and(|rise| rise >= least) && value - level >= least {
            maxima.push(Maximum { place: 0.5 * (first + last) as f64, height: value - level });
        }
        first = last + 1;
    }
    (maxima, level)
}

/// Puts the larger neighbour where a whole neighbourhood is at the rails: the maximum is there.
fn fill(values: &mut [f64]) {
    let highest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    values.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = highest);
}

/// How far equal values `first..=last` rise out of the higher of the valleys that part them from higher values; `None`
/// where they are no maximum within the record.
fn prominence(values: &[f64], first: usize, last: usize) -> Option<f64> {
    let value = values[first];
    let before = values[..first].last().is_some_and(|before| *before < value);
    let behind = values.get(last + 1).is_some_and(|behind| *behind < value);
    if !before || !behind {
        return None;
    }
    let lowest = |low: f64, other: &f64| low.min(*other);
    let left = values[..first].iter().rev().take_while(|other| **other <= value).fold(value, lowest);
    let right = values[last + 1..].iter().take_while(|other| **other <= value).fold(value, lowest);
    Some(value - left.max(right))
}
