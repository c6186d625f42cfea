//! Growth of a solution, patch by patch.
//!
//! Next comes the patch whose best place explains its ties by the largest margin over its second best; among equals,
//! the one with most ties. Every few patches all are settled together, so that errors do not pile up.

use super::{Measurements, State};
use crate::Point;
use crate::multilateration::{self, Candidate};

/// Patches that are placed between two settlements of all.
const BETWEEN: usize = 6;
/// Steps of a settlement on the way.
const STEPS_BETWEEN: usize = 10;
/// A place whose loss is lower than the second best's by this many times its own is safe.
const SAFE: f64 = 30.0;

/// A patch that can be placed.
pub(super) struct Next {
    clearness: f64,
    ties: usize,
    patch: usize,
    point: Point,
}

impl Measurements<'_> {
    /// Places for all patches, grown from those that have one; the last of them are not settled.
    pub(super) fn grow(&self, mut state: State) -> State {
        let mut since = 0;
        loop {
            let mut next = self.next(&state);
            // With the clearest come others that are safe.
            let safe = next.iter().skip(1).take(BETWEEN - 1).take_while(|next| next.clearness >= SAFE).count();
            next.truncate(1 + safe);
            if next.is_empty() {
                let Some((patch, point)) = self.anywhere(&state) else { return state };
                next.push(Next { clearness: 0.0, ties: 0, patch, point });
            }
            next.iter().for_each(|next| state.places[next.patch] = Some(next.point));
            since += next.len();
            if since >= BETWEEN {
                since = 0;
                state = self.settle(state.places, STEPS_BETWEEN);
            }
        }
    }

    /// Patches that their ties determine, clearest first.
    pub(super) fn next(&self, state: &State) -> Vec<Next> {
        let dimensions = self.problem.dimensions;
        let of = |patch: usize| -> Option<Next> {
            self.problem.cancel.check();
            let ties = self.ties(patch, state);
            let candidates = multilateration::candidates(&ties, dimensions, self.apart_m, self.problem.loss);
            let gap = |best: &Candidate, second: &Candidate| ((second.cost - best.cost) / (1.0 + best.cost)).min(SAFE);
            let best = candidates.first()?;
            // Mirror images have the same loss.
            let certain = ties.len() > dimensions;
            let clearness = if certain { candidates.get(1).map_or(SAFE, |second| gap(best, second)) } else { 0.0 };
            Some(Next { clearness, ties: ties.len(), patch, point: best.point })
        };
        let unplaced = (0..self.count()).filter(|&patch| state.places[patch].is_none());
        let mut next: Vec<Next> = unplaced.filter_map(of).collect();
        next.sort_by(|a, b| b.clearness.total_cmp(&a.clearness).then(b.ties.cmp(&a.ties)));
        next
    }

    /// The patch with most ties, at a place that agrees with them, of those that they leave; `None` when all are in
    /// place.
    fn anywhere(&self, state: &State) -> Option<(usize, Point)> {
        let unplaced = (0..self.count()).filter(|&patch| state.places[patch].is_none());
        let tied = unplaced.map(|patch| (patch, self.ties(patch, state)));
        // Of equals the first.
        let (patch, ties) = tied.rev().max_by_key(|(_, ties)| ties.len())?;
        let point = multilateration::somewhere(&ties, self.problem.dimensions, self.problem.loss);
        Some((patch, point.unwrap_or_else(|| self.guess(patch, patch as u64))))
    }
}
