//! Where a solution begins.

use std::cmp::Reverse;
use std::iter;

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::{Measurements, SAME, STEPS, State, patches};
use crate::{Point, classical, completion, smacof};

/// Most seeds that are grown from.
const SEEDS: usize = 12;
/// Random places of a seed from which it is brought down.
const TRIES: usize = 60;
/// Neighbours of a patch that seeds are made of.
const NEIGHBOURS: usize = 30;
/// Paths that a seed without first bounces has above its unknowns.
const SURPLUS: usize = 6;

impl Measurements<'_> {
    /// Starts, most promising first; all patches of each have a place.
    pub(super) fn starts(&self) -> impl Iterator<Item = State> {
        let spectral = [false, true].into_iter().filter_map(|smooth| Some(self.grow(self.spectral(smooth)?)));
        let direct = iter::once_with(|| self.nothing()).filter(|state| !self.next(state).is_empty());
        let seeds = iter::once_with(|| self.seeds()).flatten().take(SEEDS);
        let seeded = seeds.enumerate().map(|(number, seed)| self.sprout(&seed, number));
        spectral.chain(direct.chain(seeded).map(|state| self.grow(state)))
    }

    /// The patches with first bounces, all stations taken for one point: missing distances filled with shortest paths,
    /// then classical scaling; then SMACOF on the measured ones where asked for. `None` where they do not span space.
    fn spectral(&self, smooth: bool) -> Option<State> {
        let of: Vec<usize> = (0..self.count()).filter(|&patch| self.first_m[patch].is_some()).collect();
        if of.len() <= self.problem.dimensions {
            return None;
        }
        let distance_m = |i: usize, j: usize| match (i.min(j), i.max(j)) {
            (0, 0) => Some(0.0),
            (0, j) => self.range_m(of[j - 1]),
            (i, j) => self.across_m(of[i - 1], of[j - 1]),
        };
        let size = of.len() + 1;
        let complete_m =
            completion::complete(size, distance_m, &self.problem.cancel).expect("every patch here has a first bounce");
        let mut points = classical::embed(&complete_m, self.problem.dimensions);
        if smooth {
            let weights = Mat::from_fn(size, size, |i, j| if distance_m(i, j).is_some() { 1.0 } else { 0.0 });
            points = smacof::scale(&points, &complete_m, &weights).expect("every patch here has a first bounce").points;
        }
        let mut state = self.nothing();
        of.iter().zip(points).for_each(|(&patch, p)| state.places[patch] = Some(self.frame.centre + p.coords));
        Some(state)
    }

    /// A seed brought down from random places, the lowest of all.
    pub(super) fn sprout(&self, seed: &[usize], number: usize) -> State {
        let descend = |attempt: usize| {
            let mut places = vec![None; self.count()];
            for &patch in seed {
                places[patch] = Some(self.guess(patch, (number * TRIES + attempt) as u64));
            }
            self.settle(places, STEPS)
        };
        let mut best = descend(0);
        for attempt in 1..TRIES {
            if best.loss < best.likely_loss {
                break;
            }
            let next = descend(attempt);
            if next.loss < best.loss - SAME {
                best = next;
            }
        }
        best
    }

    /// A random place that a patch's own paths, ray or anchor allow.
    pub(super) fn guess(&self, patch: usize, number: u64) -> Point {
        if let Some(anchor) = self.problem.anchors.iter().find(|anchor| anchor.patch == patch) {
            return anchor.position;
        }
        let mut dice = Dice::new(patch as u64, number);
        // A path gets no farther from the middle of its ends than half its length.
        let halves_m = self.of_patch[patch].iter().map(|&n| 0.5 * self.problem.observations[n].length_m);
        let farthest_m = halves_m.fold(self.frame.longest_m, f64::min);
        let range_m = self.range_m(patch).unwrap_or_else(|| farthest_m * dice.throw());
        if let Some(ray) = self.problem.rays.iter().find(|ray| ray.patch == patch) {
            return self.problem.stations[ray.from].position + range_m * ray.direction;
        }
        let direction = Vector3::from_fn(|k, _| if k < self.problem.dimensions { dice.bell() } else { 0.0 });
        self.frame.centre + range_m * direction.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::x)
    }

    /// Seeds, best first: threes (in flatland twos) that all see one another and span space; without any, groups that
    /// many paths join. Each patch once as far as there are others, then again.
    pub(super) fn seeds(&self) -> Vec<Vec<usize>> {
        let mut scored: Vec<(f64, Vec<usize>)> = Vec::new();
        let mut neighbours = vec![Vec::new(); self.count()];
        let apart = self.second_m.keys().filter(|(a, b)| self.across_m(*a, *b).is_some());
        apart.for_each(|&(a, b)| neighbours[b].push(a));
        for (i, of_i) in neighbours.iter().enumerate() {
            let of_i: Vec<usize> = of_i.iter().copied().step_by(of_i.len().div_ceil(NEIGHBOURS).max(1)).collect();
            self.problem.cancel.check();
            for &j in &of_i {
                if self.problem.dimensions == 2 {
                    scored.extend(self.span(&[i, j]).map(|span| (span, vec![i, j])));
                    continue;
                }
                let thirds = of_i.iter().filter(|&&k| k < j);
                scored.extend(thirds.filter_map(|&k| Some((self.span(&[i, j, k])?, vec![i, j, k]))));
            }
        }
        if scored.is_empty() {
            return (0..SEEDS.min(self.count())).map(|number| self.group(number)).collect();
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

    /// Smallest eigenvalue of the Gram matrix of patches about the stations; `None` unless all see one another.
    fn span(&self, seed: &[usize]) -> Option<f64> {
        let mut gram = Matrix3::zeros();
        for (r, &a) in seed.iter().enumerate() {
            gram[(r, r)] = self.range_m(a)?.powi(2);
            for (c, &b) in seed[..r].iter().enumerate() {
                let across_m = self.across_m(a, b)?;
                gram[(r, c)] = 0.5 * (self.range_m(a)?.powi(2) + self.range_m(b)?.powi(2) - across_m.powi(2));
                gram[(c, r)] = gram[(r, c)];
            }
        }
        if self.problem.dimensions == 2 {
            // No third direction, and none that could be the smallest.
            gram[(2, 2)] = gram.trace();
        }
        Some(gram.symmetric_eigenvalues().min())
    }

    /// Patches that many paths join: always the one with most paths to those before it, until paths outnumber unknowns.
    fn group(&self, number: usize) -> Vec<usize> {
        let dimensions = self.problem.dimensions;
        let mut order: Vec<usize> = (0..self.count()).collect();
        // Patches with many paths first, their order otherwise another for each group.
        order.sort_by_key(|&patch| (Reverse(self.of_patch[patch].len()), Dice::new(patch as u64, number as u64).0));
        let mut group = vec![order[0]];
        let mut inner = self.joining(&[], order[0]);
        while inner < dimensions * group.len() + SURPLUS && group.len() < order.len() {
            self.problem.cancel.check();
            let others = order.iter().filter(|patch| !group.contains(patch));
            let joined = others.map(|&patch| (self.joining(&group, patch), patch));
            // Of equals the first in order.
            let (more, patch) = joined.rev().max_by_key(|(more, _)| *more).expect("others are left");
            inner += more;
            group.push(patch);
        }
        group
    }

    /// Different paths over a patch and otherwise only patches of a group.
    fn joining(&self, group: &[usize], patch: usize) -> usize {
        let mut paths: Vec<Vec<usize>> = Vec::new();
        for &n in &self.of_patch[patch] {
            let mut over: Vec<usize> = patches(&self.problem.observations[n]).collect();
            over.sort_unstable();
            if over.iter().all(|other| *other == patch || group.contains(other)) {
                paths.push(over);
            }
        }
        paths.sort();
        paths.dedup();
        paths.len()
    }
}

/// Numbers that look random and are always the same (Steele, Lea and Flood's SplitMix64).
pub(super) struct Dice(u64);

impl Dice {
    pub(super) fn new(a: u64, b: u64) -> Self {
        let mut dice = Self(a.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ b.wrapping_mul(0xD1B5_4A32_D192_ED03));
        Self(dice.next())
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// Between 0 and 1.
    pub(super) fn throw(&mut self) -> f64 {
        (self.next() >> 11) as f64 * 0.5_f64.powi(53)
    }

    /// Nearly normal: the sum of twelve throws.
    fn bell(&mut self) -> f64 {
        (0..12).map(|_| self.throw()).sum::<f64>() - 6.0
    }
}
