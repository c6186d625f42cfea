//! Kernels on waveforms: slices and spectra in, values out. No file, no table, no thread.

pub mod average;
pub mod averaged_response;
pub mod banded;
pub mod between;
pub mod codes;
pub mod drift;
pub mod echo;
pub mod fft;
pub mod fold;
pub mod largest;
pub mod merge_ranges;
pub mod noise;
pub mod noise_model;
pub mod onset;
pub mod oversample;
pub mod pickup;
pub mod pulse_fit;
pub mod reference;
pub mod regression;
pub mod resample;
pub mod response;
pub mod shot_spread;
pub mod sparse;
pub mod spline_fit;
pub mod tails;
pub mod whiten;
mod widest;
pub mod wiener;

#[cfg(test)]
mod tests;
