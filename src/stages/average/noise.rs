//! What the first shots of a range say of its noise: standard deviation, autocorrelation, and the variance of a record
//! as a function of level and slope ([`noise_model`]); and what is slower than these describe ([`slow_noise`]).

use std::ops::Range;

use crate::signal::average::{Mean, PHASES};
use crate::signal::codes::Codes;
use crate::signal::dark::{self, Dark};
use crate::signal::merge_ranges;
use crate::signal::noise;
use crate::signal::noise_model::{self, NoiseModel};
use crate::signal::resample;
use crate::signal::shot_spread::{self, OwnNoise, Spread};
use crate::signal::slow_noise::SlowNoise;
use crate::tables::Trace;

/// Lags of the noise autocorrelation that a profile keeps.
const ACF_LAGS: usize = 16;
/// Fewer dark samples in a row tell little of these.
const RUN_MIN: usize = 4 * ACF_LAGS;
/// Fewer shots tell no model.
const MODEL_SHOTS_MIN: usize = 4;
/// A coefficient within this many of its standard deviations of 0 is not claimed.
const CLAIM_SIGMA: f64 = 2.0;

/// Jitter may exceed the variance of the times of the first shots by this factor: that of 16 shots scatters by a third.
const MOVES_MAX: f64 = 1.5;

/// Rounding errors of neighbouring samples are alike where a signal moves by less than a step from one to the next, and
/// so count for fewer: for so many times less.
const ROUNDING_ALIKE: f64 = 4.0;
/// Standard deviations of a shot, its offset apart, up to which the mean counts as dark, where slow noise is sought.
const DARK_SIGMA: f64 = 3.0;

/// Terms of the model.
const LEVEL: usize = 1;
const ENERGY: usize = 2;
const JITTER: usize = 3;

/// Noise of the records of one range.
pub struct Noise {
    /// Standard deviation of a sample without light, V, slow noise left out.
    pub sd_v: f64,
    /// Its autocorrelation.
    pub acf: Vec<f64>,
    /// Samples behind both.
    pub samples: usize,
    /// Variance of a sample; `None` where shots are too few, or do not vary.
    pub model: Option<NoiseModel>,
    /// Variances of the components of slow noise, V^2; `None` where there is none.
    pub slow_v2: Option<Vec<f64>>,
    /// Variance that rounding to whole codes leaves in any mean, V^2.
    rounding_v2: f64,
}

/// The shots of a range from which its noise is taken.
pub struct Judges<'a> {
    /// Codes and places on the grid.
    pub shots: &'a [(Codes<'a>, i64)],
    pub mean: &'a Mean,
    /// How they differ from the mean.
    pub spread: &'a Spread,
    /// Mean code without light.
    pub level: f64,
    /// Where each shot is dark.
    pub dark: &'a Dark,
    /// Which places no clipping touches.
    pub clear: &'a [bool],
    pub first: &'a Trace,
}

impl Judges<'_> {
    /// Slow noise, and each shot less mean, offset and slow noise; `None` where noise is fast alone.
    pub fn slow(&self) -> Option<Slow> {
        if self.shots.len() < 2 {
            return None; // the mean is the shot
        }
        let is_dark = self.darkness();
        let noise = SlowNoise::of(&self.spread.differences, &is_dark)?;
        let mut dark = dark_runs(&is_dark);
        if dark.is_empty() {
            dark = vec![self.dark.of_mean(self.mean)];
        }
        // The mean has its share of each shot.
        let shots = self.shots.len() as f64;
        let scale = (shots / (shots - 1.0)).sqrt();
        let mut fast = noise.fast(&dark::differences(self.shots, self.mean));
        fast.iter_mut().flatten().for_each(|value| *value *= scale);
        let given_back = |values: &[f64]| values.iter().map(|value| value * scale * scale).collect::<Vec<f64>>();
        let lacking = given_back(&noise.lacking(&dark, ACF_LAGS));
        Some(Slow { variances: given_back(&noise.variances), fast, dark, lacking })
    }

    /// Which places are dark. Where a pulse is too fast for its sampling, the filter that aligns shots rings as far as
    /// it reaches, in each shot by its phase, and that is no noise.
    fn darkness(&self) -> Vec<bool> {
        let sd = self.spread.usual_variance().sqrt();
        let is_lit = |(mean, clear): (&f64, &bool)| !clear || (mean - self.level).abs() >= DARK_SIGMA * sd;
        let lit: Vec<bool> = self.mean.mean.iter().zip(self.clear).map(is_lit).collect();
        merge_ranges::valid(&lit, resample::TAPS / 2, resample::TAPS / 2)
    }

    /// Variance of a record as a function of level and slope. What grows with the light may come from pulses that are
    /// too fast for their sampling: then shots are compared with those of nearly the same phase.
    fn model(&self, slow: Option<&Slow>) -> Option<NoiseModel> {
        let gain_v = self.first.gain_v.abs();
        let mean_v: Vec<f64> = self.mean.mean.iter().map(|code| (code - self.level) * gain_v).collect();
        let fit = |variances: &[f64], shots: usize| {
            let variance_v2 = |(square, clear): (&f64, &bool)| if *clear { square * gain_v * gain_v } else { f64::NAN };
            let variance_v2: Vec<f64> = variances.iter().zip(self.clear).map(variance_v2).collect();
            let dt_ps = self.first.dt_ps;
            noise_model::fit(&noise_model::Spread { mean_v: &mean_v, variance_v2: &variance_v2, shots, dt_ps })
        };
        let model = fit(&self.variances(slow), self.shots.len())?;
        let grows = [LEVEL, ENERGY, JITTER].iter().any(|term| is_claimed(model.values[*term], &model, *term, 1.0));
        let phase = |position: i64| position.rem_euclid(PHASES as i64);
        let has_phases = self.shots.iter().any(|(_, position)| phase(*position) != phase(self.shots[0].1));
        if !grows || !has_phases {
            return Some(model);
        }
        let positions: Vec<i64> = self.shots.iter().map(|(_, position)| *position).collect();
        let own = match slow {
            Some(slow) => OwnNoise::of(&slow.fast, &positions),
            None => OwnNoise::of(&self.differences(), &positions),
        };
        let shots = (OwnNoise::SHARE * self.shots.len() as f64) as usize;
        let mut model = fit(&own.variances(mean_v.len()), shots.max(2))?;
        let moves_ps2 = own.moves(&self.mean.mean, self.clear) * self.first.dt_ps * self.first.dt_ps;
        model.values[JITTER] = model.values[JITTER].min(MOVES_MAX * moves_ps2);
        Some(model)
    }

    /// Each shot less the mean, offsets apart.
    fn differences(&self) -> Vec<Vec<f64>> {
        let mut differences = dark::differences(self.shots, self.mean);
        let range = self.dark.of_mean(self.mean);
        for values in &mut differences {
            let stretch = &values[range.start.min(values.len())..range.end.min(values.len())];
            let own = stretch.iter().sum::<f64>() / stretch.len().max(1) as f64;
            values.iter_mut().for_each(|value| *value -= own);
        }
        differences
    }

    /// Variance over shots at each place of the mean, codes squared.
    fn variances(&self, slow: Option<&Slow>) -> Vec<f64> {
        let Some(slow) = slow else { return self.spread.variances.clone() };
        let of_place = |n: usize| {
            let (sum, count) = slow
                .fast
                .iter()
                .filter_map(|fast| fast.get(n))
                .fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
            if count > 1 { sum / f64::from(count) + slow.lacking[0] } else { f64::NAN }
        };
        (0..self.mean.mean.len()).map(of_place).collect()
    }
}

/// Slow noise of shots, codes.
pub struct Slow {
    variances: Vec<f64>,
    /// Each shot without it, from the mean's first place on.
    fast: Vec<Vec<f64>>,
    /// Where the mean is dark.
    dark: Vec<Range<usize>>,
    /// Autocovariance that `fast` lacks there.
    lacking: Vec<f64>,
}

impl Slow {
    /// The fast noise of each shot wherever the mean is dark: what noise of many time constants leaves above its slow
    /// part, the few samples before light would not show.
    fn stretches(&self) -> Vec<Vec<f64>> {
        let stretch = |fast: &Vec<f64>, range: &Range<usize>| {
            fast[range.start.min(fast.len())..range.end.min(fast.len())].to_vec()
        };
        self.fast.iter().flat_map(|fast| self.dark.iter().map(|range| stretch(fast, range))).collect()
    }
}

/// Stretches of dark places that tell all lags of the autocorrelation.
fn dark_runs(is_dark: &[bool]) -> Vec<Range<usize>> {
    let runs = is_dark.chunk_by(|a, b| a == b).scan(0, |end, run| {
        *end += run.len();
        Some((run[0], *end - run.len()..*end))
    });
    runs.filter(|(dark, run)| *dark && run.len() >= RUN_MIN).map(|(_, run)| run).collect()
}

impl Noise {
    /// Of what the judges show: their `slow` noise, and `stretches` of noise where there is none.
    pub fn of(judges: &Judges<'_>, stretches: impl FnOnce() -> Vec<Vec<f64>>, slow: Option<Slow>) -> Self {
        let Judges { shots, first, .. } = judges;
        let stretches = slow.as_ref().map_or_else(stretches, Slow::stretches);
        let noise = match &slow {
            Some(slow) => noise::estimate_of_rest(&stretches, &slow.lacking),
            None => noise::estimate(&stretches, ACF_LAGS),
        };
        let gain_v = first.gain_v.abs();
        let model = (shots.len() >= MODEL_SHOTS_MIN).then(|| judges.model(slow.as_ref())).flatten();
        let slow_v2 = |slow: Slow| slow.variances.iter().map(|variance| variance * gain_v * gain_v).collect();
        let is_whole = shots.first().is_some_and(|(codes, _)| codes.is_whole());
        let step = if is_whole { shot_spread::step(shots).max(1.0) } else { 0.0 };
        // Two neighbouring codes alone do not tell how much noise there is: the level may lie between them.
        let sd = if exceeds(&stretches, step) { noise.sd } else { 0.0 };
        let rounding = if is_whole { ROUNDING_ALIKE * step * step * dark::rounding_variance(sd / step) } else { 0.0 };
        Self {
            sd_v: noise.sd * gain_v,
            acf: noise.acf,
            samples: stretches.iter().map(Vec::len).sum(),
            model,
            slow_v2: slow.map(slow_v2),
            rounding_v2: rounding * gain_v * gain_v,
        }
    }

    /// Standard deviations that samples of these levels have for themselves in the mean of so many `records`, V, slow
    /// noise left out.
    pub fn mean_sd_v(&self, mean_v: &[f64], records: f64) -> Vec<f64> {
        let of_model = |model: &NoiseModel| (model.values[0], model.values[LEVEL]);
        let (constant, of_level) = self.model.as_ref().map_or((self.sd_v * self.sd_v, 0.0), of_model);
        let sd_v = |v: f64| ((constant + of_level * v.abs()) / records + self.rounding_v2).sqrt();
        if of_level == 0.0 {
            return vec![sd_v(0.0); mean_v.len()];
        }
        mean_v.iter().map(|v| sd_v(*v)).collect()
    }

    /// Standard deviation of a sample without light in one of so many `records` whose mean has the noise of all kinds.
    pub fn total_sd_v(&self, records: f64) -> f64 {
        let slow_v2: f64 = self.slow_v2.iter().flatten().sum();
        (self.sd_v * self.sd_v + slow_v2 + records * self.rounding_v2).sqrt()
    }

    /// Relative variance of the laser's energy from record to record; 0 where it is not significant.
    pub fn energy(&self) -> f64 {
        self.exceeding(ENERGY, 0.0).unwrap_or(0.0)
    }

    /// Variance of the records' times, ps^2; `None` where it does not significantly exceed the `known_ps2`.
    pub fn jitter_ps2(&self, known_ps2: f64) -> Option<f64> {
        self.exceeding(JITTER, known_ps2)
    }

    fn exceeding(&self, term: usize, expected: f64) -> Option<f64> {
        let model = self.model.as_ref()?;
        // Correlated samples say less than as many independent ones: variances correlate by the square.
        let alike = 1.0 + 2.0 * self.acf.iter().skip(1).map(|r| r * r).sum::<f64>();
        let value = model.values[term];
        is_claimed(value - expected, model, term, alike).then_some(value)
    }
}

/// Whether samples lie further apart than a `step`; seldom looks beyond the first stretch.
fn exceeds(stretches: &[Vec<f64>], step: f64) -> bool {
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    stretches.iter().any(|stretch| {
        (low, high) = stretch.iter().fold((low, high), |(low, high), value| (value.min(low), value.max(high)));
        high - low > step
    })
}

/// Whether a coefficient exceeds what its error makes of none, where so many samples tell as much as one.
fn is_claimed(value: f64, model: &NoiseModel, term: usize, alike: f64) -> bool {
    value > CLAIM_SIGMA * (alike * model.covariance[term][term]).sqrt()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::signal::average::PhaseSums;
    use crate::signal::shot_spread::HEAD_SHOTS;

    const SAMPLES: usize = 480;
    const DARK: Dark = Dark { place: None, samples: 48 };

    /// Shots of white noise of 20 codes under a pulse of that many, faster than its sampling, each with an offset of
    /// that many codes and an own phase.
    fn pulses(height: f64, offset: f64) -> Vec<(Vec<u8>, i64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut shot = || {
            let position = rng.random_range(-32..32_i64);
            let middle = 200.0 - position as f64 / PHASES as f64;
            let hum = offset * rng.random_range(-1.0..1.0);
            let mut code = |n: usize| {
                let (normal, late): (f64, f64) = (StandardNormal.sample(&mut rng), n as f64 - middle);
                let pulse = if late < 0.0 { (-0.5 * (late / 0.6).powi(2)).exp() } else { (-late / 2.2).exp() };
                ((height * pulse + hum + 20.0 * normal).round() as i16).to_le_bytes()
            };
            ((0..SAMPLES).flat_map(&mut code).collect(), position)
        };
        (0..HEAD_SHOTS).map(|_| shot()).collect()
    }

    /// Offsets that move shots by many times their noise make no light dark: what its sampling leaves of a strong pulse
    /// is neither slow noise nor fast.
    #[test]
    fn a_strong_pulse_is_not_dark_where_hum_moves_shots() {
        for offset in [0.0, 2000.0] {
            let shots = pulses(24_000.0, offset);
            let shots: Vec<(Codes<'_>, i64)> = shots.iter().map(|(bytes, at)| (Codes::I16(bytes), *at)).collect();
            let mut sums = PhaseSums::new(SAMPLES);
            shots.iter().for_each(|(codes, position)| sums.add(*codes, *position));
            let mean = sums.finish().unwrap();
            let spread = Spread::of(&shots, &mean, &DARK);
            let of_mean = &mean.mean[DARK.of_mean(&mean)];
            let judges = Judges {
                shots: &shots,
                level: of_mean.iter().sum::<f64>() / of_mean.len() as f64,
                clear: &vec![true; mean.mean.len()],
                mean: &mean,
                spread: &spread,
                dark: &DARK,
                first: &Trace { gain_v: 1.0, dt_ps: 50.0, ..Trace::default() },
            };
            let slow = judges.slow();
            assert!(slow.is_none(), "{offset}: {:?}", slow.map(|slow| slow.variances));
            let is_dark = judges.darkness();
            let lit: Vec<usize> = (0..is_dark.len()).filter(|n| !is_dark[*n]).collect();
            assert!((190..222).all(|n| lit.contains(&n)) && lit.len() < 80, "{lit:?}");
        }
    }
}
