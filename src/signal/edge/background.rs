//! The light before first returns: a constant, and an exponential tail of what came before.
//!
//! Each histogram has its own level. The shape is common: it is fitted to the sum of all histograms, over some time
//! before the first return of each, since a single one has too few counts. A background taken as constant where it
//! declines makes weak first returns late.

use std::collections::BTreeMap;

use super::{Bins, Noise};

/// Bins of a histogram that enter, before its first return, in standard deviations of the response.
pub(super) const FROM: f64 = 30.0;
const TO: f64 = 4.0;
/// Times of decline that are tried, over the standard deviation of the response, and the ratio of neighbours.
const SHORTEST: f64 = 3.0;
const RATIO: f64 = 1.15;
const TIMES: usize = 40;
/// Rounds of the likeliest levels.
const ROUNDS: usize = 60;

/// Shape of the background over time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Background {
    /// Level of the constant over that of the tail at `from_ps`; infinite where there is no tail.
    constant: f64,
    from_ps: f64,
    decline_ps: f64,
}

impl Background {
    /// No tail.
    pub const CONSTANT: Self = Self { constant: f64::INFINITY, from_ps: 0.0, decline_ps: 1.0 };

    /// Light that declines as this power of time about one.
    pub(super) fn declining(time_ps: f64, power: f64) -> Self {
        Self { constant: 0.0, from_ps: time_ps, decline_ps: time_ps / power }
    }

    /// The likeliest shape before the first returns of histograms. Levels are taken as constant; histograms whose bins
    /// are not as wide as those of the first one tell nothing.
    #[must_use]
    pub fn before(histograms: &[(Bins<'_>, f64)], sigma_ps: f64) -> Self {
        let sums = Sum::all(histograms, sigma_ps);
        let Some(from_ps) = sums.first().map(|sum| sum.time_ps) else { return Self::CONSTANT };
        let flat = levels(&sums, |_| 0.0);
        let tries = (0..TIMES).map(|n| {
            let decline_ps = SHORTEST * RATIO.powi(n as i32) * sigma_ps;
            let ([constant, level], likelihood) = levels(&sums, |time_ps| (-(time_ps - from_ps) / decline_ps).exp());
            (likelihood, Self { constant: constant / level.max(1e-300), from_ps, decline_ps })
        });
        let best = tries.max_by(|a, b| a.0.total_cmp(&b.0));
        // Two more unknowns that explain nothing gain one in the mean.
        best.filter(|(likelihood, _)| *likelihood > flat.1 + 3.0).map_or(Self::CONSTANT, |(_, shape)| shape)
    }

    /// Background at a time, on any scale.
    pub(super) fn at(&self, time_ps: f64) -> f64 {
        if self.constant.is_infinite() {
            return 1.0;
        }
        self.constant + (-(time_ps - self.from_ps) / self.decline_ps).exp()
    }
}

/// Counts of all histograms in a bin of time, and how many histograms have it.
#[derive(Clone, Copy)]
struct Sum {
    time_ps: f64,
    counts: f64,
    histograms: f64,
}

impl Sum {
    /// Of the bins before first returns, in order of time.
    fn all(histograms: &[(Bins<'_>, f64)], sigma_ps: f64) -> Vec<Self> {
        let counted = || histograms.iter().filter(|(bins, _)| bins.noise == Noise::Counts);
        let Some((first, _)) = counted().min_by(|(a, _), (b, _)| a.first_ps.total_cmp(&b.first_ps)) else {
            return Vec::new();
        };
        let (first_ps, dt_ps) = (first.first_ps, first.dt_ps);
        let mut sums: BTreeMap<i64, Self> = BTreeMap::new();
        for (bins, start_ps) in counted().filter(|(bins, _)| bins.dt_ps == dt_ps) {
            let offset = ((bins.first_ps - first_ps) / dt_ps).round() as i64;
            let place = |sigmas: f64| ((start_ps - sigmas * sigma_ps - bins.first_ps) / dt_ps).max(0.0) as usize;
            let to = place(TO).min(bins.values.len());
            for n in place(FROM).min(to)..to {
                let bin = offset + n as i64;
                let none = Self { time_ps: first_ps + bin as f64 * dt_ps, counts: 0.0, histograms: 0.0 };
                let sum = sums.entry(bin).or_insert(none);
                sum.counts += bins.values[n];
                sum.histograms += 1.0;
            }
        }
        sums.into_values().collect()
    }
}

/// The likeliest levels of a constant and a tail, given by time (by expectation and maximization), and the logarithm of
/// the likelihood.
fn levels(sums: &[Sum], tail: impl Fn(f64) -> f64) -> ([f64; 2], f64) {
    let shapes: Vec<(f64, f64, f64)> = sums.iter().map(|sum| (sum.counts, sum.histograms, tail(sum.time_ps))).collect();
    let total: f64 = shapes.iter().map(|one| one.0).sum();
    let [ones, tails]: [f64; 2] = [shapes.iter().map(|one| one.1).sum(), shapes.iter().map(|one| one.1 * one.2).sum()];
    let mut levels = [0.5 * total / ones.max(1.0), if tails > 0.0 { 0.5 * total / tails } else { 0.0 }];
    let rate = |levels: [f64; 2], tail: f64| (levels[0] + levels[1] * tail).max(1e-300);
    for _ in 0..ROUNDS {
        let mut shares = [0.0; 2];
        for (sum, _, tail) in &shapes {
            let part = sum / rate(levels, *tail);
            shares[0] += part * levels[0];
            shares[1] += part * levels[1] * tail;
        }
        levels = [shares[0] / ones.max(1.0), if tails > 0.0 { shares[1] / tails } else { 0.0 }];
    }
    let of_bin = |(sum, count, tail): &(f64, f64, f64)| sum * rate(levels, *tail).ln() - count * rate(levels, *tail);
    (levels, shapes.iter().map(of_bin).sum())
}
