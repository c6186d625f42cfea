//! Why a kernel of this crate has no solution.

use thiserror::Error;

use crate::{bistatic, maximum_likelihood, mirror};

/// Why there is no solution: the measurements are well-formed, but do not determine positions.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Error {
    /// No chain of measured distances leads from point 0 to these points ([`crate::completion`]).
    #[error("no chain of measured distances leads from point 0 to points {0:?}; measure a distance to each of them")]
    Unconnected(Vec<usize>),
    /// No solution of [`crate::maximum_likelihood`].
    #[error(transparent)]
    MaximumLikelihood(#[from] maximum_likelihood::Unsolved),
    /// No solution of [`crate::bistatic`].
    #[error(transparent)]
    Bistatic(#[from] bistatic::Unsolved),
    /// No solution of [`crate::mirror`].
    #[error(transparent)]
    Mirror(#[from] mirror::Unsolved),
}
