//! Moves of single patches to other places that their ties allow.

use super::{SAME, STEPS, Scene, State};
use crate::geometry::{Point, multilateration};

/// A move that raises the loss by more than this, all other patches held, is not worth settling.
const HOPELESS: f64 = 300.0;
/// Moves that are settled in a round, and rounds.
const MOVES: usize = 15;
const ROUNDS: usize = 20;

impl Scene<'_> {
    /// Moves patches while that lowers the loss of all.
    pub(super) fn mend(&self, mut now: State) -> State {
        for _ in 0..ROUNDS {
            let better = self.moves(&now).into_iter().take(MOVES).find_map(|(patch, point)| {
                let then = self.moved(&now, patch, point);
                (then.loss < now.loss - SAME).then_some(then)
            });
            match better {
                Some(better) => now = better,
                None => break,
            }
        }
        now
    }

    /// Patch and place of all moves with some hope, most promising first.
    pub(super) fn moves(&self, now: &State) -> Vec<(usize, Point)> {
        let mut moves = Vec::new();
        for (patch, here) in now.points().into_iter().enumerate() {
            let ties = self.ties(patch, now);
            let cost = multilateration::cost(&ties, here);
            let found = multilateration::candidates(&ties, self.problem.dimensions, self.apart_m);
            let elsewhere = found.into_iter().filter(|candidate| (candidate.point - here).norm() > self.apart_m);
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
