//! Several records that show the same pulses: a common fit, and the result as each record sees it.
//!
//! Profiles (i, k) and (k, i) of a pair of patches hold the same paths, walked in opposite directions: their pulses
//! arrive at the same times, while noise, sampling and response differ. Fitted together, two records of equal noise
//! give times better by `sqrt(2)`, and tell pulses apart as one of `sqrt(2)` times their SNR does.

use super::cause;
use super::evidence::{evidence_min_joint, evidence_min_of};
use super::greedy::Fitter;
use super::model::Model;
use super::pair::PairFit;
use super::prediction::{OwnTimes, own_variance_ps2};
use super::state::State;
use super::{FALSE_PULSES, Profile, Pulse, Response, SparseFit, SparseOptions};

/// Fits pulses whose times, and widths, all `records` share; amplitudes too with `shared_amplitudes`, else each record
/// has its own. One result a record: times, widths, their covariance and the evidence are common; amplitudes, baseline
/// and chi2 are its own.
///
/// A pulse must have its maximum inside of every record.
///
/// # Panics
/// If there is no record, the records' steps differ, or for one of them what [`super::fit`] panics for.
#[must_use]
pub fn fit_joint(records: &[(Profile, &Response)], options: &SparseOptions, shared_amplitudes: bool) -> Vec<SparseFit> {
    assert!(!records.is_empty(), "a fit needs a record");
    for (profile, _) in records {
        check(profile);
        assert!(profile.dt_ps == records[0].0.dt_ps, "records that are fitted together have one sample step");
    }
    assert!((0.0..f64::INFINITY).contains(&options.extent_max_ps), "the extent must not be negative");
    let threshold = options.evidence_min.unwrap_or_else(|| {
        if let [(profile, response)] = records {
            return evidence_min_of(profile, response, FALSE_PULSES);
        }
        let total_ps: f64 = records.iter().map(|(profile, _)| profile.mean_v.len() as f64 * profile.dt_ps).sum();
        let model = Model::new(records, options, shared_amplitudes);
        evidence_min_joint(&model, total_ps / records.len() as f64, FALSE_PULSES)
    });
    assert!(threshold > 0.0, "the evidence must be positive");
    cause::explain(records, options, shared_amplitudes, threshold)
}

/// An error that all unknowns of a fit share: what one unit of it does to each, and its variance.
pub(super) struct Common {
    pub(super) per_unit: Vec<f64>,
    pub(super) variance: f64,
}

/// What a state says: one result a record.
pub(super) fn run(
    fitter: &Fitter,
    state: &State,
    evidences: Vec<f64>,
    common: Vec<Common>,
    evidence_min: f64,
) -> Vec<SparseFit> {
    let widenings = fitter.widenings(state);
    let pairs = fitter.pairs(state);
    let judged = Judged { evidences, widenings, pairs, common };
    (0..fitter.records()).map(|r| describe(fitter, state, r, &judged, evidence_min)).collect()
}

fn check(profile: &Profile) {
    let len = profile.mean_v.len();
    assert!(len > 0, "the profile is empty");
    assert_eq!(len, profile.sd_v.len(), "one sd a sample");
    assert!(profile.dt_ps > 0.0, "the sample step must be positive");
    let finite = profile.mean_v.iter().all(|v| v.is_finite());
    assert!(finite, "the means must be finite");
    let positive = profile.sd_v.iter().all(|sd| *sd > 0.0);
    assert!(positive, "the sds must be positive");
}

/// What is known of each pulse of a state beyond its place: the evidence, the factor of the first-order sd of its time,
/// and the pair that may stand in its place; and the errors that all share.
struct Judged {
    evidences: Vec<f64>,
    widenings: Vec<f64>,
    pairs: Vec<Option<PairFit>>,
    common: Vec<Common>,
}

/// The fit as record `r` sees it, pulses in order of time.
fn describe(fitter: &Fitter, state: &State, r: usize, judged: &Judged, evidence_min: f64) -> SparseFit {
    let Judged { evidences, widenings, pairs, common } = judged;
    // What is predicted and shows no light is no pulse; what it may hide is in the errors of those beside it.
    let is_pulse = |k: &usize| state.fit.has_amplitude(*k) || state.place(*k).prior.is_none();
    let mut order: Vec<usize> = (0..state.pulses()).filter(is_pulse).collect();
    order.sort_by(|i, j| state.time_ps(*i).total_cmp(&state.time_ps(*j)));
    let (all, unknowns) = state.covariance();
    let shared = |i: usize, j: usize| {
        common.iter().map(|error| error.variance * error.per_unit[i] * error.per_unit[j]).sum::<f64>()
    };
    let covariance = |i: usize, j: usize| all[i * unknowns + j] + shared(i, j);
    // All records' samples of a pulse speak for its time.
    let inflations: Vec<f64> = order.iter().map(|&k| fitter.misfit(state, None, Some(k)).inflation()).collect();
    let group = fitter.group_of(r);
    let each = || order.iter().flat_map(|&i| order.iter().map(move |&j| (i, j)));
    let of_times = |i: usize, j: usize| (state.time_unknown(i), state.time_unknown(j));
    let with_priors = each().map(|(i, j)| of_times(i, j)).map(|(i, j)| all[i * unknowns + j]).collect();
    let pulls: Vec<_> = order.iter().map(|&k| state.place(k).pull(0)).collect();
    let own_times = OwnTimes::new(with_priors, &pulls, fitter.model.width_ps);
    let pulse = |(n, (&k, inflation)): (usize, (&usize, &f64))| {
        let place = state.place(k);
        let sd = |unknown: usize| covariance(unknown, unknown).sqrt() * inflation;
        let (time, amplitude) = (state.time_unknown(k), group * state.pulses() + k);
        let width_ps = place.variance_ps2.sqrt();
        let [variance_ps2, variance_sd_ps2] =
            if width_ps > 0.0 { own_variance_ps2(&place, sd(time + 1)) } else { [0.0; 2] };
        Pulse {
            time_ps: place.time_ps,
            time_sd_ps: covariance(time, time).sqrt() * widenings[k],
            own_time_ps: place.time_ps + own_times.moves_ps[n],
            width_ps,
            kurtosis: place.kurtosis(),
            tilt: place.tilt(),
            own_variance_ps2: variance_ps2,
            width_sd_ps: if width_ps > 0.0 { variance_sd_ps2 / (2.0 * width_ps) } else { 0.0 },
            tail_ps: place.tail_ps(),
            tail_sd_ps: if place.tail_ps() > 0.0 { sd(time + 2) } else { 0.0 },
            amplitude_v: state.amplitude_of(group, k),
            amplitude_sd_v: sd(amplitude),
            evidence: evidences[k],
            chi2_per_dof: fitter.misfit(state, Some(r), Some(k)).per_dof(),
            misfit_sigma: fitter.misfit(state, Some(r), Some(k)).sigma(),
            misfit_factor: inflation * inflation,
            pair: pairs[k].as_ref().map(|pair| pair.of_group(group)),
        }
    };
    let pulses = order.iter().zip(&inflations).enumerate().map(pulse).collect();
    let covariance_ps2 = each()
        .zip(&own_times.covariance_ps2)
        .map(|((i, j), own_ps2)| {
            let (of_i, of_j) = of_times(i, j);
            (own_ps2 + shared(of_i, of_j)) * widenings[i] * widenings[j]
        })
        .collect();
    SparseFit {
        pulses,
        covariance_ps2,
        baseline_v: state.baseline_v(r),
        chi2_per_dof: fitter.misfit(state, Some(r), None).per_dof(),
        evidence_min,
        ground_v: 0.0,
        width: None,
    }
}
