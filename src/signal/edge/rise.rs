//! Where light rises in a histogram.

use super::{Bins, Noise, wide};

/// Widths of what is compared, in standard deviations of the response: the light before a rise, the gap up to it, and
/// the light behind it.
const BEFORE: f64 = 5.0;
const GAP: f64 = 1.0;
const BEHIND: f64 = 2.5;
/// How far up a rise goes on, in the same unit.
const UP: f64 = 3.0;

/// Behind a rise light may grow for so long by itself; and the least and the most of each of two stretches before a
/// later rise.
pub(super) const RISEN: f64 = 3.0;
const STRETCH: [f64; 2] = [3.0, 5.0];

/// About when light first rises above what lies before it, by at least `threshold` standard deviations; `None` where
/// it does not.
#[must_use]
pub fn first_rise(bins: &Bins<'_>, sigma_ps: f64, threshold: f64) -> Option<f64> {
    first(bins, &sums(bins), sigma_ps, threshold)
}

/// About when light rises: first, and again behind a rise, by at least `threshold` standard deviations above both a
/// level and a line through what lies before it. Light of a corner grows steadily, that of a small thing declines ever
/// more slowly. Things are told apart where their light is ten standard deviations of the response apart, or more.
#[must_use]
pub fn rises(bins: &Bins<'_>, sigma_ps: f64, threshold: f64) -> Vec<f64> {
    let sums = sums(bins);
    let Some(first_ps) = first(bins, &sums, sigma_ps, threshold) else { return Vec::new() };
    let mut rises = vec![first_ps];
    while let Some(next_ps) = next(bins, &sums, (sigma_ps, threshold), rises[rises.len() - 1]) {
        rises.push(next_ps);
    }
    rises
}

fn first(bins: &Bins<'_>, sums: &[f64], sigma_ps: f64, threshold: f64) -> Option<f64> {
    let wide = |sigmas: f64| wide(sigmas * sigma_ps, bins.dt_ps);
    let [before, gap, behind] = [BEFORE, GAP, BEHIND].map(wide);
    let score = |at: usize| {
        let [from, to] = [at.saturating_sub(before + gap), at.saturating_sub(gap)];
        if to <= from + gap {
            return f64::NEG_INFINITY;
        }
        let (quiet, light) = (sums[to] - sums[from], sums[at + behind] - sums[at]);
        let ratio = behind as f64 / (to - from) as f64;
        let variance = match bins.noise {
            Noise::Counts => (ratio * (quiet + light)).max(ratio),
            Noise::Gauss { sd } => sd * sd * behind as f64 * (1.0 + ratio),
        };
        (light - ratio * quiet) / variance.sqrt()
    };
    let last = bins.values.len().saturating_sub(behind);
    let start = (0..last).find(|at| score(*at) > threshold)?;
    Some(time_ps(bins, sigma_ps, up(start, last, wide(UP), score)))
}

/// The next rise behind one.
fn next(bins: &Bins<'_>, sums: &[f64], (sigma_ps, threshold): (f64, f64), before_ps: f64) -> Option<f64> {
    let wide = |sigmas: f64| wide(sigmas * sigma_ps, bins.dt_ps);
    let [gap, behind, risen] = [GAP, BEHIND, RISEN].map(wide);
    let [least, most] = STRETCH.map(wide);
    let place = |time_ps: f64| ((time_ps - bins.first_ps) / bins.dt_ps).max(0.0) as usize;
    let from = place(before_ps) + risen;
    let score = |at: usize| {
        let stretch = (at.saturating_sub(from + gap) / 2).min(most);
        if stretch < least {
            return f64::NEG_INFINITY;
        }
        let (end, ratio) = (at - gap, behind as f64 / stretch as f64);
        let sum = |from: usize, to: usize| sums[to] - sums[from];
        let light = sum(at, at + behind);
        let variance = match bins.noise {
            Noise::Counts => light,
            Noise::Gauss { sd } => sd * sd * behind as f64,
        };
        let above = light - 0.5 * ratio * sum(end - 2 * stretch, end);
        // With the noise of the light alone: most light is no rise, and that is soon said.
        if above <= 0.0 || above * above <= threshold * threshold * variance {
            return f64::NEG_INFINITY;
        }
        let stretches = [sum(end - 2 * stretch, end - stretch), sum(end - stretch, end)];
        // By how much the middle of the light lies behind that of the second stretch, over a stretch.
        let ahead = 0.5 + (gap as f64 + 0.5 * behind as f64) / stretch as f64;
        let excess = |[first, second]: [f64; 2]| {
            let before = ratio * (first * stretches[0] + second * stretches[1]);
            let of_stretches = match bins.noise {
                Noise::Counts => ratio * ratio * (first * first * stretches[0] + second * second * stretches[1]),
                Noise::Gauss { .. } => variance * ratio * (first * first + second * second),
            };
            (light - before) / (variance + of_stretches).sqrt()
        };
        excess([0.5, 0.5]).min(excess([-ahead, 1.0 + ahead]))
    };
    let last = bins.values.len().saturating_sub(behind);
    let start = (from..last).find(|at| score(*at) > threshold)?;
    Some(time_ps(bins, sigma_ps, up(start, last, wide(UP), score)))
}

/// Sums of the values before each bin.
fn sums(bins: &Bins<'_>) -> Vec<f64> {
    let mut sum = 0.0;
    let before = bins.values.iter().map(|value| {
        sum += value;
        sum
    });
    std::iter::once(0.0).chain(before).collect()
}

/// Strong light exceeds the threshold long before it has risen: on to where the score rises no more.
fn up(start: usize, last: usize, wide: usize, score: impl Fn(usize) -> f64) -> usize {
    let largest = |from: usize| (from..(from + wide).min(last)).max_by(|a, b| score(*a).total_cmp(&score(*b)));
    let mut best = start;
    while let Some(next) = largest(best).filter(|next| *next > best) {
        best = next;
    }
    best
}

fn time_ps(bins: &Bins<'_>, sigma_ps: f64, bin: usize) -> f64 {
    bins.first_ps + (bin as f64 - 0.5) * bins.dt_ps + 0.5 * sigma_ps
}
