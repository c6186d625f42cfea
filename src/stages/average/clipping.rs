//! Which samples of a capture the converter cut off.

use std::collections::BTreeSet;

use super::Average;
use crate::signal::average::PHASES;
use crate::signal::codes::Codes;
use crate::signal::merge_ranges;
use crate::signal::resample;

/// Places on the common grid where a shot is clipped, and how far around them samples are wrong.
pub struct Clipping {
    places: BTreeSet<i64>,
    /// Samples to be left out before a clipped one: what the filter that aligns shots reaches.
    pub before: usize,
    /// Samples to be left out behind a clipped one: the same, and the amplifier's recovery.
    pub after: usize,
}

impl Clipping {
    /// None yet.
    pub fn new(average: &Average, dt_ps: f64) -> Self {
        let reach = resample::TAPS / 2;
        let recovery = (average.recovery_ps.get() / dt_ps).ceil() as usize;
        Self { places: BTreeSet::new(), before: reach, after: reach + recovery }
    }

    /// Marks the `count` clipped samples of a shot: those at its own highest code, at its lowest, or at both, whichever
    /// are `count`. Where rails are more than one code wide, it marks those furthest from the median.
    pub fn mark(&mut self, codes: Codes<'_>, position: i64, count: usize) {
        let values = codes.to_f64();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let (low, high, median) = (sorted[0], sorted[sorted.len() - 1], sorted[sorted.len() / 2]);
        let at = |rail: f64| values.iter().filter(|value| **value == rail).count();
        let (at_low, at_high) = (at(low), at(high));
        let mut off: Vec<f64> = values.iter().map(|value| (value - median).abs()).collect();
        off.sort_by(|a, b| b.total_cmp(a));
        let furthest = off[count.clamp(1, off.len()) - 1];
        let is_clipped = |value: f64| match count {
            _ if count == at_high => value == high,
            _ if count == at_low => value == low,
            _ if count == at_low + at_high => value == low || value == high,
            _ => (value - median).abs() >= furthest,
        };
        let (whole, between) = (position.div_euclid(PHASES as i64), i64::from(position.rem_euclid(PHASES as i64) > 0));
        for n in (0..values.len()).filter(|n| is_clipped(values[*n])) {
            self.places.extend(whole + n as i64..=whole + n as i64 + between);
        }
    }

    /// The places, in order.
    pub fn places(&self) -> impl Iterator<Item = i64> {
        self.places.iter().copied()
    }

    /// Marks places that another piece of the capture has found.
    pub fn absorb(&mut self, places: impl IntoIterator<Item = i64>) {
        self.places.extend(places);
    }

    /// None any more.
    pub fn forget(&mut self) {
        self.places.clear();
    }

    /// Which of `count` places from `first` on are clipped.
    pub fn at(&self, first: i64, count: usize) -> Vec<bool> {
        let mut clipped = vec![false; count];
        for place in self.places.range(first..first + count as i64) {
            clipped[(place - first) as usize] = true;
        }
        clipped
    }

    /// Which of `count` places from `first` on are neither clipped nor close to it.
    pub fn clear_of(&self, first: i64, count: usize) -> Vec<bool> {
        if self.places.is_empty() {
            return vec![true; count];
        }
        merge_ranges::valid(&self.at(first, count), self.before, self.after)
    }
}
