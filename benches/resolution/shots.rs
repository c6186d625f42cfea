//! Averages of shots, with the noise that the shots' own beginnings tell.
//!
//! The noise is white behind a single pole of 3 GHz; its standard deviation and autocorrelation are estimated from the
//! samples before the light, as the pipeline does. Not drawn: jitter of the trigger, quantisation.

use periscope::signal::noise;
use periscope::signal::response::Response;
use periscope::signal::sparse::{self, SparseFit, SparseOptions};
use rand_chacha::ChaCha8Rng;

use super::draw::{normal, profile};

/// Correlation from one sample of 50 ps to the next: `exp(-2 pi 3 GHz 50 ps)`.
const CORRELATION: f64 = 0.389_66;
/// Samples of each shot that are before the light.
const QUIET: usize = 40;
/// Autocorrelations that are estimated.
const LAGS: usize = 16;

/// Mean of shots and what is known of its noise.
pub struct Average {
    mean_v: Vec<f64>,
    sd_v: Vec<f64>,
    acf: Vec<f64>,
}

impl Average {
    /// Mean of `shots` records of `clean` in noise that leaves `sd` in their mean.
    pub fn new(clean: &[f64], sd: f64, shots: usize, rng: &mut ChaCha8Rng) -> Self {
        let root = (shots as f64).sqrt();
        let mut mean_v = clean.to_vec();
        let mut quiet = Vec::with_capacity(shots);
        for _ in 0..shots {
            let mut noise = root * sd * normal(rng);
            let shot: Vec<f64> = (0..clean.len())
                .map(|_| {
                    let this = noise;
                    noise = CORRELATION * this + (1.0 - CORRELATION * CORRELATION).sqrt() * root * sd * normal(rng);
                    this
                })
                .collect();
            mean_v.iter_mut().zip(&shot).for_each(|(mean, noise)| *mean += noise / shots as f64);
            quiet.push(shot[..QUIET].to_vec());
        }
        let noise_estimate = noise::estimate(&quiet, LAGS);
        let acf = noise::autoregressive(&noise_estimate.acf, shots * QUIET);
        Self { sd_v: vec![noise_estimate.sd / root; clean.len()], mean_v, acf }
    }

    /// Fit of the mean.
    pub fn fit(&self, response: &Response) -> SparseFit {
        sparse::fit(&profile(&self.mean_v, &self.sd_v, &self.acf), response, &SparseOptions::default())
    }
}
