//! Where light rises in a histogram.

use super::{Bins, Noise, wide};

/// Widths of what is compared, in standard deviations of the response: the light before a rise, the gap up to it, and
/// the light behind it.
const BEFORE: f64 = 5.0;
const GAP: f64 = 1.0;
const BEHIND: f64 = 2.5;
/// How far up a rise goes on, in the same unit.
const UP: f64 = 3.0;

/// About when light first rises above what lies before it, by at least `threshold` standard deviations; `None` where
/// it does not.
#[must_use]
pub fn first_rise(bins: &Bins<'_>, sigma_ps: f64, threshold: f64) -> Option<f64> {
    let mut sums = Vec::with_capacity(bins.values.len() + 1);
    sums.push(0.0);
    bins.values.iter().for_each(|value| sums.push(sums[sums.len() - 1] + value));
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
    // Strong light exceeds the threshold long before it has risen: on to where the score rises no more.
    let largest = |from: usize| (from..(from + wide(UP)).min(last)).max_by(|a, b| score(*a).total_cmp(&score(*b)));
    let mut best = start;
    while let Some(next) = largest(best).filter(|next| *next > best) {
        best = next;
    }
    Some(bins.first_ps + (best as f64 - 0.5) * bins.dt_ps + 0.5 * sigma_ps)
}
