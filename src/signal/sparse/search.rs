//! Where the next pulse may be: the matched filter's maximum, and the best pair in place of a pulse; and how much evidence to ask for.

use super::Response;
use super::model::{Column, Model};

/// Arrivals with less than this part of the pulse's energy in samples that count are not searched.
const SEEN_MIN: f64 = 0.05;
/// Positions searched per full width at half maximum of the response.
const POSITIONS_PER_WIDTH: f64 = 3.0;
/// Pair search: grid step and half range in widths of the response.
const PAIR_STEP: f64 = 0.08;
const PAIR_RANGE: i32 = 15;

/// Threshold on the drop of chi2 a pulse, for `false_pulses` a record of noise alone.
///
/// A matched filter's output, scaled to unit variance, crosses `u` upwards at the rate `beta / (2 pi) exp(-u^2 / 2)`, with
/// `beta^2 = sum h'^2 / sum h^2` (Rice, Bell Syst. Tech. J. 24, 46 (1945)); the best pulse lowers chi2 by `u^2`. Hence
/// `gamma = 2 ln(T beta / (2 pi false_pulses))`, T the record's length, and never below 20, against the splitting of single pulses.
#[must_use]
pub fn evidence_min(response: &Response, record_ps: f64, false_pulses: f64) -> f64 {
    let (first_ps, last_ps) = response.support_ps();
    let step_ps = (last_ps - first_ps) / 1000.0;
    let (energy, slope_energy) = (0..=1000)
        .map(|i| response.value_and_slope(first_ps + f64::from(i) * step_ps))
        .fold((0.0, 0.0), |(e, s), (value, slope)| (e + value * value, s + slope * slope));
    let beta = (slope_energy / energy).sqrt();
    let crossings = record_ps * beta / (std::f64::consts::TAU * false_pulses);
    (2.0 * crossings.ln()).max(20.0)
}

/// Matched filter on a grid of arrival times, with the pulse's maximum inside the record.
pub(super) struct MatchedFilter {
    phases: Vec<Phase>,
}

/// Arrivals at one offset against the samples.
struct Phase {
    /// Arrival of the first candidate, ps; the next follow by the sample step.
    start_ps: f64,
    /// Record sample that the first tap of the first candidate meets.
    first: i64,
    taps: Vec<f64>,
    /// `||h||^2` in the weights of each candidate, 0 where too little of it is seen.
    energies: Vec<f64>,
}

impl MatchedFilter {
    pub(super) fn new(model: &Model, width_ps: f64, peak_ps: f64) -> Self {
        let count = (POSITIONS_PER_WIDTH * model.dt_ps / width_ps).ceil().max(1.0) as usize;
        let squares: Vec<f64> = model.weights.iter().map(|w| w * w).collect();
        let counted: Vec<f64> = model.weights.iter().map(|w| f64::from(*w > 0.0)).collect();
        let phases =
            (0..count).map(|p| Phase::new(model, peak_ps, p as f64 / count as f64, &squares, &counted)).collect();
        Self { phases }
    }

    /// Arrival time and drop of chi2 of the best pulse in whitened `residual`. `None` if no place wants one.
    pub(super) fn best(&self, model: &Model, residual: &[f64]) -> Option<(f64, f64)> {
        let weighted: Vec<f64> = residual.iter().zip(&model.weights).map(|(r, w)| r * w).collect();
        let mut best: Option<(f64, f64)> = None;
        for phase in &self.phases {
            let outputs = correlate(&weighted, &phase.taps, phase.first, phase.energies.len());
            for (j, (output, energy)) in outputs.iter().zip(&phase.energies).enumerate() {
                let drop = output * output / energy;
                if *energy > 0.0 && (*output > 0.0 || model.signed) && best.is_none_or(|(_, d)| drop > d) {
                    best = Some((phase.start_ps + j as f64 * model.dt_ps, drop));
                }
            }
        }
        best
    }
}

impl Phase {
    /// Candidates whose maximum falls `fraction` of a step after each sample.
    fn new(model: &Model, peak_ps: f64, fraction: f64, squares: &[f64], counted: &[f64]) -> Self {
        let start_ps = model.t0_ps + fraction * model.dt_ps - peak_ps;
        let (first_ps, last_ps) = model.response.support_ps();
        let index = |after_ps: f64| (start_ps + after_ps - model.t0_ps) / model.dt_ps;
        let first = index(first_ps).ceil() as i64;
        let last = index(last_ps).floor() as i64;
        let taps: Vec<f64> =
            (first..=last).map(|n| model.response.value(model.t0_ps + n as f64 * model.dt_ps - start_ps)).collect();
        let squared_taps: Vec<f64> = taps.iter().map(|h| h * h).collect();
        let mut energies = correlate(squares, &squared_taps, first, squares.len());
        let seen = correlate(counted, &squared_taps, first, counted.len());
        let enough = SEEN_MIN * squared_taps.iter().sum::<f64>();
        for (energy, seen) in energies.iter_mut().zip(&seen) {
            if *seen < enough {
                *energy = 0.0;
            }
        }
        Self { start_ps, first, taps, energies }
    }
}

/// `out[j] = sum_m taps[m] * record[j + first + m]`, zeros outside of the record, for `j` in `0..len`.
fn correlate(record: &[f64], taps: &[f64], first: i64, len: usize) -> Vec<f64> {
    let mut out = vec![0.0; len];
    for (m, tap) in taps.iter().enumerate() {
        let shift = first + m as i64;
        let (skip_out, skip_in) = ((-shift).max(0) as usize, shift.max(0) as usize);
        if skip_out < len && skip_in < record.len() {
            for (o, r) in out[skip_out..].iter_mut().zip(&record[skip_in..]) {
                *o += tap * r;
            }
        }
    }
    out
}

/// Best two arrival times, both amplitudes positive, for whitened `data` near `center_ps`, by exhaustion over a grid.
pub(super) fn best_pair(model: &Model, data: &[f64], center_ps: f64, width_ps: f64) -> Option<[f64; 2]> {
    let times: Vec<f64> = (-PAIR_RANGE..=PAIR_RANGE).map(|i| center_ps + f64::from(i) * PAIR_STEP * width_ps).collect();
    let columns: Vec<Column> = times.iter().map(|t| model.column(*t)).collect();
    let with_data: Vec<f64> = columns.iter().map(|c| c.dot_record(data)[0]).collect();
    let own: Vec<f64> = columns.iter().map(|c| c.dot(c)[0][0]).collect();
    let mut best: Option<([f64; 2], f64)> = None;
    for i in 0..columns.len() {
        for j in 0..i {
            let shared = columns[i].dot(&columns[j])[0][0];
            let determinant = own[i] * own[j] - shared * shared;
            let a_i = with_data[i] * own[j] - with_data[j] * shared;
            let a_j = with_data[j] * own[i] - with_data[i] * shared;
            let energy = (a_i * with_data[i] + a_j * with_data[j]) / determinant;
            let possible = a_i > 0.0 && a_j > 0.0 && determinant > 1e-10 * own[i] * own[j];
            if possible && best.is_none_or(|(_, e)| energy > e) {
                best = Some(([times[j], times[i]], energy));
            }
        }
    }
    best.map(|(pair, _)| pair)
}
