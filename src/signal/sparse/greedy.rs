//! The greedy growth and pruning of a fit.

use super::linear::Cholesky;
use super::model::{Model, Projection};
use super::refine::refine;
use super::search::{MatchedFilter, best_pair};
use super::{Profile, Response, SparseOptions};

/// Pulses farther apart than this many widths of the response are refined separately while candidates are compared.
const CLUSTER_WIDTHS: f64 = 2.5;
/// Largest move of a pulse in one step, in widths of the response.
const STEP_WIDTHS: f64 = 0.32;
/// A pulse is tried as two if the first-order drop of chi2 by widening it exceeds this part of the evidence asked for.
const WIDENED: f64 = 0.25;
/// Fewer degrees of freedom than this say nothing about the fit of one pulse.
const FREEDOM_MIN: f64 = 4.0;

/// What stays fixed during a fit.
pub(super) struct Fitter<'a> {
    model: Model<'a>,
    /// The record over its sd.
    data: Vec<f64>,
    width_ps: f64,
    filter: MatchedFilter,
    evidence_min: f64,
}

/// Pulses that fit the whole record best, near where they were started.
pub(super) struct State {
    fit: Projection,
    /// Record less pulses and baseline, over its sd.
    residual: Vec<f64>,
    baseline_v: f64,
    /// Factor of the products of all values and derivatives.
    factor: Cholesky,
}

/// A change of a state: the times of all pulses after it, and the drop of chi2 that it brings.
struct Change {
    times_ps: Vec<f64>,
    drop: f64,
}

impl<'a> Fitter<'a> {
    pub(super) fn new(profile: &Profile, response: &'a Response, options: &SparseOptions, evidence_min: f64) -> Self {
        let model = Model::new(profile, response, options);
        let data = profile.mean_v.iter().zip(&model.weights).map(|(y, w)| y * w).collect();
        let width_ps = response.width_ps();
        Self { filter: MatchedFilter::new(&model, width_ps, response.peak_ps()), model, data, width_ps, evidence_min }
    }

    /// The state without pulses.
    pub(super) fn start(&self) -> State {
        self.solve(Vec::new()).expect("nothing can coincide")
    }

    /// Refines all pulses together from the given times. `None` if two of them cannot be told apart.
    fn solve(&self, times_ps: Vec<f64>) -> Option<State> {
        let fit = self.refine(&self.data, times_ps)?;
        let mut residual = self.data.clone();
        for (column, a) in fit.columns.iter().zip(&fit.amplitudes) {
            column.add_to(&mut residual, -a);
        }
        let baseline_v = self.model.baseline(&residual);
        for (r, w) in residual.iter_mut().zip(&self.model.weights) {
            *r -= baseline_v * w;
        }
        Some(State { factor: fit.factor()?, fit, residual, baseline_v })
    }

    fn refine(&self, data: &[f64], times_ps: Vec<f64>) -> Option<Projection> {
        refine(&self.model, data, times_ps, STEP_WIDTHS * self.width_ps)
    }

    /// The state with one more pulse, if one is worth its evidence.
    pub(super) fn grow(&self, state: &State) -> Option<State> {
        let added = self
            .filter
            .best(&self.model, &state.residual)
            .filter(|(_, drop)| *drop > WIDENED * self.evidence_min)
            .and_then(|(time_ps, _)| self.change(state, &[], time_ps, &[time_ps]));
        let split = (0..state.pulses()).filter_map(|k| self.split(state, k));
        let best = added
            .into_iter()
            .chain(split)
            .max_by(|a, b| a.drop.total_cmp(&b.drop))
            .filter(|best| best.drop > self.evidence_min)?;
        self.solve(best.times_ps)
    }

    /// Pulse `k` replaced by the best pair in its place, if it looks widened.
    fn split(&self, state: &State, k: usize) -> Option<Change> {
        if self.model.signed || self.widening(state, k) < WIDENED * self.evidence_min {
            return None;
        }
        let mut alone = state.residual.clone();
        state.fit.columns[k].add_to(&mut alone, state.amplitude(k));
        let pair = best_pair(&self.model, &alone, state.time_ps(k), self.width_ps)?;
        self.change(state, &[k], state.time_ps(k), &pair)
    }

    /// Drop of chi2, to first order, by widening pulse `k`: the residual's product with the part of its second derivative that no shift or
    /// amplitude of any pulse can imitate. Two pulses close together look like one widened pulse.
    fn widening(&self, state: &State, k: usize) -> f64 {
        let widened = self.model.second_derivative(state.time_ps(k));
        let [with_residual, _] = widened.dot_record(&state.residual);
        if with_residual <= 0.0 {
            return 0.0;
        }
        let mut imitated: Vec<f64> = state.fit.columns.iter().flat_map(|c| widened.dot(c)[0]).collect();
        state.factor.solve_lower(&mut imitated);
        let own = widened.dot(&widened)[0][0] - imitated.iter().map(|v| v * v).sum::<f64>();
        with_residual * with_residual / own
    }

    /// Takes the pulses `out` away, puts pulses at `times_ps` in, and refines them with the pulses near `center_ps`; the others stay.
    fn change(&self, state: &State, out: &[usize], center_ps: f64, times_ps: &[f64]) -> Option<Change> {
        let near = |k: &usize| (state.time_ps(*k) - center_ps).abs() < CLUSTER_WIDTHS * self.width_ps;
        let (cluster, others): (Vec<usize>, Vec<usize>) = (0..state.pulses()).partition(near);
        let mut data = state.residual.clone();
        for k in &cluster {
            state.fit.columns[*k].add_to(&mut data, state.amplitude(*k));
        }
        let old = cluster.iter().map(|k| state.time_ps(*k)).collect();
        let old = self.model.project(&data, old)?;
        let start = cluster
            .iter()
            .filter(|k| !out.contains(k))
            .map(|k| state.time_ps(*k))
            .chain(times_ps.iter().copied())
            .collect();
        let new = self.refine(&data, start)?;
        let others = others.iter().map(|k| state.time_ps(*k));
        Some(Change { drop: new.energy - old.energy, times_ps: others.chain(new.times_ps).collect() })
    }

    /// Pulse `k` taken out. A neighbour that may have been split off from it starts from where one pulse would stand for both.
    fn removal(&self, state: &State, k: usize) -> Option<Change> {
        let distance = |j: usize| (state.time_ps(j) - state.time_ps(k)).abs();
        let neighbour = (0..state.pulses())
            .filter(|j| *j != k && distance(*j) < self.width_ps)
            .min_by(|i, j| distance(*i).total_cmp(&distance(*j)));
        let Some(j) = neighbour else {
            return self.change(state, &[k], state.time_ps(k), &[]);
        };
        let share = state.amplitude(k) / (state.amplitude(j) + state.amplitude(k));
        let shift_ps = if share.is_finite() { share * (state.time_ps(k) - state.time_ps(j)) } else { 0.0 };
        let merged_ps = state.time_ps(j) + shift_ps;
        self.change(state, &[j, k], state.time_ps(k), &[merged_ps])
    }

    /// Takes out pulses not worth their evidence, the weakest first. The state that remains, and the evidence of each of its pulses.
    pub(super) fn prune(&self, mut state: State) -> (State, Vec<f64>) {
        loop {
            let removals: Vec<Option<Change>> = (0..state.pulses()).map(|k| self.removal(&state, k)).collect();
            // Without a fit for the rest, a pulse is indispensable.
            let evidence = |r: &Option<Change>| r.as_ref().map_or(f64::INFINITY, |r| -r.drop);
            let evidences: Vec<f64> = removals.iter().map(evidence).collect();
            let fewer = removals
                .into_iter()
                .flatten()
                .max_by(|a, b| a.drop.total_cmp(&b.drop))
                .filter(|weakest| -weakest.drop < self.evidence_min)
                .and_then(|weakest| self.solve(weakest.times_ps));
            match fewer {
                Some(fewer) => state = fewer,
                None => return (state, evidences),
            }
        }
    }

    /// Chi2 over degrees of freedom, and these, of the record, or of the samples that pulse `k` reaches (of the record, if these are too few).
    pub(super) fn chi2_per_dof(&self, state: &State, k: Option<usize>) -> (f64, f64) {
        let columns = &state.fit.columns;
        let range = k.map_or(0..self.data.len(), |k| columns[k].range());
        let used = self.model.weights[range.clone()].iter().filter(|w| **w > 0.0).count() as f64;
        // A pulse takes its two unknowns from the samples that it reaches.
        let unknowns: f64 = columns
            .iter()
            .map(|c| {
                let both = c.range().end.min(range.end) as f64 - c.range().start.max(range.start) as f64;
                2.0 * both.max(0.0) / c.range().len() as f64
            })
            .sum();
        let share = used / self.data.len() as f64;
        let freedom = used - unknowns - self.model.offsets() as f64 * share;
        if k.is_some() && freedom < FREEDOM_MIN {
            return self.chi2_per_dof(state, None);
        }
        let chi2: f64 = state.residual[range].iter().map(|r| r * r).sum();
        (chi2 / freedom.max(1.0), freedom.max(1.0))
    }
}

impl State {
    pub(super) fn pulses(&self) -> usize {
        self.fit.times_ps.len()
    }

    pub(super) fn time_ps(&self, k: usize) -> f64 {
        self.fit.times_ps[k]
    }

    pub(super) fn amplitude(&self, k: usize) -> f64 {
        self.fit.amplitudes[k]
    }

    pub(super) fn baseline_v(&self) -> f64 {
        self.baseline_v
    }

    /// Covariance `(J^T J)^-1` of `(amplitude_0, time_0, amplitude_1, ..)`, row-major.
    pub(super) fn covariance(&self) -> Vec<f64> {
        let unknowns = 2 * self.pulses();
        // The derivative by a time is the amplitude times the derivative column.
        let scale = |i: usize| {
            if i % 2 == 1 { self.amplitude(i / 2) } else { 1.0 }
        };
        self.factor.inverse().iter().enumerate().map(|(e, v)| v / (scale(e / unknowns) * scale(e % unknowns))).collect()
    }
}
