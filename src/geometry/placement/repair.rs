//! Moves of single patches to other places that their ties allow, and of those that fit worst together.

use std::iter;

use super::{Measurements, SAME, STEPS, State, likely_loss};
use crate::{Point, multilateration};

/// A move that raises the loss by more than this, all other patches held, is not worth settling.
const HOPELESS: f64 = 300.0;
/// Moves that are settled in a round, and rounds.
const MOVES: usize = 15;
const ROUNDS: usize = 20;

impl Measurements<'_> {
    /// Moves patches while that lowers the loss of all.
    pub(super) fn repair(&self, mut now: State) -> State {
        for _ in 0..ROUNDS {
            let moves = self.moves(&now).into_iter().take(MOVES).map(|(patch, point)| self.moved(&now, patch, point));
            let better = moves.chain(iter::once_with(|| self.replanted(&now)).flatten());
            let Some(better) = better.into_iter().find(|then| then.loss < now.loss - SAME) else { break };
            now = better;
        }
        now
    }

    /// All settled with the patches that fit worst placed anew, at most a quarter of all; `None` where all fit. Patches
    /// that hold one another in wrong places come free in this way.
    fn replanted(&self, now: &State) -> Option<State> {
        let misfit = |(patch, here): (usize, Point)| {
            let ties = self.ties(patch, now);
            multilateration::cost(&ties, here, self.problem.loss) / likely_loss(ties.len() as f64)
        };
        let misfits = now.points().into_iter().enumerate().map(|place| (misfit(place), place.0));
        let mut worst: Vec<(f64, usize)> = misfits.filter(|(misfit, _)| *misfit > 1.0).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        worst.truncate(self.count().div_ceil(4));
        let mut places = now.places.clone();
        worst.iter().for_each(|&(_, patch)| places[patch] = None);
        (!worst.is_empty()).then(|| self.settle(self.grow(self.settle(places, STEPS)).places, STEPS))
    }

    /// Patch and place of all moves with some hope, most promising first.
    pub(super) fn moves(&self, now: &State) -> Vec<(usize, Point)> {
        let mut moves = Vec::new();
        for (patch, here) in now.points().into_iter().enumerate().filter(|(patch, _)| !self.open.contains(patch)) {
            self.problem.cancel.check();
            let ties = self.ties(patch, now);
            let cost = multilateration::cost(&ties, here, self.problem.loss);
            let candidates =
                multilateration::candidates(&ties, self.problem.dimensions, self.apart_m, self.problem.loss);
            let elsewhere = candidates.into_iter().filter(|candidate| (candidate.point - here).norm() > self.apart_m);
            moves.extend(elsewhere.map(|candidate| (candidate.cost - cost, patch, candidate.point)));
        }
        moves.retain(|(rise, _, _)| *rise < HOPELESS);
        moves.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        moves.into_iter().map(|(_, patch, point)| (patch, point)).collect()
    }

    /// All settled with a patch elsewhere.
    pub(super) fn moved(&self, from: &State, patch: usize, point: Point) -> State {
        let mut places = from.places.clone();
        places[patch] = Some(point);
        self.settle(places, STEPS)
    }
}
