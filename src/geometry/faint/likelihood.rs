//! The likelihood of a patch at a place, by its strength.

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Room;
use crate::Point;
use crate::hidden::Focus;
use crate::hidden::search::{Curve, Domain};

/// Standard deviation of the log of a pulse's amplitude about the common strength over the fall of light: four cosines.
pub const SPREAD: f64 = 0.6;
/// Probability that something stands between in a profile.
const BLOCKED: f64 = 0.05;
/// A pulse of a larger score would be an onset: chance, or what is left of strong light, counts as no more.
const SCORE_MAX: f64 = 6.0;
/// Strengths and factors lie on one logarithmic grid, so that one exponential serves many: the ratio of two neighbours.
const RATIO: f64 = 1.258_925_411_794_167_2; // ten a decade
/// The smallest root-mean-square signal-to-noise ratio, and how many there are.
const SNR_MIN: f64 = 0.158_489_319_246_111_36;
pub(super) const STRENGTHS: usize = 21;
/// Number of factors on either side of 1; they lie two steps apart.
const SIDE: usize = 3;
const FACTORS: usize = 2 * SIDE + 1;
const LADDER: usize = STRENGTHS + 4 * SIDE;
/// Number of profiles whose product of ratios neither overflows nor vanishes.
const TOGETHER: usize = 16;
/// Points along each axis that the volume is counted by.
const VOLUME_POINTS: i32 = 24;

/// What one profile says of one more pulse, by the length of its way over a hidden point: the two patches' own legs
/// taken off.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Positions of both visible patches among the foci.
    pub foci: [usize; 2],
    /// Length at the first value.
    pub low_m: f64,
    /// Distance of two values.
    pub step_m: f64,
    /// Score of a pulse: its amplitude in standard deviations.
    pub scores: Vec<f64>,
    /// What a unit of amplitude adds to the score; 0 where the record says nothing.
    pub gains: Vec<f64>,
}

impl Profile {
    /// The longest way that it holds.
    #[must_use]
    pub fn end_m(&self) -> f64 {
        self.low_m + self.step_m * (self.scores.len() as f64 - 1.0)
    }

    /// Score of a patch that is so far from each focus, and what a unit of strength adds to it; `None` where the
    /// profile could not have recorded it.
    pub(super) fn signal(&self, legs_m: &[Option<f64>]) -> Option<(f64, f64)> {
        let (a, b) = (legs_m[self.foci[0]]?, legs_m[self.foci[1]]?);
        let (score, gain) = self.at(a + b)?;
        Some((score, gain / (a * b).powi(2)))
    }

    /// Score and gain at a length; `None` outside the record.
    fn at(&self, length_m: f64) -> Option<(f64, f64)> {
        let place = (length_m - self.low_m) / self.step_m;
        if place.is_nan() || place < 0.0 {
            return None;
        }
        let (k, part) = (place as usize, place.fract());
        let between = |values: &[f64]| Some(values.get(k)? * (1.0 - part) + values.get(k + 1)? * part);
        Some((between(&self.scores)?, between(&self.gains)?))
    }
}

/// Distance of a point from each focus; `None` where it lies behind one.
pub(super) fn legs_m(foci: &[Focus], point: &Point) -> Vec<Option<f64>> {
    foci.iter().map(|focus| focus.faces(*point, 0.0).then(|| (point - focus.point).norm())).collect()
}

/// Probabilities of the factors.
fn weights() -> [f64; FACTORS] {
    let step = 2.0 * RATIO.ln() / SPREAD;
    let density = |j: usize| (-0.5 * ((j as f64 - SIDE as f64) * step).powi(2)).exp();
    let total: f64 = (0..FACTORS).map(density).sum();
    std::array::from_fn(|j| density(j) / total)
}

/// `1 - p + p sum_f w_f exp(u_f z - u_f^2 / 2)` for all strengths; `expected` is the smallest signal-to-noise ratio on
/// the ladder.
fn ratios<const COUNT: usize>(score: f64, expected: f64, weights: &[f64; FACTORS], rungs: &mut [f64]) -> [f64; COUNT] {
    let score = score.min(SCORE_MAX);
    let mut u = expected;
    for rung in &mut *rungs {
        *rung = (u * (score - 0.5 * u)).exp();
        u *= RATIO;
    }
    std::array::from_fn(|k| {
        let sum: f64 = weights.iter().enumerate().map(|(j, weight)| weight * rungs[k + 2 * j]).sum();
        BLOCKED + (1.0 - BLOCKED) * sum
    })
}

/// Log-likelihood ratios by length for pulses of about one signal-to-noise ratio, wherever the patch lies.
pub(super) fn searched(profiles: &[Profile], snr: f64, cancel: &Cancel) -> Vec<Curve> {
    let gains = || profiles.iter().flat_map(|profile| &profile.gains).filter(|gain| **gain > 0.0);
    let usual = (gains().map(|gain| gain * gain).sum::<f64>() / gains().count().max(1) as f64).sqrt();
    let weights = weights();
    let first = snr / usual * RATIO.powi(-2 * SIDE as i32);
    let curve = |profile: &Profile| {
        cancel.check();
        let mut rungs = [0.0; 4 * SIDE + 1];
        let mut value = |(score, gain): (&f64, &f64)| {
            let [ratio] = ratios::<1>(*score, first * gain, &weights, &mut rungs);
            ratio.ln() as f32
        };
        let values = profile.scores.iter().zip(&profile.gains).map(&mut value).collect();
        Curve { low_m: profile.low_m, step_m: profile.step_m, values }
    };
    profiles.par_iter().map(curve).collect()
}

/// The likelihood at a place: for each strength its log-likelihood ratio.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlaceLikelihood {
    pub(super) by_strength: [f64; STRENGTHS],
    /// Profiles that could have recorded a patch here.
    pub(super) profiles: usize,
}

impl PlaceLikelihood {
    /// Log of the mean likelihood ratio over strengths.
    pub(super) fn mean(&self) -> f64 {
        let most = self.most();
        let sum: f64 = self.by_strength.iter().map(|value| (value - most).exp()).sum();
        most + (sum / STRENGTHS as f64).ln()
    }

    pub(super) fn most(&self) -> f64 {
        self.by_strength.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Sum over strengths of their probability and the sum of squares of the signal-to-noise ratios that they mean.
    pub(super) fn squared_snr(&self) -> f64 {
        let most = self.most();
        let (mut sum, mut total, mut snr) = (0.0, 0.0, SNR_MIN);
        for value in self.by_strength {
            let weight = (value - most).exp();
            sum += weight * snr * snr;
            total += weight;
            snr *= RATIO;
        }
        sum / total * self.profiles as f64
    }
}

/// Profiles in a room.
pub(super) struct Likelihood<'a> {
    pub(super) profiles: &'a [Profile],
    pub(super) foci: &'a [Focus],
    pub(super) domain: &'a Domain,
    weights: [f64; FACTORS],
    pub(super) log_volume: f64,
    cancel: &'a Cancel,
}

impl<'a> Likelihood<'a> {
    pub(super) fn new(profiles: &'a [Profile], room: &'a Room, domain: &'a Domain) -> Self {
        let mut all =
            Self { profiles, foci: &room.foci, domain, weights: weights(), log_volume: 0.0, cancel: &room.cancel };
        all.log_volume = all.volume().ln();
        all
    }

    /// Volume of the places that count.
    fn volume(&self) -> f64 {
        let (n, flat) = (VOLUME_POINTS, self.domain.dimensions == 2);
        let step_m = 2.0 * self.domain.half_m / f64::from(n);
        let at = |k: i32| (f64::from(k) + 0.5) * step_m - self.domain.half_m;
        let row = |i: i32| {
            let points = (0..n).flat_map(|j| (0..if flat { 1 } else { n }).map(move |k| (j, k)));
            let point = |(j, k)| self.domain.centre + Vector3::new(at(i), at(j), if flat { 0.0 } else { at(k) });
            points.filter(|jk| self.signals(&point(*jk)).is_some()).count()
        };
        let count: usize = (0..n).into_par_iter().map(row).sum();
        count.max(1) as f64 * step_m.powi(self.domain.dimensions as i32)
    }

    /// Of the profiles that could have recorded a patch at a place: score, and what a unit of strength adds to it.
    /// `None` where these are no more than half.
    fn signals(&self, point: &Point) -> Option<Vec<(f64, f64)>> {
        self.cancel.check();
        if !self.domain.holds(*point, 0.0) {
            return None;
        }
        let legs_m = legs_m(self.foci, point);
        let signals: Vec<(f64, f64)> = self.profiles.iter().filter_map(|profile| profile.signal(&legs_m)).collect();
        (2 * signals.len() > self.profiles.len()).then_some(signals)
    }

    /// The likelihood of a patch at a point; `None` where too few profiles could have recorded it.
    pub(super) fn place(&self, point: &Point) -> Option<PlaceLikelihood> {
        let signals = self.signals(point)?;
        let squares: f64 = signals.iter().map(|(_, gain)| gain * gain).sum();
        if squares == 0.0 {
            return None;
        }
        // Strengths are such that the root-mean-square signal-to-noise ratio is on the ladder.
        let first = SNR_MIN * RATIO.powi(-2 * SIDE as i32) / (squares / signals.len() as f64).sqrt();
        let mut place = PlaceLikelihood { by_strength: [0.0; STRENGTHS], profiles: signals.len() };
        let mut rungs = [0.0; LADDER];
        for together in signals.chunks(TOGETHER) {
            let mut products = [1.0; STRENGTHS];
            for (score, gain) in together {
                let ratios: [f64; STRENGTHS] = ratios(*score, first * gain, &self.weights, &mut rungs);
                products.iter_mut().zip(ratios).for_each(|(product, ratio)| *product *= ratio);
            }
            place.by_strength.iter_mut().zip(products).for_each(|(sum, product)| *sum += product.ln());
        }
        Some(place)
    }

    /// The `most` points with the largest mean likelihood ratios that are at least `apart_m` from a better one.
    pub(super) fn best(&self, points: &[Point], most: usize, apart_m: f64) -> Vec<Point> {
        let judged = |point: &Point| Some((*point, self.place(point)?.mean()));
        let mut judged: Vec<(Point, f64)> = points.par_iter().filter_map(judged).collect();
        judged.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut best: Vec<Point> = Vec::new();
        for (point, _) in judged {
            if best.len() < most && best.iter().all(|other| (other - point).norm() > 3.0 * apart_m) {
                best.push(point);
            }
        }
        best
    }
}
