//! Fourier transforms of real records: the one address of `rustfft` and `realfft`.
//!
//! Forward `Y[k] = sum_n y[n] exp(-2 pi i k n / N)` for `k = 0..=N/2`, inverse with the factor `1/N`: the conventions
//! of `numpy.fft.rfft` and `irfft`. Any length; lengths of small prime factors are fastest.

use realfft::RealFftPlanner;
pub use rustfft::num_complex::Complex;

/// Real transforms with their plans and buffers: one for each worker (it is `Send`), reused for every record.
pub struct RealFft {
    planner: RealFftPlanner<f64>,
    samples: Vec<f64>,
    bins: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl Default for RealFft {
    fn default() -> Self {
        Self::new()
    }
}

impl RealFft {
    /// A transformer without plans; a length is planned when it is first met.
    #[must_use]
    pub fn new() -> Self {
        Self { planner: RealFftPlanner::new(), samples: Vec::new(), bins: Vec::new(), scratch: Vec::new() }
    }

    /// Number of spectral bins of a real record of `len` samples.
    #[must_use]
    pub const fn bins(len: usize) -> usize {
        len / 2 + 1
    }

    /// Spectrum of `signal` (N samples) into `spectrum` (N/2 + 1 bins).
    ///
    /// # Panics
    /// If `signal` is empty or `spectrum` has another length.
    pub fn forward(&mut self, signal: &[f64], spectrum: &mut [Complex<f64>]) {
        check_lengths(signal.len(), spectrum.len());
        let plan = self.planner.plan_fft_forward(signal.len());
        self.scratch.resize(plan.get_scratch_len(), Complex::default());
        self.samples.clear();
        self.samples.extend_from_slice(signal);
        plan.process_with_scratch(&mut self.samples, spectrum, &mut self.scratch).expect("lengths were checked");
    }

    /// Record (N samples) of `spectrum` (N/2 + 1 bins) into `signal`, divided by N. The imaginary parts of the first
    /// bin and, for even N, of the last are ignored: a real record has none.
    ///
    /// # Panics
    /// If `signal` is empty or `spectrum` has another length.
    pub fn inverse(&mut self, spectrum: &[Complex<f64>], signal: &mut [f64]) {
        check_lengths(signal.len(), spectrum.len());
        let len = signal.len();
        let plan = self.planner.plan_fft_inverse(len);
        self.scratch.resize(plan.get_scratch_len(), Complex::default());
        self.bins.clear();
        self.bins.extend_from_slice(spectrum);
        self.bins[0].im = 0.0;
        if len.is_multiple_of(2) {
            self.bins[len / 2].im = 0.0;
        }
        plan.process_with_scratch(&mut self.bins, signal, &mut self.scratch).expect("lengths were checked");
        let scale = 1.0 / len as f64;
        for v in signal {
            *v *= scale;
        }
    }
}

fn check_lengths(samples: usize, bins: usize) {
    assert!(samples > 0, "cannot transform an empty record");
    assert_eq!(bins, RealFft::bins(samples), "a record of {samples} samples has another number of bins");
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::TAU;

    fn noise(len: usize) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
    }

    #[test]
    fn forward_is_the_defining_sum_for_any_length() {
        let mut fft = RealFft::new();
        for len in [1, 2, 3, 7, 16, 30, 97, 128] {
            let signal = noise(len);
            let mut spectrum = vec![Complex::default(); RealFft::bins(len)];
            fft.forward(&signal, &mut spectrum);
            for (k, bin) in spectrum.iter().enumerate() {
                let naive: Complex<f64> = signal
                    .iter()
                    .enumerate()
                    .map(|(n, v)| Complex::from_polar(*v, -TAU * (k * n) as f64 / len as f64))
                    .sum();
                assert!((bin - naive).norm() < 1e-11, "length {len}, bin {k}");
            }
        }
    }

    #[test]
    fn inverse_undoes_forward_and_ignores_what_no_real_record_has() {
        let mut fft = RealFft::new();
        for len in [1, 2, 9, 2048, 1001] {
            let signal = noise(len);
            let mut spectrum = vec![Complex::default(); RealFft::bins(len)];
            fft.forward(&signal, &mut spectrum);
            spectrum[0].im = 3.0;
            let mut back = vec![0.0; len];
            fft.inverse(&spectrum, &mut back);
            for (a, b) in signal.iter().zip(&back) {
                assert!((a - b).abs() < 1e-12, "length {len}");
            }
        }
    }

    #[test]
    fn can_be_handed_to_a_worker() {
        fn is_send<T: Send>(_: &T) {}
        is_send(&RealFft::new());
    }
}
