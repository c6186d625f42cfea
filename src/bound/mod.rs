//! The Cramer-Rao bound of a scene: how well any unbiased estimator can know where the patches are, from the instrument through profiles and
//! onsets to coordinates. It shares no code with the estimators.
//!
//! - [`profile`]: the samples of a capture say when each pulse arrived. Noise: the oscilloscope's with its correlation, the converter's rounding,
//!   shot noise by level. Unknown beside the times: all amplitudes, the baseline, the width of the response.
//! - [`coordinates`]: all captures and the response captures together say where the patches are. Unknown beside them: each sensor's delay and
//!   response width, the reference pulse's error in each profile, the length of the known path.
//! - [`outlook`]: what that means to somebody who is about to capture, for `periscope design`.
//!
//! Not in it: what the flaws of an instrument distort (saturation, slew, interleaving, drift), the pile-up of photon counters, amplitudes as a
//! source of geometry.

mod banded;
pub mod coordinates;
pub mod outlook;
pub mod profile;

use crate::simulate::{Laboratory, Scene, SimulateError};
use coordinates::Coordinates;
use profile::ProfileBound;

/// What of the light is used.
#[derive(Clone, Copy, Debug)]
pub struct Use {
    /// Highest order of bounces whose times go into the geometry.
    pub bounces: usize,
    /// Matched-filter signal-to-noise ratio from which a pulse is an onset.
    pub threshold_sigma: f64,
}

impl Default for Use {
    /// What the pipelines do: first and second bounces above five standard deviations.
    fn default() -> Self {
        Self { bounces: 2, threshold_sigma: 5.0 }
    }
}

/// The bound of a scene.
pub struct Bound {
    /// One for each scene capture.
    pub profiles: Vec<ProfileBound>,
    /// Patches, delays, widths.
    pub coordinates: Coordinates,
}

impl Bound {
    /// Of a scene, for what is used of its light.
    ///
    /// # Errors
    /// When the first light of a capture arrives outside the record.
    pub fn new(scene: &Scene, using: Use) -> Result<Self, SimulateError> {
        Ok(Self::of(&Laboratory::new(scene, 0)?, using))
    }

    /// The same from a scene's light.
    #[must_use]
    pub fn of(laboratory: &Laboratory, using: Use) -> Self {
        let profiles = profile::all(laboratory, using.threshold_sigma);
        let coordinates = Coordinates::new(laboratory, &profiles, using.bounces);
        Self { profiles, coordinates }
    }
}
