//! Moves of single patches to other places that their lengths allow.

use super::{Scene, Settled, Twin};
use crate::geometry::{Point, multilateration};

/// A move that raises the loss by more than this, all other patches held, is not worth settling.
const HOPELESS: f64 = 300.0;
/// Moves that are settled in a round, and rounds.
const MOVES: usize = 15;
const ROUNDS: usize = 20;
/// A loss that is lower by less has not fallen.
const FALLEN: f64 = 1e-3;
/// A second place whose loss is higher by less than this (three standard deviations) cannot be ruled out.
const TWIN: f64 = 9.0;

impl Scene<'_> {
    /// Moves patches while that lowers the loss of all.
    pub(super) fn mend(&self, mut now: Settled) -> Settled {
        for _ in 0..ROUNDS {
            let better = self.moves(&now).into_iter().take(MOVES).find_map(|(_, patch, point)| {
                let then = self.moved(&now, patch, point);
                (then.loss < now.loss - FALLEN).then_some(then)
            });
            match better {
                Some(better) => now = better,
                None => break,
            }
        }
        now
    }

    /// Second places of patches that explain the lengths about as well, most likely first.
    pub(super) fn twins(&self, best: &Settled) -> Vec<Twin> {
        let twin = |(_, patch, point): (f64, usize, Point)| {
            let other = self.moved(best, patch, point);
            let stayed_away = (other.points[patch] - best.points[patch]).norm() > self.apart_m;
            let more = other.loss - best.loss;
            (stayed_away && more < TWIN).then_some(Twin { patch, point: other.points[patch], more })
        };
        let mut twins: Vec<Twin> = self.moves(best).into_iter().filter_map(twin).collect();
        twins.sort_by(|a, b| a.more.total_cmp(&b.more).then(a.patch.cmp(&b.patch)));
        twins
    }

    /// Rise of the loss, patch and place of all moves with some hope, most promising first.
    fn moves(&self, now: &Settled) -> Vec<(f64, usize, Point)> {
        let mut moves = Vec::new();
        for (patch, &here) in now.points.iter().enumerate() {
            let ties = self.ties(patch, |other| Some(now.points[other]));
            let cost = multilateration::cost(&ties, here);
            let found = multilateration::candidates(&ties, self.lengths.dimensions, self.apart_m);
            let elsewhere = found.into_iter().filter(|candidate| (candidate.point - here).norm() > self.apart_m);
            moves.extend(elsewhere.map(|candidate| (candidate.cost - cost, patch, candidate.point)));
        }
        moves.retain(|(rise, _, _)| *rise < HOPELESS);
        moves.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        moves
    }

    fn moved(&self, from: &Settled, patch: usize, point: Point) -> Settled {
        let mut points = from.points.clone();
        points[patch] = point;
        self.settle(points)
    }
}
