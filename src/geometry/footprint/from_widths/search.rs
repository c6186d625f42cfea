//! The least of many minima: from several starts, then from wherever turning one patch leads all.

use std::ops::Range;

use nalgebra::Vector3;
use periscope_cancel::Cancel;

use super::{CERTAIN, Fit, LINEAR, TIGHTER, TOGETHER};

/// Rounds over all patches, and those in which normals are searched for from all directions.
const ROUNDS: usize = 40;
const WIDE_ROUNDS: Range<usize> = 2..20;
const STARTS: usize = 8;
/// Starts are so far from where a patch's light goes on average, in that direction's length.
const ASIDE: f64 = 0.9;
/// Rounds in which better places of single patches are searched for, all others held.
const SEARCHES: usize = 4;
/// Steps of all patches after one was turned, and the loss that a round over all patches must gain for another.
const STEPS_TURNED: usize = 20;
const LEAST_GAIN: f64 = 0.1;
/// A patch that is turned has at least this share of the middle size.
const LEAST_SIZE: f64 = 0.3;
/// Directions that a normal is searched from: corners and faces of half a cube; then its edges.
const DIRECTIONS: [[f64; 3]; 13] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [1.0, 1.0, -1.0],
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [1.0, 1.0, 0.0],
    [1.0, -1.0, 0.0],
    [1.0, 0.0, 1.0],
    [1.0, 0.0, -1.0],
    [0.0, 1.0, 1.0],
    [0.0, 1.0, -1.0],
];
const COARSE: usize = 7;

fn direction(n: usize) -> Vector3<f64> {
    Vector3::from(DIRECTIONS[n]).normalize()
}

impl Fit<'_> {
    /// The best of the minima that are reached from several starts.
    pub(super) fn best_of_starts(&self, open: &[usize], cancel: &Cancel) -> Self {
        let mut fit = self.settled(open, 0, cancel);
        for start in 1..if self.vectors_m.len() > CERTAIN { 1 } else { STARTS } {
            let other = self.settled(open, start, cancel);
            if other.total(open) < fit.total(open) {
                fit = other;
            }
        }
        fit
    }

    /// The minimum that is reached by searching on: few patches are turned, of many each is moved with others held.
    pub(super) fn searched(mut self, open: &[usize], cancel: &Cancel) -> Self {
        if self.vectors_m.len() <= CERTAIN {
            return self.turned(open, cancel);
        }
        for _ in 0..SEARCHES {
            let mut other = self.clone();
            for &patch in open {
                cancel.check();
                other.improve(patch, true);
            }
            other.settle_together(open, cancel);
            if other.total(open) >= self.total(open) {
                break;
            }
            self = other;
        }
        self
    }

    /// The minimum that is reached from one start.
    fn settled(&self, open: &[usize], start: usize, cancel: &Cancel) -> Self {
        let mut fit = self.clone();
        for &patch in open {
            let other = direction((patch * (start + 1) + start) % COARSE);
            let front = fit.front(patch).try_normalize(0.0).unwrap_or(other);
            let direction = if start == 0 { front } else { front + ASIDE * other };
            fit.vectors_m[patch] = direction.try_normalize(0.0).unwrap_or(other) * fit.start_m(patch);
        }
        if open.len() <= TOGETHER {
            fit.settle_together(open, cancel);
            return fit;
        }
        for round in 0..ROUNDS {
            for &patch in open {
                cancel.check();
                fit.improve(patch, WIDE_ROUNDS.contains(&round));
            }
            fit.improve_common(open);
            fit.set_usual();
            fit.linear = f64::max(LINEAR, TIGHTER * fit.linear);
        }
        fit
    }

    /// The minimum that is reached where each patch in turn is turned to all sides, and all settle after it: most wrong
    /// minima have a patch or two that face wrong, and neighbours that went along.
    fn turned(mut self, open: &[usize], cancel: &Cancel) -> Self {
        loop {
            let before = self.total(open);
            for &patch in open {
                let mut best = (self.total(open), self.clone());
                for other in self.turns(open, patch, cancel) {
                    let total = other.total(open);
                    if total < best.0 {
                        best = (total, other);
                    }
                }
                self = best.1;
            }
            self.settle_together(open, cancel);
            if self.total(open) > before - LEAST_GAIN {
                return self;
            }
        }
    }

    /// Where one patch is turned to each side in turn, and all settle after it.
    pub(super) fn turns(&self, open: &[usize], patch: usize, cancel: &Cancel) -> impl Iterator<Item = Self> {
        let length_m = f64::max(self.vectors_m[patch].norm(), LEAST_SIZE * self.usual_m);
        (0..DIRECTIONS.len()).map(move |n| {
            cancel.check();
            let mut other = self.clone();
            other.vectors_m[patch] = other.descend(patch, length_m * direction(n)).1;
            other.descend_together(open, STEPS_TURNED, cancel);
            other
        })
    }

    /// A better vector for one patch, all others held; searched for from other directions too if `anew`.
    fn improve(&mut self, patch: usize, anew: bool) {
        let mut best = (self.loss(patch, self.vectors_m[patch]), self.vectors_m[patch]);
        let size_m = self.start_m(patch);
        let directions = (0..COARSE).filter(|_| anew).map(|n| direction(n) * size_m);
        let starts: Vec<Vector3<f64>> = std::iter::once(best.1).chain(directions).collect();
        for start_m in starts {
            let descended = self.descend(patch, start_m);
            if descended.0 < best.0 {
                best = descended;
            }
        }
        self.vectors_m[patch] = best.1;
    }
}
