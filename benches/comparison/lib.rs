//! Methods to compare with: none of them is in the program.
//!
//! | of profiles | |
//! |---|---|
//! | [`nnls`] | non-negative least squares on a grid of arrivals |
//! | [`pencil`] | arrivals as poles of the spectrum (ESPRIT) |
//! | [`richardson_lucy`] | light on a grid by multiplicative steps |
//!
//! All three take a profile without its baseline ([`baseline`]) and return [`pulses`], which they refine and prune the
//! same way. The method of the program is [`periscope_signal::sparse`].
//!
//! | of distances | |
//! |---|---|
//! | [`semidefinite`] | convex embedding by Gram matrices |
//! | [`landmark`] | classical scaling of a few patches, the others by their distances to these |
//! | [`many_pairs`] | maximum likelihood of thousands of patches, all pairs measured, from a start by [`landmark`] |
//!
//! The methods of the program are [`periscope_geometry::placement`] and [`periscope_geometry::maximum_likelihood`].
//! What the comparisons show stands in docs/time-resolution.md and docs/geometry.md.

pub mod baseline;
pub mod dictionary;
pub mod landmark;
pub mod many_pairs;
pub mod nnls;
pub mod pencil;
pub mod pulses;
pub mod richardson_lucy;
pub mod semidefinite;

#[cfg(test)]
#[allow(dead_code, reason = "the tests of `periscope-geometry` and the studies use more of it")]
#[path = "../../src/geometry/room.rs"]
mod room;

use periscope_geometry::{Point, dense};
