//! Fourier transforms of real records and of complex planes: the one address of `rustfft` and `realfft`.
//!
//! Forward `Y[k] = sum_n y[n] exp(-2 pi i k n / N)` for `k = 0..=N/2`, inverse with the factor `1/N`: the conventions
//! of `numpy.fft.rfft` and `irfft`. Any length; lengths of small prime factors are fastest.

use std::sync::Arc;

use realfft::RealFftPlanner;
pub use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

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

/// Rows and columns of a square that are transposed together, so that both stay in the cache.
const TILE: usize = 16;

/// Transforms of complex planes, `rows` x `columns` values, row by row. The spectrum is transposed: `columns` x `rows`.
pub struct PlaneFft {
    columns: usize,
    rows: usize,
    /// Plans along a row and along a column, forward and inverse.
    forward: [Arc<dyn Fft<f64>>; 2],
    inverse: [Arc<dyn Fft<f64>>; 2],
    turned: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl PlaneFft {
    /// Plans for planes of this size.
    ///
    /// # Panics
    /// If the plane is empty.
    #[must_use]
    pub fn new(columns: usize, rows: usize) -> Self {
        assert!(columns > 0 && rows > 0, "cannot transform an empty plane");
        let mut planner = FftPlanner::new();
        let forward = [columns, rows].map(|length| planner.plan_fft_forward(length));
        let inverse = [columns, rows].map(|length| planner.plan_fft_inverse(length));
        let scratch = forward.iter().chain(&inverse).map(|plan| plan.get_inplace_scratch_len()).max().unwrap_or(0);
        let zero = Complex::default();
        Self { columns, rows, forward, inverse, turned: vec![zero; columns * rows], scratch: vec![zero; scratch] }
    }

    /// Number of values of a plane.
    #[must_use]
    pub fn values(&self) -> usize {
        self.columns * self.rows
    }

    /// Replaces a plane whose rows from `held` on are zero by its spectrum.
    ///
    /// # Panics
    /// If the plane has another size.
    pub fn forward(&mut self, plane: &mut Vec<Complex<f64>>, held: usize) {
        assert_eq!(plane.len(), self.values(), "a plane has another size than its plan");
        self.forward[0].process_with_scratch(&mut plane[..held * self.columns], &mut self.scratch);
        transpose(plane, self.columns, &mut self.turned);
        std::mem::swap(plane, &mut self.turned);
        self.forward[1].process_with_scratch(plane, &mut self.scratch);
    }

    /// Replaces a spectrum by its plane, divided by the number of values. Rows from `held` on are not computed: their
    /// values have no meaning.
    ///
    /// # Panics
    /// If the spectrum has another size.
    pub fn inverse(&mut self, spectrum: &mut Vec<Complex<f64>>, held: usize) {
        assert_eq!(spectrum.len(), self.values(), "a spectrum has another size than its plan");
        self.inverse[1].process_with_scratch(spectrum, &mut self.scratch);
        transpose(spectrum, self.rows, &mut self.turned);
        std::mem::swap(spectrum, &mut self.turned);
        let rows = &mut spectrum[..held * self.columns];
        self.inverse[0].process_with_scratch(rows, &mut self.scratch);
        let scale = 1.0 / (self.columns * self.rows) as f64;
        for value in rows {
            *value *= scale;
        }
    }
}

/// Writes a plane with `columns` values in a row into `turned`, its columns as rows.
fn transpose(plane: &[Complex<f64>], columns: usize, turned: &mut [Complex<f64>]) {
    let rows = plane.len() / columns;
    for top in (0..rows).step_by(TILE) {
        for left in (0..columns).step_by(TILE) {
            for row in top..rows.min(top + TILE) {
                for column in left..columns.min(left + TILE) {
                    turned[column * rows + row] = plane[row * columns + column];
                }
            }
        }
    }
}

/// The least length of `least` or more whose prime factors are 2, 3 and 5: transforms of such lengths are fast.
#[must_use]
pub fn fast_length(least: usize) -> usize {
    let without = |mut rest: usize, factor: usize| {
        while rest.is_multiple_of(factor) {
            rest /= factor;
        }
        rest
    };
    let mut length = least.max(1);
    while [2, 3, 5].into_iter().fold(length, without) > 1 {
        length += 1;
    }
    length
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
    fn planes_are_transformed_as_by_the_defining_sum_and_back() {
        let (columns, rows, held) = (18, 20, 7);
        let real = noise(2 * columns * held);
        let mut plane: Vec<Complex<f64>> = real.chunks(2).map(|v| Complex::new(v[0], v[1])).collect();
        plane.resize(columns * rows, Complex::default());
        let mut fft = PlaneFft::new(columns, rows);
        let mut spectrum = plane.clone();
        fft.forward(&mut spectrum, held);
        for (fx, fy) in [(0, 0), (3, 0), (0, 11), (17, 19), (5, 6)] {
            let turns =
                |at: usize| (fx * (at % columns)) as f64 / columns as f64 + (fy * (at / columns)) as f64 / rows as f64;
            let naive: Complex<f64> =
                plane.iter().enumerate().map(|(at, v)| v * Complex::from_polar(1.0, -TAU * turns(at))).sum();
            assert!((spectrum[fx * rows + fy] - naive).norm() < 1e-10, "{fx}, {fy}");
        }
        fft.inverse(&mut spectrum, held);
        assert!(spectrum.iter().zip(&plane[..held * columns]).all(|(a, b)| (a - b).norm() < 1e-12));
    }

    #[test]
    fn fast_lengths_have_small_factors() {
        assert_eq!([1, 7, 97, 121, 1000, 1021].map(fast_length), [1, 8, 100, 125, 1000, 1024]);
    }

    #[test]
    fn can_be_handed_to_a_worker() {
        fn is_send<T: Send>(_: &T) {}
        is_send(&RealFft::new());
        is_send(&PlaneFft::new(2, 3));
    }
}
