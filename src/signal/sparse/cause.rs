//! What a record shows besides pulses on a line: a baseline that moves, a response of another width.
//!
//! Both are tried where the record asks for them, and kept where the whole record is the likelier for it: chi2, the
//! evidence that each pulse must bring, and what the freedom of the cause costs, all in one sum. Where the baseline is
//! a constant, or none, neither is tried.
//!
//! A baseline that moves is slow noise ([`crate::slow_noise`]) that no difference between shots shows, since it is the
//! same in each: pick-up, undershoot, light that is far slower than the response. It is sought where noise does not
//! explain the residual. Its first K components get one variance, K and variance by their marginal likelihood: with p
//! the mean power of these components in the residual, over that of noise, `ln L = K / 2 (p - 1 - ln p)`.
//!
//! The width's factor has a prior about 1, that of a calibration of another day. Its score comes from the residual's
//! product with the derivative by it, freed of what times and amplitudes can imitate. Where it is significant, the
//! record is fitted again with the response so stretched, until it stays; its error is common to all times. A small
//! pulse beside a large one may itself be what a wrong width looks like: then a wider and a narrower response are tried
//! in any case. Where light may be spread in time, which looks the same as a wider response, only a narrower one is
//! sought.

use super::column::Column;
use super::greedy::{Fitter, Slope};
use super::joint::{Common, run};
use super::model::{Model, WhitenedRecord};
use super::nuisance::{Direction, slow_direction};
use super::scatter;
use super::state::State;
use super::tone::Tone;
use super::{Baseline, Jitter, Profile, Response, SparseFit, SparseOptions};

/// Score from which another width is tried: of pulses that stand alone; of pulses that blend, whose distance looks like
/// a width. And score from which a width is moved on once it was taken.
const WIDTH_SIGMA: f64 = 2.0;
const WIDTH_SIGMA_BLENDED: f64 = 4.0;
const WIDTH_SETTLED: f64 = 0.3;
/// Steps of a width in one attempt, and those tried where a small pulse stands beside a large one: nearer than so many
/// widths, and with less than this share of its amplitude.
const WIDTH_STEP: f64 = 0.1;
const WIDTH_TRIAL: f64 = 0.03;
const BESIDE_WIDTHS: f64 = 1.5;
const BESIDE_SHARE: f64 = 0.3;
/// A width that is known no better is not tried.
const WIDTH_SD_MAX: f64 = 0.05;
/// Standard deviations of the record's chi2 from which its baseline is doubted.
const MISFIT_SIGMA: f64 = 3.0;
/// Components of a baseline that moves at most, and samples to each.
const COMPONENTS_MAX: usize = 64;
const SAMPLES_PER_COMPONENT: usize = 8;
/// Part of a component that pulses, line and slow noise must leave for it to count.
const NEW: f64 = 0.05;
/// Fits from which the scatter of the shots' times is taken: the first may have split a pulse that it blurred.
const SCATTER_ROUNDS: usize = 2;
/// Pulses from which on they may be the waves of a baseline that moves: what pulses leave that are worth this share of
/// the strongest shows it.
const MANY: usize = 6;
const STRONG: f64 = 0.05;
/// Attempts at most.
pub(super) const ATTEMPTS: usize = 6;

/// What is supposed of a record besides its pulses.
#[derive(Clone, Debug, Default, PartialEq)]
struct Cause {
    ground: Ground,
    /// Logarithm of the width's factor.
    stretch: f64,
    /// What the scatter of the shots' times makes of the pulses.
    scatter: Vec<Direction>,
}

/// Another cause of one record, or several of which the best is to be taken, and the chi2 that it promises.
struct Hint {
    record: usize,
    causes: Vec<Cause>,
    promise: f64,
    /// Chi2 that it must gain at least.
    least_gain: f64,
}

/// A fit under given causes.
struct Attempt {
    fits: Vec<SparseFit>,
    /// Chi2, with all that pulses and causes cost.
    cost: f64,
    hints: Vec<Hint>,
    /// What the scatter of the shots' times makes of these pulses, record by record.
    scatter: Vec<Vec<Direction>>,
}

/// Pulses of the records, under the causes that explain them best.
pub(super) fn explain(
    records: &[(Profile, &Response)],
    options: &SparseOptions,
    shared_amplitudes: bool,
    evidence_min: f64,
) -> Vec<SparseFit> {
    let fit = |causes: &[Cause], least_share: f64| {
        Attempt::new(records, options, shared_amplitudes, evidence_min, causes, least_share)
    };
    let attempt = |causes: &[Cause]| fit(causes, 0.0);
    let mut causes = vec![Cause::default(); records.len()];
    let mut best = attempt(&causes);
    for _ in 0..SCATTER_ROUNDS {
        if best.scatter.iter().all(Vec::is_empty) {
            break;
        }
        causes.iter_mut().zip(best.scatter).for_each(|(cause, scatter)| cause.scatter = scatter);
        best = attempt(&causes);
    }
    if options.baseline != Baseline::Line {
        return best.fits;
    }
    if best.pulses() > MANY {
        // Before those of pulses that explain the waves in part.
        let moves = |hint: &Hint| hint.causes.iter().all(|cause| cause.ground != causes[hint.record].ground);
        best.hints.splice(0..0, fit(&causes, STRONG).hints.into_iter().filter(moves));
    }
    for _ in 0..ATTEMPTS {
        let better = best.hints.iter().find_map(|hint| {
            let trial = |cause: &Cause| {
                let mut changed = causes.clone();
                changed[hint.record] = cause.clone();
                let trial = attempt(&changed);
                let is_stretched = cause.stretch != causes[hint.record].stretch;
                // Two pulses that blend look like one of a wider response. That there is one pulse less is no evidence
                // for the width: the calibration is rather right.
                let fewer = if is_stretched { best.pulses().saturating_sub(trial.pulses()) } else { 0 };
                (trial.cost + evidence_min * fewer as f64 + hint.least_gain, trial, changed)
            };
            let (cost, trial, changed) = hint.causes.iter().map(trial).min_by(|a, b| a.0.total_cmp(&b.0))?;
            (cost <= best.cost).then_some((trial, changed))
        });
        let Some((trial, changed)) = better else { break };
        (best, causes) = (trial, changed);
    }
    best.fits
}

impl Attempt {
    fn pulses(&self) -> usize {
        self.fits[0].pulses.len()
    }

    fn new(
        records: &[(Profile, &Response)],
        options: &SparseOptions,
        shared_amplitudes: bool,
        evidence_min: f64,
        causes: &[Cause],
        least_share: f64,
    ) -> Self {
        let slow_v2: Vec<Vec<f64>> = records
            .iter()
            .zip(causes)
            .map(|((profile, _), cause)| sum(profile.slow_v2, &cause.ground.variances_v2))
            .collect();
        let responses: Vec<Response> =
            records.iter().zip(causes).map(|((_, response), cause)| response.stretched(cause.stretch.exp())).collect();
        let supposed: Vec<(Profile, &Response)> = records
            .iter()
            .zip(slow_v2.iter().zip(&responses))
            .map(|((profile, _), (slow_v2, response))| (Profile { slow_v2, ..*profile }, response))
            .collect();
        let means_v: Vec<&[f64]> = records.iter().map(|(profile, _)| profile.mean_v).collect();
        let mut model = Model::new(&supposed, options, shared_amplitudes);
        for (r, cause) in causes.iter().enumerate() {
            model.add_under(r, cause.scatter.iter().chain(&cause.ground.tones));
        }
        let fitter = Fitter::new(model, &means_v, evidence_min, options.pulses_max)
            .starting_from(&options.predictions)
            .with_least_share(least_share);
        let (state, evidences) = fitter.grown();
        let widths: Vec<Option<Width>> =
            (0..records.len()).map(|r| Width::of(&fitter, &state, r, causes[r].stretch, options.width_sd)).collect();
        let least_score = if has_pair(&fitter, &state, |_, _| true) { WIDTH_SIGMA_BLENDED } else { WIDTH_SIGMA };
        let mut hints: Vec<Hint> = (0..records.len())
            .flat_map(|r| {
                let may_be_wider = options.extent_max_ps == 0.0;
                let hint = |width: &Width| {
                    width.hint(r, &causes[r], least_score).filter(|hint| may_be_wider || hint.causes[0].stretch < 0.0)
                };
                let width = widths[r].as_ref().and_then(hint);
                let grounds = Ground::of(&fitter, &state, r, evidence_min);
                let ground = grounds.first().map(|(_, promise)| {
                    let with = |(ground, _): &(Ground, f64)| Cause {
                        ground: causes[r].ground.and(ground),
                        ..causes[r].clone()
                    };
                    Hint { record: r, causes: grounds.iter().map(with).collect(), promise: *promise, least_gain: 0.0 }
                });
                [width, ground]
            })
            .flatten()
            .collect();
        hints.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        if options.extent_max_ps == 0.0
            && !options.signed
            && has_pair(&fitter, &state, |small, large| small < BESIDE_SHARE * large)
        {
            hints.extend(trials(causes));
        }
        let stretches = causes.iter().map(|cause| (cause.stretch / options.width_sd).powi(2));
        let cost = fitter.cost(&state) + stretches.sum::<f64>();
        let taken = widths.iter().zip(causes).filter(|(_, cause)| cause.stretch != 0.0);
        let common = taken.filter_map(|(width, _)| width.as_ref()).map(Width::common).collect();
        let mut fits = run(&fitter, &state, evidences, common, evidence_min);
        for ((fit, cause), width) in fits.iter_mut().zip(causes).zip(&widths) {
            fit.ground_v = cause.ground.sd_v();
            fit.width = width.as_ref().map(|width| width.shown);
        }
        let jitters: Vec<Option<Jitter>> = records.iter().map(|(profile, _)| profile.jitter).collect();
        Self { fits, cost, hints, scatter: scatter::directions(&fitter, &state, &jitters) }
    }
}

/// Whether two pulses of such amplitudes stand beside one another.
fn has_pair(fitter: &Fitter, state: &State, are_such: impl Fn(f64, f64) -> bool) -> bool {
    let is_beside = |k: usize, j: usize| {
        k != j
            && (state.time_ps(k) - state.time_ps(j)).abs() < BESIDE_WIDTHS * fitter.model.width_ps
            && are_such(state.amplitude(k), state.amplitude(j))
    };
    (0..state.pulses()).any(|k| (0..state.pulses()).any(|j| is_beside(k, j)))
}

/// Another width of the response in each record, as long as none was taken.
fn trials(causes: &[Cause]) -> Vec<Hint> {
    if causes.iter().any(|cause| cause.stretch != 0.0) {
        return Vec::new();
    }
    let least_gain = WIDTH_SIGMA_BLENDED.powi(2);
    let trial = |(record, stretch): (usize, f64)| {
        let cause = Cause { stretch, ..causes[record].clone() };
        Hint { record, causes: vec![cause], promise: 0.0, least_gain }
    };
    let records = || 0..causes.len();
    [WIDTH_TRIAL, -WIDTH_TRIAL]
        .into_iter()
        .flat_map(|stretch| records().map(move |r| (r, stretch)))
        .map(trial)
        .collect()
}

/// Variances of components, one upon the other.
pub(super) fn sum(own: &[f64], other: &[f64]) -> Vec<f64> {
    let at = |values: &[f64], k: usize| values.get(k).copied().unwrap_or(0.0);
    (0..own.len().max(other.len())).map(|k| at(own, k) + at(other, k)).collect()
}

/// What a record says of the response's width.
struct Width {
    /// The likeliest logarithm of its factor with the prior, to first order, and the variance of that.
    stretch: f64,
    variance: f64,
    /// What the record alone says of the factor, and its standard deviation: those of many records add up.
    shown: [f64; 2],
    /// Chi2 that it would gain.
    gain: f64,
    imitation: Vec<f64>,
}

impl Width {
    /// `None` where there are no pulses, or these tell nothing.
    fn of(fitter: &Fitter, state: &State, r: usize, stretch: f64, sd: f64) -> Option<Self> {
        let group = fitter.group_of(r);
        let direction = |(other, record): (usize, &WhitenedRecord)| {
            let pulses = (0..state.pulses()).filter(|k| other == r && state.place(*k).shapes() == 0);
            let column = |k: usize| (state.amplitude_of(group, k), Column::stretching(record, state.time_ps(k)));
            (1.0, Column::sum(pulses.map(column), record.len()))
        };
        let direction: Vec<(f64, Column)> = fitter.model.records.iter().enumerate().map(direction).collect();
        let Slope { with_residual, own, imitation } = fitter.slope(state, &direction);
        let is_known = own > WIDTH_SD_MAX.powi(-2) || stretch != 0.0 && own > 0.0;
        (state.pulses() > 0 && is_known).then(|| {
            let prior = sd.powi(-2);
            let step = (with_residual - stretch * prior) / (own + prior);
            let variance = (own + prior).recip();
            let shown = [(stretch + with_residual / own).exp(), own.sqrt().recip()];
            Self { stretch: stretch + step, variance, shown, gain: step * step / variance, imitation }
        })
    }

    fn hint(&self, record: usize, cause: &Cause, least_score: f64) -> Option<Hint> {
        let least = if cause.stretch == 0.0 { least_score } else { WIDTH_SETTLED };
        let stretch = self.stretch.clamp(cause.stretch - WIDTH_STEP, cause.stretch + WIDTH_STEP);
        let cause = Cause { stretch, ..cause.clone() };
        (self.gain > least * least).then(|| Hint { record, causes: vec![cause], promise: self.gain, least_gain: 0.0 })
    }

    /// Its error in all unknowns.
    fn common(&self) -> Common {
        Common { per_unit: self.imitation.clone(), variance: self.variance }
    }
}

/// A baseline that moves.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Ground {
    /// Variances of its components beyond those of the record's slow noise, V^2.
    pub(super) variances_v2: Vec<f64>,
    /// Cosines and sines of tones.
    pub(super) tones: Vec<Direction>,
}

impl Ground {
    /// What may be added to it for the residual of record `r`, and the chi2 that each promises, the most first; nothing
    /// where noise explains it.
    pub(super) fn of(fitter: &Fitter, state: &State, r: usize, evidence_min: f64) -> Vec<(Self, f64)> {
        if fitter.misfit(state, Some(r), None).sigma() < MISFIT_SIGMA {
            return Vec::new();
        }
        let (record, residual) = (&fitter.model.records[r], &state.residuals[r]);
        let tone = Tone::of(record, residual)
            .map(|Tone { directions, promise }| (Self { tones: directions, ..Self::default() }, promise));
        let mut all: Vec<(Self, f64)> = tone.into_iter().chain(Self::slow(record, residual)).collect();
        all.retain(|(_, promise)| *promise > evidence_min);
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        all
    }

    /// Components of one variance, the first ones.
    fn slow(record: &WhitenedRecord, residual: &[f64]) -> Option<(Self, f64)> {
        let (mut power, mut left) = (Vec::new(), Vec::new());
        for k in 0..(record.len() / SAMPLES_PER_COMPONENT).min(COMPONENTS_MAX) {
            let direction = slow_direction(&record.whitener, k);
            let dot = |other: &[f64]| direction.iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
            let own = dot(&record.nuisance.without(&direction));
            let counts = own > NEW * NEW * dot(&direction);
            power.push(if counts { dot(residual).powi(2) / own } else { 1.0 });
            left.push(own);
        }
        let of_first = |count: usize| {
            let mean = |values: &[f64]| values[..count].iter().sum::<f64>() / count as f64;
            let excess = (mean(&power) - 1.0).max(0.0);
            (count as f64 * (excess - excess.ln_1p()), count, excess / mean(&left))
        };
        let (promise, count, variance_v2) = (1..=power.len()).map(of_first).max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((Self { variances_v2: vec![variance_v2; count], ..Self::default() }, promise))
    }

    /// Both together.
    pub(super) fn and(&self, other: &Self) -> Self {
        let tones = self.tones.iter().chain(&other.tones).cloned().collect();
        Self { variances_v2: sum(&self.variances_v2, &other.variances_v2), tones }
    }

    /// Its standard deviation, V: half of a tone's variance is the cosine's, half the sine's.
    fn sd_v(&self) -> f64 {
        let tones: f64 = self.tones.iter().map(|(_, variance_v2)| 0.5 * variance_v2).sum();
        (self.variances_v2.iter().sum::<f64>() + tones).sqrt()
    }
}
