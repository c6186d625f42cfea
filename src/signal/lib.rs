//! Kernels on time-of-flight waveforms: from the recorded shots of a sensor to the arrival times of light, each with
//! its standard deviation. Slices and spectra go in, values come out. The crate knows no file, no table, no thread and
//! no clock, so the same samples give the same result anywhere.
//!
//! # Example
//!
//! Deconvolve a profile: the sensor's response and the averaged samples go in, pulses come out. These two pulses are
//! 40 ps apart, and the response is 120 ps wide.
//!
//! ```
//! use periscope_signal::{response::Response, sparse::{self, Profile, SparseOptions}};
//!
//! // The response: any shape, sampled finer than the record; time 0 is the arrival of the pulse.
//! let gauss = |time_ps: f64| (-0.5 * (time_ps / 51.0).powi(2)).exp();
//! let shape: Vec<f64> = (-30..=30).map(|i| gauss(10.0 * f64::from(i))).collect();
//! let response = Response::new(-300.0, 10.0, &shape);
//!
//! // The record: 100 samples, 50 ps apart; one sample of the mean has a standard deviation of 0.5 mV.
//! let pulse = |arrival_ps: f64, time_ps: f64| response.value(time_ps - arrival_ps);
//! let mean_v: Vec<f64> = (0..100)
//!     .map(|n| 50.0 * f64::from(n))
//!     .map(|time_ps| 0.002 + 0.8 * pulse(2000.0, time_ps) + 0.5 * pulse(2040.0, time_ps))
//!     .collect();
//! let sd_v = &[0.0005; 100];
//! let profile = Profile { mean_v: &mean_v, sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
//!
//! let fit = sparse::fit(&profile, &response, &SparseOptions::default());
//! for (k, pulse) in fit.pulses.iter().enumerate() {
//!     println!("{:.1} ± {:.1} ps, {:.3} V", pulse.time_ps, fit.time_sd_ps(k), pulse.amplitude_v);
//! }
//! # assert_eq!(fit.pulses.len(), 2, "{fit:?}");
//! # for (k, arrival_ps) in [2000.0, 2040.0].into_iter().enumerate() {
//! #     assert!((fit.pulses[k].time_ps - arrival_ps).abs() < 0.1, "{fit:?}");
//! #     assert!((0.05..1.0).contains(&fit.time_sd_ps(k)), "{fit:?}");
//! # }
//! ```
//!
//! # Rooms
//!
//! | modules | do |
//! |---|---|
//! | [`codes`], [`average`], [`resample`], [`merge_ranges`], [`fold`] | shots to one mean profile, on one time grid |
//! | [`reference`](mod@reference), [`drift`] | time of the reference pulse, and its drift over a session |
//! | [`pickup`] | pick-up that is synchronous with the laser |
//! | [`noise`], [`noise_model`], [`whiten`] | standard deviation and autocorrelation of samples |
//! | [`dark`] | where a record has no light |
//! | [`outlying`] | outlying shots |
//! | [`shot_spread`] | how shots differ from their mean |
//! | [`oversample`], [`response`], [`averaged_response`], [`echo`] | the impulse response of a sensor |
//! | [`echoes`] | single shots of a lidar: echoes of free width of the outgoing pulse |
//! | [`sparse`] | deconvolution into pulses by maximum likelihood, for volts and for photon counts |
//! | [`wiener`] | deconvolution in the frequency domain |
//! | [`onset`], [`pulse_fit`], [`between`] | classical timing; one pulse; whether a third stands between two |
//! | [`edge`] | when the light of an extended hidden thing begins |
//! | [`image`] | images of hidden surfaces: light-cone transform, f-k migration, back-projection |
//! | [`regression`], [`spline_fit`], [`tails`], [`fft`] | the mathematics that they share |
//!
//! # Conventions
//!
//! - Times are `f64` picoseconds, voltages `f64` volts. A name carries its unit: `time_ps`, `mean_v`, `covariance_ps2`.
//! - Sample `n` of a record lies at `t0_ps + n * dt_ps`. A sample with infinite standard deviation is ignored.
//! - A pulse that arrives at `t` adds `a h(time - t)` to the record; `h` is the [`Response`](response::Response).
//! - Matrices are row-major slices.
//! - [`Option`] means that the samples do not show what is asked for. [`Error`] says why a kernel cannot answer.
//!   A broken precondition, such as slices of different lengths, is a panic that the kernel documents.
//!
//! # Not here
//!
//! No file formats, no distances and no positions. Responses do not depend on amplitude: a saturated sensor is not
//! modelled.

pub mod average;
pub mod averaged_response;
pub mod banded;
pub mod between;
pub mod block_means;
pub mod codes;
mod column_medians;
pub mod dark;
pub mod drift;
pub mod echo;
pub mod echoes;
pub mod edge;
mod failure;
pub mod fft;
pub mod fold;
pub mod image;
pub mod largest;
pub mod median;
pub mod merge_ranges;
pub mod noise;
pub mod noise_model;
pub mod onset;
pub mod outlying;
pub mod oversample;
pub mod pickup;
pub mod pulse_fit;
pub mod reference;
pub mod regression;
pub mod resample;
pub mod response;
pub mod shot_spread;
pub mod slow_noise;
pub mod sparse;
pub mod spline_fit;
mod sums;
pub mod tails;
pub mod whiten;
mod widest;
pub mod wiener;

pub use failure::Error;
pub use periscope_cancel::Cancel;

#[cfg(test)]
mod tests;
