//! Kernels on points and distances: from path lengths to coordinates. No file, no table, no thread of their own: sums
//! over many paths are shared out to rayon's, in chunks that the data define. Lengths in metres.
//!
//! Convention: patch 0 is `p0`, source and camera in one (paper section 3). Paths are written in the order light meets
//! the patches.

pub mod association;
pub mod bistatic;
pub mod classical;
pub mod completion;
pub mod dense;
pub mod detours;
pub mod ellipsoid;
pub mod faint;
pub mod footprint;
pub mod frame;
pub mod hidden;
pub mod iso_embed;
pub mod labelling;
pub mod loss;
pub mod maximum_likelihood;
pub mod mirror;
pub mod multilateration;
pub mod path;
pub mod placement;
pub mod planes;
pub mod procrustes;
pub mod reestimate;
#[cfg(test)]
#[expect(dead_code, reason = "the studies use more of it")]
mod room;
pub mod smacof;
pub mod t2;
pub mod t3;
pub mod units;

/// A dense matrix.
pub type Matrix = faer::Mat<f64>;

/// A point in space; in flatland z = 0.
pub type Point = nalgebra::Point3<f64>;

#[cfg(test)]
mod tests;
