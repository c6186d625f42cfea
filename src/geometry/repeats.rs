//! Lengths of one path that were measured more than once: in both directions (reciprocity), or again. Whatever the
//! path, and whoever labelled it, they are equal but for their errors. So they show how large these are, and whether
//! they grow with the time between both.

use std::collections::BTreeMap;

use crate::maximum_likelihood::{Node, Observation};

/// Fewer differences say nothing of errors in general.
const LEAST: usize = 8;
/// Median of the square of a standard normal number, and its standard deviation over itself for one number: that of a
/// median of n is smaller by the root of n.
const MEDIAN: f64 = 0.454_936;
const MEDIAN_SD: f64 = 2.33;
/// The 99.9 % point of a normal distribution.
const BY_CHANCE_SD: f64 = 3.09;

/// Differences between two measurements of one path.
#[derive(Clone, Debug)]
pub struct Repeats(Vec<Difference>);

/// Measurements by their numbers, their difference and what is stated of it.
#[derive(Clone, Copy, Debug)]
struct Difference {
    of: [usize; 2],
    square_m2: f64,
    variance_m2: f64,
}

impl Repeats {
    /// Of lengths that share a delay, each with the next one of its path.
    #[must_use]
    pub fn of(observations: &[Observation]) -> Self {
        let mut paths: BTreeMap<(Vec<Node>, Option<usize>), Vec<usize>> = BTreeMap::new();
        for (n, observation) in observations.iter().enumerate() {
            let back: Vec<Node> = observation.nodes.iter().rev().copied().collect();
            let path = if back < observation.nodes { back } else { observation.nodes.clone() };
            paths.entry((path, observation.delay)).or_default().push(n);
        }
        let difference = |of: &[usize]| {
            let [one, other] = [&observations[of[0]], &observations[of[1]]];
            Difference {
                of: [of[0], of[1]],
                square_m2: (one.length_m - other.length_m).powi(2),
                variance_m2: one.sd_m.powi(2) + other.sd_m.powi(2),
            }
        };
        Self(paths.values().flat_map(|path| path.windows(2)).map(difference).collect())
    }

    /// By how much the variances of these lengths are larger than stated; `None` where there are too few, and where
    /// chance explains what they differ by. By the median, so that a few wrong paths do not count.
    #[must_use]
    pub fn scatter(&self) -> Option<f64> {
        let factor = self.median(|difference| Some(difference.square_m2 / difference.variance_m2))?;
        (factor > 1.0 + BY_CHANCE_SD * MEDIAN_SD / (self.0.len() as f64).sqrt()).then_some(factor)
    }

    /// Variance of a random walk after one unit of time, by the times of all lengths; `None` where they show none, or
    /// are too few.
    #[must_use]
    pub fn walk_m2(&self, times: &[Option<f64>]) -> Option<f64> {
        let rate = |difference: &Difference| {
            let [one, other] = difference.of.map(|n| times[n]);
            let apart = (one? - other?).abs();
            (apart > 0.0).then_some((difference.square_m2 - difference.variance_m2) / apart)
        };
        self.median(rate).filter(|rate_m2| *rate_m2 > 0.0)
    }

    /// Median of a square, over that of a standard normal number.
    fn median(&self, square: impl Fn(&Difference) -> Option<f64>) -> Option<f64> {
        let mut squares: Vec<f64> = self.0.iter().filter_map(square).collect();
        squares.sort_by(f64::total_cmp);
        squares.get(squares.len() / 2).filter(|_| squares.len() >= LEAST).map(|median| median / MEDIAN)
    }
}

#[cfg(test)]
mod tests;
