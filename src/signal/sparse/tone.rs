//! A tone that is the same in every shot: pick-up that is locked to the laser, spurs of interleaved converters.
//!
//! It is a sine of any frequency up to half the sample rate. Where it lies, the spectrum of the whitened residual says;
//! there its frequency is refined by how much chi2 a sine and a cosine of it explain, besides what lies under the
//! pulses already. Both have one variance, that of the amplitudes found, by the marginal likelihood that
//! [`super::cause`] has for the components of a baseline that moves, less the price of having sought it everywhere.

use std::f64::consts::{PI, TAU};

use super::model::WhitenedRecord;
use super::nuisance::Direction;
use crate::fft::{Complex, RealFft};

/// Turns of a record at least: fewer are for slow components, which bend as a line does.
const LEAST_TURNS: usize = 4;
/// Bins of the spectrum to each that a record distinguishes.
const FINENESS: usize = 4;
/// Steps of the search for the frequency between bins: each leaves 0.62 of the range.
const STEPS: usize = 24;
const GOLDEN: f64 = 0.618_034;
/// Part of a sine that must be left by what is explained already.
const NEW: f64 = 0.05;

/// A tone in a residual.
pub(super) struct Tone {
    /// Cosine and sine, and the variance of either's amplitude.
    pub(super) directions: Vec<Direction>,
    /// Chi2 that it promises.
    pub(super) promise: f64,
}

impl Tone {
    /// The strongest of a record's whitened residual; `None` where the record is too short for one.
    pub(super) fn of(record: &WhitenedRecord, residual: &[f64]) -> Option<Self> {
        let len = residual.len();
        let bins = FINENESS * len;
        let mut padded = residual.to_vec();
        padded.resize(bins, 0.0);
        let mut spectrum = vec![Complex::default(); bins / 2 + 1];
        RealFft::new().forward(&padded, &mut spectrum);
        let strongest = (LEAST_TURNS * FINENESS..spectrum.len()).max_by(|a, b| {
            let [a, b] = [a, b].map(|bin: &usize| spectrum[*bin].norm_sqr());
            a.total_cmp(&b)
        })?;
        let per_bin = TAU / bins as f64;
        let gain = |turn: f64| Quadratures::of(record, turn).map_or(0.0, |both| both.gain(residual));
        let (mut low, mut high) = ((strongest as f64 - 1.0) * per_bin, ((strongest as f64 + 1.0) * per_bin).min(PI));
        for _ in 0..STEPS {
            let [a, b] = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
            if gain(a) < gain(b) { low = a } else { high = b }
        }
        let both = Quadratures::of(record, 0.5 * (low + high))?;
        let power = 0.5 * both.gain(residual);
        let excess = (power - 1.0).max(0.0);
        let promise = 2.0 * (excess - excess.ln_1p()) - 2.0 * (len as f64).ln();
        let variance = 2.0 * excess / (both.left[0] + both.left[2]);
        Some(Self { directions: both.directions.map(|direction| (direction, variance)).to_vec(), promise })
    }
}

/// Cosine and sine of a tone, whitened.
struct Quadratures {
    directions: [Vec<f64>; 2],
    /// Products of what others leave of them: cosine with itself, with sine, sine with itself.
    left: [f64; 3],
}

impl Quadratures {
    /// Of a tone that turns by so much from sample to sample; `None` where others explain it.
    fn of(record: &WhitenedRecord, turn: f64) -> Option<Self> {
        let quadrature = |of: fn(f64) -> f64| {
            record.whitener.apply(&(0..record.len()).map(|n| of(turn * n as f64)).collect::<Vec<_>>())
        };
        let directions = [quadrature(f64::cos), quadrature(f64::sin)];
        let [cos, sin] = [0, 1].map(|k| record.nuisance.without(&directions[k]));
        let left = [dot(&cos, &directions[0]), dot(&cos, &directions[1]), dot(&sin, &directions[1])];
        let all = dot(&directions[0], &directions[0]) + dot(&directions[1], &directions[1]);
        let determinant = left[0] * left[2] - left[1] * left[1];
        (determinant > (NEW * all).powi(2)).then_some(Self { directions, left })
    }

    /// Chi2 that both explain of a residual.
    fn gain(&self, residual: &[f64]) -> f64 {
        let [cos, sin] = [0, 1].map(|k| dot(&self.directions[k], residual));
        let [a, b, c] = self.left;
        (c * cos * cos - 2.0 * b * cos * sin + a * sin * sin) / (a * c - b * b)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
