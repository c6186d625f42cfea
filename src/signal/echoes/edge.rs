//! The leading edge of an echo, at half of the way from its foot to its maximum.

use super::maxima::{smooth, weights};

/// An echo has its foot where its curve is below this share of its height.
const FOOT_SHARE: f64 = 0.02;
/// Smoothing of the edge, as a share of the smoothing of maximum and foot: smoothing moves steep edges.
const AT_EDGE: f64 = 0.35;

/// The edge of an echo.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Place, in samples.
    pub place: f64,
    /// How much each sample's noise moves it.
    pub influence: Vec<f64>,
}

/// Levels that the edge is between: that of the foot and that of the maximum.
struct Levels {
    top: f64,
    foot: f64,
    /// Samples that they are read at.
    highest: usize,
    start: Option<usize>,
}

/// The edge of an echo of this curve; `record` is the record without level and other echoes, `sigma` the width of the
/// outgoing pulse. `None` where the edge is not in the record.
///
/// Smoothing moves levels and edges. So each is that of the fitted curve, moved by what lies between smoothed record
/// and smoothed curve.
pub fn edge(curve: &[f64], record: &[f64], sigma: f64) -> Option<Edge> {
    let (wide, narrow) = (weights(sigma), weights(AT_EDGE * sigma));
    let levels = levels(curve, record, &wide);
    let of_curve = smooth(curve, &narrow);
    let of_record = smooth(record, &narrow);
    let smoothed = rise(&of_curve, levels.highest, 0.5 * curve[levels.highest])?;
    // The record's own maximum may lie later than the curve's.
    let top = (levels.highest + wide.len()).min(record.len() - 1);
    let place = rise(curve, levels.highest, 0.5 * curve[levels.highest])? - smoothed
        + rise(&of_record, top, 0.5 * (levels.top + levels.foot))?;
    let before = smoothed.floor() as usize;
    let (slope, nearest) = (of_curve[before + 1] - of_curve[before], smoothed.round() as usize);
    let weight = |weights: &[f64], from: usize, n: usize| weights.get(from.abs_diff(n)).copied().unwrap_or(0.0);
    let level = |n: usize| {
        weight(&wide, levels.highest, n) + levels.start.map_or(0.0, |start| weight(&wide, start, n))
    };
    // A higher sample at the edge brings it forward, a higher level puts it off.
    let influence = (0..curve.len()).map(|n| (0.5 * level(n) - weight(&narrow, nearest, n)) / slope).collect();
    Some(Edge { place, influence })
}

fn levels(curve: &[f64], record: &[f64], wide: &[f64]) -> Levels {
    let highest = (0..curve.len()).max_by(|a, b| curve[*a].total_cmp(&curve[*b])).unwrap_or(0);
    let (of_curve, of_record) = (smooth(curve, wide), smooth(record, wide));
    let near = highest.saturating_sub(wide.len())..(highest + wide.len() + 1).min(record.len());
    let top = near.map(|n| of_record[n]).filter(|value| value.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    // A maximum at the rails is that of the curve.
    let top = if of_record[highest].is_finite() { top + curve[highest] - of_curve[highest] } else { curve[highest] };
    let is_foot = |n: &usize| curve[*n] < FOOT_SHARE * curve[highest] && of_record[*n].is_finite();
    let start = (0..highest).rev().find(is_foot);
    let foot = start.map_or(0.0, |start| of_record[start] - of_curve[start]);
    Levels { top, foot, highest, start }
}

/// Where values, seen backwards from `top`, fall through a level for good: the first sample above it has none below it
/// behind.
fn rise(values: &[f64], top: usize, level: f64) -> Option<f64> {
    let highest = (0..=top).rev().find(|n| values[*n] > level)?;
    let above = (1..=highest).rev().find(|n| values[n - 1] <= level)?;
    Some((above - 1) as f64 + (level - values[above - 1]) / (values[above] - values[above - 1]))
}
