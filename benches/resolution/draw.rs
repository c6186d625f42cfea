//! Draws: records of pulses in noise, the same for any number of threads.

use periscope::signal::response::Response;
use periscope::signal::sparse::{self, Profile, SparseFit, SparseOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::shape::Shape;

/// Sample step, ps.
pub const DT_PS: f64 = 50.0;
/// Samples of a record, where a table does not say otherwise.
pub const LEN: usize = 200;

/// How many of the full study's draws are made.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// One draw in this many is made.
    pub one_in: usize,
}

impl Effort {
    /// Draws in place of `full`.
    pub fn of(self, full: usize) -> usize {
        (full / self.one_in).max(1)
    }
}

/// `count` results of `draw`, each with random numbers of its own that label and place determine.
pub fn draws<T: Send>(label: &str, count: usize, draw: impl Fn(&mut ChaCha8Rng) -> T + Sync) -> Vec<T> {
    let seeded = |i: usize| {
        let seed = blake3::hash(format!("{label}, draw {i}").as_bytes());
        draw(&mut ChaCha8Rng::from_seed(*seed.as_bytes()))
    };
    (0..count).into_par_iter().map(seeded).collect()
}

/// A time in the middle of a record of `len` samples, at a random place between two of them.
pub fn middle_ps(len: usize, rng: &mut ChaCha8Rng) -> f64 {
    (0.4 * len as f64).floor() * DT_PS + rng.random_range(0.0..DT_PS)
}

/// Samples of `pulses` (time, amplitude) without noise.
pub fn clean(shape: &Shape, pulses: &[(f64, f64)], len: usize) -> Vec<f64> {
    let sample = |n: usize| pulses.iter().map(|(at, a)| a * shape.at(n as f64 * DT_PS - at)[0]).sum();
    (0..len).map(sample).collect()
}

/// The same in white noise.
pub fn noisy(shape: &Shape, pulses: &[(f64, f64)], sd: f64, len: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    clean(shape, pulses, len).into_iter().map(|value| value + sd * normal(rng)).collect()
}

/// A normal number.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Fit of a record in white noise.
pub fn fit(response: &Response, samples: &[f64], sd: f64, options: &SparseOptions) -> SparseFit {
    let sd_v = vec![sd; samples.len()];
    sparse::fit(&profile(samples, &sd_v, &[]), response, options)
}

/// A record that begins at 0.
pub fn profile<'a>(mean_v: &'a [f64], sd_v: &'a [f64], acf: &'a [f64]) -> Profile<'a> {
    Profile { mean_v, sd_v, acf, slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: DT_PS }
}

/// Errors of `fit`'s times if it has as many pulses as the truth.
pub fn errors_ps(fit: &SparseFit, truth: &[(f64, f64)]) -> Option<Vec<f64>> {
    let both = fit.pulses.iter().zip(truth).map(|(pulse, (at, _))| pulse.time_ps - at);
    (fit.pulses.len() == truth.len()).then(|| both.collect())
}

/// Standard deviations that `fit` gives its times.
pub fn own_sds_ps(fit: &SparseFit) -> Vec<f64> {
    (0..fit.pulses.len()).map(|k| fit.time_sd_ps(k)).collect()
}
