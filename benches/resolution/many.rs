//! d: many pulses.

use periscope::signal::sparse::SparseOptions;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::draw::{Effort, clean, draws, fit, middle_ps, noisy};
use super::information::{resolution_limit_ps, time_sds_ps};
use super::score::{Estimate, Rate, heading, mean_square, row};
use super::shape::Sensor;

/// Samples: twelve pulses at the widest spacing, and room on both sides.
const LEN: usize = 600;
/// A pulse is resolved from its next neighbour if its bound is below this fraction of their distance: for two equal
/// pulses, 1.35 limits apart.
const DISTINCT: f64 = 1.0 / 6.0;

/// One draw.
struct Draw {
    truth: usize,
    pulses: usize,
    matched: usize,
    /// Pulses that can be resolved from their neighbours.
    distinct: usize,
    distinct_matched: usize,
    /// Mean squared error over the bound, of all that are matched.
    square: f64,
    /// The truth explains the samples better than the fit.
    is_worse: bool,
}

/// 3 to 12 pulses of amplitudes from 1 to 10, spaced by 0.5 to 1.5 of `spacing_ps`.
fn light(spacing_ps: f64, rng: &mut ChaCha8Rng) -> Vec<(f64, f64)> {
    let mut at_ps = middle_ps(100, rng);
    let count = rng.random_range(3..=12);
    let pulse = |_| {
        at_ps += spacing_ps * rng.random_range(0.5..1.5);
        (at_ps, 10_f64.powf(rng.random_range(0.0..1.0)))
    };
    (0..count).map(pulse).collect()
}

/// The way from pulse `i` to its next neighbour, ps.
fn room_ps(truth: &[(f64, f64)], i: usize) -> f64 {
    let others = truth.iter().enumerate().filter(|(j, _)| *j != i);
    others.map(|(_, (at, _))| (at - truth[i].0).abs()).fold(f64::INFINITY, f64::min)
}

/// Indices of the truth, and errors, of matched pulses: the nearest first, each once, at most half the distance to the
/// next neighbour away.
fn matches(truth: &[(f64, f64)], times_ps: &[f64]) -> Vec<(usize, f64)> {
    let mut pairs: Vec<(usize, usize, f64)> = (0..truth.len())
        .flat_map(|i| times_ps.iter().enumerate().map(move |(j, at)| (i, j, at - truth[i].0)))
        .filter(|(i, _, error)| error.abs() < 0.5 * room_ps(truth, *i))
        .collect();
    pairs.sort_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
    let (mut matched, mut taken) = (vec![false; truth.len()], vec![false; times_ps.len()]);
    pairs.retain(|(i, j, _)| {
        let is_free = !matched[*i] && !taken[*j];
        matched[*i] |= is_free;
        taken[*j] |= is_free;
        is_free
    });
    pairs.into_iter().map(|(i, _, error)| (i, error)).collect()
}

fn measure(sensor: &Sensor, spacing_ps: f64, snr: f64, count: usize) -> Vec<Draw> {
    draws(&format!("many {} {spacing_ps} {snr}", sensor.name), count, |rng| {
        let truth = light(spacing_ps, rng);
        let bounds_ps = time_sds_ps(&sensor.shape, &truth, 1.0 / snr, LEN);
        let samples = noisy(&sensor.shape, &truth, 1.0 / snr, LEN, rng);
        let solution = fit(&sensor.response, &samples, 1.0 / snr, &SparseOptions::default());
        let times_ps: Vec<f64> = solution.pulses.iter().map(|pulse| pulse.time_ps).collect();
        let chi2 = |pulses: &[(f64, f64)], baseline: f64| -> f64 {
            let fitted = clean(&sensor.shape, pulses, LEN);
            samples.iter().zip(fitted).map(|(y, f)| (snr * (y - f - baseline)).powi(2)).sum()
        };
        let fitted: Vec<(f64, f64)> = solution.pulses.iter().map(|pulse| (pulse.time_ps, pulse.amplitude_v)).collect();
        let pairs = matches(&truth, &times_ps);
        let is_distinct = |i: &usize| bounds_ps[*i] < DISTINCT * room_ps(&truth, *i);
        Draw {
            truth: truth.len(),
            pulses: times_ps.len(),
            matched: pairs.len(),
            is_worse: chi2(&fitted, solution.baseline_v) > chi2(&truth, 0.0) + solution.evidence_min,
            square: mean_square(pairs.iter().map(|(i, error)| error / bounds_ps[*i])),
            distinct: (0..truth.len()).filter(is_distinct).count(),
            distinct_matched: pairs.iter().filter(|(i, _)| is_distinct(i)).count(),
        }
    })
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = [
        "response",
        "SNR",
        "limit (ps)",
        "mean spacing (limits)",
        "draws",
        "precision",
        "recall",
        "draws with all right",
        "fits worse than the truth",
        "rms / bound there",
        "rms / bound of all matched",
        "share of distinct pulses",
        "recall of those",
    ];
    heading("### d. 3 to 12 pulses, amplitudes over a factor 10; SNR and resolution limit of the weakest", &columns);
    for sensor in Sensor::both() {
        for snr in [30.0, 100.0, 1000.0] {
            let limit_ps = resolution_limit_ps(&sensor.shape, snr);
            for spacing in [3.0, 6.0, 12.0, 24.0].into_iter().filter(|spacing| spacing * limit_ps < 1500.0) {
                let draws = measure(&sensor, spacing * limit_ps, snr, effort.of(200));
                let sum = |part: fn(&Draw) -> usize| draws.iter().map(part).sum::<usize>();
                let matched = sum(|draw| draw.matched);
                let is_right = |draw: &&Draw| draw.pulses == draw.truth && draw.matched == draw.truth;
                let squares: Vec<f64> = draws.iter().filter(|draw| draw.matched > 0).map(|draw| draw.square).collect();
                let right: Vec<f64> = draws.iter().filter(is_right).map(|draw| draw.square).collect();
                let distinct = sum(|draw| draw.distinct);
                row(&[
                    sensor.name.to_owned(),
                    snr.to_string(),
                    format!("{limit_ps:.1}"),
                    spacing.to_string(),
                    draws.len().to_string(),
                    Rate { hits: matched, of: sum(|draw| draw.pulses) }.to_string(),
                    Rate { hits: matched, of: sum(|draw| draw.truth) }.to_string(),
                    Rate { hits: right.len(), of: draws.len() }.to_string(),
                    draws.iter().filter(|draw| draw.is_worse).count().to_string(),
                    Estimate::rms(&right).to_string(),
                    Estimate::rms(&squares).to_string(),
                    format!("{:.2}", distinct as f64 / sum(|draw| draw.truth) as f64),
                    Rate { hits: sum(|draw| draw.distinct_matched), of: distinct }.to_string(),
                ]);
            }
        }
    }
}
