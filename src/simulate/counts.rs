//! The photon counter: histograms of detections over the laser's pulses.
//!
//! In each cycle a bin detects with probability `live (1 - exp(-expected))`. The counter is live unless a detection
//! within the dead time before has blinded it (also from earlier cycles, as the laser repeats): early light hides late
//! light (pile-up). The live share follows from the earlier bins; for a repeating laser it is computed by iteration.
//! Detections of different cycles are independent, so each bin is drawn as a binomial. This neglects only that one
//! cycle cannot count twice within a dead time.

use rand::RngExt;
use rand_distr::{Binomial, Distribution};

use super::chain::{dark_per_bin, detections_per_j};
use super::pulse::Pulse;
use super::recorder::binned;
use super::scene::Scene;
use super::transport::Light;

/// Most iterations for the live share to converge.
const ROUNDS: usize = 200;

/// Expected detections per cycle in each bin of a perfect counter.
fn expected(scene: &Scene, pulse: &Pulse, light: &Light, factor: f64, latency_ps: f64) -> Vec<f64> {
    let instrument = &scene.instrument;
    let mut bins = vec![dark_per_bin(scene); instrument.samples];
    if light.0.is_empty() {
        return bins;
    }
    let (start_ps, strengths) = binned(light, latency_ps);
    let (area_ps, per_j) = (pulse.area_ps(), detections_per_j(scene));
    let period_ps = scene.repetition_ps().filter(|period_ps| *period_ps < instrument.samples as f64 * instrument.dt_ps);
    for (k, strength) in strengths.iter().enumerate().filter(|(_, strength)| **strength > 0.0) {
        for (i, value) in pulse.values().iter().enumerate() {
            let time_ps = start_ps + k as f64 + pulse.start_ps() + i as f64 - instrument.t0_ps;
            let time_ps = period_ps.map_or(time_ps, |period_ps| time_ps.rem_euclid(period_ps));
            let bin = (time_ps / instrument.dt_ps).floor();
            if bin >= 0.0 && bin < bins.len() as f64 {
                bins[bin as usize] += strength * factor * per_j * value * Pulse::STEP_PS / area_ps;
            }
        }
    }
    bins
}

/// Probability per cycle that each bin counts, with a dead time of `dead_bins`. If the laser repeats after `period`
/// bins, a detection also blinds the following cycles.
fn count_probabilities(expected: &[f64], dead_bins: usize, period: Option<usize>) -> Vec<f64> {
    let mut hit: Vec<f64> = expected.iter().map(|expected| -(-expected).exp_m1()).collect();
    hit.resize(period.unwrap_or(hit.len()).max(hit.len()), 0.0);
    let count = hit.len();
    let (turns, reach) = match period {
        Some(_) => (dead_bins / count, dead_bins % count),
        None => (0, dead_bins.min(count)),
    };
    let mut probabilities = hit.clone();
    for _ in 0..ROUNDS {
        // Detections of earlier cycles that still blind the first bin of this one.
        let whole = turns as f64 * probabilities.iter().sum::<f64>();
        let mut recent = if period.is_some() { probabilities[count - reach..].iter().sum() } else { 0.0 };
        let mut largest = 0.0_f64;
        for bin in 0..count {
            let live = (1.0 - whole - recent).max(0.0);
            // Half a step: with strong light a full step overshoots.
            let now = if period.is_some() { 0.5 * (probabilities[bin] + live * hit[bin]) } else { live * hit[bin] };
            largest = largest.max((now - probabilities[bin]).abs());
            recent += now;
            if bin >= reach {
                recent -= probabilities[bin - reach];
            } else if period.is_some() {
                recent -= probabilities[count + bin - reach];
            }
            probabilities[bin] = now;
        }
        if largest < 1e-12 {
            break;
        }
    }
    probabilities.truncate(expected.len());
    probabilities
}

/// Histogram of one capture over all its laser pulses.
pub fn histogram(
    scene: &Scene,
    pulse: &Pulse,
    light: &Light,
    factor: f64,
    latency_ps: f64,
    cycles: u64,
    rng: &mut impl RngExt,
) -> Vec<i32> {
    let counts = scene.instrument.counts.expect("checked: the scene has a counter");
    let expected = expected(scene, pulse, light, factor, latency_ps);
    let dead_bins = (counts.dead_time_ps / scene.instrument.dt_ps).round() as usize;
    let draw = |probability: f64| {
        let detections = Binomial::new(cycles, probability.clamp(0.0, 1.0)).expect("a probability").sample(rng);
        i32::try_from(detections).unwrap_or(i32::MAX)
    };
    let period = scene.repetition_ps().map(|period_ps| (period_ps / scene.instrument.dt_ps).round() as usize);
    count_probabilities(&expected, dead_bins, period).into_iter().map(draw).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dead time beyond the record: only the first photon of a cycle counts.
    #[test]
    fn early_light_hides_late_light() {
        let expected = [0.1, 0.0, 0.7, 0.4, 0.2];
        let probabilities = count_probabilities(&expected, 1000, None);
        let mut none = 1.0;
        for (expected, probability) in expected.iter().zip(&probabilities) {
            let first = none * (1.0 - f64::exp(-expected));
            assert!((probability - first).abs() < 1e-12, "{probability} {first}");
            none *= f64::exp(-expected);
        }
    }

    /// Constant light and a non-extended dead time: rate / (1 + rate * dead time).
    #[test]
    fn constant_light_counts_as_a_dead_time_that_is_not_extended() {
        let (expected, dead) = (1e-3, 1300);
        let probabilities = count_probabilities(&vec![expected; 500], dead, Some(500));
        let hit = 1.0 - f64::exp(-expected);
        let law = hit / (1.0 + hit * dead as f64);
        assert!(
            probabilities.iter().all(|probability| (probability / law - 1.0).abs() < 1e-6),
            "{} {law}",
            probabilities[100]
        );
    }
}
