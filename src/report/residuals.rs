//! What the solution leaves over.

use super::arrivals::{Arrivals, doubt};
use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::history::behind::OnsetBehind;
use crate::table;
use crate::tables::Name;

/// Points drawn at most.
const POINTS: usize = 3000;
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
                bounces: onset.path.as_ref().map_or(0, Vec::len),
                name: name(onset),
            })
        };
        let points = drawn.iter().filter_map(point).collect();
        Ok(Some(Self { heading, count: with_pull.len(), rms, histogram, points, worst }))
    }
}

/// What an onset is called: `s1, lit 3, seen 4, rank 2`.
pub fn name(onset: &OnsetBehind) -> String {
    format!("{}, lit {}, seen {}, rank {}", onset.sensor, onset.lit, onset.seen, onset.rank)
}
