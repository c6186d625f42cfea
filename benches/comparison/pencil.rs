//! Times of pulses as poles of a spectrum: a method of comparison for [`periscope_signal::sparse`].
//!
//! In the band where the response is above the noise, `S_k = Y_k / H_k = sum_j a_j z_j^k` with
//! `z_j = exp(-2 pi i (t_j - t0) / (N dt))`: a sum of exponentials. Its Hankel matrix has rank K. The rotation between
//! the signal space's rows and the same rows one further has the poles as eigenvalues (ESPRIT). Sources: Roy and
//! Kailath, IEEE Trans. Acoust. Speech Signal Process. 37, 984 (1989); Hua and Sarkar, ibid. 38, 814 (1990); for
//! pulses, Vetterli, Marziliano and Blu, IEEE Trans. Signal Process. 50, 1417 (2002).
//!
//! It needs no start and no iteration. Every bin weighs the same although the quotient's noise grows as the response
//! falls, so times scatter by 2 to 8 times the Cramer-Rao bound; [`Pulses::refined`] makes up for it. Not modelled: a
//! response with power beyond half the sample rate, a baseline, samples to be ignored, noise correlated between
//! samples; records are circular.

use std::f64::consts::TAU;

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::{evd, svd};
use faer::{Mat, Par, Spec, c64};
use periscope_signal::fft::{Complex, RealFft};
use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

use crate::pulses::Pulses;

/// A bin is used while the noise of its quotient is below this share of the light's sum.
const NOISE_SHARE: f64 = 0.3;
/// Most rows of the Hankel matrix: the time of the decomposition grows with their square.
const ROWS_MAX: usize = 160;
/// Chance that noise alone is taken for a pulse.
const FALSE_PULSES: f64 = 1e-3;

/// What is asked of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PencilOptions {
    /// Number of pulses; `None` for the number of singular values above the noise's.
    pub pulses: Option<usize>,
    /// At most this many pulses.
    pub pulses_max: usize,
}

impl Default for PencilOptions {
    fn default() -> Self {
        Self { pulses: None, pulses_max: 32 }
    }
}

/// Pulses of `profile`, whose baseline is removed, with amplitudes by least squares and the covariance of the times to
/// first order in the noise. Fewer than asked for if the band is too narrow; none if two of them cannot be resolved.
///
/// # Panics
/// If the profile is empty, its slices differ in length, an sd is not positive and finite, or a step is not positive.
#[must_use]
pub fn fit(profile: &Profile, response: &Response, options: &PencilOptions) -> Pulses {
    let len = profile.mean_v.len();
    assert!(len > 0 && profile.sd_v.len() == len, "an sd for each of the samples");
    assert!(profile.sd_v.iter().all(|sd| *sd > 0.0 && sd.is_finite()), "the sds must be positive and finite");
    assert!(profile.dt_ps > 0.0, "the sample step must be positive");
    let mut fft = RealFft::new();
    let Some(band) = Band::new(&mut fft, profile, response) else {
        return Pulses::none(profile);
    };
    let rows = band.quotient.len().div_ceil(2).min(ROWS_MAX);
    let hankel = Mat::from_fn(rows, band.quotient.len() + 1 - rows, |i, j| band.quotient[i + j]);
    let (left, singular, right) = singular_triplets(&hankel);
    let above = singular.iter().take_while(|s| **s > band.noise_norm()).count();
    let count = options.pulses.unwrap_or(above).min(options.pulses_max).min(rows - 1).min(singular.len());
    if count == 0 {
        return Pulses::none(profile);
    }
    let space = SignalSpace {
        left: left.subcols(0, count).to_owned(),
        right: right.subcols(0, count).to_owned(),
        singular: singular[..count].to_vec(),
    };
    let poles = space.poles();
    let period_ps = len as f64 * profile.dt_ps;
    let mut timed: Vec<(f64, Vec<f64>)> = poles
        .iter()
        .map(|pole| {
            let turn = (-pole.value.arg() / TAU).rem_euclid(1.0);
            (profile.t0_ps + turn * period_ps, band.influence(&mut fft, pole, len, period_ps))
        })
        .collect();
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (times_ps, influences): (Vec<f64>, Vec<Vec<f64>>) = timed.into_iter().unzip();
    let covariance_ps2 = covariance(&influences, profile.sd_v);
    Pulses::at(profile, response, times_ps)
        .map_or_else(|| Pulses::none(profile), |pulses| Pulses { covariance_ps2: Some(covariance_ps2), ..pulses })
}

/// `sum_n g_in g_jn sd_n^2`, row-major.
fn covariance(influences: &[Vec<f64>], sd_v: &[f64]) -> Vec<f64> {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(sd_v).map(|((a, b), sd)| a * b * sd * sd).sum();
    influences.iter().flat_map(|a| influences.iter().map(|b| product(a, b))).collect()
}

/// The quotient of spectra at the bins `-reach..=reach`.
struct Band {
    reach: usize,
    quotient: Vec<c64>,
    gain: Vec<Complex<f64>>,
    /// Noise power of every bin of the record's spectrum.
    noise: f64,
}

impl Band {
    /// `None` if no bin but the first is above the noise.
    fn new(fft: &mut RealFft, profile: &Profile, response: &Response) -> Option<Self> {
        let len = profile.mean_v.len();
        let circular = wrapped_response(response, profile.dt_ps, len);
        let mut gain = vec![Complex::default(); RealFft::bins(len)];
        let mut spectrum = gain.clone();
        fft.forward(&circular, &mut gain);
        fft.forward(profile.mean_v, &mut spectrum);
        let noise: f64 = profile.sd_v.iter().map(|sd| sd * sd).sum();
        // The sum of all amplitudes, not below what noise makes of it.
        let light = (spectrum[0].norm() / gain[0].norm()).max(noise.sqrt() / gain[0].norm());
        let usable = |h: &Complex<f64>| noise.sqrt() < NOISE_SHARE * light * h.norm();
        let reach = gain.iter().take_while(|h| usable(h)).count().checked_sub(1)?.min((len - 1) / 2);
        let positive = |k: usize| spectrum[k] / gain[k];
        let quotient =
            (0..=2 * reach).map(|m| if m < reach { positive(reach - m).conj() } else { positive(m - reach) }).collect();
        (reach > 0).then_some(Self { reach, quotient, gain, noise })
    }

    /// What the largest singular value of a Hankel matrix of noise exceeds with a chance of [`FALSE_PULSES`] at most:
    /// it is bounded by the largest of the Fourier sums of the noise, each of exponential power with mean
    /// `sum_m var_m`.
    fn noise_norm(&self) -> f64 {
        let total: f64 = self.bins().map(|k| self.noise / self.gain[k].norm_sqr()).sum();
        (total * (self.quotient.len() as f64 / FALSE_PULSES).ln()).sqrt()
    }

    fn bins(&self) -> impl Iterator<Item = usize> {
        let reach = self.reach as i64;
        (-reach..=reach).map(|k| k.unsigned_abs() as usize)
    }

    /// How much each sample of the record moves the time of a pole, to first order: `dz = alpha^T dS beta` over the
    /// Hankel matrix `dS`, and `dS_k` is the transform of the samples' errors over `H_k`.
    fn influence(&self, fft: &mut RealFft, pole: &Pole, len: usize, period_ps: f64) -> Vec<f64> {
        let bins = self.quotient.len();
        let mut factors = vec![c64::new(0.0, 0.0); bins];
        for (i, a) in pole.alpha.iter().enumerate() {
            for (factor, b) in factors[i..].iter_mut().zip(&pole.beta) {
                *factor += a * b;
            }
        }
        // The time is -arg(z) / 2 pi periods: d arg = Im(dz / z).
        for (m, factor) in factors.iter_mut().enumerate() {
            let gain = self.gain[m.abs_diff(self.reach)];
            *factor /= pole.value * if m < self.reach { gain.conj() } else { gain };
        }
        // Im(sum_k f_k exp(-i k w)), with the terms of k and -k taken together, as a real series in cos(k w) and sin(k
        // w).
        let scale = -period_ps / TAU * len as f64;
        let mut series = vec![Complex::default(); self.gain.len()];
        series[0] = Complex::new(scale * factors[self.reach].im, 0.0);
        for k in 1..=self.reach {
            let (after, before) = (factors[self.reach + k], factors[self.reach - k]);
            series[k] = Complex::new(after.im + before.im, after.re - before.re) * (scale / 2.0);
        }
        let mut influence = vec![0.0; len];
        fft.inverse(&series, &mut influence);
        influence
    }
}

/// The strongest singular triplets of the Hankel matrix.
struct SignalSpace {
    left: Mat<c64>,
    right: Mat<c64>,
    singular: Vec<f64>,
}

/// A pole, and the vectors of its first-order change `dz = alpha^T dX beta` with the Hankel matrix X.
struct Pole {
    value: c64,
    alpha: Vec<c64>,
    beta: Vec<c64>,
}

impl SignalSpace {
    /// Eigenvalues of the rotation `F = U1^+ U2`, U1 and U2 the left space without its last and its first row.
    ///
    /// With `y`, `x` the left and right eigenvectors, `dz = y^H U1^+ (dU2 - z dU1) x`, and `dU = (1 - U U^H) dX V / s`;
    /// the projector drops, since `U1^+ (U2 - z U1) = F - z` and `y^H (F - z) = 0`.
    fn poles(&self) -> Vec<Pole> {
        let (rows, count) = (self.left.nrows(), self.left.ncols());
        let pseudo_inverse = pseudo_inverse(&self.left);
        let rotation = Mat::from_fn(count, count, |i, j| {
            (0..rows - 1).map(|n| pseudo_inverse[(i, n)] * self.left[(n + 1, j)]).sum::<c64>()
        });
        let (values, left, right) = eigenvectors(&rotation);
        (0..count)
            .map(|k| {
                let value = values[k];
                // Left eigenvectors come with a norm of their own; y^H x must be 1.
                let norm: c64 = (0..count).map(|q| left[(q, k)].conj() * right[(q, k)]).sum();
                let row: Vec<c64> = (0..rows - 1)
                    .map(|n| (0..count).map(|q| left[(q, k)].conj() * pseudo_inverse[(q, n)]).sum::<c64>() / norm)
                    .collect();
                let at = |i: Option<usize>| i.and_then(|i| row.get(i)).copied().unwrap_or_default();
                let alpha = (0..rows).map(|i| at(i.checked_sub(1)) - value * at(Some(i))).collect();
                let beta = (0..self.right.nrows())
                    .map(|j| (0..count).map(|q| self.right[(j, q)] * right[(q, k)] / self.singular[q]).sum())
                    .collect();
                Pole { value, alpha, beta }
            })
            .collect()
    }
}

/// Pseudo-inverse of the rows but the last of orthonormal columns U: `U1^H U1 = 1 - v v^H`, with `v^H` the last row, is
/// inverted by Sherman and Morrison.
fn pseudo_inverse(columns: &Mat<c64>) -> Mat<c64> {
    let (last, count) = (columns.nrows() - 1, columns.ncols());
    let lost: f64 = (0..count).map(|k| columns[(last, k)].norm_sqr()).sum();
    Mat::from_fn(count, last, |i, n| {
        let along: c64 = (0..count).map(|k| columns[(last, k)] * columns[(n, k)].conj()).sum();
        columns[(n, i)].conj() + columns[(last, i)].conj() * along / (1.0 - lost)
    })
}

/// The response at the samples of a circular record of `len` samples every `step_ps`, sample 0 at the arrival: what
/// precedes the arrival, or exceeds a period, wraps around.
///
/// # Panics
/// If `len` is 0 or `step_ps` not positive.
fn wrapped_response(response: &Response, step_ps: f64, len: usize) -> Vec<f64> {
    assert!(len > 0 && step_ps > 0.0, "a record has samples and a step");
    let (first_ps, last_ps) = response.support_ps();
    let mut wrapped = vec![0.0; len];
    for n in (first_ps / step_ps).ceil() as i64..=(last_ps / step_ps).floor() as i64 {
        wrapped[n.rem_euclid(len as i64) as usize] += response.value(n as f64 * step_ps);
    }
    wrapped
}

/// Left singular vectors, singular values and right singular vectors, on one thread: faer's sums depend on how many
/// share them.
fn singular_triplets(matrix: &Mat<c64>) -> (Mat<c64>, Vec<f64>, Mat<c64>) {
    let (rows, columns) = (matrix.nrows(), matrix.ncols());
    let size = rows.min(columns);
    let (mut left, mut values, mut right) = (Mat::zeros(rows, size), Diag::zeros(size), Mat::zeros(columns, size));
    let (thin, params) = (svd::ComputeSvdVectors::Thin, Spec::default());
    let mut memory = MemBuffer::new(svd::svd_scratch::<c64>(rows, columns, thin, thin, Par::Seq, params));
    let stack = MemStack::new(&mut memory);
    let (u, v) = (Some(left.as_mut()), Some(right.as_mut()));
    svd::svd(matrix.as_ref(), values.as_mut(), u, v, Par::Seq, stack, params)
        .expect("the singular value decomposition of a finite matrix converges");
    let values = values.column_vector().iter().map(|s| s.re).collect();
    (left, values, right)
}

/// Eigenvalues with their left and right eigenvectors, on one thread.
fn eigenvectors(matrix: &Mat<c64>) -> (Vec<c64>, Mat<c64>, Mat<c64>) {
    let size = matrix.nrows();
    let (mut left, mut values, mut right) = (Mat::zeros(size, size), Diag::zeros(size), Mat::zeros(size, size));
    let (both, params) = (evd::ComputeEigenvectors::Yes, Spec::default());
    let mut memory = MemBuffer::new(evd::evd_scratch::<c64>(size, both, both, Par::Seq, params));
    let stack = MemStack::new(&mut memory);
    let (u, v) = (Some(left.as_mut()), Some(right.as_mut()));
    evd::evd_cplx(matrix.as_ref(), values.as_mut(), u, v, Par::Seq, stack, params)
        .expect("the eigenproblem of a finite matrix converges");
    (values.column_vector().iter().copied().collect(), left, right)
}

#[cfg(test)]
mod tests;
