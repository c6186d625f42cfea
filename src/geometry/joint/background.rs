//! The wall's own light behind the gate: a mixture of decaying exponentials, with a scale in each histogram, over a
//! constant.
//!
//! The shape comes from the sum of all histograms less the light of points. Bins in which the sum exceeds the shape
//! count little, since hidden light only adds. Exponentials with positive weights fall and are convex, so they follow
//! no pulse.

use super::{Histogram, Noise, Problem};

/// Decay lengths, from the width of the response to the whole record.
const DECAYS: usize = 14;
/// Rounds of weights, and turns of coordinates within each.
const ROUNDS: usize = 12;
const TURNS: usize = 1000;
/// Bins that lie above by this many standard deviations and this share of the light count as hidden light.
const ABOVE_SD: f64 = 2.0;
const ABOVE_SHARE: f64 = 0.01;
/// Weight of such bins.
const HIDDEN: f64 = 1e-3;
/// Newton steps for the scale and the constant of a histogram.
const STEPS: usize = 6;

/// Shape of the wall's own light by path length.
#[derive(Clone, Debug)]
pub struct Tail {
    first_m: f64,
    step_m: f64,
    values: Vec<f64>,
    constant: f64,
}

/// Scale of the tail and constant of a histogram, and the length by which all its light is late.
pub type Level = [f64; 3];
/// Before anything is known of a histogram.
pub const PLAIN: Level = [1.0, 0.0, 0.0];

impl Tail {
    /// From the sum of `count` histograms less the light of points, with `sum` and `light` in bins of `step_m`, and the
    /// noise of the sum.
    pub fn new(
        [first_m, step_m, width_m]: [f64; 3],
        (sum, light): (&[f64], &[f64]),
        (count, noise): (usize, Noise),
    ) -> Self {
        let length_m = step_m * sum.len() as f64;
        let ratio = (length_m / width_m).max(2.0);
        let decay_m = |n: usize| width_m * ratio.powf(n as f64 / (DECAYS - 1) as f64);
        let basis: Vec<Vec<f64>> = (0..=DECAYS)
            .map(|n| {
                let value = |bin: usize| (-(bin as f64) * step_m / decay_m(n)).exp();
                (0..sum.len()).map(|bin| if n == DECAYS { 1.0 } else { value(bin) }).collect()
            })
            .collect();
        let block = (width_m / step_m).ceil().max(1.0) as usize;
        let mut weights = vec![1.0; sum.len()];
        let mut mixture = vec![0.0; DECAYS + 1];
        let mut model: Vec<f64> = sum.iter().zip(light).map(|(sum, light)| (sum - light).max(0.0)).collect();
        for _ in 0..ROUNDS {
            improve(&basis, &mut mixture, (sum, light), (&weights, &model, noise));
            mix(&basis, &mixture, &mut model);
            for (n, weight) in weights.iter_mut().enumerate() {
                let bins = n.saturating_sub(block / 2)..(n + block / 2 + 1).min(sum.len());
                let of = |values: &[f64]| values[bins.clone()].iter().sum::<f64>();
                let [sum, own] = [of(sum), of(&model) + of(light)];
                let width = (block / 2 * 2 + 1) as f64;
                let sd = (width * noise.variance(own / width)).sqrt();
                let is_hidden = sum - own > ABOVE_SD * sd + ABOVE_SHARE * own;
                *weight = if is_hidden { HIDDEN } else { 1.0 };
            }
        }
        let count = count.max(1) as f64;
        let constant = mixture[DECAYS] / count;
        let values = model.iter().map(|value| value / count - constant).collect();
        Self { first_m, step_m, values, constant }
    }

    /// The constant of the sum, over the number of histograms.
    pub fn constant(&self) -> f64 {
        self.constant
    }

    /// The tail in the bins that it was made from.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The tail in the bins of a histogram.
    pub fn fill(&self, histogram: &Histogram, into: &mut Vec<f64>) {
        into.clear();
        let place = (histogram.first_m - self.first_m) / self.step_m;
        let (left, share) = (place.floor(), place - place.floor());
        let last = self.values.len().saturating_sub(1) as f64;
        let value = |n: f64| self.values.get(n.clamp(0.0, last) as usize).copied().unwrap_or(0.0);
        into.extend((0..histogram.values.len()).map(|bin| {
            let at = left + bin as f64;
            value(at) * (1.0 - share) + value(at + 1.0) * share
        }));
    }
}

/// Weights of the mixture by least squares, none below zero: coordinates in turn, on the normal equations.
fn improve(
    basis: &[Vec<f64>],
    mixture: &mut [f64],
    (sum, light): (&[f64], &[f64]),
    (weights, model, noise): (&[f64], &[f64], Noise),
) {
    let size = mixture.len();
    let (mut system, mut goal) = (vec![0.0; size * size], vec![0.0; size]);
    for n in 0..sum.len() {
        let weight = weights[n] / noise.variance(model[n] + light[n]);
        for a in 0..size {
            let slope = weight * basis[a][n];
            goal[a] += slope * (sum[n] - light[n]);
            (0..=a).for_each(|b| system[a * size + b] += slope * basis[b][n]);
        }
    }
    for _ in 0..TURNS {
        for a in 0..size {
            let at = |b: usize| system[a.max(b) * size + a.min(b)];
            let rest = goal[a] - (0..size).map(|b| at(b) * mixture[b]).sum::<f64>();
            if at(a) > 0.0 {
                mixture[a] = (mixture[a] + rest / at(a)).max(0.0);
            }
        }
    }
}

fn mix(basis: &[Vec<f64>], mixture: &[f64], model: &mut [f64]) {
    model.fill(0.0);
    for (entry, shape) in mixture.iter().zip(basis) {
        model.iter_mut().zip(shape).for_each(|(sum, value)| *sum += entry * value);
    }
}

/// The likeliest scale and constant of a histogram beneath the light of points, from a start.
pub fn level(problem: &Problem, histogram: &Histogram, tail: &[f64], light: &[f64], start: Level) -> Level {
    let values = &histogram.values;
    let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len().max(1) as f64;
    let least = match problem.noise {
        Noise::Counts => 1e-3 * mean.max(1.0 / values.len() as f64),
        Noise::Gauss { .. } => f64::NEG_INFINITY,
    };
    let [mut scale, mut constant] = [start[0], start[1].max(least)];
    for _ in 0..STEPS {
        let (mut g, mut f) = ([0.0; 2], [0.0; 3]);
        for n in 0..values.len() {
            let rate = scale * tail[n] + constant + light[n];
            let weight = problem.noise.weight(rate);
            let rest = (f64::from(values[n]) - rate) * weight;
            g[0] += rest * tail[n];
            g[1] += rest;
            f[0] += weight * tail[n] * tail[n];
            f[1] += weight * tail[n];
            f[2] += weight;
        }
        let determinant = f[0] * f[2] - f[1] * f[1];
        let [mut up, mut over] = [0.0, g[1] / f[2]];
        if determinant > 1e-9 * f[0] * f[2] {
            up = (f[2] * g[0] - f[1] * g[1]) / determinant;
            over = (f[0] * g[1] - f[1] * g[0]) / determinant;
        }
        if matches!(problem.noise, Noise::Counts) {
            if scale + up < 0.0 {
                up = -scale;
                over = (g[1] - f[1] * up) / f[2];
            } else if constant + over < least && f[0] > 0.0 {
                over = least - constant;
                up = ((g[0] - f[1] * over) / f[0]).max(-scale);
            }
        }
        scale += up;
        constant = (constant + over).max(least);
        if up * up * f[0] + over * over * f[2] < 1e-6 {
            break;
        }
    }
    [scale, constant, start[2]]
}
