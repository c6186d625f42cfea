//! Growth of a solution, patch by patch, from few that span space.
//!
//! The seeds are patches that all see one another (three; in flatland two) whose p0-centred Gram matrix has the largest smallest eigenvalue: p0 and they
//! span the largest volume. The patch that comes next is the one whose best place explains its lengths most clearly better than its second best, and
//! among equals the one with most neighbours in place. Every few patches all are settled together, so that errors do not pile up.

use std::cmp::Ordering;

use nalgebra::{Matrix3, Vector3};

use super::{STEPS, Scene};
use crate::geometry::multilateration::{self, Candidate};
use crate::geometry::{Point, classical};
use faer::Mat;

/// Patches that are placed between two settlements of all.
const BETWEEN: usize = 6;
/// Steps of a settlement on the way.
const STEPS_BETWEEN: usize = 10;
/// A place whose loss is lower than the second best's by this many times its own is safe.
const SAFE: f64 = 30.0;

impl Scene<'_> {
    /// Seeds, best first; each patch once as far as there are others, then again.
    pub(super) fn seeds(&self) -> Vec<Vec<usize>> {
        let mut scored: Vec<(f64, Vec<usize>)> = Vec::new();
        for i in 0..self.count() {
            for (j, _) in self.neighbours[i].iter().filter(|(j, _)| *j < i) {
                if self.lengths.dimensions == 2 {
                    scored.push((self.span(&[i, *j]), vec![i, *j]));
                    continue;
                }
                let thirds = self.neighbours[i].iter().filter(|(k, _)| k < j && self.across_m(*j, *k).is_some());
                scored.extend(thirds.map(|(k, _)| (self.span(&[i, *j, *k]), vec![i, *j, *k])));
            }
        }
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut used = vec![false; self.count()];
        let (fresh, again): (Vec<_>, Vec<_>) = scored.into_iter().map(|(_, seed)| seed).partition(|seed| {
            let fresh = seed.iter().all(|&patch| !used[patch]);
            if fresh {
                seed.iter().for_each(|&patch| used[patch] = true);
            }
            fresh
        });
        fresh.into_iter().chain(again).collect()
    }

    /// Smallest eigenvalue of the Gram matrix of patches that all see one another.
    fn span(&self, seed: &[usize]) -> f64 {
        let range2 = |patch: usize| self.range_m(patch).powi(2);
        let largest = seed.iter().map(|&patch| range2(patch)).sum::<f64>();
        let gram = Matrix3::from_fn(|r, c| match (seed.get(r), seed.get(c)) {
            (Some(&a), Some(&b)) if a == b => range2(a),
            (Some(&a), Some(&b)) => {
                0.5 * (range2(a) + range2(b) - self.across_m(a, b).expect("they see one another").powi(2))
            }
            // Flatland: no third direction, and none that could be the smallest.
            _ => {
                if r == c {
                    largest
                } else {
                    0.0
                }
            }
        });
        gram.symmetric_eigenvalues().min()
    }

    /// Distance of two patches from their second bounce.
    fn across_m(&self, a: usize, b: usize) -> Option<f64> {
        let (_, length) = self.neighbours[a].iter().find(|(other, _)| *other == b)?;
        Some(length.length_m - self.range_m(a) - self.range_m(b))
    }

    /// All patches, grown from a seed.
    pub(super) fn grow(&self, seed: &[usize]) -> Vec<Point> {
        let distance_m = Mat::from_fn(seed.len() + 1, seed.len() + 1, |i, j| match (i.min(j), i.max(j)) {
            (i, j) if i == j => 0.0,
            (0, j) => self.range_m(seed[j - 1]),
            (i, j) => self.across_m(seed[i - 1], seed[j - 1]).expect("they see one another"),
        });
        let mut places = vec![None; self.count()];
        let first = classical::embed(&distance_m, self.lengths.dimensions);
        seed.iter().zip(first).for_each(|(&patch, point)| places[patch] = Some(point));
        self.settle_placed(&mut places, STEPS);
        let mut since = 0;
        while let Some((patch, point)) = self.next(&places) {
            places[patch] = Some(point);
            since += 1;
            if since % BETWEEN == 0 {
                self.settle_placed(&mut places, STEPS_BETWEEN);
            }
        }
        (0..self.count()).map(|patch| places[patch].unwrap_or_else(|| self.somewhere(patch, &places))).collect()
    }

    /// The patch to be placed next, and where; `None` when no other has enough neighbours.
    fn next(&self, places: &[Option<Point>]) -> Option<(usize, Point)> {
        let clear = |patch: usize| -> Option<(f64, usize, usize, Point)> {
            let ties = self.ties(patch, |other| places[other]);
            let found = multilateration::candidates(&ties, self.lengths.dimensions, self.apart_m);
            let gap = |best: &Candidate, second: &Candidate| ((second.cost - best.cost) / (1.0 + best.cost)).min(SAFE);
            let best = found.first()?;
            // Mirror images have no loss to be told apart by.
            let certain = ties.len() > self.lengths.dimensions;
            let clearness = if certain { found.get(1).map_or(SAFE, |second| gap(best, second)) } else { 0.0 };
            Some((clearness, ties.len(), patch, best.point))
        };
        let unplaced = (0..self.count()).filter(|&patch| places[patch].is_none());
        let clearer = |a: &(f64, usize, usize, Point), b: &(f64, usize, usize, Point)| -> Ordering {
            // Of equals the first.
            a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(b.2.cmp(&a.2))
        };
        unplaced.filter_map(clear).max_by(clearer).map(|(_, _, patch, point)| (patch, point))
    }

    /// A place that agrees with the lengths of a patch that has too few of them.
    fn somewhere(&self, patch: usize, places: &[Option<Point>]) -> Point {
        let range_m = self.range_m(patch);
        let neighbour = self.neighbours[patch].iter().find_map(|(other, _)| Some((*other, places[*other]?)));
        let Some((other, point)) = neighbour else { return Point::new(range_m, 0.0, 0.0) };
        let (away, across) = (self.range_m(other), self.across_m(patch, other).expect("it is a neighbour"));
        let along = point.coords.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::x);
        let aside = if along.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() };
        let aside = (aside - along * along.dot(&aside)).normalize();
        let foot = (range_m * range_m + away * away - across * across) / (2.0 * away);
        Point::from(along * foot + aside * (range_m * range_m - foot * foot).max(0.0).sqrt())
    }
}
