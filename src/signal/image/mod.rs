//! Volume images of what a wall shows: many histograms of hidden light go in, the brightness of voxels comes out.
//!
//! | module | does |
//! |---|---|
//! | [`gate`] | the time behind which the wall's own light is smooth |
//! | [`foreground`] | removes smooth light from a histogram, and gives the variance of what remains |
//! | [`light_cone`] | the light-cone transform, for confocal scans of a grid |
//! | [`migration`] | f-k migration, for confocal scans of a grid |
//! | [`back_projection`] | filtered back-projection, for any pairs of points |
//!
//! Every image is linear in independent values of known variance, so each voxel has a known standard deviation where
//! nothing is hidden. Value over standard deviation is the voxel's significance, and [`threshold`] is the level that
//! noise exceeds in no voxel but with a stated probability.
//!
//! Lengths are times of flight in picoseconds: the crate does not know the speed of light. Times are those from the lit
//! point over the hidden surface to the seen point.

pub mod back_projection;
pub mod foreground;
pub mod gate;
pub mod light_cone;
pub mod migration;

/// Level of significance that Gaussian noise exceeds in any of `cells` cells with a probability below `false_alarm`:
/// `sqrt(2 ln(cells / false_alarm))`. Cells may depend on one another; the bound only gets safer.
///
/// # Panics
/// If there is no cell, or `false_alarm` is not above 0 and at most 1.
#[must_use]
pub fn threshold(cells: usize, false_alarm: f64) -> f64 {
    assert!(cells > 0 && false_alarm > 0.0 && false_alarm <= 1.0, "{cells} cells, false alarm {false_alarm}");
    (2.0 * (cells as f64 / false_alarm).ln()).sqrt()
}

#[cfg(test)]
mod tests;
