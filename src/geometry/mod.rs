//! Kernels on points and distances: from path lengths to coordinates. No file, no table, no thread. Lengths in metres.
//!
//! Convention: patch 0 is `p0`, source and camera in one (paper section 3). Paths are written in the order light meets the patches.

pub mod association;
pub mod classical;
pub mod completion;
pub mod dense;
pub mod detours;
pub mod frame;
pub mod iso_embed;
pub mod maximum_likelihood;
pub mod procrustes;
pub mod t2;

/// A point in space; in flatland z = 0.
pub type Point = nalgebra::Point3<f64>;
