//! Sparse deconvolution: the pulses, between samples and closer than the response, that explain a profile best.
//!
//! Model: `y_n = b_n + sum_k a_k h(t_n - t_k) + w_n`, `a_k >= 0` (or of any sign), response h known, w of known sd a
//! sample and autocorrelation, b a baseline: a line, and slow noise of known variances ([`super::slow_noise`]). It is
//! explained together with the pulses and not taken off before. Everything happens after whitening ([`super::whiten`]):
//! there least squares are maximum likelihood. Maximum likelihood for a number of pulses that grows greedily:
//! 1. candidates: the matched filter's maximum in the residual, and the best pair in place of each pulse whose residual
//!    looks widened;
//! 2. each candidate is refined jointly with the pulses around it;
//! 3. the best is kept if it lowers chi2 by more than `evidence_min` ([`evidence_min`]), and all pulses are refined
//!    together;
//! 4. at the end, pulses that turn out to be worth less than that are taken out again.
//!
//! Times then scatter at the Cramer-Rao bound `(J^T J)^-1` (J: whitened derivatives). Two equal pulses are resolved
//! down to a distance that falls with the square root of the SNR, far below the response's width. Where pulses are so
//! close that first order does not hold, the sds of their times come from the profile likelihood. Sources: alternating
//! descent (Boyd, Schiebinger and Recht, SIAM J. Optim. 27, 616 (2017)) without its l1 penalty; resolution limit as in
//! Smith, IEEE Trans. Signal Process. 53, 1597 (2005).
//!
//! Light that extended patches spread in time is modelled where [`SparseOptions::extent_max_ps`] allows it. Several
//! records of the same pulses are fitted together by [`fit_joint`]; histograms of single photons by [`fit_counts`].
//!
//! Pulses that other records predict ([`SparseOptions::predictions`]) are started from, with priors of their times and
//! widths; results hold the times without these priors too.
//!
//! A baseline that moves the same way in every shot, and a response of another width than the calibration's, are tried
//! where a record asks for them. Many records together show another shape of it, an echo or a tail: [`ResponseErrors`].
//!
//! Where shots come early and late, the shape of the mean of finitely many scatters too ([`Jitter`]).
//!
//! Not modelled: light wrapped around the end of the record; in one record, a response of another shape. Its error
//! shows as `chi2_per_dof` above 1 and, near strong pulses, as false pulses. Where its size is known, adding it
//! to the sd of the samples under a strong pulse keeps both away.

mod cause;
mod column;
mod counts;
mod evidence;
mod greedy;
mod interval;
mod joint;
mod linear;
mod matched;
mod model;
mod nodes;
mod nuisance;
mod own_response;
mod pair;
mod place;
mod prediction;
mod projection;
mod refine;
mod scatter;
mod search;
mod state;
#[cfg(test)]
mod tests;
mod tone;

use periscope_cancel::Cancel;

use super::response::Response;
use super::whiten::Whitener;
pub use counts::{Unpiled, fit_counts};
pub use evidence::{evidence_min, evidence_min_of};
pub use joint::fit_joint;
pub use matched::{Given, Matched, Open, matched};
pub use own_response::{OwnResponse, ResponseErrors, ResponseScore};
pub use pair::Pair;
use place::Place;
pub use prediction::Prediction;
pub use scatter::Jitter;

/// Standard deviation of the logarithm of a response's width that was calibrated another day.
pub const WIDTH_SD: f64 = 0.03;
/// False pulses a record of pure noise, where the caller sets no threshold.
const FALSE_PULSES: f64 = 1e-4;

/// An averaged record: sample `n` at `t0_ps + n * dt_ps`.
#[derive(Clone, Copy, Debug)]
pub struct Profile<'a> {
    /// Mean of each sample, V.
    pub mean_v: &'a [f64],
    /// Standard deviation of each mean, V; infinite for a sample to be ignored.
    pub sd_v: &'a [f64],
    /// Autocorrelation of the noise at lags 0, 1, ..; `&[1.0]` or nothing for white noise. An estimate is best passed
    /// through
    /// [`super::noise::autoregressive`] first.
    pub acf: &'a [f64],
    /// Variances of the components of slow noise in the means, V^2 ([`super::slow_noise::component`]), on top of the
    /// noise above; nothing for none.
    pub slow_v2: &'a [f64],
    /// Scatter of the times of the shots behind the means, which the response has in it; `None` where all come at the
    /// same.
    pub jitter: Option<Jitter>,
    /// Time of the first sample, ps.
    pub t0_ps: f64,
    /// Time between samples, ps.
    pub dt_ps: f64,
}

/// What lies under the pulses besides slow noise, of any size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// Nothing.
    None,
    /// A constant, as of dark counts.
    Constant,
    /// A constant and a slope.
    Line,
}

/// What is asked of a fit.
#[derive(Clone, Debug)]
pub struct SparseOptions {
    /// Drop of chi2 that a pulse must be worth; `None` for [`evidence_min`] at 1e-4 false pulses a record.
    pub evidence_min: Option<f64>,
    /// The fit stops at this many pulses.
    pub pulses_max: usize,
    /// What is fitted with the pulses.
    pub baseline: Baseline,
    /// Whether amplitudes may be negative, as reflections on a line are; light is never. Pulses closer than the
    /// response is wide are then not resolved: two of opposite sign imitate anything.
    pub signed: bool,
    /// Largest sd (ps) of the spread in time of one pulse's light, as extended patches give; 0 for points only. Where
    /// the samples are better explained so, a pulse is widened by a Gaussian of sd up to this; where that is not
    /// enough, by what disks make of it, or also by an exponential tail. What looks wider still is taken
    /// for two pulses; two closer than twice this may be taken for one, and are kept as its [`Pulse::pair`].
    pub extent_max_ps: f64,
    /// Standard deviation of the logarithm of the response's width, over what it is, before the record is seen.
    pub width_sd: f64,
    /// Pulses that other records predict.
    pub predictions: Vec<Prediction>,
    /// Ends the fit: polled once a trial place of pulses, and once a tap or block in passes over a whole record.
    pub cancel: Cancel,
}

impl Default for SparseOptions {
    fn default() -> Self {
        Self {
            evidence_min: None,
            pulses_max: 64,
            baseline: Baseline::Line,
            signed: false,
            extent_max_ps: 0.0,
            width_sd: WIDTH_SD,
            predictions: Vec::new(),
            cancel: Cancel::never(),
        }
    }
}

/// One pulse of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulse {
    /// Arrival, ps: where time 0 of the response lies; of light that is spread in time, of its centroid. Where it was
    /// predicted, with that prior.
    pub time_ps: f64,
    /// Standard deviation of that.
    pub time_sd_ps: f64,
    /// The arrival as the records alone have it, to first order; `time_ps` where no pulse was predicted.
    pub own_time_ps: f64,
    /// Standard deviation of the spread of its light without its tail, ps; 0 for a point.
    pub width_ps: f64,
    /// Excess kurtosis of that spread: 0 for a Gaussian, -1 for the chords of a disk, between them for more disks.
    pub kurtosis: f64,
    /// Relative change of the light over a standard deviation of that spread: what is nearer is brighter.
    pub tilt: f64,
    /// Standard deviation of `width_ps`, to first order; where a width was predicted, by what the records alone say.
    pub width_sd_ps: f64,
    /// Variance of the light, ps^2, as the records alone have it; below 0 where noise makes it so. Its standard
    /// deviation is `2 width_ps width_sd_ps`.
    pub own_variance_ps2: f64,
    /// Constant of the exponential tail of its light, ps; 0 for none.
    pub tail_ps: f64,
    /// Standard deviation of `tail_ps`, to first order.
    pub tail_sd_ps: f64,
    /// Factor of the response: V for a response whose maximum is 1.
    pub amplitude_v: f64,
    /// Standard deviation of the amplitude.
    pub amplitude_sd_v: f64,
    /// Rise of chi2 when this pulse is taken out and its neighbours are fitted again.
    pub evidence: f64,
    /// Chi2 over degrees of freedom of the samples that this pulse reaches.
    pub chi2_per_dof: f64,
    /// By how many standard deviations that exceeds what noise alone makes it: beyond three something else than noise
    /// is left.
    pub misfit_sigma: f64,
    /// Factor of the variances of the pulse: chi2 per degree of freedom of the samples that it reaches in all records,
    /// where noise alone does not explain it, else 1.
    pub misfit_factor: f64,
    /// Of light that is spread in time, the best two points in its place; `None` where none fit.
    pub pair: Option<Pair>,
}

impl Pulse {
    /// What the pulse adds to a record (sample `n` at `t0_ps + n * dt_ps`): index and value of the samples that it
    /// reaches.
    pub fn samples(
        &self,
        response: &Response,
        t0_ps: f64,
        dt_ps: f64,
        len: usize,
    ) -> impl Iterator<Item = (usize, f64)> {
        let place = Place::of(self);
        let reach = place.reach(response, t0_ps, dt_ps, len);
        let after_ps = t0_ps + reach.start as f64 * dt_ps - place.time_ps;
        let samples = place.samples(response, response.width_ps(), after_ps, dt_ps, reach.len());
        let amplitude_v = self.amplitude_v;
        reach.zip(samples).map(move |(n, sample)| (n, amplitude_v * sample[0]))
    }
}

/// Pulses of a profile in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseFit {
    /// Pulses by rising time.
    pub pulses: Vec<Pulse>,
    /// Covariance of the times as the records alone have them, ps^2, row-major: `(J^T J)^-1`. Each pulse's sd is
    /// multiplied by the square root of its `chi2_per_dof` where that exceeds 1 by more than three of its standard
    /// deviations. Where an sd exceeds 1/20 of the distance of two pulses, a second sd is taken from the profile
    /// likelihood: half the 95 % interval over 1.96. The larger counts; rows and columns grow alike.
    pub covariance_ps2: Vec<f64>,
    /// Constant under the pulses, V, as what they leave says without a slope or slow noise; 0 if none is fitted.
    pub baseline_v: f64,
    /// Chi2 over degrees of freedom of the record.
    pub chi2_per_dof: f64,
    /// Standard deviation of a baseline that moves the same way in every shot, V; 0 where the record shows none.
    pub ground_v: f64,
    /// Factor of the response's width that the record alone shows, and its standard deviation; `None` where it tells
    /// nothing of it. Where the factor is significant, the pulses are those of a response so stretched, and its error
    /// is in `covariance_ps2`.
    pub width: Option<[f64; 2]>,
    /// The threshold that was applied to the evidence.
    pub evidence_min: f64,
}

impl SparseFit {
    /// Standard deviation of the time of pulse `k` as the records alone have it, ps.
    ///
    /// # Panics
    /// When there is no such pulse.
    #[must_use]
    pub fn time_sd_ps(&self, k: usize) -> f64 {
        self.covariance_ps2[k * (self.pulses.len() + 1)].sqrt()
    }
}

/// Fits pulses to `profile`.
///
/// # Panics
/// If the profile is empty, its slices differ in length, a mean is not finite, or an sd or `dt_ps` is not positive.
/// Also if the autocorrelation is not finite or not positive at lag 0, `evidence_min` is not positive, or
/// `extent_max_ps` is negative or not finite.
#[must_use]
pub fn fit(profile: &Profile, response: &Response, options: &SparseOptions) -> SparseFit {
    fit_joint(&[(*profile, response)], options, true).remove(0)
}
