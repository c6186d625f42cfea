//! Which shots of a capture differ too much from the others.

use super::average::PHASES;
use super::codes::Codes;
use super::column_medians::ColumnMedians;
use super::dark::Dark;
use super::median::upper_median;
use super::shot_spread::step;

/// Fewer shots say nothing about outliers.
const JUDGES_MIN: usize = 8;
/// Largest standard deviation, in steps of the converter, of noise whose median deviation after rounding may be 0:
/// 0.5 / 0.6745, since half of normal values lie within 0.6745 standard deviations.
const QUIET_SD: f64 = 0.741;
/// Robust standard deviation of rounding to whole samples, samples: 1.4826 times a quarter.
const ROUNDED_SD: f64 = 0.371;
/// Scatter of a sample over the noise from which it is common to most shots: that of so few is never so large by
/// chance.
const COMMON: f64 = 2.0;
/// Standard deviations of jitter by which a shot may be late.
const LATE_SIGMA: f64 = 5.0;

/// Finds outlying shots: those with a sample further from the median of the first shots than noise, the rounding to
/// whole samples, and what most shots scatter by there explain.
#[derive(Clone, Debug)]
pub struct OutlierTest {
    first: i64,
    dark: Dark,
    low: Vec<f64>,
    high: Vec<f64>,
    /// Whole samples by which jitter makes shots late, or early.
    late: i64,
}

impl OutlierTest {
    /// From the first shots, whose baselines are their `dark` samples; `sigma` robust standard deviations are allowed.
    /// `None` with fewer than eight shots, or none that overlap.
    #[must_use]
    pub fn new(shots: &[(Codes<'_>, i64)], dark: Dark, sigma: f64) -> Option<Self> {
        if shots.len() < JUDGES_MIN {
            return None;
        }
        // Where most shots begin and end: single shots far off do not shrink the test.
        let first =
            upper_median(&mut shots.iter().map(|(_, position)| nearest(*position) as f64).collect::<Vec<_>>()) as i64;
        let count = shots[0].0.len();
        let shifted: Vec<(i64, Vec<f64>)> = shots
            .iter()
            .map(|(codes, position)| (first - nearest(*position), without_baseline(*codes, *position, &dark)))
            .collect();
        let ColumnMedians { medians: median, deviations, fewest } = ColumnMedians::of(&shifted, count);
        if fewest < JUDGES_MIN {
            return None;
        }
        // A median deviation of 0 says only that half of the normal noise lies within half a step.
        let scale = (1.4826 * upper_median(&mut deviations.clone())).max(QUIET_SD * step(shots));
        let slope = |n: usize| {
            let neighbour = |m: usize| (median[m.min(count - 1)] - median[n]).abs();
            neighbour(n + 1).max(neighbour(n.saturating_sub(1)))
        };
        // Where most shots scatter more than noise and rounding make them, by jitter on a slope or by the laser's
        // energy, that is no fault of one.
        let common = |n: usize| {
            let own = ((1.4826 * deviations[n]).powi(2) - (ROUNDED_SD * slope(n)).powi(2)).max(0.0).sqrt();
            (own > COMMON * scale).then_some(own)
        };
        let is_steep = |n: &usize| slope(*n) > sigma * scale;
        // At the highest point, where jitter moves little, the laser's energy shows: it is no delay.
        let highest = (0..count).max_by(|a, b| median[*a].abs().total_cmp(&median[*b].abs()))?;
        let energy = common(highest).map_or(0.0, |own| own / median[highest].abs());
        let delay = |n: usize| {
            let own = common(n).unwrap_or(0.0);
            (own.powi(2) - (energy * median[n]).powi(2)).max(0.0).sqrt() / slope(n)
        };
        let mut delays: Vec<f64> = (0..count).filter(is_steep).map(delay).collect();
        let late = if delays.is_empty() { 0 } else { (LATE_SIGMA * upper_median(&mut delays)).ceil() as i64 };
        let margin: Vec<f64> = (0..count).map(|n| sigma * common(n).unwrap_or(scale) + slope(n)).collect();
        let low = median.iter().zip(&margin).map(|(median, margin)| median - margin).collect();
        let high = median.iter().zip(&margin).map(|(median, margin)| median + margin).collect();
        Some(Self { first, dark, low, high, late })
    }

    /// Whether a shot lies outside, at any sample, however late jitter may have made it.
    #[must_use]
    pub fn is_outlier(&self, codes: Codes<'_>, position: i64) -> bool {
        let own = codes.slice(self.dark.range(codes.len(), position)).mean();
        let is_outside = |late: i64| {
            let offset = nearest(position) - self.first - late;
            let (from, at) = ((-offset).max(0) as usize, offset.max(0) as usize);
            from >= codes.len()
                || at >= self.low.len()
                || codes.slice(from..codes.len()).leaves(&self.low[at..], &self.high[at..], own)
        };
        is_outside(0) && (1..=self.late).all(|late| is_outside(late) && is_outside(-late))
    }
}

fn nearest(position: i64) -> i64 {
    (position + PHASES as i64 / 2).div_euclid(PHASES as i64)
}

fn without_baseline(codes: Codes<'_>, position: i64, dark: &Dark) -> Vec<f64> {
    let mut values = Vec::new();
    codes.read_into(&mut values);
    let of_shot = &values[dark.range(values.len(), position)];
    let own = of_shot.iter().sum::<f64>() / of_shot.len() as f64;
    values.iter_mut().for_each(|value| *value -= own);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot_spread::HEAD_SHOTS;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Noise of a step or less, at any level between two: its median deviation is 0 or 1 step, whatever its sd. Steps
    /// are of one code, or of 16.
    #[test]
    fn good_shots_with_little_noise_are_not_rejected() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (noise, step) in [(0.3, 1.0), (0.5, 1.0), (0.65, 1.0), (0.74, 1.0), (1.0, 1.0), (0.5, 16.0), (0.7, 16.0)] {
            let mut wrong = 0;
            for _ in 0..10 {
                let level = rng.random_range(-0.5..0.5);
                let mut code = || -> [u8; 2] {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    ((step * (level + noise * normal).round()) as i16).to_le_bytes()
                };
                let mut shot = || -> Vec<u8> { (0..500).flat_map(|_| code()).collect() };
                let head: Vec<Vec<u8>> = (0..HEAD_SHOTS).map(|_| shot()).collect();
                let views: Vec<(Codes<'_>, i64)> = head.iter().map(|bytes| (Codes::I16(bytes), 0)).collect();
                let test = OutlierTest::new(&views, Dark::at_start(32), 6.0).expect("enough shots");
                wrong += (0..100).filter(|_| test.is_outlier(Codes::I16(&shot()), 0)).count();
            }
            assert!(wrong <= 1, "noise {noise}: {wrong} of 1000");
        }
    }

    /// A pulse hardly wider than a sample, thousands of times its noise, at any phase of the samples.
    #[test]
    fn good_shots_of_a_fast_and_strong_pulse_are_not_rejected() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut shot = || -> (Vec<u8>, i64) {
            let phase = rng.random_range(0..PHASES as i64);
            let mut code = |n: usize| -> [u8; 2] {
                let late = (n as f64 + phase as f64 / PHASES as f64 - 100.0) / 0.8;
                let normal: f64 = StandardNormal.sample(&mut rng);
                ((3000.0 * (-0.5 * late * late).exp() + normal).round() as i16).to_le_bytes()
            };
            ((0..200).flat_map(&mut code).collect(), phase)
        };
        let head: Vec<(Vec<u8>, i64)> = (0..HEAD_SHOTS).map(|_| shot()).collect();
        let views: Vec<(Codes<'_>, i64)> = head.iter().map(|(bytes, at)| (Codes::I16(bytes), *at)).collect();
        let test = OutlierTest::new(&views, Dark::at_start(32), 6.0).expect("enough shots");
        let wrong = (0..1000).map(|_| shot()).filter(|(bytes, at)| test.is_outlier(Codes::I16(bytes), *at)).count();
        assert!(wrong <= 2, "{wrong} of 1000");
    }

    /// Shots of a trigger that jitters are good ones, however late; not so those without light, or with twice as much.
    #[test]
    fn late_shots_of_a_trigger_that_jitters_are_not_rejected() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for jitter in [0.0, 0.6, 1.0] {
            let mut shot = |height: f64, late: f64| -> Vec<u8> {
                let mut code = |n: usize| -> [u8; 2] {
                    let after = (n as f64 - 100.0 - late) / 1.5;
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    ((250.0 * height * (-0.5 * after * after).exp() + 10.0 * normal).round() as i16).to_le_bytes()
                };
                (0..200).flat_map(&mut code).collect()
            };
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            let mut late = || -> f64 { jitter * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
            let head: Vec<Vec<u8>> = (0..HEAD_SHOTS).map(|_| shot(1.0, late())).collect();
            let views: Vec<(Codes<'_>, i64)> = head.iter().map(|bytes| (Codes::I16(bytes), 0)).collect();
            let test = OutlierTest::new(&views, Dark::at_start(32), 6.0).expect("enough shots");
            let mut rejected = |height: f64, after: f64| {
                (0..300).filter(|_| test.is_outlier(Codes::I16(&shot(height, after + late())), 0)).count()
            };
            let (good, none, twice) = (rejected(1.0, 0.0), rejected(0.0, 0.0), rejected(2.0, 0.0));
            assert!(good <= 5 && none >= 290 && twice >= 200, "{jitter}: {good}, {none}, {twice}");
            // Later than jitter makes any.
            assert!(rejected(1.0, 15.0) == 300, "{jitter}");
        }
    }

    /// Energy that changes from shot to shot makes none late: what comes many samples later is another light.
    #[test]
    fn energy_is_no_jitter() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut shot = |late: f64| -> Vec<u8> {
            let energy: f64 = 1.0 + 0.1 * Distribution::<f64>::sample(&StandardNormal, &mut rng);
            let mut code = |n: usize| -> [u8; 2] {
                let after = (n as f64 - 200.0 - late) / 15.0;
                let normal: f64 = StandardNormal.sample(&mut rng);
                ((3000.0 * energy * (-0.5 * after * after).exp() + 10.0 * normal).round() as i16).to_le_bytes()
            };
            (0..400).flat_map(&mut code).collect()
        };
        let head: Vec<Vec<u8>> = (0..HEAD_SHOTS).map(|_| shot(0.0)).collect();
        let views: Vec<(Codes<'_>, i64)> = head.iter().map(|bytes| (Codes::I16(bytes), 0)).collect();
        let test = OutlierTest::new(&views, Dark::at_start(32), 6.0).expect("enough shots");
        let mut rejected = |late: f64| (0..300).filter(|_| test.is_outlier(Codes::I16(&shot(late)), 0)).count();
        let (good, late) = (rejected(0.0), rejected(20.0));
        assert!(test.late <= 1 && good <= 3 && late >= 280, "{}: {good}, {late}", test.late);
    }
}
