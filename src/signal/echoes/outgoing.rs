//! The pulse that left, as a template.

use crate::fft::{Complex, RealFft};

/// Samples at each end of the record whose mean is its level.
const ENDS: usize = 3;
/// Samples to each side of the highest one that place the maximum.
const ABOUT: usize = 2;
/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// Standard deviations to each side of a Gaussian pulse.
const REACH: f64 = 5.0;

/// The outgoing pulse of a shot, of height 1 and without its level. Times are in samples of the returning record.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing {
    samples: Vec<f64>,
    /// Place of its maximum after its first sample.
    pub peak: f64,
    /// Width: its full width at half maximum, in standard deviations of a Gaussian.
    pub sigma: f64,
}

impl Outgoing {
    /// The pulse of a record. `None` where it shows no pulse: too few samples, one that is no number, a maximum at an
    /// end, or flanks that do not fall below half of it.
    #[must_use]
    pub fn of(record: &[f64]) -> Option<Self> {
        if record.len() < 2 * ENDS + 1 || record.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        // The lower end: behind the pulse, the level comes back slowly.
        let level = mean(&record[..ENDS]).min(mean(&record[record.len() - ENDS..]));
        let highest = (0..record.len()).max_by(|a, b| record[*a].total_cmp(&record[*b]))?;
        let height = record[highest] - level;
        if height <= 0.0 || highest < ABOUT || highest + ABOUT >= record.len() {
            return None;
        }
        let samples: Vec<f64> = record.iter().map(|value| (value - level) / height).collect();
        let peak = highest as f64 + vertex(&samples[highest - ABOUT..=highest + ABOUT])?;
        let rise = (1..=highest).rev().find(|i| samples[i - 1] < 0.5)?;
        let fall = (highest..samples.len() - 1).find(|i| samples[i + 1] < 0.5)?;
        let part = |outer: usize, inner: usize| (0.5 - samples[outer]) / (samples[inner] - samples[outer]);
        let fwhm = (fall + 1) as f64 - part(fall + 1, fall) - (rise - 1) as f64 - part(rise - 1, rise);
        Some(Self { samples, peak, sigma: fwhm / FWHM })
    }

    /// A Gaussian of this full width at half maximum.
    ///
    /// # Panics
    /// When the width is not positive.
    #[must_use]
    pub fn gaussian(fwhm: f64) -> Self {
        assert!(fwhm > 0.0 && fwhm.is_finite(), "a pulse has a width");
        let sigma = fwhm / FWHM;
        let half = (REACH * sigma).ceil() as i32;
        let samples = (-half..=half).map(|i| (-0.5 * (f64::from(i) / sigma).powi(2)).exp()).collect();
        Self { samples, peak: f64::from(half), sigma }
    }

    /// Number of samples.
    pub(super) fn len(&self) -> usize {
        self.samples.len()
    }

    /// Spectrum of the pulse in a record of `length` samples, its maximum at time 0.
    pub(super) fn spectrum(&self, length: usize, fft: &mut RealFft) -> Vec<Complex<f64>> {
        let mut samples = self.samples.clone();
        samples.resize(length, 0.0);
        let mut spectrum = vec![Complex::default(); RealFft::bins(length)];
        fft.forward(&samples, &mut spectrum);
        for (k, bin) in spectrum.iter_mut().enumerate() {
            let turn = std::f64::consts::TAU * k as f64 / length as f64 * self.peak;
            *bin *= Complex::from_polar(1.0, turn);
        }
        spectrum
    }
}

/// Place of the vertex of the parabola through five samples, from the middle one; within the samples.
fn vertex(samples: &[f64]) -> Option<f64> {
    let [a, b, c, d, e] = samples else { return None };
    // Least squares on x = -2..2.
    let slope = (2.0 * (e - a) + d - b) / 10.0;
    let bend = (2.0 * (a + e) - b - d - 2.0 * c) / 14.0;
    (bend < 0.0).then(|| (-0.5 * slope / bend).clamp(-2.0, 2.0))
}
