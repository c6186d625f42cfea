//! What the solution leaves over.

use super::arrivals::{Arrivals, doubt};
use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::history::behind::OnsetBehind;
use crate::signal::tails::normal;
use crate::table;
use crate::tables::Name;
use crate::units::PatchId;

/// Points drawn at most.
const POINTS: usize = 3000;
/// Points of the quantile plot at most, but for the ends, and those at either end that are all drawn.
const QUANTILES: usize = 400;
const ENDS: usize = 50;
/// More standard deviations than the extreme of any number of onsets has.
const FARTHEST: f64 = 12.0;
/// Onsets listed at most.
const WORST: usize = 25;
/// Half the range of the histogram, in standard deviations; what lies beyond goes into the outermost bins.
pub const RANGE: f64 = 5.0;
/// Bins of the histogram.
pub const BINS: usize = 40;

table! {
    /// When a profile was captured.
    "profiles": Captured, CapturedColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Time of the first shot.
        acquired_at: Option<Name>,
    }
}

/// A residual that is drawn.
pub struct Point {
    /// Time of flight.
    pub time_ps: f64,
    /// Wall-clock time of its capture (ISO 8601).
    pub acquired_at: Option<Name>,
    /// Residual in its own standard deviations.
    pub pull: f64,
    /// Patch that the laser lit.
    pub lit: PatchId,
    /// Patch that the sensor saw.
    pub seen: PatchId,
    /// Bounces of its path.
    pub bounces: usize,
    /// What it is called.
    pub name: String,
}

/// Residuals of labelled onsets.
pub struct Residuals {
    /// Heading of their table.
    pub heading: String,
    /// How many there are.
    pub count: usize,
    /// Root mean square of the pulls of those that the solution rests on.
    pub rms: f64,
    /// Counts in [`BINS`] bins from -[`RANGE`] to [`RANGE`].
    pub histogram: Vec<usize>,
    /// A choice of them.
    pub points: Vec<Point>,
    /// Quantile of the normal distribution and of the residuals, ascending, a choice with both ends.
    pub quantiles: Vec<(f64, f64)>,
    /// Those farthest off, worst first.
    pub worst: Vec<OnsetBehind>,
}

impl Residuals {
    /// Gathers them; `None` where no onset has one.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>, arrivals: &Arrivals) -> Result<Option<Self>, HistoryError> {
        let with_pull: Vec<(&OnsetBehind, f64)> =
            arrivals.offered().filter_map(|onset| onset.pull.map(|pull| (onset, pull))).collect();
        let (Some(heading), false) = (arrivals.heading.clone(), with_pull.is_empty()) else { return Ok(None) };
        let mut histogram = vec![0; BINS];
        for (_, pull) in &with_pull {
            let bin = ((pull + RANGE) / (2.0 * RANGE) * BINS as f64).floor().clamp(0.0, BINS as f64 - 1.0);
            histogram[bin as usize] += 1;
        }
        let used: Vec<f64> =
            with_pull.iter().filter(|(onset, _)| onset.used != Some(false)).map(|(_, pull)| pull * pull).collect();
        let rms = (used.iter().sum::<f64>() / used.len().max(1) as f64).sqrt();
        let mut worst: Vec<OnsetBehind> = with_pull.iter().map(|(onset, _)| (*onset).clone()).collect();
        worst.sort_by(|a, b| doubt(b).total_cmp(&doubt(a)));
        worst.truncate(WORST);
        let drawn = spread(&with_pull, POINTS);
        let wanted: std::collections::BTreeSet<_> = drawn.iter().map(|(onset, _)| onset.capture()).collect();
        let key = |row: &Captured| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let captured: std::collections::BTreeMap<_, _> = sources
            .rows(|row: &Captured| wanted.contains(&key(row)))?
            .into_iter()
            .map(|row| (key(&row), row.acquired_at))
            .collect();
        let point = |(onset, pull): &(&OnsetBehind, f64)| {
            Some(Point {
                time_ps: onset.time_ps?,
                acquired_at: captured.get(&onset.capture()).cloned().flatten(),
                pull: *pull,
                lit: onset.lit,
                seen: onset.seen,
                bounces: onset.path.as_ref().map_or(0, Vec::len),
                name: name(onset),
            })
        };
        let points = drawn.iter().filter_map(point).collect();
        let quantiles = quantiles(with_pull.iter().map(|(_, pull)| *pull).collect());
        Ok(Some(Self { heading, count: with_pull.len(), rms, histogram, points, quantiles, worst }))
    }
}

/// Each value with the quantile of the normal distribution at its rank.
fn quantiles(mut pulls: Vec<f64>) -> Vec<(f64, f64)> {
    pulls.sort_by(f64::total_cmp);
    let count = pulls.len();
    let quantile = |rank: usize| (normal_quantile((rank as f64 + 0.5) / count as f64), pulls[rank]);
    let mut ranks = spread(&(0..count).collect::<Vec<_>>(), QUANTILES);
    // The ends say most.
    ranks.retain(|rank| *rank >= ENDS && rank + ENDS < count);
    let mut all: Vec<usize> =
        (0..count.min(ENDS)).chain(ranks).chain(count.saturating_sub(ENDS).max(ENDS)..count).collect();
    all.dedup();
    all.into_iter().map(quantile).collect()
}

/// The value below which a standard normal variable lies with this probability, by halving.
pub fn normal_quantile(probability: f64) -> f64 {
    // Chance beyond z on one side, of the smaller tail, where no digits are lost.
    let tail = probability.min(1.0 - probability);
    let (mut low, mut high) = (0.0, FARTHEST);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if 0.5 * normal(middle) > tail { low = middle } else { high = middle }
    }
    if probability < 0.5 { -low } else { low }
}

/// What an onset is called: `s1, lit 3, seen 4, rank 2`.
pub fn name(onset: &OnsetBehind) -> String {
    format!("{}, lit {}, seen {}, rank {}", onset.sensor, onset.lit, onset.seen, onset.rank)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table of the normal distribution.
    #[test]
    fn quantiles_are_those_of_a_table() {
        for (probability, z) in [(0.5, 0.0), (0.975, 1.959_964), (0.025, -1.959_964), (0.000_5, -3.290_527)] {
            assert!((normal_quantile(probability) - z).abs() < 1e-5, "{probability}");
        }
    }

    #[test]
    fn a_quantile_plot_keeps_both_ends() {
        let all = quantiles((0..10_000).rev().map(f64::from).collect());
        assert!(all.len() <= QUANTILES + 2 * ENDS && all.is_sorted_by(|a, b| a.0 < b.0 && a.1 < b.1));
        assert_eq!((all[0].1, all[all.len() - 1].1), (0.0, 9999.0));
        assert_eq!(quantiles(vec![1.0]).len(), 1);
        assert_eq!(quantiles((0..60).map(f64::from).collect()).len(), 60);
    }
}
