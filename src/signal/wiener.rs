//! Wiener deconvolution: the regularised inverse of a known response, in the frequency domain.
//!
//! `X(f) = Y(f) conj(H(f)) / (|H(f)|^2 + L) * exp(-(f/f_c)^2 / 2)`, with `L` the ratio of the noise's power to the
//! light's and an optional Gaussian low-pass against ringing. Source: Wiener, *Extrapolation, Interpolation, and
//! Smoothing of Stationary Time Series* (1949), for white noise and white light (both spectra flat, so that `L` is one
//! number).
//!
//! Good for a look at a profile and for the plain chain (deconvolve, then threshold). Not a separator of pulses: it
//! knows neither that light is positive nor that it comes in pulses. Records are circular: light before the first
//! sample appears at the end.

use std::f64::consts::TAU;

use super::fft::{Complex, RealFft};
use super::response::Response;
use super::widest::widest;

/// Bins that are worked on side by side; the order of additions is fixed.
const LANES: usize = 8;

/// Spectrum `H` of a response on the grid of records of one length, scaled to a largest gain of 1.
///
/// The scale gives deconvolved light the unit of the profile, and the noise-to-signal ratio one meaning for all
/// sensors. (A response of unit area whose values are not negative has this scale already.)
#[derive(Clone, Debug)]
pub struct Transfer {
    len: usize,
    gain: Vec<Complex<f64>>,
}

impl Transfer {
    /// From samples of the response on the record's grid, the first at the arrival of the pulse; `len` is the record's
    /// length.
    ///
    /// # Panics
    /// If the samples are more than `len`, or all zero.
    #[must_use]
    pub fn from_samples(fft: &mut RealFft, samples: &[f64], len: usize) -> Self {
        assert!(samples.len() <= len, "the response has {} samples, the record only {len}", samples.len());
        let mut padded = samples.to_vec();
        padded.resize(len, 0.0);
        Self::from_circular(fft, &padded)
    }

    /// From a [`Response`], sampled every `dt_ps`; what precedes the arrival, or exceeds the record's `len`, wraps
    /// around.
    ///
    /// # Panics
    /// If `len` is 0, `dt_ps` not positive, or no sample of the response differs from zero.
    #[must_use]
    pub fn from_response(fft: &mut RealFft, response: &Response, dt_ps: f64, len: usize) -> Self {
        assert!(len > 0 && dt_ps > 0.0, "a record needs samples and a step");
        let (first_ps, last_ps) = response.support_ps();
        let mut circular = vec![0.0; len];
        for n in (first_ps / dt_ps).ceil() as i64..=(last_ps / dt_ps).floor() as i64 {
            circular[n.rem_euclid(len as i64) as usize] += response.value(n as f64 * dt_ps);
        }
        Self::from_circular(fft, &circular)
    }

    fn from_circular(fft: &mut RealFft, samples: &[f64]) -> Self {
        let mut gain = vec![Complex::default(); RealFft::bins(samples.len())];
        fft.forward(samples, &mut gain);
        let largest = gain.iter().map(|g| g.norm()).fold(0.0, f64::max);
        assert!(largest > 0.0, "the response is zero");
        for g in &mut gain {
            *g /= largest;
        }
        Self { len: samples.len(), gain }
    }

    /// Noise-to-signal ratio of a profile (baseline removed) whose samples carry white noise of standard deviation
    /// `noise_sd`.
    ///
    /// By Parseval, `sum y^2 = N sd^2 + S mean|H|^2`, with `S` the power of white light in every bin, and the noise has
    /// power `N sd^2` in every bin; hence `L = N sd^2 mean|H|^2 / (sum y^2 - N sd^2)`. The difference is not taken
    /// below its own standard deviation under noise alone, `sd^2 sqrt(2N)`, so that a profile without light is
    /// smoothed, not amplified.
    ///
    /// # Panics
    /// If the profile has another length or `noise_sd` is not positive.
    #[must_use]
    pub fn noise_to_signal(&self, profile: &[f64], noise_sd: f64) -> f64 {
        assert_eq!(profile.len(), self.len, "length of the profile");
        assert!(noise_sd > 0.0, "the noise must be positive");
        let n = self.len as f64;
        let noise = n * noise_sd * noise_sd;
        let total: f64 = profile.iter().map(|y| y * y).sum();
        let signal = (total - noise).max(noise_sd * noise_sd * (2.0 * n).sqrt());
        noise * mean_square(&self.gain, self.len) / signal
    }
}

/// Mean of the squared magnitude over all `len` bins of a real record's spectrum; those that it leaves out are
/// conjugates.
fn mean_square(spectrum: &[Complex<f64>], len: usize) -> f64 {
    let total: f64 = spectrum.iter().map(Complex::norm_sqr).sum();
    let last = spectrum[spectrum.len() - 1].norm_sqr();
    let unpaired = spectrum[0].norm_sqr() + if len.is_multiple_of(2) { last } else { 0.0 };
    (2.0 * total - unpaired) / len as f64
}

/// A Wiener filter, made once and applied to many profiles.
#[derive(Clone, Debug)]
pub struct Wiener {
    len: usize,
    filter: Vec<Complex<f64>>,
    /// What white noise of power 1 leaves in each bin, as a share of the variance of a sample.
    power: Vec<f64>,
    /// `2 cos(2 pi k / N)` of bin k.
    turns: Vec<f64>,
}

impl Wiener {
    /// Filter for records of the length of `transfer`. `low_pass` is `f_c` in cycles per sample (0.5 is the highest
    /// frequency of a record): the frequency at which the Gaussian low-pass has fallen to `exp(-1/2)`.
    ///
    /// # Panics
    /// If `noise_to_signal` or `low_pass` is not positive.
    #[must_use]
    pub fn new(transfer: &Transfer, noise_to_signal: f64, low_pass: Option<f64>) -> Self {
        assert!(noise_to_signal > 0.0, "the noise-to-signal ratio must be positive");
        assert!(low_pass.is_none_or(|f| f > 0.0), "the low-pass frequency must be positive");
        let filter: Vec<Complex<f64>> = transfer
            .gain
            .iter()
            .enumerate()
            .map(|(k, h)| {
                let frequency = k as f64 / transfer.len as f64;
                let smooth = low_pass.map_or(1.0, |f_c| (-0.5 * (frequency / f_c).powi(2)).exp());
                h.conj() / (h.norm_sqr() + noise_to_signal) * smooth
            })
            .collect();
        let len = transfer.len;
        // Bins that a real record's spectrum leaves out are conjugates.
        let is_paired = |k: usize| k > 0 && 2 * k < len;
        let power = |(k, w): (usize, &Complex<f64>)| w.norm_sqr() * if is_paired(k) { 2.0 } else { 1.0 } / len as f64;
        let power = filter.iter().enumerate().map(power).collect();
        let turns = (0..filter.len()).map(|k| 2.0 * (TAU * k as f64 / len as f64).cos()).collect();
        Self { len, filter, power, turns }
    }

    /// Standard deviation of deconvolved noise of standard deviation 1 and autocorrelation `acf` (lags 0, 1, ..;
    /// `&[1.0]` or nothing: white): root of the sum of `|W|^2 / N` over all bins, each weighted by the noise's power in
    /// it, `1 + 2 sum_l r_l cos(l theta)`. That is not negative but for the lags that an estimate leaves out. (The sum
    /// by Clenshaw's recurrence: Math. Tables Aids Comput. 9, 118 (1955).)
    #[must_use]
    pub fn noise_gain(&self, acf: &[f64]) -> f64 {
        let lags = &acf[..acf.len().min(self.len.div_ceil(2))];
        let lags = &lags[..lags.iter().rposition(|r| *r != 0.0).map_or(0, |last| last + 1)];
        let Some((first, later)) = lags.split_first().filter(|(_, later)| !later.is_empty()) else {
            return self.power.iter().sum::<f64>().sqrt();
        };
        let (powers, turns) = (self.power.as_chunks::<LANES>(), self.turns.as_chunks::<LANES>());
        let coloured = |power: f64, turn: f64| {
            let (mut b, mut last) = (0.0, 0.0);
            for r in later.iter().rev() {
                (b, last) = (r + turn * b - last, b);
            }
            power * (first + turn * b - 2.0 * last).max(0.0)
        };
        let mut sums = [0.0; LANES];
        widest(
            #[inline(always)]
            || {
                for (power, turn) in powers.0.iter().zip(turns.0) {
                    let (mut b, mut last) = ([0.0; LANES], [0.0; LANES]);
                    for r in later.iter().rev() {
                        for i in 0..LANES {
                            (b[i], last[i]) = (r + turn[i] * b[i] - last[i], b[i]);
                        }
                    }
                    for i in 0..LANES {
                        sums[i] += power[i] * (first + turn[i] * b[i] - 2.0 * last[i]).max(0.0);
                    }
                }
            },
        );
        let rest = powers.1.iter().zip(turns.1).map(|(power, turn)| coloured(*power, *turn));
        ((sums.iter().sum::<f64>() + rest.sum::<f64>()) / first).sqrt()
    }

    /// Deconvolves `profile` into `light`, both of the filter's length; `light` has the profile's unit, and its time 0
    /// is the arrival.
    ///
    /// # Panics
    /// If a length differs from the filter's.
    pub fn apply(&self, fft: &mut RealFft, profile: &[f64], light: &mut [f64]) {
        assert_eq!(profile.len(), self.len, "length of the profile");
        let mut spectrum = vec![Complex::default(); self.filter.len()];
        fft.forward(profile, &mut spectrum);
        for (bin, gain) in spectrum.iter_mut().zip(&self.filter) {
            *bin *= gain;
        }
        fft.inverse(&spectrum, light);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};
    use std::f64::consts::TAU;

    /// Response of a damped, slightly ringing sensor, of unit area.
    fn ringing() -> Vec<f64> {
        let raw: Vec<f64> = (0..40)
            .map(|i| {
                let t = f64::from(i);
                (1.0 - (-t / 1.5).exp()) * (-t / 9.0).exp() * (1.0 + 0.25 * (TAU * t / 17.0).cos())
            })
            .collect();
        let area: f64 = raw.iter().sum();
        raw.iter().map(|v| v / area).collect()
    }

    fn circular_convolution(x: &[f64], h: &[f64]) -> Vec<f64> {
        let len = x.len();
        (0..len).map(|n| h.iter().enumerate().map(|(m, v)| v * x[(n + len - m) % len]).sum()).collect()
    }

    /// All N bins of the defining sum, and back: what `numpy.fft.fft` and `ifft` compute.
    fn dft(x: &[Complex<f64>], sign: f64) -> Vec<Complex<f64>> {
        let len = x.len();
        (0..len)
            .map(|k| {
                x.iter()
                    .enumerate()
                    .map(|(n, v)| v * Complex::from_polar(1.0, sign * TAU * ((k * n) % len) as f64 / len as f64))
                    .sum()
            })
            .collect()
    }

    #[test]
    fn equals_the_formula_bin_by_bin() {
        let (len, nsr, f_c) = (150, 0.02, 0.08);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let y: Vec<f64> = (0..len).map(|_| rng.random_range(-1.0..1.0)).collect();
        let h = ringing();
        let complex = |v: &[f64]| -> Vec<Complex<f64>> {
            (0..len).map(|n| Complex::new(v.get(n).copied().unwrap_or(0.0), 0.0)).collect()
        };
        let (big_y, big_h) = (dft(&complex(&y), -1.0), dft(&complex(&h), -1.0));
        let product: Vec<Complex<f64>> = (0..len)
            .map(|k| {
                let f = k.min(len - k) as f64 / len as f64;
                big_y[k] * big_h[k].conj() / (big_h[k].norm_sqr() + nsr) * (-0.5 * (f / f_c).powi(2)).exp()
            })
            .collect();
        let expected = dft(&product, 1.0);

        let mut fft = RealFft::new();
        let transfer = Transfer::from_samples(&mut fft, &h, len);
        let mut light = vec![0.0; len];
        Wiener::new(&transfer, nsr, Some(f_c)).apply(&mut fft, &y, &mut light);
        for n in 0..len {
            assert!((light[n] - expected[n].re / len as f64).abs() < 1e-12, "sample {n}");
        }
    }

    #[test]
    fn undoes_a_convolution_and_shifts_with_its_input() {
        let len = 256;
        let light: Vec<f64> = (0..len).map(|n| (-0.5 * ((n as f64 - 100.0) / 4.0).powi(2)).exp()).collect();
        let y = circular_convolution(&light, &ringing());
        let mut fft = RealFft::new();
        let transfer = Transfer::from_samples(&mut fft, &ringing(), len);
        let wiener = Wiener::new(&transfer, 1e-12, None);
        let mut back = vec![0.0; len];
        wiener.apply(&mut fft, &y, &mut back);
        for n in 0..len {
            assert!((back[n] - light[n]).abs() < 1e-6, "sample {n}");
        }
        let mut later = y.clone();
        later.rotate_right(200);
        let mut shifted = vec![0.0; len];
        wiener.apply(&mut fft, &later, &mut shifted);
        back.rotate_right(200);
        for n in 0..len {
            assert!((shifted[n] - back[n]).abs() < 1e-9, "sample {n}");
        }
    }

    #[test]
    fn a_spline_and_its_samples_give_the_same_filter() {
        let h = ringing();
        let mut fft = RealFft::new();
        let samples = Transfer::from_samples(&mut fft, &h, 100);
        let spline = Transfer::from_response(&mut fft, &Response::new(0.0, 50.0, &h), 50.0, 100);
        for (a, b) in samples.gain.iter().zip(&spline.gain) {
            assert!((a - b).norm() < 1e-12);
        }
        // Three samples earlier: the same magnitudes, the phase of a circular shift.
        let early = Response::new(-150.0, 50.0, &h);
        let early = Transfer::from_response(&mut fft, &early, 50.0, 100);
        for (k, (a, b)) in samples.gain.iter().zip(&early.gain).enumerate() {
            let turn = Complex::from_polar(1.0, TAU * 3.0 * k as f64 / 100.0);
            assert!((a * turn - b).norm() < 1e-12, "bin {k}");
        }
    }

    #[test]
    fn noise_leaves_with_the_stated_gain() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        for len in [255, 256] {
            let mut fft = RealFft::new();
            let wiener = Wiener::new(&Transfer::from_samples(&mut fft, &ringing(), len), 0.01, Some(0.2));
            // White noise, and that of two samples' mean.
            for acf in [&[1.0][..], &[1.0, 0.5]] {
                let (mut squares, mut light) = (0.0, vec![0.0; len]);
                for _ in 0..400 {
                    let white: Vec<f64> = (0..=len).map(|_| rand_distr::StandardNormal.sample(&mut rng)).collect();
                    let mean = |pair: &[f64]| 0.5_f64.sqrt() * (pair[0] + pair[1]);
                    let noise: Vec<f64> =
                        if acf.len() == 1 { white[1..].to_vec() } else { white.windows(2).map(mean).collect() };
                    wiener.apply(&mut fft, &noise, &mut light);
                    squares += light.iter().map(|x| x * x).sum::<f64>() / len as f64;
                }
                let ratio = (squares / 400.0).sqrt() / wiener.noise_gain(acf);
                assert!((ratio - 1.0).abs() < 0.01, "{len} {acf:?}: {ratio}");
            }
        }
    }

    #[test]
    fn noise_to_signal_recovers_the_ratio_that_was_put_in() {
        let len = 4096;
        let sd = 0.02;
        let normal = Normal::new(0.0, sd).expect("positive");
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut light = vec![0.0; len];
        (light[700], light[1900]) = (3.0, 2.0);
        let noise: Vec<f64> = (0..len).map(|_| normal.sample(&mut rng)).collect();
        let mut y = circular_convolution(&light, &ringing());
        y.iter_mut().zip(&noise).for_each(|(y, w)| *y += w);

        let mut fft = RealFft::new();
        let transfer = Transfer::from_samples(&mut fft, &ringing(), len);
        let expected = len as f64 * sd * sd / 13.0; // two impulses: |X|^2 = 3^2 + 2^2 on average
        let ratio = transfer.noise_to_signal(&y, sd) / expected;
        assert!((0.8..1.25).contains(&ratio), "ratio {ratio}");
        // Without light the ratio is as large as the noise can make it.
        assert!(transfer.noise_to_signal(&noise, sd) > 10.0 * transfer.noise_to_signal(&y, sd));
    }
}
