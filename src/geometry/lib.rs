//! Kernels on points and distances: from the lengths of light's paths between patches of a scene to the positions of
//! the patches, with their covariances. Light that bounces off one, two or three patches gives the lengths; no camera
//! image is needed.
//!
//! # Example
//!
//! Two patches seen from one point (paper section 4.1). Light that bounces off patch `i` alone covers `2 d_0i`; light
//! over patches 1 and 2 covers `d_01 + d_12 + d_02`. Four lengths, the second bounce both ways, give three distances:
//!
//! ```
//! use periscope_geometry::t2::{self, Length};
//!
//! let length = |length_m: f64| Length { length_m, variance_m2: 0.001_f64.powi(2) };
//! let first = [(1, length(6.0)), (2, length(8.0))];
//! let second = [((1, 2), length(11.999)), ((2, 1), length(12.001))];
//!
//! let distances = t2::invert(&first, &second);
//! for distance in &distances.distances {
//!     let (length_m, sd_m) = (distance.distance_m, distance.variance_m2.sqrt());
//!     println!("{} to {}: {length_m:.4} ± {sd_m:.4} m", distance.a, distance.b);
//! }
//! # let d_12 = distances.between(2, 1).expect("both first bounces are there");
//! # assert!((d_12.distance_m - 5.0).abs() < 1e-12 && d_12.variance_m2 == 1e-6);
//! ```
//!
//! Positions from distances: fill what is missing with shortest paths, then scale. The frame is arbitrary: patch 0 lies
//! at the origin, rotation and mirror image are free.
//!
//! ```
//! use periscope_geometry::{Cancel, Matrix, classical, completion};
//!
//! let measured_m = |a: usize, b: usize| match (a.min(b), a.max(b)) {
//!     (0, 1) => Some(3.0),
//!     (0, 2) => Some(4.0),
//!     (1, 2) => Some(5.0),
//!     _ => None,
//! };
//! let distances_m: Matrix = completion::complete(3, measured_m, &Cancel::never())?;
//! let points = classical::embed(&distances_m, 2); // patches 1 and 2
//! # assert!((points[0].coords.norm() - 3.0).abs() < 1e-12 && (points[1].coords.norm() - 4.0).abs() < 1e-12);
//! assert!(((points[0] - points[1]).norm() - 5.0).abs() < 1e-12);
//! # Ok::<(), periscope_geometry::Error>(())
//! ```
//!
//! That is a start. The likeliest positions, with covariances, come from the lengths themselves:
//!
//! ```
//! use periscope_geometry::{Point, maximum_likelihood::{self, Node, Observation, Problem}};
//!
//! let source = Node::Station(0);
//! let path = |patches: &[usize], length_m: f64| {
//!     let patches = patches.iter().map(|&patch| Node::Patch(patch));
//!     let nodes = std::iter::once(source).chain(patches).chain([source]).collect();
//!     Observation::new(nodes, length_m, 0.001)
//! };
//! let observations = vec![path(&[0], 6.0), path(&[1], 8.0), path(&[0, 1], 12.0)];
//! let start = vec![Point::new(2.5, 0.3, 0.0), Point::new(0.2, 4.5, 0.0)];
//!
//! let solution = maximum_likelihood::solve(&Problem::new(start, 2, &[Point::origin()], observations))?;
//! println!("{:.3} ± {:.4} m", solution.points[0], solution.patch_covariance_m2(0, 0).trace().sqrt());
//! # assert!((solution.points[0].coords.norm() - 3.0).abs() < 1e-9, "{solution:?}");
//! # assert!(((solution.points[0] - solution.points[1]).norm() - 5.0).abs() < 1e-9, "{solution:?}");
//! # Ok::<(), periscope_geometry::Error>(())
//! ```
//!
//! # Rooms
//!
//! | modules | do |
//! |---|---|
//! | [`units`], [`path`] | picoseconds to metres, the one place that does; a path as the patches that light meets |
//! | [`t2`], [`t3`], [`detours`] | distances from path lengths; pairs whose light takes a detour |
//! | [`completion`], [`classical`], [`smacof`], [`iso_embed`], [`reestimate`] | distances to positions, as a start |
//! | [`maximum_likelihood`] | the likeliest positions, with covariances |
//! | [`placement`], [`multilateration`] | positions from nothing; one patch from its lengths |
//! | [`association`], [`labelling`] | which path made which arrival |
//! | [`hidden`], [`faint`] | patches that no first bounce reaches |
//! | [`joint`] | small hidden things from all photon histograms of a wall together |
//! | [`first_return`] | points of hidden surfaces, with normals, from the first light at each point of a wall |
//! | [`shapes`] | planes, spheres and cylinders that such points lie on |
//! | [`height_field`] | the surface between such points, with its error bars |
//! | [`mirror`], [`bistatic`] | scenes behind a diffuser, source and sensor apart |
//! | [`companion`] | light of other paths that an onset does not resolve |
//! | [`planes`], [`frame`], [`procrustes`], [`ellipsoid`], [`footprint`] | what positions say, and in which frame |
//! | [`dense`], [`loss`] | the mathematics that they share |
//!
//! # Conventions
//!
//! - Lengths are metres, times picoseconds, voltages volts. A name carries its unit: `distance_m`, `variance_m2`.
//! - Patch 0 is `p0`, source and camera in one (paper section 3); patches count from 1. [`maximum_likelihood`] counts
//!   its unknowns from 0, and numbers stations separately.
//! - A path names its patches in the order in which light meets them.
//! - Flatland is `dimensions` = 2: z stays.
//! - [`Error`] says why there is no solution. A broken precondition, such as a path without a standard deviation, is a
//!   panic that the kernel documents.
//!
//! # Not here
//!
//! No file, no table and no clock. No kernel starts a thread of its own: sums over many paths use rayon's pool, in
//! chunks that the data define, so results do not depend on the number of threads. What no length determines, such as a
//! rotation or a mirror image, is reported, not guessed.

pub mod association;
mod axes;
mod band;
pub mod bistatic;
pub mod classical;
pub mod companion;
pub mod completion;
pub mod dense;
pub mod detours;
pub mod drift;
pub mod ellipsoid;
mod failure;
pub mod faint;
pub mod first_return;
pub mod footprint;
pub mod frame;
pub mod height_field;
pub mod hidden;
pub mod iso_embed;
pub mod joint;
pub mod labelling;
pub mod loss;
pub mod maximum_likelihood;
mod median;
pub mod mirror;
pub mod multilateration;
mod neighbours;
pub mod path;
pub mod placement;
pub mod planes;
pub mod procrustes;
pub mod reestimate;
pub mod repeats;
#[cfg(test)]
#[expect(dead_code, reason = "the studies use more of it")]
mod room;
pub mod shapes;
pub mod smacof;
pub mod t2;
pub mod t3;
pub mod units;
mod waves;

pub use failure::Error;
pub use periscope_cancel::Cancel;

/// A dense matrix.
pub type Matrix = faer::Mat<f64>;

/// A point in space; in flatland z = 0.
pub type Point = nalgebra::Point3<f64>;

#[cfg(test)]
mod tests;
