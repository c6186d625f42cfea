//! Where light rises: in one histogram, or where neighbours say that it does.

use std::ops::Range;

use super::{Bins, Noise};

/// Widths of what is compared, in standard deviations of the response: the light before a rise, the gap up to it, and
/// the light behind it.
const BEFORE: f64 = 5.0;
const GAP: f64 = 1.0;
const BEHIND: f64 = 2.5;
/// How far up a rise goes on, in the same unit.
const UP: f64 = 3.0;

/// The same in bins.
#[derive(Clone, Copy, Debug)]
struct Widths {
    before: usize,
    gap: usize,
    behind: usize,
}

impl Widths {
    fn new(sigma_ps: f64, dt_ps: f64) -> Self {
        let [before, gap, behind] = [BEFORE, GAP, BEHIND].map(|sigmas| wide(sigmas * sigma_ps, dt_ps));
        Self { before, gap, behind }
    }

    /// The `sum` of the bins behind a place, less what those before say, and the standard deviation of that; `None`
    /// where there are too few before.
    fn excess(self, noise: Noise, at: usize, sum: impl Fn(Range<usize>) -> f64) -> Option<[f64; 2]> {
        let Self { before, gap, behind } = self;
        let [from, to] = [at.saturating_sub(before + gap), at.saturating_sub(gap)];
        if to <= from + gap {
            return None;
        }
        let ratio = behind as f64 / (to - from) as f64;
        let [quiet, light] = [sum(from..to), sum(at..at + behind)];
        let variance = match noise {
            Noise::Counts => (ratio * (quiet + light)).max(ratio),
            Noise::Gauss { sd } => sd * sd * behind as f64 * (1.0 + ratio),
        };
        Some([light - ratio * quiet, variance.sqrt()])
    }
}

fn wide(width_ps: f64, dt_ps: f64) -> usize {
    ((width_ps / dt_ps).round() as usize).max(1)
}

/// About when light first rises above what lies before it, by at least `threshold` standard deviations; `None` where
/// it does not.
#[must_use]
pub fn first_rise(bins: &Bins<'_>, sigma_ps: f64, threshold: f64) -> Option<f64> {
    let mut sums = Vec::with_capacity(bins.values.len() + 1);
    sums.push(0.0);
    bins.values.iter().for_each(|value| sums.push(sums[sums.len() - 1] + value));
    let widths = Widths::new(sigma_ps, bins.dt_ps);
    let last = bins.values.len().saturating_sub(widths.behind);
    let score = |at: usize| {
        let excess = widths.excess(bins.noise, at, |range| sums[range.end] - sums[range.start]);
        excess.map_or(f64::NEG_INFINITY, |[excess, sd]| excess / sd)
    };
    let start = (0..last).find(|at| score(*at) > threshold)?;
    // Strong light exceeds the threshold long before it has risen: on to where the score rises no more.
    let up = wide(UP * sigma_ps, bins.dt_ps);
    let largest = |from: usize| (from..(from + up).min(last)).max_by(|a, b| score(*a).total_cmp(&score(*b)));
    let mut best = start;
    while let Some(next) = largest(best).filter(|next| *next > best) {
        best = next;
    }
    Some(bins.first_ps + (best as f64 - 0.5) * bins.dt_ps + 0.5 * sigma_ps)
}

/// A histogram as far as its first rise.
#[derive(Clone, Debug)]
pub struct Early {
    first_ps: f64,
    dt_ps: f64,
    sigma_ps: f64,
    noise: Noise,
    widths: Widths,
    values: Vec<f32>,
}

impl Early {
    /// Of a histogram, as far as [`first_rise`] is asked about it.
    #[must_use]
    pub fn of(bins: &Bins<'_>, sigma_ps: f64, rise_ps: Option<f64>) -> Self {
        let widths = Widths::new(sigma_ps, bins.dt_ps);
        let place = |ps: f64| ((ps - bins.first_ps) / bins.dt_ps).max(0.0) as usize;
        let to = rise_ps.map_or(usize::MAX, |rise_ps| place(rise_ps) + 2 * widths.behind).min(bins.values.len());
        let values = bins.values[..to].iter().map(|value| *value as f32).collect();
        Self { first_ps: bins.first_ps, dt_ps: bins.dt_ps, sigma_ps, noise: bins.noise, widths, values }
    }

    /// How much more light there is behind a rise at this time than before it, and the standard deviation of that;
    /// `None` where the histogram is not known as far, or begins too late.
    #[must_use]
    pub fn excess(&self, time_ps: f64) -> Option<[f64; 2]> {
        let at = ((time_ps - 0.5 * self.sigma_ps - self.first_ps) / self.dt_ps + 0.5).round();
        if at < 0.0 || at + self.widths.behind as f64 > self.values.len() as f64 {
            return None;
        }
        self.widths.excess(self.noise, at as usize, |range| self.values[range].iter().copied().map(f64::from).sum())
    }
}
