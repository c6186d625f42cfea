//! Why a kernel of this crate has no answer.

use thiserror::Error;

use crate::drift::DriftError;

/// Why a kernel has no answer: the samples are well-formed, but do not determine what is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Error {
    /// A histogram counts more photons within a dead time than there are laser pulses ([`crate::sparse::Unpiled`]).
    #[error("more photons within a dead time than laser pulses")]
    DeadTime {
        /// First bin where that is so.
        bin: usize,
    },
    /// A vertical range has no scale relative to the first ([`crate::merge_ranges`]).
    #[error("range {range} shares too few valid samples with range 0 to determine its gain")]
    NoCommonSamples {
        /// Position among the ranges.
        range: usize,
    },
    /// A delay has no drift ([`crate::drift`]).
    #[error(transparent)]
    Drift(#[from] DriftError),
}
