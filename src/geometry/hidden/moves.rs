//! Adding, moving and dropping hidden surfaces.

use rayon::prelude::*;

use super::climb::Estimate;
use super::explanation::{Claims, Explanation};
use super::surface::Surface;
use super::{Hidden, ROUNDS, SEEN};
use crate::Point;

/// Least and largest share of ways on which a patch is taken to be seen.
const SEEN_RANGE: [f64; 2] = [0.3, 0.98];
/// A patch that moves by more standard deviations explains other arrivals than before.
const FAR: f64 = 0.5;
/// Rounds of climbing all patches, plus one for each that is dropped, and the move in standard deviations that ends
/// them.
const POLISH: usize = 12;
const SETTLED: f64 = 2e-4;
/// All messages settle again before one in this many surfaces is new.
const UNSETTLED: usize = 3;
/// Patches that are tried together, and the evidence that they must bring.
const TOGETHER: usize = 4;
const GAIN: f64 = 1.0;

impl Explanation<'_> {
    /// Adds the sure patches and planes that minimal sets lead to, until these lead to no more.
    pub(super) fn add_seeds(&mut self, claims: Claims) {
        for _ in 0..ROUNDS {
            let mut starts = self.seeds(claims);
            starts.extend(self.plane_seeds(claims));
            if !self.add(&starts) {
                break;
            }
        }
    }

    /// Adds the sure ones among the tops near some starts, and says whether there are more then.
    pub(super) fn add(&mut self, starts: &[(Surface, Point)]) -> bool {
        let before = self.surfaces.len();
        let mut places = self.tops(starts);
        let mut unsettled = 0;
        while let Some(next) =
            places.iter().position(|place| self.hidden(*place, SEEN).is_some_and(|hidden| self.is_sure(&hidden)))
        {
            // What came before it was not sure and will not become so by more patches.
            let Estimate { surface, point, .. } = places[next];
            places.drain(..=next);
            let place = self.view(surface, self.left(), SEEN).climb(point);
            if let Some(hidden) = self.hidden(place, SEEN).filter(|hidden| self.is_sure(hidden)) {
                self.surfaces.push(hidden);
                unsettled += 1;
                if unsettled >= self.surfaces.len() / UNSETTLED {
                    self.settle();
                    unsettled = 0;
                } else {
                    self.claim(&hidden);
                }
            }
        }
        if unsettled > 0 {
            self.settle();
        }
        if self.surfaces.len() == before {
            return false;
        }
        self.polish();
        self.surfaces.len() > before
    }

    /// Adds patches that are not sure alone, the likeliest first, but may be together: what one explains is no longer
    /// clutter to the others. Says whether they stay.
    pub(super) fn add_together(&mut self, first: Hidden) -> bool {
        let before = (self.surfaces.clone(), self.total());
        let mut next = Some(first);
        for left in (0..TOGETHER).rev() {
            let Some(hidden) = next else { break };
            self.surfaces.push(hidden);
            self.settle();
            for _ in 0..3 {
                self.climb_all();
            }
            next = if left > 0 { self.likeliest() } else { None };
        }
        self.polish();
        let better = self.total() > before.1 + GAIN;
        if !better {
            self.surfaces = before.0;
            self.settle();
        }
        better
    }

    /// The likeliest place for one more patch, sure or not.
    pub(super) fn likeliest(&self) -> Option<Hidden> {
        self.hidden(*self.tops(&self.cubes()).first()?, SEEN)
    }

    /// Evidence of all.
    fn total(&self) -> f64 {
        self.surfaces.iter().map(|patch| patch.evidence).sum()
    }

    /// Climbs all again, each with what the others leave; the longest move in standard deviations.
    fn climb_all(&mut self) -> f64 {
        let mut moved = 0.0_f64;
        let climbed: Vec<Hidden> = (0..self.surfaces.len()).into_par_iter().map(|n| self.climbed(n)).collect();
        for (n, next) in climbed.into_iter().enumerate() {
            let step = |next: &Hidden, now: &Hidden| (next.point - now.point).norm() / self.sd_m;
            let far = step(&next, &self.surfaces[n]);
            moved = moved.max(far);
            if far > FAR {
                // Others that compete for the same arrivals would all follow.
                self.settle();
                self.surfaces[n] = self.climbed(n);
                self.settle();
            } else {
                self.surfaces[n] = next;
            }
        }
        self.settle();
        moved
    }

    /// A surface where it is likeliest near its place.
    fn climbed(&self, n: usize) -> Hidden {
        let (left, now) = (self.left_for(n), self.surfaces[n]);
        let place = self.view(now.surface, &left, now.seen).climb(now.point);
        let share = (place.arrivals + 2.0 * SEEN) / (place.clear + 2.0);
        let seen = share.clamp(SEEN_RANGE[0], SEEN_RANGE[1]);
        self.hidden(place, seen).unwrap_or(Hidden { evidence: f64::NEG_INFINITY, ..now })
    }

    /// Climbs all again, each with what the others leave, and drops those without evidence, the least first.
    fn polish(&mut self) {
        let places = |all: &Self| all.surfaces.iter().map(|hidden| hidden.point).collect::<Vec<Point>>();
        let mut before = [Vec::new(), Vec::new()];
        for _ in 0..POLISH + self.surfaces.len() {
            let moved = self.climb_all();
            let worst = (0..self.surfaces.len())
                .min_by(|&a, &b| self.surfaces[a].evidence.total_cmp(&self.surfaces[b].evidence));
            if let Some(worst) = worst.filter(|&worst| !self.is_sure(&self.surfaces[worst])) {
                self.surfaces.remove(worst);
                self.settle();
                before = [Vec::new(), Vec::new()];
                continue;
            }
            // Two neighbours that share an arrival may go to and fro without end.
            let now = places(self);
            let is_back = now.len() == before[0].len()
                && now.iter().zip(&before[0]).all(|(a, b): (&Point, &Point)| (a - b).norm() < SETTLED * self.sd_m);
            if moved < SETTLED || is_back {
                break;
            }
            before = [std::mem::take(&mut before[1]), now];
        }
    }
}
