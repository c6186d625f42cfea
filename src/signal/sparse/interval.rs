//! Standard deviations of the times of blended pulses, by the profile likelihood.
//!
//! The inverse of the information is of first order: it takes chi2 for a parabola. Along the times of two pulses that
//! are close against their sds chi2 is no parabola: a pulse that goes outwards becomes weaker and is held less. There
//! the interval of a time ends where chi2, all other unknowns fitted again, has risen by the square of a normal
//! quantile. The sd is half the interval over that quantile. Source: Venzon and Moolgavkar, J. R. Stat. Soc. C 37, 87
//! (1988).
//!
//! Not modelled: that one side is longer than the other, which no sd can say; that the time of pulses farther away is
//! not known either.

use super::greedy::Fitter;
use super::model::Model;
use super::place::Place;
use super::projection::Projection;
use super::refine::refine;
use super::state::State;

/// First order serves pulses that are farther apart than this many sds of either.
const CLEAR_SDS: f64 = 20.0;
/// Normal quantile of the interval: two-sided 95 %.
pub(super) const QUANTILE: f64 = 1.959_964;
/// Fits at most for one end of an interval, and the part of the quantile that it may miss.
const TRIALS: usize = 6;
const TOLERANCE: f64 = 0.02;
/// A trial lies no more than this many times as far out as those before.
const STRIDE: f64 = 3.0;

/// A pulse among those around it, all at their best.
pub(super) struct Blend<'a> {
    pub(super) model: &'a Model<'a>,
    /// Whitened records of these pulses alone.
    pub(super) data: Vec<Vec<f64>>,
    pub(super) places: Vec<Place>,
    pub(super) energy: f64,
    /// The pulse, among `places`.
    pub(super) k: usize,
    /// Its sd, ps, to first order.
    pub(super) sd_ps: f64,
}

impl Fitter<'_> {
    /// Factors of the first-order sds of all times: those of misfit, and more for blended pulses.
    pub(super) fn widenings(&self, state: &State) -> Vec<f64> {
        let sds_ps: Vec<f64> = (0..state.pulses()).map(|k| state.time_sd_ps(k)).collect();
        let widening = |k: usize| {
            let inflation = self.misfit(state, None, Some(k)).inflation();
            let is_close = |j: usize| {
                let apart_ps = (state.time_ps(j) - state.time_ps(k)).abs();
                j != k && apart_ps < CLEAR_SDS * inflation * sds_ps[j].max(sds_ps[k])
            };
            // A predicted time is held by its prior to where first order serves.
            let is_free = state.place(k).prior.is_none();
            let blend =
                (is_free && (0..state.pulses()).any(is_close)).then(|| self.blend(state, k, sds_ps[k])).flatten();
            blend.map_or(inflation, |blend| inflation.max(blend.half_width(inflation * QUANTILE) / QUANTILE))
        };
        (0..state.pulses()).map(widening).collect()
    }

    fn blend(&self, state: &State, k: usize, sd_ps: f64) -> Option<Blend<'_>> {
        let (cluster, data) = self.cluster(state, state.time_ps(k));
        let places: Vec<Place> = cluster.iter().map(|j| state.place(*j)).collect();
        let energy = Projection::new(&self.model, &data, places.clone())?.energy;
        let k = cluster.iter().position(|j| *j == k)?;
        Some(Blend { model: &self.model, data, places, energy, k, sd_ps })
    }
}

impl Blend<'_> {
    /// Half the interval, in sds, in which the root of the rise of chi2 stays below `goal`.
    pub(super) fn half_width(&self, goal: f64) -> f64 {
        0.5 * (self.end(-1.0, goal) + self.end(1.0, goal))
    }

    /// How many sds to one side the time is where the root of the rise of chi2 reaches `goal`: by secants, kept between
    /// trials inside and outside, and to the width of the response: a pulse farther away stands for something else.
    fn end(&self, side: f64, goal: f64) -> f64 {
        let (mut inside, mut outside) = (0.0, self.model.width_ps / self.sd_ps);
        let mut before = (0.0, 0.0);
        let mut near = self.places.clone();
        let mut sds = goal.min(outside);
        for _ in 0..TRIALS {
            let fit = self.fit_at(side * sds * self.sd_ps, &near);
            let root = fit.as_ref().map_or(f64::INFINITY, |fit| (self.energy - fit.energy).max(0.0).sqrt());
            if (root - goal).abs() < TOLERANCE * goal {
                break;
            }
            match fit {
                Some(fit) if root < goal => (inside, near) = (sds, fit.places),
                _ => outside = sds,
            }
            let secant = sds + (goal - root) * (sds - before.0) / (root - before.1);
            if root.is_finite() {
                before = (sds, root);
            }
            let is_between = inside < secant && secant < outside;
            sds = if is_between { secant } else { 0.5 * (inside + outside) }.min(STRIDE * sds);
        }
        sds
    }

    /// The fit with the time `away_ps` from its best and all else fitted again, from places `near`. `None` where the
    /// pulse has merged with another: it has passed it, or one of them has no amplitude.
    fn fit_at(&self, away_ps: f64, near: &[Place]) -> Option<Projection> {
        let mut start = near.to_vec();
        start[self.k] = Place { time_ps: self.places[self.k].time_ps + away_ps, is_pinned: true, ..near[self.k] };
        let fit = refine(self.model, &self.data, start)?;
        let is_later = |places: &[Place], j: usize| places[j].time_ps > places[self.k].time_ps;
        let stands = |j: usize| is_later(&fit.places, j) == is_later(&self.places, j) && fit.has_amplitude(j);
        (0..self.places.len()).all(stands).then_some(fit)
    }
}
