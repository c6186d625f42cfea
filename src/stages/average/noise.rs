//! What the first shots of a range say of its noise: standard deviation, autocorrelation, and the variance of a record
//! as a function of level and slope ([`noise_model`]).

use crate::signal::average::Mean;
use crate::signal::codes::Codes;
use crate::signal::dark::Dark;
use crate::signal::noise;
use crate::signal::noise_model::{self, NoiseModel};
use crate::signal::shot_spread;
use crate::tables::Trace;

/// Lags of the noise autocorrelation that a profile keeps.
const ACF_LAGS: usize = 16;
/// Fewer shots tell no model.
const MODEL_SHOTS_MIN: usize = 4;
/// A coefficient within this many of its standard deviations of 0 is not claimed.
const CLAIM_SIGMA: f64 = 2.0;

/// Terms of the model.
const LEVEL: usize = 1;
const ENERGY: usize = 2;
const JITTER: usize = 3;

/// Noise of the records of one range.
pub struct Noise {
    /// Standard deviation of a sample without light, V.
    pub sd_v: f64,
    /// Its autocorrelation.
    pub acf: Vec<f64>,
    /// Samples behind both.
    pub samples: usize,
    /// Variance of a sample; `None` where shots are too few, or do not vary.
    pub model: Option<NoiseModel>,
}

impl Noise {
    /// Of `shots` with their `mean`, codes: their `stretches` of noise, the level without light, where each is `dark`,
    /// and which places are `clear` of clipping.
    pub fn of(
        shots: &[(Codes<'_>, i64)],
        stretches: &[Vec<f64>],
        mean: &Mean,
        level: f64,
        dark: &Dark,
        clear: &[bool],
        first: &Trace,
    ) -> Self {
        let noise = noise::estimate(stretches, ACF_LAGS);
        let gain_v = first.gain_v.abs();
        let model = (shots.len() >= MODEL_SHOTS_MIN).then(|| {
            let variance_v2 = |(square, clear): (f64, &bool)| if *clear { square * gain_v * gain_v } else { f64::NAN };
            let variance_v2: Vec<f64> =
                shot_spread::spread(shots, mean, dark).into_iter().zip(clear).map(variance_v2).collect();
            let mean_v: Vec<f64> = mean.mean.iter().map(|code| (code - level) * gain_v).collect();
            let spread = noise_model::Spread {
                mean_v: &mean_v,
                variance_v2: &variance_v2,
                shots: shots.len(),
                dt_ps: first.dt_ps,
            };
            noise_model::fit(&spread)
        });
        Self {
            sd_v: noise.sd * gain_v,
            acf: noise.acf,
            samples: stretches.iter().map(Vec::len).sum(),
            model: model.flatten(),
        }
    }

    /// Variance that a sample at level `v` has for itself in one record, V^2.
    pub fn own_v2(&self, v: f64) -> f64 {
        let own = |model: &NoiseModel| model.values[0] + model.values[LEVEL] * v.abs();
        self.model.as_ref().map_or(self.sd_v * self.sd_v, own)
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
        let sd = (alike * model.covariance[term][term]).sqrt();
        let value = model.values[term];
        (value - expected > CLAIM_SIGMA * sd).then_some(value)
    }
}
