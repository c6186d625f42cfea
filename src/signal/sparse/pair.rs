//! The runner-up of a widened pulse: the best two points in its place.
//!
//! One wide pulse and two points a little apart differ only from the fourth moment of the light on. Of one profile
//! alone the choice between them is often open; who knows where paths end can decide it. So the loser is kept.

use super::greedy::Fitter;
use super::interval::{Blend, QUANTILE};
use super::place::Place;
use super::projection::Projection;
use super::refine::refine;
use super::search::best_pair;
use super::state::{Misfit, State};

/// Two points in the place of one widened pulse, their neighbours fitted again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Arrivals, ps, the earlier first.
    pub times_ps: [f64; 2],
    /// Covariance of the arrivals, ps^2: of the first, of both, of the second.
    pub covariance_ps2: [f64; 3],
    /// Amplitudes, as of a [`super::Pulse`].
    pub amplitudes_v: [f64; 2],
    /// Chi2 of the widened pulse less that of the pair: positive where the pair fits better. Where noise does not
    /// explain the samples even of the better one, over its chi2 per degree of freedom: misfit is no evidence.
    pub gain: f64,
}

/// The pair as all records of a fit see it.
pub(super) struct PairFit {
    times_ps: [f64; 2],
    covariance_ps2: [f64; 3],
    /// Of each group of records.
    amplitudes: Vec<[f64; 2]>,
    gain: f64,
}

/// Light that is wider than predicted by more than so many standard deviations of that may be other light beside it.
const WIDER_SDS: f64 = 1.0;

impl PairFit {
    /// As the records of group `g` see it.
    pub(super) fn of_group(&self, g: usize) -> Pair {
        Pair {
            times_ps: self.times_ps,
            covariance_ps2: self.covariance_ps2,
            amplitudes_v: self.amplitudes[g],
            gain: self.gain,
        }
    }
}

impl Fitter<'_> {
    /// For each pulse that is widened, and wider than predicted, the best pair of points in its place; `None` for
    /// others, and where no pair stands by itself.
    pub(super) fn pairs(&self, state: &State) -> Vec<Option<PairFit>> {
        let is_wider = |[off, information]: [f64; 2]| off * information.sqrt() > WIDER_SDS;
        let is_widened = |k: &usize| state.place(*k).shapes() > 0 && state.place(*k).pull(1).is_none_or(is_wider);
        (0..state.pulses()).map(|k| Some(k).filter(is_widened).and_then(|k| self.runner_up(state, k))).collect()
    }

    fn runner_up(&self, state: &State, k: usize) -> Option<PairFit> {
        if self.model.signed {
            return None;
        }
        let time_ps = state.time_ps(k);
        let (cluster, data) = self.cluster(state, time_ps);
        let start = best_pair(&self.model, &self.alone(state, &[k]), time_ps)?;
        let own = cluster.iter().map(|j| state.place(*j)).collect();
        let own = Projection::new(&self.model, &data, own)?;
        let kept = cluster.iter().filter(|j| **j != k).map(|j| state.place(*j));
        let fit = refine(&self.model, &data, kept.chain(start.map(Place::point)).collect())?;
        let (first, second) = in_order(&fit)?;
        let gain = fit.energy - own.energy;
        let (inverse, unknowns) = (fit.factor()?.inverse(), fit.unknowns());
        let covariance_ps2 = |a: usize, b: usize| inverse[fit.time_unknown(a) * unknowns + fit.time_unknown(b)];
        let misfit = self.misfit(state, None, Some(k));
        let of_better = Misfit { chi2: misfit.chi2 - gain.max(0.0), ..misfit }.inflation();
        let inflation = Misfit { chi2: misfit.chi2 - gain, ..misfit }.inflation();
        // A first-order sd holds for pulses that are far apart against it; these are not.
        let widening = |k: usize| {
            let (data, places) = (data.clone(), fit.places.clone());
            let sd_ps = covariance_ps2(k, k).sqrt();
            let blend = Blend { model: &self.model, data, places, energy: fit.energy, k, sd_ps };
            inflation.max(blend.half_width(inflation * QUANTILE) / QUANTILE)
        };
        let [of_first, of_second] = [first, second].map(widening);
        Some(PairFit {
            times_ps: [fit.places[first].time_ps, fit.places[second].time_ps],
            covariance_ps2: [
                covariance_ps2(first, first) * of_first * of_first,
                covariance_ps2(first, second) * of_first * of_second,
                covariance_ps2(second, second) * of_second * of_second,
            ],
            amplitudes: fit.groups.iter().map(|g| [g.amplitudes[first], g.amplitudes[second]]).collect(),
            gain: gain / (of_better * of_better),
        })
    }
}

/// The last two places of a fit, the earlier first; `None` where one of them has no light.
fn in_order(fit: &Projection) -> Option<(usize, usize)> {
    let (a, b) = (fit.places.len() - 2, fit.places.len() - 1);
    let stand = fit.has_amplitude(a) && fit.has_amplitude(b);
    let is_ordered = fit.places[a].time_ps <= fit.places[b].time_ps;
    stand.then_some(if is_ordered { (a, b) } else { (b, a) })
}
