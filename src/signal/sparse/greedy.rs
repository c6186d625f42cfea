//! The greedy growth and pruning of a fit.

use super::column::Column;
use super::model::Model;
use super::place::{Place, Spread};
use super::prediction::Prediction;
use super::projection::Projection;
use super::refine::refine;
use super::search::{MatchedFilter, best_pair};
use super::state::{Misfit, State};

/// Pulses farther apart than this many widths of the response are refined separately while candidates are compared:
/// Gaussian columns overlap by 2e-4 there. The change that is made is refined with all pulses.
const CLUSTER_WIDTHS: f64 = 2.5;
/// A pulse is tried as two if the first-order drop of chi2 by widening it exceeds this part of the evidence asked for.
const WIDENED: f64 = 0.25;
/// Drop of chi2 that the width, or the tail, of a pulse far from others must be worth: it makes no new pulse and costs
/// the time little, and left out it moves the time. Between blended pulses a needless width costs much, and must be
/// worth what a pulse is.
const WIDTH_EVIDENCE: f64 = 4.0;
/// Chi2 of the samples of a widened pulse may lie this many of its standard deviations below its mean and still hide a
/// misfit.
const EXCESS_SIGMA: f64 = 3.0;
/// Fewer degrees of freedom than this say nothing about the fit of one pulse.
const FREEDOM_MIN: f64 = 4.0;

/// What stays fixed during a fit.
pub(super) struct Fitter<'a> {
    pub(super) model: Model<'a>,
    /// The records, whitened, and freed of what lies under their pulses.
    data: Vec<Vec<f64>>,
    /// The constant under each, if it had no pulse.
    means_v: Vec<f64>,
    /// Chi2 of all records, if they had no pulse, with what the ground under the pulses costs.
    cost: f64,
    filter: MatchedFilter,
    evidence_min: f64,
    pulses_max: usize,
    /// Pulses to start from.
    predicted: Vec<Place>,
    /// Excess kurtosis of each sample's noise, of each record; nothing for Gaussian noise.
    kurtosis: Vec<Vec<f64>>,
}

/// A direction beside the unknowns of a fit.
pub(super) struct Slope {
    /// Its product with the residuals.
    pub(super) with_residual: f64,
    /// Information on its amplitude, that which the unknowns can imitate left out.
    pub(super) own: f64,
    /// By how much each unknown falls where its amplitude rises by one.
    pub(super) imitation: Vec<f64>,
}

/// A change of a state: the places of all pulses after it, the drop of chi2 that it brings, and what that must exceed.
struct Change {
    places: Vec<Place>,
    drop: f64,
    cost: f64,
}

impl<'a> Fitter<'a> {
    pub(super) fn new(model: Model<'a>, means_v: &[&[f64]], evidence_min: f64, pulses_max: usize) -> Self {
        let whitened: Vec<Vec<f64>> =
            model.records.iter().zip(means_v).map(|(record, mean_v)| record.whitener.apply(mean_v)).collect();
        let both = || model.records.iter().zip(&whitened);
        let data: Vec<Vec<f64>> = both().map(|(record, whitened)| record.nuisance.without(whitened)).collect();
        let means_v = both().map(|(record, whitened)| record.nuisance.mean_v(0, whitened.iter().copied())).collect();
        let chi2 = whitened.iter().zip(&data).flat_map(|(raw, free)| raw.iter().zip(free).map(|(a, b)| a * b));
        let determinants = model.records.iter().map(|record| record.nuisance.log_determinant());
        let cost = chi2.sum::<f64>() + determinants.sum::<f64>();
        let kurtosis = vec![Vec::new(); model.records.len()];
        Self {
            filter: MatchedFilter::new(&model),
            model,
            data,
            means_v,
            cost,
            evidence_min,
            pulses_max,
            predicted: Vec::new(),
            kurtosis,
        }
    }

    /// From pulses that are predicted, those outside of a record left out.
    pub(super) fn starting_from(mut self, predictions: &[Prediction]) -> Self {
        let places = predictions.iter().map(|pulse| pulse.place(self.model.width_ps, self.model.extent_max_ps));
        self.predicted = places.filter(|place| self.model.is_inside(place.time_ps)).collect();
        self
    }

    /// With noise in record 0 that is not Gaussian.
    pub(super) fn with_kurtosis(mut self, kurtosis: Vec<f64>) -> Self {
        self.kurtosis[0] = kurtosis;
        self
    }

    /// Where a pulse must be worth at least this share of what the strongest is: what is less may be what an error of
    /// the response makes of the strongest.
    pub(super) fn with_least_share(mut self, share: f64) -> Self {
        if share > 0.0 {
            let strongest = self.filter.best(&self.model, &self.data).map_or(0.0, |(_, drop)| drop);
            self.evidence_min = self.evidence_min.max(share * strongest);
        }
        self
    }

    /// The state with the pulses that are predicted. Where two of them cannot be told apart, the later of the list is
    /// left out.
    fn start(&self) -> State {
        self.solve(self.predicted.clone()).unwrap_or_else(|| {
            let nothing = self.solve(Vec::new()).expect("nothing can coincide");
            self.predicted.iter().fold(nothing, |state, place| {
                self.solve([state.fit.places.as_slice(), &[*place]].concat()).unwrap_or(state)
            })
        })
    }

    /// The state with all pulses that are worth their evidence, and the evidence of each.
    pub(super) fn grown(&self) -> (State, Vec<f64>) {
        let mut state = self.start();
        while let Some(grown) = self.grow(&state) {
            state = grown;
        }
        self.prune(state)
    }

    /// Chi2 of a state, with what its pulses and the ground under them cost: twice the negative logarithm of its
    /// likelihood, but for a constant.
    pub(super) fn cost(&self, state: &State) -> f64 {
        self.cost - state.fit.energy + self.evidence_min * state.pulses() as f64
    }

    /// Refines all pulses together from the given places. `None` if two of them cannot be resolved.
    fn solve(&self, places: Vec<Place>) -> Option<State> {
        let fit = refine(&self.model, &self.data, places)?;
        let mut residuals = self.data.clone();
        let mut baselines_v = self.means_v.clone();
        for (group, range) in fit.groups.iter().zip(&self.model.groups) {
            for (columns, r) in group.columns.iter().zip(range.clone()) {
                let pulses = || columns.iter().zip(&group.amplitudes).map(|(column, a)| (column, -a));
                self.model.records[r].add_pulses(&mut residuals[r], pulses());
                let of_pulse = |(column, a): (&Column, f64)| a * column.mean_v(&self.model.records[r]);
                baselines_v[r] += pulses().map(of_pulse).sum::<f64>();
            }
        }
        Some(State { factor: fit.factor()?, fit, residuals, baselines_v })
    }

    /// The state with one more pulse or a wider one, if that is worth its evidence.
    fn grow(&self, state: &State) -> Option<State> {
        let added = self
            .filter
            .best(&self.model, &state.residuals)
            .filter(|(_, drop)| *drop > WIDENED * self.evidence_min && state.pulses() < self.pulses_max)
            .and_then(|(time_ps, _)| self.change(state, &[], time_ps, &[Place::point(time_ps)]));
        let replaced = (0..state.pulses()).filter_map(|k| self.replacement(state, k));
        let gain = |change: &Change| change.drop - change.cost;
        let best = added
            .into_iter()
            .chain(replaced)
            .max_by(|a, b| gain(a).total_cmp(&gain(b)))
            .filter(|best| best.drop > best.cost)?;
        self.solve(best.places)
    }

    /// Pulse `k`, if it looks widened, replaced by one of more extended light. Or replaced by the best pair in its
    /// place, if the pair explains the samples better by `evidence_min`.
    fn replacement(&self, state: &State, k: usize) -> Option<Change> {
        let place = state.fit.places[k];
        let is_predicted = place.prior.is_some();
        // A predicted pulse has the width that is predicted, unless noise does not explain what it leaves.
        if is_predicted && self.misfit(state, None, Some(k)).inflation() == 1.0 {
            return None;
        }
        let (misfit, variance_ps2) = match place.shapes() {
            0 => self.widening(state, k),
            _ => (self.excess(state, k), place.variance_ps2),
        };
        let least = WIDENED * self.evidence_min;
        let extended = if self.model.extent_max_ps > 0.0 && misfit > least.min(self.width_cost(state, k)) {
            self.extended(state, k, variance_ps2)
        } else {
            None
        };
        if self.model.signed || is_predicted || misfit < least || state.pulses() >= self.pulses_max {
            return extended;
        }
        let Some(pair) = self.pair(state, k) else { return extended };
        let is_better = |one: &Change| pair.drop < one.drop + self.evidence_min;
        let Some(one) = extended else { return Some(pair) };
        if is_better(&one) {
            return Some(one);
        }
        Some(self.reshaped(state, &[k], &one).filter(is_better).unwrap_or(pair))
    }

    /// Drop of chi2 that a width of pulse `k` must be worth.
    fn width_cost(&self, state: &State, k: usize) -> f64 {
        let blended = (0..state.pulses()).any(|j| j != k && self.is_near(state.time_ps(j), state.time_ps(k)));
        if blended { self.evidence_min } else { WIDTH_EVIDENCE }
    }

    fn is_near(&self, time_ps: f64, other_ps: f64) -> bool {
        (time_ps - other_ps).abs() < CLUSTER_WIDTHS * self.model.width_ps
    }

    /// Pulse `k` with another shape, the variance started from the given one: a Gaussian in place of a point, and where
    /// it is one, what [`Self::reshaped`] makes of it. `None` if it has all, is not worth it, or the best is as large
    /// as is allowed.
    fn extended(&self, state: &State, k: usize, variance_ps2: f64) -> Option<Change> {
        let most_ps = self.model.extent_max_ps;
        let place = state.fit.places[k];
        let cost = self.width_cost(state, k);
        let best = match place.shapes() {
            0 => {
                let variance_ps2 = variance_ps2.clamp(0.0, 0.9 * most_ps * most_ps);
                self.change(state, &[k], place.time_ps, &[Place::widened(place.time_ps, variance_ps2)])
                    .filter(|change| self.is_within_limits(change))
            }
            _ => self.best_shape(state, &[k], place),
        };
        best.map(|change| Change { cost, ..change }).filter(|change| change.drop > cost)
    }

    /// The best of the shapes that a widened pulse in place of the pulses `out` may have besides its own: of a Gaussian
    /// that of disks or one with a tail, of disks that with a tilt.
    fn best_shape(&self, state: &State, out: &[usize], place: Place) -> Option<Change> {
        let shaped = |start: Place| {
            self.change(state, out, start.time_ps, &[start]).filter(|change| self.is_within_limits(change))
        };
        match place.spread {
            Spread::Gaussian => {
                let changes = [place.of_disks(), place.tailed(self.model.extent_max_ps)].map(shaped);
                let best = changes.into_iter().flatten().max_by(|a, b| a.drop.total_cmp(&b.drop))?;
                let tilted = self.best_shape(state, out, *best.places.last()?);
                tilted.filter(|tilted| tilted.drop > best.drop + WIDTH_EVIDENCE).or(Some(best))
            }
            Spread::Disks { .. } => shaped(place.tilted()),
            _ => None,
        }
    }

    /// A change that ends in a widened pulse in place of the pulses `out`, with a better shape for it.
    fn reshaped(&self, state: &State, out: &[usize], widened: &Change) -> Option<Change> {
        let place = *widened.places.last()?;
        self.best_shape(state, out, place).filter(|change| change.drop > widened.drop + WIDTH_EVIDENCE)
    }

    /// Whether the spread of the pulse put in last is less than the largest allowed.
    fn is_within_limits(&self, change: &Change) -> bool {
        change.places.last().is_none_or(|place| !place.is_at_limit(self.model.extent_max_ps))
    }

    /// Pulse `k` replaced by the best pair in its place.
    fn pair(&self, state: &State, k: usize) -> Option<Change> {
        let time_ps = state.time_ps(k);
        let pair = best_pair(&self.model, &self.alone(state, &[k]), time_ps)?;
        self.change(state, &[k], time_ps, &pair.map(Place::point))
    }

    /// Drop of chi2, to first order, by widening the point `k`, and the variance that it takes: the residual's product
    /// with the part of its derivative by the variance that no shift or amplitude of any pulse can imitate. Two pulses
    /// close together look like one widened pulse.
    fn widening(&self, state: &State, k: usize) -> (f64, f64) {
        let amplitudes = state.fit.groups.iter().zip(&self.model.groups);
        let amplitudes = amplitudes.flat_map(|(group, range)| range.clone().map(|_| group.amplitudes[k]));
        let direction: Vec<(f64, Column)> = amplitudes
            .zip(&self.model.records)
            .map(|(a, record)| (a, Column::widening(record, state.time_ps(k))))
            .collect();
        let Slope { with_residual, own, .. } = self.slope(state, &direction);
        if with_residual <= 0.0 {
            return (0.0, 0.0);
        }
        (with_residual * with_residual / own, with_residual / own)
    }

    /// What the residuals say of a direction, given as a column of each record, besides all unknowns.
    pub(super) fn slope(&self, state: &State, direction: &[(f64, Column)]) -> Slope {
        let parts = direction.iter().zip(&state.residuals);
        let with_residual: f64 = parts.map(|((a, column), residual)| a * column.dot_record(residual)[0]).sum();
        let mut imitation = state.fit.products_with(&self.model, direction);
        let alone = direction.iter().zip(&self.model.records).map(|((a, column), record)| {
            let along: f64 = record.nuisance.axes().iter().map(|axis| column.dot_record(axis)[0].powi(2)).sum();
            a * a * (column.shared(column) - along)
        });
        let alone = alone.sum::<f64>();
        state.factor.solve_lower(&mut imitation);
        let own = alone - imitation.iter().map(|v| v * v).sum::<f64>();
        state.factor.solve_upper(&mut imitation);
        Slope { with_residual, own, imitation }
    }

    /// The information on the amplitudes of directions in record 0, row-major, that which the unknowns can imitate left
    /// out, and their products with its residual. For fits of one record.
    pub(super) fn information(&self, state: &State, directions: Vec<Column>) -> (Vec<f64>, Vec<f64>) {
        let record = &self.model.records[0];
        let with_residual = directions.iter().map(|column| column.dot_record(&state.residuals[0])[0]).collect();
        // What the unknowns and the ground under the pulses imitate of each.
        let imitated: Vec<(Column, Vec<f64>)> = directions
            .into_iter()
            .map(|column| {
                let direction = [(1.0, column)];
                let mut products = state.fit.products_with(&self.model, &direction);
                let [(_, column)] = direction;
                state.factor.solve_lower(&mut products);
                products.extend(record.nuisance.axes().iter().map(|axis| column.dot_record(axis)[0]));
                (column, products)
            })
            .collect();
        let product = |(a, of_a): &(Column, Vec<f64>), (b, of_b): &(Column, Vec<f64>)| {
            a.shared(b) - of_a.iter().zip(of_b).map(|(a, b)| a * b).sum::<f64>()
        };
        let information = imitated.iter().flat_map(|a| imitated.iter().map(|b| product(a, b))).collect();
        (information, with_residual)
    }

    /// What chi2 of the samples of pulse `k` may exceed that of noise by.
    fn excess(&self, state: &State, k: usize) -> f64 {
        let Misfit { chi2, freedom, variance } = self.chi2(state, Some(k));
        chi2 - freedom + EXCESS_SIGMA * variance.sqrt()
    }

    /// The pulses near `center_ps`, and whitened records of them alone.
    pub(super) fn cluster(&self, state: &State, center_ps: f64) -> (Vec<usize>, Vec<Vec<f64>>) {
        let cluster: Vec<usize> = (0..state.pulses()).filter(|k| self.is_near(state.time_ps(*k), center_ps)).collect();
        (cluster.clone(), self.alone(state, &cluster))
    }

    /// Whitened records of the pulses `kept` alone, freed of what lies under them.
    pub(super) fn alone(&self, state: &State, kept: &[usize]) -> Vec<Vec<f64>> {
        let mut data = state.residuals.clone();
        for (group, range) in state.fit.groups.iter().zip(&self.model.groups) {
            for (columns, r) in group.columns.iter().zip(range.clone()) {
                let pulses = kept.iter().map(|k| (&columns[*k], group.amplitudes[*k]));
                self.model.records[r].add_pulses(&mut data[r], pulses);
            }
        }
        data
    }

    /// Takes the pulses `out` away, puts pulses at `into` in, and refines them with the pulses near `center_ps`; the
    /// others stay. The last places are those put in.
    fn change(&self, state: &State, out: &[usize], center_ps: f64, into: &[Place]) -> Option<Change> {
        self.model.cancel.check();
        let (cluster, data) = self.cluster(state, center_ps);
        let others = (0..state.pulses()).filter(|k| !cluster.contains(k));
        let places = &state.fit.places;
        let old = Projection::new(&self.model, &data, cluster.iter().map(|k| places[*k]).collect())?;
        let kept = cluster.iter().filter(|k| !out.contains(k)).map(|k| places[*k]);
        let new = refine(&self.model, &data, kept.chain(into.iter().copied()).collect())?;
        let others = others.map(|k| places[k]);
        Some(Change {
            drop: new.energy - old.energy,
            places: others.chain(new.places).collect(),
            cost: self.evidence_min,
        })
    }

    /// Pulse `k` taken out. A neighbour that may have been split off from it starts from where one pulse would stand
    /// for both, unless one of them is predicted. That pulse is a point or, where that is allowed and better, an
    /// extended one.
    fn removal(&self, state: &State, k: usize) -> Option<Change> {
        let distance = |j: usize| (state.time_ps(j) - state.time_ps(k)).abs();
        let neighbour = (0..state.pulses())
            .filter(|j| *j != k && distance(*j) < self.model.width_ps)
            .min_by(|i, j| distance(*i).total_cmp(&distance(*j)));
        let are_free = |j: &usize| state.place(*j).prior.is_none() && state.place(k).prior.is_none();
        let Some(j) = neighbour.filter(are_free) else {
            return self.change(state, &[k], state.time_ps(k), &[]);
        };
        let share = state.amplitude(k) / (state.amplitude(j) + state.amplitude(k));
        let share = if share.is_finite() { share } else { 0.0 };
        let apart_ps = state.time_ps(k) - state.time_ps(j);
        let place = Place { time_ps: state.time_ps(j) + share * apart_ps, ..state.fit.places[j] };
        let merged = |place: Place| self.change(state, &[j, k], state.time_ps(k), &[place]);
        let alike = merged(place);
        let most_ps = self.model.extent_max_ps;
        let variance_ps2 = place.variance_ps2 + share * (1.0 - share) * apart_ps * apart_ps;
        if most_ps == 0.0 || !(0.0..most_ps * most_ps).contains(&variance_ps2) {
            return alike;
        }
        let extended =
            merged(Place::widened(place.time_ps, variance_ps2)).filter(|change| self.is_within_limits(change));
        let worse = extended.as_ref().filter(|change| -change.drop > self.evidence_min);
        let reshaped = worse.and_then(|change| self.reshaped(state, &[j, k], change));
        [alike, extended, reshaped].into_iter().flatten().max_by(|a, b| a.drop.total_cmp(&b.drop))
    }

    /// Takes out pulses, and parameters of their shape, not worth their evidence, the weakest first. The state that
    /// remains, and the evidence of each of its pulses.
    fn prune(&self, mut state: State) -> (State, Vec<f64>) {
        loop {
            let removals: Vec<Option<Change>> = (0..state.pulses()).map(|k| self.removal(&state, k)).collect();
            // Without a fit for the rest, a pulse is indispensable.
            let evidence = |r: &Option<Change>| r.as_ref().map_or(f64::INFINITY, |r| -r.drop);
            let evidences: Vec<f64> = removals.iter().map(evidence).collect();
            // What is predicted may be there even where it shows no light: that much others beside it are unsure.
            let is_free = |(k, _): &(usize, Option<Change>)| state.place(*k).prior.is_none();
            let fewer = removals
                .into_iter()
                .enumerate()
                .filter(is_free)
                .filter_map(|(_, removal)| removal)
                .max_by(|a, b| a.drop.total_cmp(&b.drop))
                .filter(|weakest| -weakest.drop < self.evidence_min)
                .or_else(|| self.simpler(&state))
                .and_then(|weakest| self.solve(weakest.places));
            match fewer {
                Some(fewer) => state = fewer,
                None => return (state, evidences),
            }
        }
    }

    /// The first pulse whose last parameter of shape is not worth its evidence, without it.
    fn simpler(&self, state: &State) -> Option<Change> {
        let is_free = |place: &Place| place.shapes() > usize::from(place.prior.is_some());
        let mut extended = state.fit.places.iter().enumerate().filter(|(_, place)| is_free(place));
        extended.find_map(|(k, place)| {
            let less = match place.spread {
                Spread::Gaussian => Place::point(place.time_ps),
                Spread::TiltedDisks { kurtosis, .. } => Place { spread: Spread::Disks { kurtosis }, ..*place },
                _ => Place { spread: Spread::Gaussian, ..*place },
            };
            let cost = self.width_cost(state, k);
            self.change(state, &[k], place.time_ps, &[less]).filter(|change| -change.drop < cost)
        })
    }

    /// Misfit of all records, or of the samples that pulse `k` reaches.
    fn chi2(&self, state: &State, k: Option<usize>) -> Misfit {
        let parts = (0..self.model.records.len()).map(|r| self.chi2_of(state, r, k));
        parts.reduce(Misfit::plus).expect("a fit has a record")
    }

    /// Misfit of record `r`, or of its samples that pulse `k` reaches.
    fn chi2_of(&self, state: &State, r: usize, k: Option<usize>) -> Misfit {
        let record = &self.model.records[r];
        let columns = state.columns(&self.model, r);
        let range = k.map_or(0..record.len(), |k| columns[k].range());
        let used = record.whitener.weights()[range.clone()].iter().filter(|w| **w > 0.0).count() as f64;
        // A pulse takes its unknowns from the samples that it reaches.
        let unknowns: f64 = columns
            .iter()
            .zip(&state.fit.places)
            .map(|(c, place)| {
                let both = c.range().end.min(range.end) as f64 - c.range().start.max(range.start) as f64;
                (1 + place.parameters()) as f64 * both.max(0.0) / c.range().len() as f64
            })
            .sum();
        let share = used / record.len() as f64;
        let freedom = used - unknowns - record.nuisance.freedom() * share;
        let kurtosis: f64 = self.kurtosis[r].get(range.clone()).map_or(0.0, |kurtosis| kurtosis.iter().sum());
        let chi2 = state.residuals[r][range].iter().map(|r| r * r).sum();
        Misfit { chi2, freedom, variance: 2.0 * freedom + kurtosis }
    }

    /// Misfit of record `r` (all records for `None`), or of the samples that pulse `k` reaches (of the record, if these
    /// are too few).
    pub(super) fn misfit(&self, state: &State, r: Option<usize>, k: Option<usize>) -> Misfit {
        let misfit = r.map_or_else(|| self.chi2(state, k), |r| self.chi2_of(state, r, k));
        if k.is_some() && misfit.freedom < FREEDOM_MIN { self.misfit(state, r, None) } else { misfit }
    }

    /// Number of records.
    pub(super) fn records(&self) -> usize {
        self.model.records.len()
    }

    /// The group of records that record `r` shares its amplitudes with.
    pub(super) fn group_of(&self, r: usize) -> usize {
        self.model.groups.iter().position(|group| group.contains(&r)).expect("each record is in a group")
    }
}
