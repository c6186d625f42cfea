//! The response as the pulses of many records show it, where that contradicts the calibration.
//!
//! A response that was measured another day is a little wider or narrower, has an echo from a connector, or a tail. One
//! record can hardly tell that from light: an echo looks like a weak pulse, a wider response like two pulses. Many
//! records can, since light arrives at other distances in each, and what is the sensor's does not.
//!
//! Model: `h + sum_j c_j e_j` in the place of h, with small coefficients c of given standard deviations about 0. The
//! shapes e are the derivative by the logarithm of the width, that by the variance of a blur to either side, as jitter
//! of the trigger or a slower amplifier make, copies of the response at delays, and the response behind exponential
//! tails. Each record is fitted with its pulses; the residual's products with the shapes, freed of what
//! times, amplitudes and ground of the record can imitate, add up to the normal equations of c. All is Gaussian, so
//! that the marginal likelihoods of all models are known in closed form: the calibration stands; its width is another,
//! or it is blurred; that, with echoes and tails. A width and a blur at once would hardly be told apart.
//!
//! A correction counts if it is as large in all records: patches that spread light each in their own way, and bounces
//! that follow one another, are no property of the sensor. (A random effect between records: DerSimonian and Laird,
//! Control. Clin. Trials 7, 177 (1986).)
//!
//! What a record shows besides pulses and noise, a baseline that moves ([`super::cause`]), is its own: it is explained
//! before the record is asked, or else ripple would pass for tails of the response.
//!
//! Not modelled: a response that arrives earlier or later, which no record tells from light that does.

use super::cause::{self, ATTEMPTS, Ground};
use super::column::Column;
use super::evidence::evidence_min_of;
use super::greedy::Fitter;
use super::linear::Cholesky;
use super::model::Model;
use super::nuisance::Direction;
use super::scatter;
use super::state::State;
use super::{Baseline, FALSE_PULSES, Profile, Response, SparseOptions, WIDTH_SD};

/// Distance of the copies of the response, in widths, the first one's place in units of that, and their number: nearer
/// ones look like another width, and wider gaps would miss a fast response between them.
const DELAY_WIDTHS: f64 = 0.25;
const FIRST_DELAY: usize = 2;
const DELAYS: usize = 31;
/// Light that patches spread in time is not followed by a copy that lies so many widths later.
const LATE_WIDTHS: f64 = 2.0;
/// Constants of the tails, in widths, and how many of these a tail is followed.
const TAILS_WIDTHS: [f64; 3] = [2.0, 4.0, 8.0];
const TAIL_REACH: f64 = 6.0;
/// Shapes that change the response where it is: its width, its blur.
const OWN_SHAPES: usize = 2;
/// Nodes and weights of a Gaussian of variance 1: exact up to the fifth power.
const NODES: [(f64, f64); 3] = [(-1.732_050_8, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_8, 1.0 / 6.0)];
/// Standard deviation of a Gaussian over its width at half maximum.
const SD_PER_WIDTH: f64 = 0.424_66;
/// Standard deviations of the coefficients before a record is seen: of a blur's variance over that of a Gaussian as
/// wide as the response, of an echo's share of the amplitude, of a tail's share of the area.
const BLUR_SD: f64 = 0.05;
const ECHO_SD: f64 = 0.01;
const TAIL_SD: f64 = 0.02;
/// Rounds: what a pulse must be worth in each as a share of the strongest, and whether width or blur alone is sought.
/// What an error of the response makes of the strongest is less at first, and is corrected before it could be taken for
/// light; a width that is off is corrected before what is not linear in it could be taken for echoes.
const ROUNDS: [(f64, bool); 6] = [(1e-2, true), (1e-3, true), (1e-2, false), (1e-3, false), (0.0, false), (0.0, false)];
/// Logarithm of the ratio of likelihoods that a change of the width must bring, and what more than that a change of the
/// shape.
const LEAST_GAIN: f64 = 7.0;
const LEAST_MORE: f64 = 3.0;
/// Fewer records of equal weight are not many, nor are fewer that know the size of a correction to a quarter.
const RECORDS_MIN: f64 = 6.0;
const TELLING: f64 = 16.0;
/// The sizes of the correction in the records may have this standard deviation, over its own size.
const SPREAD_MAX: f64 = 0.35;
/// Standard deviations of chi2 that a spread must exceed.
const SPREAD_SIGMA: f64 = 2.0;

/// A response, and how it may differ from what it is.
#[derive(Clone, Debug)]
pub struct ResponseErrors {
    response: Response,
    /// The derivative by the logarithm of the width, that by the variance of a blur, then the others.
    shapes: Vec<Response>,
    sds: Vec<f64>,
    /// Whether light may be spread in time, which looks like a wider response.
    may_spread: bool,
}

/// What one record says of the coefficients: twice the logarithm of its likelihood falls from `2 gradient c` by
/// `c information c`.
#[derive(Clone, Debug)]
pub struct ResponseScore {
    information: Vec<f64>,
    gradient: Vec<f64>,
}

/// A response that explains all records better than the calibration's.
#[derive(Clone, Debug)]
pub struct OwnResponse {
    /// Coefficient of each shape.
    pub coefficients: Vec<f64>,
    /// Factor of the width, and its standard deviation; `None` where it is the calibration's.
    pub width: Option<[f64; 2]>,
    /// Logarithm of the ratio of likelihoods to the calibration's response.
    pub gain: f64,
    /// Standard deviation of the correction's size between records, over its size: the least that they allow, and the
    /// likeliest.
    pub spread: [f64; 2],
}

impl OwnResponse {
    /// What its echoes and tails add to the area of the response, as a share; `None` where it has none.
    #[must_use]
    pub fn tail(&self) -> Option<f64> {
        let added = &self.coefficients[OWN_SHAPES..];
        added.iter().any(|c| *c != 0.0).then(|| added.iter().sum())
    }

    /// Whether the correction is the sensor's: as large in all records.
    #[must_use]
    pub fn is_common(&self) -> bool {
        self.spread[0] < SPREAD_MAX
    }
}

impl ResponseErrors {
    /// Of a pulse's response; `may_spread` where light may be spread in time ([`SparseOptions::extent_max_ps`]): then
    /// a wider response is not sought, nor are echoes within two widths, since these may be the patches' light.
    /// `None` for a step's response.
    #[must_use]
    pub fn new(response: &Response, may_spread: bool) -> Option<Self> {
        if response.is_step() {
            return None;
        }
        let width_ps = response.width_ps();
        let delays = (FIRST_DELAY..).take(DELAYS).map(|n| n as f64 * DELAY_WIDTHS);
        let echoes = delays.map(|widths| response.delayed(widths * width_ps));
        let tails = TAILS_WIDTHS.iter().map(|widths| tailed(response, widths * width_ps));
        let own = [stretching(response), blurring(response)];
        let shapes: Vec<Response> = own.into_iter().chain(echoes).chain(tails).collect();
        let sds = (0..shapes.len()).map(|j| match j {
            0 => WIDTH_SD,
            1 => BLUR_SD,
            _ if j < shapes.len() - TAILS_WIDTHS.len() => ECHO_SD,
            _ => TAIL_SD,
        });
        Some(Self { response: response.clone(), sds: sds.collect(), shapes, may_spread })
    }

    /// Coefficients of the response as it is.
    fn none(&self) -> Vec<f64> {
        vec![0.0; self.shapes.len()]
    }

    /// The response with these coefficients.
    ///
    /// # Panics
    /// When there are not as many coefficients as shapes.
    #[must_use]
    pub fn response(&self, coefficients: &[f64]) -> Response {
        assert_eq!(coefficients.len(), self.shapes.len(), "one coefficient a shape");
        let own = blurred(self.response.stretched(coefficients[0].exp()), coefficients[1]);
        let added: Vec<(&Response, f64)> =
            self.shapes.iter().zip(coefficients.iter().copied()).skip(OWN_SHAPES).filter(|(_, c)| *c != 0.0).collect();
        if added.is_empty() {
            return own;
        }
        let step_ps = self.response.step_ps();
        let supports = added.iter().map(|(shape, _)| shape.support_ps()).chain([own.support_ps()]);
        let (first_ps, last_ps) =
            supports.fold((f64::INFINITY, f64::NEG_INFINITY), |all, one| (all.0.min(one.0), all.1.max(one.1)));
        let (first, last) = ((first_ps / step_ps).floor() as i64, (last_ps / step_ps).ceil() as i64);
        let value = |n: i64| {
            let after_ps = n as f64 * step_ps;
            own.value(after_ps) + added.iter().map(|(shape, c)| c * shape.value(after_ps)).sum::<f64>()
        };
        Response::new(first as f64 * step_ps, step_ps, &(first..=last).map(value).collect::<Vec<_>>())
    }

    /// By how much later a pulse of another response is taken to arrive, ps, to first order in what they differ by.
    #[must_use]
    pub fn delay_ps(&self, other: &Response) -> f64 {
        let ((first_ps, last_ps), step_ps) = (other.support_ps(), self.response.step_ps());
        // Products of the response, its slope, and the other.
        let (mut own, mut both, mut slopes, mut height, mut rise) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for n in 0..=((last_ps - first_ps) / step_ps) as usize {
            let after_ps = first_ps + n as f64 * step_ps;
            let (value, slope) = self.response.value_and_slope(after_ps);
            let other = other.value(after_ps);
            own += value * value;
            both += value * slope;
            slopes += slope * slope;
            height += value * other;
            rise += slope * other;
        }
        // The other as `height response - height delay slope`.
        -(own * rise - both * height) / (slopes * height - both * rise)
    }

    /// What a record says, fitted with the response of these coefficients; `averaged` is what averaging leaves of a
    /// response in it. Pulses that are worth less than `least_share` of what the strongest is are not sought. `None`
    /// where the record shows no pulse.
    ///
    /// # Panics
    /// For what [`super::fit`] panics for.
    pub fn score(
        &self,
        profile: &Profile,
        coefficients: &[f64],
        averaged: impl Fn(&Response) -> Response,
        least_share: f64,
        options: &SparseOptions,
    ) -> Option<ResponseScore> {
        let response = averaged(&self.response(coefficients));
        let evidence_min = options.evidence_min.unwrap_or_else(|| evidence_min_of(profile, &response, FALSE_PULSES));
        let (mut ground, mut scattered) = (Ground::default(), Vec::new());
        let fitted = |ground: &Ground, scattered: &[Vec<Direction>]| {
            let slow_v2 = cause::sum(profile.slow_v2, &ground.variances_v2);
            let supposed = Profile { slow_v2: &slow_v2, ..*profile };
            let mut model = Model::new(&[(supposed, &response)], options, true);
            model.add_under(0, ground.tones.iter().chain(scattered.iter().flatten()));
            let fitter = Fitter::new(model, &[profile.mean_v], evidence_min, options.pulses_max);
            let fitter = fitter.with_least_share(least_share);
            let (state, _) = fitter.grown();
            (fitter.cost(&state), fitter, state)
        };
        let mut best = fitted(&ground, &scattered);
        let found = scatter::directions(&best.1, &best.2, &[profile.jitter]);
        if found.iter().any(|directions| !directions.is_empty()) {
            scattered = found;
            best = fitted(&ground, &scattered);
        }
        for _ in 0..if options.baseline == Baseline::Line { ATTEMPTS } else { 0 } {
            let more = Ground::of(&best.1, &best.2, 0, evidence_min);
            let trials =
                more.iter().map(|(more, _)| ground.and(more)).map(|ground| (fitted(&ground, &scattered), ground));
            let likeliest = trials.min_by(|a, b| a.0.0.total_cmp(&b.0.0));
            let Some((trial, changed)) = likeliest.filter(|(trial, _)| trial.0 <= best.0) else { break };
            (best, ground) = (trial, changed);
        }
        self.score_of(&best.1, &best.2, coefficients, &averaged)
    }

    /// What the record of a fit says.
    fn score_of(
        &self,
        fitter: &Fitter,
        state: &State,
        coefficients: &[f64],
        averaged: impl Fn(&Response) -> Response,
    ) -> Option<ResponseScore> {
        if state.pulses() == 0 {
            return None;
        }
        let record = &fitter.model.records[0];
        let direction = |(j, shape): (usize, &Response)| {
            let shape = averaged(shape);
            // A pulse that is spread in time tells nothing of width and blur.
            let tells = |k: &usize| j >= OWN_SHAPES || state.place(*k).shapes() == 0;
            let column = |k: usize| (state.amplitude(k), Column::of_shape(record, state.time_ps(k), &shape));
            Column::sum((0..state.pulses()).filter(tells).map(column), record.len())
        };
        let directions = self.shapes.iter().enumerate().map(direction).collect();
        let (mut information, mut gradient) = fitter.information(state, directions);
        let inflation = fitter.misfit(state, None, None).inflation().powi(2);
        information.iter_mut().chain(&mut gradient).for_each(|value| *value /= inflation);
        for (gradient, row) in gradient.iter_mut().zip(information.chunks(coefficients.len())) {
            *gradient += row.iter().zip(coefficients).map(|(a, b)| a * b).sum::<f64>();
        }
        Some(ResponseScore { information, gradient })
    }

    /// The response that the records show, in rounds, each linear in small coefficients; `None` where the calibration's
    /// response explains them as well, or they are too few. `scores` has what [`Self::score`] says of each record, for
    /// the coefficients and the least share of a round.
    pub fn own_response(&self, scores: impl Fn(&[f64], f64) -> Vec<ResponseScore>) -> Option<OwnResponse> {
        let mut own: Option<OwnResponse> = None;
        for (least_share, is_own_alone) in ROUNDS {
            let coefficients = own.map_or_else(|| self.none(), |own| own.coefficients);
            own = self.estimate(&scores(&coefficients, least_share), is_own_alone);
            if own.is_none() && !is_own_alone {
                return None;
            }
        }
        own
    }

    /// What all records say together, of the width or a blur alone or of the whole shape.
    fn estimate(&self, scores: &[ResponseScore], is_own_alone: bool) -> Option<OwnResponse> {
        let shapes = self.shapes.len();
        let mut all = ResponseScore { information: vec![0.0; shapes * shapes], gradient: vec![0.0; shapes] };
        for score in scores {
            all.information.iter_mut().zip(&score.information).for_each(|(sum, value)| *sum += value);
            all.gradient.iter_mut().zip(&score.gradient).for_each(|(sum, value)| *sum += value);
        }
        let is_allowed = |own: &OwnResponse| !self.may_spread || own.coefficients[0] <= 0.0;
        let best = |all: Vec<OwnResponse>| all.into_iter().max_by(|a, b| a.gain.total_cmp(&b.gain));
        // A blur to either side is what light that is spread in time looks like.
        let own_shapes = 0..if self.may_spread { 1 } else { OWN_SHAPES };
        let alone = own_shapes.clone().filter_map(|own| self.posterior(&all, &[own])).filter(is_allowed);
        let alone = best(alone.collect());
        let of_alone = alone.as_ref().map_or(0.0, |own| own.gain);
        let with_late = |own: usize| {
            // Where the pulses are as wide as calibrated or wider, a narrower response with a tail would imitate light
            // that patches spread.
            let own = (of_alone > LEAST_GAIN || !self.may_spread).then_some(own);
            let shapes: Vec<usize> = own.into_iter().chain(self.first_late()..shapes).collect();
            self.posterior(&all, &shapes)
        };
        let shape = own_shapes.filter(|_| !is_own_alone).filter_map(with_late).filter(is_allowed);
        let shape = best(shape.collect()).filter(|own| own.gain > of_alone.max(LEAST_GAIN) + LEAST_MORE);
        let mut found = shape.or(alone).filter(|found| found.gain > LEAST_GAIN)?;
        let sizes: Vec<(f64, f64)> = scores.iter().filter_map(|score| score.size_along(&found.coefficients)).collect();
        found.spread = spread(&sizes)?;
        if let Some([width, sd]) = &mut found.width {
            *sd = sd.hypot(found.spread[1] * width.ln());
        }
        Some(found)
    }

    /// The first of the shapes after width and blur that light which patches spread in time does not make.
    fn first_late(&self) -> usize {
        OWN_SHAPES + if self.may_spread { (LATE_WIDTHS / DELAY_WIDTHS) as usize - FIRST_DELAY } else { 0 }
    }

    /// The likeliest coefficients of these shapes, the others 0.
    fn posterior(&self, score: &ResponseScore, shapes: &[usize]) -> Option<OwnResponse> {
        // In units of the standard deviations before.
        let scaled = |i: usize, j: usize| {
            f64::from(u8::from(i == j)) + self.sds[i] * self.sds[j] * score.information[i * self.shapes.len() + j]
        };
        let matrix = shapes.iter().flat_map(|i| shapes.iter().map(|j| scaled(*i, *j))).collect();
        let factor = Cholesky::new(matrix, shapes.len())?;
        let mut half: Vec<f64> = shapes.iter().map(|j| self.sds[*j] * score.gradient[*j]).collect();
        factor.solve_lower(&mut half);
        let gain = 0.5 * half.iter().map(|v| v * v).sum::<f64>() - factor.half_log_determinant();
        factor.solve_upper(&mut half);
        let mut coefficients = self.none();
        for (j, value) in shapes.iter().zip(half) {
            coefficients[*j] = self.sds[*j] * value;
        }
        let sd = self.sds[shapes[0]] * factor.inverse()[0].sqrt();
        let width = match shapes[0] {
            0 => Some([coefficients[0].exp(), sd]),
            // As the variances of Gaussians add up.
            1 => Some([(1.0 + coefficients[1]).max(0.0).sqrt(), 0.5 * sd]),
            _ => None,
        };
        Some(OwnResponse { coefficients, width, gain, spread: [0.0; 2] })
    }
}

impl ResponseScore {
    /// Size of a correction in this record, over the given one's, and the weight of that; `None` where it tells
    /// nothing.
    fn size_along(&self, coefficients: &[f64]) -> Option<(f64, f64)> {
        let dot = |a: &[f64]| a.iter().zip(coefficients).map(|(a, b)| a * b).sum::<f64>();
        let weight: f64 =
            self.information.chunks(coefficients.len()).zip(coefficients).map(|(row, c)| c * dot(row)).sum();
        (weight > 0.0).then(|| (dot(&self.gradient) / weight, weight))
    }
}

/// Standard deviation of sizes, each with its weight, beyond what the weights explain: the least, and the likeliest.
/// `None` of too few.
fn spread(sizes: &[(f64, f64)]) -> Option<[f64; 2]> {
    let sum = |of: &dyn Fn(&(f64, f64)) -> f64| sizes.iter().map(of).sum::<f64>();
    let (weights, squared) = (sum(&|(_, w)| *w), sum(&|(_, w)| w * w));
    let telling = sizes.iter().filter(|(_, weight)| *weight > TELLING).count() as f64;
    if sizes.is_empty() || (weights * weights / squared).max(telling) < RECORDS_MIN {
        return None;
    }
    let mean = sum(&|(size, w)| w * size) / weights;
    let chi2 = sum(&|(size, w)| w * (size - mean).powi(2));
    let freedom = sizes.len() as f64 - 1.0;
    let of_excess = |excess: f64| (excess / (weights - squared / weights)).max(0.0).sqrt();
    Some([of_excess(chi2 - freedom - SPREAD_SIGMA * (2.0 * freedom).sqrt()), of_excess(chi2 - freedom)])
}

/// The derivative of a response by the logarithm of its width.
fn stretching(response: &Response) -> Response {
    let ((first_ps, last_ps), step_ps) = (response.support_ps(), response.step_ps());
    let knots = ((last_ps - first_ps) / step_ps).round() as usize;
    let at = |n: usize| first_ps + n as f64 * step_ps;
    let values: Vec<f64> = (0..=knots).map(|n| -at(n) * response.value_and_slope(at(n)).1).collect();
    Response::new(first_ps, step_ps, &values)
}

/// The derivative of a response by the variance of a blur, over that of a Gaussian of its width.
fn blurring(response: &Response) -> Response {
    let ((first_ps, last_ps), step_ps) = (response.support_ps(), response.step_ps());
    let knots = ((last_ps - first_ps) / step_ps).round() as usize;
    let half_variance_ps2 = 0.5 * (SD_PER_WIDTH * response.width_ps()).powi(2);
    let value = |n: usize| half_variance_ps2 * response.curvature(first_ps + n as f64 * step_ps);
    Response::new(first_ps, step_ps, &(0..=knots).map(value).collect::<Vec<_>>())
}

/// A response blurred by a Gaussian whose variance is this share of that of one of its width; sharper for a negative
/// share, to first order.
fn blurred(response: Response, share: f64) -> Response {
    if share == 0.0 {
        return response;
    }
    let step_ps = response.step_ps();
    let sd_ps = SD_PER_WIDTH * response.width_ps() * share.abs().sqrt();
    let reach = (NODES[2].0 * sd_ps / step_ps).ceil();
    let (first_ps, last_ps) = response.support_ps();
    let knots = ((last_ps - first_ps) / step_ps).round() + 2.0 * reach;
    let value = |n: usize| {
        let after_ps = first_ps + (n as f64 - reach) * step_ps;
        let wider: f64 = NODES.iter().map(|(node, weight)| weight * response.value(after_ps - node * sd_ps)).sum();
        if share > 0.0 { wider } else { 2.0 * response.value(after_ps) - wider }
    };
    Response::new(first_ps - reach * step_ps, step_ps, &(0..=knots as usize).map(value).collect::<Vec<_>>())
}

/// A response behind an exponential of constant `tail_ps` and area 1.
fn tailed(response: &Response, tail_ps: f64) -> Response {
    let ((first_ps, last_ps), step_ps) = (response.support_ps(), response.step_ps());
    let knots = ((last_ps - first_ps + TAIL_REACH * tail_ps) / step_ps).ceil() as usize;
    let decay = (-step_ps / tail_ps).exp();
    let mut value = 0.0;
    let values: Vec<f64> = (0..=knots)
        .map(|n| {
            value = decay * value + (1.0 - decay) * response.value(first_ps + n as f64 * step_ps);
            value
        })
        .collect();
    Response::new(first_ps, step_ps, &values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian() -> Response {
        let values: Vec<f64> = (-60..=60).map(|n| (-0.5 * (f64::from(n) * 5.0 / 60.0).powi(2)).exp()).collect();
        Response::new(-300.0, 5.0, &values)
    }

    #[test]
    fn shapes_add_up() {
        let response = gaussian();
        let errors = ResponseErrors::new(&response, false).unwrap();
        assert_eq!(errors.none().len(), OWN_SHAPES + DELAYS + TAILS_WIDTHS.len());
        let mut coefficients = errors.none();
        (coefficients[0], coefficients[OWN_SHAPES + 8 - FIRST_DELAY]) = (0.02, 0.01);
        let changed = errors.response(&coefficients);
        for n in -40..60 {
            let t = 7.0 * f64::from(n);
            let expected = (-0.5 * (t / 60.0 / 0.02_f64.exp()).powi(2)).exp()
                + 0.01 * response.value(t - 2.0 * response.width_ps());
            assert!((changed.value(t) - expected).abs() < 1e-5, "at {t}: {} for {expected}", changed.value(t));
        }
        // The next one blurs: variances of Gaussians add up.
        for share in [0.2, -0.05] {
            let mut coefficients = errors.none();
            coefficients[1] = share;
            let changed = errors.response(&coefficients);
            let sd_ps = 60.0 * (1.0 + share).sqrt();
            for n in -40..60 {
                let t = 7.0 * f64::from(n);
                let expected = 60.0 / sd_ps * (-0.5 * (t / sd_ps).powi(2)).exp();
                assert!((changed.value(t) - expected).abs() < 2e-3, "{share} at {t}: {} {expected}", changed.value(t));
            }
        }
        // To first order, the first shape is what a width does.
        let (less, more) = (response.stretched(0.999), response.stretched(1.001));
        for t in [-100.0, -30.0, 0.0, 55.0, 130.0] {
            let slope = (more.value(t) - less.value(t)) / 0.002;
            assert!((errors.shapes[0].value(t) - slope).abs() < 1e-4);
        }
        assert!((errors.delay_ps(&response.delayed(1.5)) - 1.5).abs() < 0.01);
        // A tail has the area that it is a share of.
        let area = |of: &Response| (-60..2000).map(|n| 5.0 * of.value(5.0 * f64::from(n))).sum::<f64>();
        let share = area(errors.shapes.last().unwrap()) / area(&response);
        assert!((share - 1.0).abs() < 5e-3, "{share}");
    }

    #[test]
    fn what_differs_from_record_to_record_is_no_property_of_the_sensor() {
        let alike: Vec<(f64, f64)> = (0..20).map(|n| (1.0 + 0.1 * f64::from(n % 3 - 1), 100.0)).collect();
        assert!(spread(&alike).unwrap()[1] < 0.05);
        let other: Vec<(f64, f64)> = (0..20).map(|n| (f64::from(n % 3), 100.0)).collect();
        assert!(spread(&other).unwrap().iter().all(|spread| (spread - 0.8).abs() < 0.1));
        assert!(spread(&alike[..4]).is_none() && spread(&[]).is_none());
    }
}
