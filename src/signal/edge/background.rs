//! The light before first returns: a constant, and an exponential tail of what came before.
//!
//! Each histogram has its own level. The shape is common: it is fitted to the sum of all histograms, over some time
//! before the first return of each, since a single one has too few counts. A background taken as constant where it
//! declines makes weak first returns late.

use super::{Bins, Noise};

/// Bins of a histogram that enter, before its first return, in standard deviations of the response.
const FROM: f64 = 30.0;
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

    /// The likeliest shape before the first returns of histograms on one grid of time. Levels are taken as constant.
    #[must_use]
    pub fn before(histograms: &[(Bins<'_>, f64)], sigma_ps: f64) -> Self {
        let counted = histograms.iter().filter(|(bins, _)| bins.noise == Noise::Counts);
        let Some(first_ps) = counted.clone().map(|(bins, _)| bins.first_ps).min_by(f64::total_cmp) else {
            return Self::CONSTANT;
        };
        let mut sums: Vec<[f64; 2]> = Vec::new();
        let mut dt_ps = 1.0;
        for (bins, start_ps) in counted {
            dt_ps = bins.dt_ps;
            let offset = ((bins.first_ps - first_ps) / dt_ps).round() as usize;
            let place = |sigmas: f64| ((start_ps - sigmas * sigma_ps - bins.first_ps) / dt_ps).max(0.0) as usize;
            let to = place(TO).min(bins.values.len());
            for n in place(FROM).min(to)..to {
                sums.resize(sums.len().max(offset + n + 1), [0.0; 2]);
                sums[offset + n][0] += bins.values[n];
                sums[offset + n][1] += 1.0;
            }
        }
        let from = sums.iter().position(|[_, count]| *count > 0.0).unwrap_or(0);
        let shape = |decline: f64| Self {
            constant: 1.0,
            from_ps: first_ps + from as f64 * dt_ps,
            decline_ps: decline * sigma_ps,
        };
        let flat = levels(&sums, |_| 0.0);
        let tries = (0..TIMES).map(|n| {
            let shape = shape(SHORTEST * RATIO.powi(n as i32));
            let tail = |n: usize| (-(first_ps + n as f64 * dt_ps - shape.from_ps) / shape.decline_ps).exp();
            let ([constant, level], likelihood) = levels(&sums, tail);
            (likelihood, Self { constant: constant / level.max(1e-300), ..shape })
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

/// The likeliest levels of a constant and a tail (by expectation and maximization), and the logarithm of the
/// likelihood.
fn levels(sums: &[[f64; 2]], tail: impl Fn(usize) -> f64) -> ([f64; 2], f64) {
    let shapes: Vec<(f64, f64, f64)> =
        sums.iter().enumerate().map(|(n, [sum, count])| (*sum, *count, tail(n))).filter(|one| one.1 > 0.0).collect();
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
