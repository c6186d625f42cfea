//! The Cramer-Rao bound of a scene: the best precision of any unbiased estimator of the patches' positions, from the
//! instrument through profiles and onsets to coordinates. It shares no code with the estimators.
//!
//! - [`profile`]: the samples of a capture determine the time of each pulse. Noise: the oscilloscope's with its
//!   correlation, the converter's rounding, shot noise by level. Also unknown: all amplitudes, the baseline, the width
//!   of the response.
//! - [`pulses`]: the same from a response and noise that a caller has.
//! - [`coordinates`]: all captures and the response captures together determine the positions. Also unknown: each
//!   sensor's delay and response width, the reference pulse's error in each profile, the length of the known path.
//! - [`outlook`]: what that means for a planned measurement; [`design`] asks for it as `periscope design` does.
//!
//! Not included: distortions by an instrument's flaws (saturation, slew, interleaving, drift), the pile-up of photon
//! counters, amplitudes as a source of geometry.

mod banded;
pub mod coordinates;
pub mod design;
pub mod outlook;
pub mod profile;
pub mod pulses;

use crate::simulate::{Laboratory, Scene, SimulateError};
use coordinates::Coordinates;
use profile::ProfileBound;

/// Which of the signal is used.
#[derive(Clone, Copy, Debug)]
pub struct Use {
    /// Highest order of bounces whose times enter the geometry.
    pub bounces: usize,
    /// Matched-filter signal-to-noise ratio from which a pulse counts as an onset.
    pub threshold_sigma: f64,
}

impl Default for Use {
    /// As in the pipelines: first and second bounces above five standard deviations.
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
    /// The bound of a scene.
    ///
    /// # Errors
    /// When the first light of a capture arrives outside the record.
    pub fn new(scene: &Scene, using: Use) -> Result<Self, SimulateError> {
        Ok(Self::of(&Laboratory::new(scene, 0)?, using))
    }

    /// The bound of a scene whose light is already computed.
    #[must_use]
    pub fn of(laboratory: &Laboratory, using: Use) -> Self {
        let profiles = profile::all(laboratory, using.threshold_sigma);
        let coordinates = Coordinates::new(laboratory, &profiles, using.bounces);
        Self { profiles, coordinates }
    }
}
