//! The leading edge of an echo, at half of the way from its foot to its maximum.

use super::maxima::{smooth, weights};

/// Smoothing of the edge, as a share of the smoothing of the maximum: smoothing moves steep edges.
const AT_EDGE: f64 = 0.35;

/// The edge of an echo.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Place, in samples.
    pub place: f64,
    /// How much each sample's noise moves it.
    pub influence: Vec<f64>,
}

/// The edge of an echo of this curve; `record` is the record without level and other echoes, `foot` its level where it
/// is quiet, `sigma` the width of the outgoing pulse. `None` where the edge is not in the record.
///
/// Smoothing moves maxima and edges. So each is that of the fitted curve, moved by what lies between smoothed record
/// and smoothed curve.
pub fn edge(curve: &[f64], record: &[f64], foot: f64, sigma: f64) -> Option<Edge> {
    let (wide, narrow) = (weights(sigma), weights(AT_EDGE * sigma));
    let highest = (0..curve.len()).max_by(|a, b| curve[*a].total_cmp(&curve[*b]))?;
    let top = maximum(curve, record, highest, &wide);
    let (of_curve, of_record) = (smooth(curve, &narrow), smooth(record, &narrow));
    let smoothed = rise(&of_curve, highest, 0.5 * curve[highest])?;
    // The record's own maximum may lie later than the curve's.
    let last = (highest + wide.len()).min(record.len() - 1);
    let place = rise(curve, highest, 0.5 * curve[highest])? - smoothed + rise(&of_record, last, 0.5 * (top + foot))?;
    let before = smoothed.floor() as usize;
    let (slope, nearest) = (of_curve[before + 1] - of_curve[before], smoothed.round() as usize);
    let weight = |weights: &[f64], from: usize, n: usize| weights.get(from.abs_diff(n)).copied().unwrap_or(0.0);
    // A higher sample at the edge brings it forward, a higher maximum puts it off.
    let moved = |n: usize| (0.5 * weight(&wide, highest, n) - weight(&narrow, nearest, n)) / slope;
    Some(Edge { place, influence: (0..curve.len()).map(moved).collect() })
}

/// Height of the record's maximum near that of the curve; one at the rails is that of the curve.
fn maximum(curve: &[f64], record: &[f64], highest: usize, wide: &[f64]) -> f64 {
    let (of_curve, of_record) = (smooth(curve, wide), smooth(record, wide));
    if !of_record[highest].is_finite() {
        return curve[highest];
    }
    let near = highest.saturating_sub(wide.len())..(highest + wide.len() + 1).min(record.len());
    let top = near.map(|n| of_record[n]).filter(|value| value.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    top + curve[highest] - of_curve[highest]
}

/// Where values, seen backwards from `top`, fall through a level for good: the first sample above it has none below it
/// behind.
fn rise(values: &[f64], top: usize, level: f64) -> Option<f64> {
    let highest = (0..=top).rev().find(|n| values[*n] > level)?;
    let above = (1..=highest).rev().find(|n| values[n - 1] <= level)?;
    Some((above - 1) as f64 + (level - values[above - 1]) / (values[above] - values[above - 1]))
}
