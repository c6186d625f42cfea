//! The echoes of one laser pulse: how many there are, and time, height, width and leading edge of each.
//!
//! The record of a stretch of time is a constant and a sum of echoes. Each echo is the outgoing pulse of the same shot,
//! moved in time and widened by a Gaussian of free width: a tilted or deep target widens it.
//!
//! Echoes are looked for where the record, lightly smoothed, has a maximum that noise does not explain, and that rises
//! out of its surroundings by a share of the strongest. All are fitted together by least squares. One whose removal
//! the Bayesian information criterion (BIC) prefers, or that is not significant, is taken out, and the rest is fitted
//! again. Two echoes that share one maximum are one wide echo.
//!
//! Noise is what the fit leaves, but never less than the rounding to whole codes. What it leaves is correlated where
//! targets are no sums of a few widened pulses. Then it has fewer independent values than samples: these decide in the
//! BIC, and the autocorrelation enters all standard deviations.
//!
//! The leading edge is the time at which the record, without the other echoes, rises through half of the echo's height.
//!
//! Not modelled: noise of the outgoing pulse's record, and noise that grows with the signal. Samples at the converter's
//! rails do not count.
//!
//! Sources: Wagner et al., *Gaussian decomposition and calibration of a novel small-footprint full-waveform digitising
//! airborne laser scanner* (ISPRS J. 60:100, 2006); Schwarz, *Estimating the dimension of a model* (Ann. Stat. 6:461,
//! 1978).

mod decomposition;
mod edge;
mod maxima;
mod model;
mod outgoing;

pub use decomposition::{Echo, Echoes, decompose};
pub use outgoing::Outgoing;

/// A stretch of time that was recorded.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<'a> {
    /// Samples; one that is no number, as at the converter's rails, does not count.
    pub samples: &'a [f64],
    /// Step of the converter in units of the samples: rounding to it is the least noise.
    pub step: f64,
}

/// What counts as an echo.
#[derive(Clone, Copy, Debug)]
pub struct EchoOptions {
    /// Least height over its standard deviation.
    pub threshold_sigma: f64,
    /// Least rise of its maximum out of its surroundings, as a share of the strongest echo's height.
    pub share_min: f64,
}

#[cfg(test)]
mod tests;
