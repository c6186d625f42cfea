//! Where the next pulse may be: the matched filter's maximum, and the best pair in place of a pulse.

use periscope_cancel::Cancel;

use super::column::Column;
use super::model::{Model, WhitenedRecord};
use super::place::Place;

/// Arrivals with less than this part of the pulse's energy in samples that count are not searched.
const SEEN_MIN: f64 = 0.05;
/// Positions searched per full width at half maximum of the response. A pulse midway between two loses 7 % of its drop
/// of chi2 (Gaussian response); candidates need only a quarter of the evidence, so none is missed for it.
const POSITIONS_PER_WIDTH: f64 = 3.0;
/// Candidates between two looks at the token.
const POLL: usize = 4096;
/// Pair search: grid step and half range in widths of the response.
const PAIR_STEP: f64 = 0.08;
const PAIR_RANGE: i32 = 15;

/// Matched filter on a grid of arrival times, with the pulse's maximum inside of every record.
pub(super) struct MatchedFilter {
    phases: Vec<Phase>,
}

/// Arrivals at one offset against the samples.
struct Phase {
    /// Arrival of the first candidate, ps; the next follow by the sample step.
    start_ps: f64,
    /// Of each record.
    taps: Vec<Taps>,
    /// `||h||^2` of each candidate, whitened, summed over each group of records; 0 where too little of it is seen.
    energies: Vec<Vec<f64>>,
}

/// The response as candidates of one phase lay it on one record.
struct Taps {
    /// Record sample that the first tap of the first candidate meets.
    first: i64,
    taps: Vec<f64>,
}

impl MatchedFilter {
    pub(super) fn new(model: &Model) -> Self {
        let record = &model.records[0];
        let count = (POSITIONS_PER_WIDTH * record.dt_ps / model.width_ps).ceil().max(1.0) as usize;
        let first_ps = record.t0_ps - record.response.peak_ps();
        let phase = |p: usize| Phase::new(model, first_ps + p as f64 / count as f64 * record.dt_ps);
        Self { phases: (0..count).map(phase).collect() }
    }

    /// Arrival time and drop of chi2 of the best pulse in whitened `residuals`. `None` if no place wants one.
    pub(super) fn best(&self, model: &Model, residuals: &[Vec<f64>]) -> Option<(f64, f64)> {
        let dt_ps = model.records[0].dt_ps;
        let both = model.records.iter().zip(residuals);
        let weighted: Vec<Vec<f64>> = both.map(|(record, residual)| record.whitener.transpose(residual)).collect();
        let mut best: Option<(f64, f64)> = None;
        for phase in &self.phases {
            for (j, drop) in phase.drops(model, &weighted).into_iter().enumerate() {
                let time_ps = phase.start_ps + j as f64 * dt_ps;
                if drop > best.map_or(0.0, |(_, d)| d) && model.is_inside(time_ps) {
                    best = Some((time_ps, drop));
                }
            }
        }
        best
    }
}

impl Phase {
    /// Candidates from `start_ps` on, one a sample of the first record.
    fn new(model: &Model, start_ps: f64) -> Self {
        let count = model.records[0].len();
        let mut taps = Vec::with_capacity(model.records.len());
        let mut energies = Vec::with_capacity(model.groups.len());
        for group in &model.groups {
            let mut sums = vec![0.0; count];
            for record in &model.records[group.clone()] {
                let own = Taps::new(record, start_ps);
                sums.iter_mut()
                    .zip(own.energies(record, count, &model.cancel))
                    .for_each(|(sum, energy)| *sum += energy);
                taps.push(own);
            }
            energies.push(sums);
        }
        Self { start_ps, taps, energies }
    }

    /// Drop of chi2 by a pulse at each candidate: what the records of each group say together.
    fn drops(&self, model: &Model, weighted: &[Vec<f64>]) -> Vec<f64> {
        let mut drops = vec![0.0; self.energies[0].len()];
        let mut outputs = drops.clone();
        for (group, energies) in model.groups.iter().zip(&self.energies) {
            outputs.fill(0.0);
            for (taps, record) in self.taps[group.clone()].iter().zip(&weighted[group.clone()]) {
                correlate(record, &taps.taps, taps.first, &mut outputs, &model.cancel);
            }
            for (drop, (output, energy)) in drops.iter_mut().zip(outputs.iter().zip(energies)) {
                if *energy > 0.0 && (*output > 0.0 || model.signed) {
                    *drop += output * output / energy;
                }
            }
        }
        drops
    }
}

impl Taps {
    /// For candidates from `start_ps` on.
    fn new(record: &WhitenedRecord, start_ps: f64) -> Self {
        let (first_ps, last_ps) = record.response.support_ps();
        let index = |after_ps: f64| (start_ps + after_ps - record.t0_ps) / record.dt_ps;
        let first = index(first_ps).ceil() as i64;
        let last = index(last_ps).floor() as i64;
        let sample = |n: i64| record.response.value(record.t0_ps + n as f64 * record.dt_ps - start_ps);
        Self { first, taps: (first..=last).map(sample).collect() }
    }

    /// `||h||^2` of `count` candidates, whitened; 0 where too little of it is seen.
    fn energies(&self, record: &WhitenedRecord, count: usize, cancel: &Cancel) -> Vec<f64> {
        let (whitener, taps) = (&record.whitener, &self.taps);
        let (weights, runs) = (whitener.weights(), whitener.run_starts());
        let enough = SEEN_MIN * taps.iter().map(|h| h * h).sum::<f64>();
        let mut column = Vec::with_capacity(taps.len() + whitener.order());
        let mut last = 0.0;
        let energy = |j: usize| {
            if j.is_multiple_of(POLL) {
                cancel.check();
            }
            let begin = j as i64 + self.first;
            let cut = ((-begin).max(0) as usize).min(taps.len());
            let begin = (begin.max(0) as usize).min(weights.len());
            let seen = (taps.len() - cut).min(weights.len() - begin);
            let end = (begin + taps.len() - cut + whitener.order()).min(weights.len());
            // In a run of like samples, the energy is that of the candidate before.
            let is_whole = cut == 0 && end - begin == taps.len() + whitener.order();
            if j > 0 && is_whole && begin > 0 && runs[end - 1] < begin {
                return last;
            }
            let met = &taps[cut..cut + seen];
            let counted = met.iter().zip(&weights[begin..]).filter(|(_, w)| **w > 0.0);
            last = 0.0;
            if counted.map(|(h, _)| h * h).sum::<f64>() >= enough {
                column.clear();
                column.extend(met.iter().map(|h| [*h]));
                column.resize(end - begin, [0.0]);
                whitener.apply_from(begin, &mut column);
                last = column.iter().map(|[v]| v * v).sum();
            }
            last
        };
        (0..count).map(energy).collect()
    }
}

/// Adds `sum_m taps[m] * record[j + first + m]` to `out[j]`, zeros outside of the record.
fn correlate(record: &[f64], taps: &[f64], first: i64, out: &mut [f64], cancel: &Cancel) {
    for (m, tap) in taps.iter().enumerate() {
        cancel.check();
        let shift = first + m as i64;
        let (skip_out, skip_in) = ((-shift).max(0) as usize, shift.max(0) as usize);
        if skip_out < out.len() && skip_in < record.len() {
            for (o, r) in out[skip_out..].iter_mut().zip(&record[skip_in..]) {
                *o += tap * r;
            }
        }
    }
}

/// Best two arrival times, both amplitudes positive, for whitened `data` near `center_ps`, by exhaustion over a grid.
pub(super) fn best_pair(model: &Model, data: &[Vec<f64>], center_ps: f64) -> Option<[f64; 2]> {
    let offsets = -PAIR_RANGE..=PAIR_RANGE;
    let times: Vec<f64> = offsets.map(|i| center_ps + f64::from(i) * PAIR_STEP * model.width_ps).collect();
    let n = times.len();
    // Of each group of records: products of the candidates with one another and with the data.
    let groups: Vec<(Vec<f64>, Vec<f64>)> = model
        .groups
        .iter()
        .map(|group| {
            let (mut shared, mut with_data) = (vec![0.0; n * n], vec![0.0; n]);
            for r in group.clone() {
                let column = |t: &f64| Column::new(&model.records[r], &Place::point(*t));
                let columns: Vec<Column> = times.iter().map(column).collect();
                for i in 0..n {
                    with_data[i] += columns[i].dot_record(&data[r])[0];
                    for j in 0..=i {
                        shared[i * n + j] += columns[i].shared(&columns[j]);
                    }
                }
            }
            (shared, with_data)
        })
        .collect();
    let mut best: Option<([f64; 2], f64)> = None;
    for i in 0..n {
        for j in 0..i {
            let parts = groups.iter().map(|(shared, with_data)| {
                pair_energy([shared[i * n + i], shared[i * n + j], shared[j * n + j]], [with_data[i], with_data[j]])
            });
            let (energy, any) = parts.fold((0.0, false), |(sum, any), (energy, both)| (sum + energy, any || both));
            if any && best.is_none_or(|(_, e)| energy > e) {
                best = Some(([times[j], times[i]], energy));
            }
        }
    }
    best.map(|(pair, _)| pair)
}

/// Drop of chi2 by two pulses of amplitudes >= 0, and whether both are positive. `gram`: products 11, 12, 22.
fn pair_energy([own_i, shared, own_j]: [f64; 3], [b_i, b_j]: [f64; 2]) -> (f64, bool) {
    let determinant = own_i * own_j - shared * shared;
    let a_i = b_i * own_j - b_j * shared;
    let a_j = b_j * own_i - b_i * shared;
    if a_i > 0.0 && a_j > 0.0 && determinant > 1e-10 * own_i * own_j {
        return ((a_i * b_i + a_j * b_j) / determinant, true);
    }
    let alone = |b: f64, own: f64| if b > 0.0 && own > 0.0 { b * b / own } else { 0.0 };
    (alone(b_i, own_i).max(alone(b_j, own_j)), false)
}
