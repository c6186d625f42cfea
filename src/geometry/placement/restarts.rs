//! Other solutions that no mirror image makes.
//!
//! Lengths that determine a few patches barely, among one another and to the rest, may be met by places that no
//! mirroring leads to. Such groups are sought by chance: patches with few pairs, with some of their neighbours, are
//! brought down from random places.

use super::starts::Dice;
use super::{Measurements, STEPS, State};
use crate::{Point, procrustes};

/// Most patches of a whole that is searched; larger ones are tied better.
const MOST: usize = 24;
/// A patch with more neighbours is determined by these, whatever theirs are.
const FEW: usize = 4;
/// Patches with few neighbours that groups begin with, and groups that begin with each.
const FIRST: usize = 12;
const TRIES: usize = 24;
/// Rounds in which patches that lie elsewhere lose weight.
const ROUNDS: usize = 20;
/// Sizes of groups: from two on.
const SIZES: usize = 4;

impl Measurements<'_> {
    /// Places whose loss is at most `more` above that of the best ones, none twice.
    pub(super) fn restarted(&self, best: &State, more: f64) -> Vec<State> {
        let next = self.neighbours();
        // A turn about two stations is not taken back here.
        if self.count() > MOST || self.frame.free_rotations() == 1 && self.problem.dimensions == 3 {
            return Vec::new();
        }
        // One that is tied to all others is as well tied as it can be.
        let is_weak = |patch: &usize| {
            next[*patch].len() <= FEW && next[*patch].len() + 1 < self.count() && !self.open.contains(patch)
        };
        let mut others: Vec<State> = Vec::new();
        for first in (0..self.count()).filter(is_weak).take(FIRST) {
            self.problem.cancel.check();
            for attempt in 0..TRIES {
                let number = (first * TRIES + attempt) as u64;
                let mut dice = Dice::new(first as u64, number);
                let mut group = vec![first];
                for _ in 0..=attempt % SIZES {
                    let from = group[(dice.throw() * group.len() as f64) as usize];
                    let free: Vec<usize> = next[from].iter().copied().filter(|one| !group.contains(one)).collect();
                    group.extend(free.get((dice.throw() * free.len() as f64) as usize));
                }
                let mut places = best.places.clone();
                group.iter().for_each(|&patch| places[patch] = Some(self.guess(patch, number)));
                let other = self.turned_onto(self.settle(places, STEPS), best);
                let is_new = |old: &State| !self.elsewhere(&other, old).is_empty();
                if other.loss < best.loss + more && is_new(best) && others.iter().all(is_new) {
                    others.push(other);
                }
            }
        }
        others
    }

    /// Turned and mirrored, where nothing fixes the frame, such that most patches lie where the best ones are.
    fn turned_onto(&self, mut state: State, best: &State) -> State {
        if self.frame.free_rotations() == 0 {
            return state;
        }
        let centre = self.frame.centre;
        let (points, targets) = (state.points(), best.points());
        let mut turned = points.clone();
        for _ in 0..ROUNDS {
            // Patches that lie elsewhere weigh little.
            let weight = |(patch, (a, b)): (usize, (&Point, &Point))| {
                if self.open.contains(&patch) { 0.0 } else { self.apart_m / (a - b).norm().hypot(self.apart_m) }
            };
            let weights: Vec<f64> = turned.iter().zip(&targets).enumerate().map(weight).collect();
            let weighted = |all: &[Point]| -> Vec<Point> {
                all.iter().zip(&weights).map(|(point, weight)| centre + *weight * (point - centre)).collect()
            };
            let turn = procrustes::rotation(&weighted(&points), &weighted(&targets), centre, true).matrix;
            turned = points.iter().map(|point| procrustes::turn(&turn, centre, *point)).collect();
        }
        state.places = turned.into_iter().map(Some).collect();
        state
    }
}
