//! The forward model: turns a scene description into a campaign of scope files, with the truth next to them.
//!
//! Light is computed by integrals over the areas of patches, with occlusion, glossy lobes, mirrors and up to five
//! bounces. The instrument has a response, noise, converter, vertical ranges and flaws. Signal-to-noise ratios follow
//! from pulse energy, optics and detector. The simulator shares no code with the estimators (`signal`, `geometry`,
//! `stages`), so that their errors cannot cancel in tests.
//!
//! ```toml
//! [campaign]
//! name = "two-patches"
//! group_index = 1.000277             # optional
//! dimensions = 3                     # optional
//! [stations.laser]                   # optional: at the origin; others for sensors that stand elsewhere
//! position_m = [0.0, 0.0, 0.0]
//! [sensors.s1]
//! station = "laser"                  # optional
//! seen = [1, 2]                      # optional: what this sensor watches of `seen` in [captures]; else all of it
//! kind = "analog"                    # optional; or "counts"
//! latency_ps = 1250.0                # true delay from arrival to the response's maximum
//! [patches.1]                        # a disk
//! position_m = [0.3, 0.2, 1.0]
//! normal = [0.0, 0.0, -1.0]
//! size_m = 0.005                     # diameter
//! reflectance = 0.8                  # optional
//! role = "visible"                   # optional; or "hidden" (neither lit nor seen), "mirror" (perfect, lit and seen
//! only in what it reflects) lobe = { share = 0.5, width_rad = 0.05 }   # optional: glossy; this share goes into a lobe
//! about the mirror direction [views.7]                          # optional: a spot and pixel that covers several
//! patches patches = [1, 2] [surfaces.door]                    # optional: furniture, walls: they block light and, with
//! `reflectance` and `cell_m`, give some back corner_m = [0.0, 0.0, 0.5] edges_m = [[0.4, 0.0, 0.0], [0.0, 1.0, 0.0]]
//! reflectance = 0.5 cell_m = 0.1 [laser] pulse_j = 4.483e-9 wavelength_nm = 810.0 repetition_hz = 93.68e6            #
//! records reach across the period: profiles are circular power_per_h = 0.0                  # optional: relative
//! drift; power_sd: scatter from capture to capture [optics] lens_m = 0.025                     # diameter transmission
//! = 0.9                 # optional detector_m = 0.00025               # optional: diameter; with it a pixel gets no
//! more than a detector of this area takes in from numerical_aperture = 0.5           # a cone of this aperture
//! (optional), however large lens and patch are ambient_w = 0.0                    # optional: power of ambient light
//! on the detector [instrument] response = { kind = "emg", sigma_ps = 33.0, tau_ps = 112.0 }   # or { kind =
//! "gaussian", fwhm_ps = 250.0 } responsivity_a_w = 0.45 load_ohm = 50.0                    # optional; times the
//! amplifier's gain dark_a = 0.0                       # optional: dark current dt_ps = 50.0 samples = 320 t0_ps =
//! -1000.0                    # nominal time of sample 0 after the trigger bits = 8                           # of the
//! converter, 8 to 16 full_scale_v = 1.0                 # range of the converter noise_v = 0.004                    #
//! of one sample of one shot at that range noise_bandwidth_ghz = 5.0          # optional: noise is white without
//! jitter_ps = 80.0                   # of the trigger, standard deviation rate_hz = 1000.0                   #
//! optional: shots that the instrument records in a second, if fewer than the laser gives reference = { fwhm_ps =
//! 200.0, height_v = 0.3 }   # optional: a second channel with the pulse that marks time zero [instrument.ranges.fine]
//! # optional: vertical ranges in place of full_scale_v and noise_v full_scale_v = 0.08 noise_v = 0.0003 latency_ps =
//! 12.0                  # what its amplifier adds [instrument.counts]                # for sensors of kind "counts"
//! efficiency = 0.3 dark_hz = 100.0 dead_time_ps = 50000.0 [instrument.flaws]                 # optional, each
//! saturation_v = 2.0                 # v becomes v / (1 + v / saturation_v) slew_ps = 20.0                     # delay
//! of a pulse that fills the range cubic = 0.01                       # relative surplus at full scale interleave = {
//! cores = 4, offset_v = 0.001, gain = 0.01 } pickup = { volts = 0.001, frequency_ghz = 0.4, decay_ps = 3000.0 } echo =
//! { ratio = 0.01, delay_ps = 4000.0 } tail = { ratio = 0.01, tau_ps = 2000.0 } recovery = { ratio = 0.02, tau_ps =
//! 3000.0 }   # after clipping delay_ps_per_h = 0.0 delay_sd_ps = 0.0                  # from capture to capture
//! delay_walk_ps = 0.0                # a random walk: its standard deviation after an hour
//! [captures] shots = 100                        # of each scene capture; for photon counters, pulses of the laser lit
//! = [1, 2]                       # optional, like `seen`: patches and views; else all visible patches bounces = 2
//! # optional: light is followed so far, 1 to 5 ranges = "auto"                    # optional: the most sensitive range
//! that holds the signal; or "all", each in turn response_shots = 400 response_od = 0.0                  # optional, at
//! least; more where the response would clip first_bounce_od = 0.0              # optional: density in the beam of
//! captures whose lit patch is seen, by itself or in a view path_m = 1.0                       # known path of the
//! response captures; the true one differs by its sd path_sd_m = 0.0003 dark_shots = 0                     # optional,
//! like blocked_shots bad_shots = 0.02                   # optional: share of shots without light or with far too much
//! lost_shots = 0.0                   # optional: share of shots that are not in the files overhead_s = 0.0
//! # optional: time between captures [[captures.fiducials]]             # optional: known paths, once or again and
//! again path_m = 0.6                       # to a white diffuser and back; or: through = [1, 5, 2] attenuation_od =
//! 0.3 shots = 100 runs = 10 every_s = 600.0 [known]                            # optional: what campaign.toml says
//! beforehand, true but for errors of these standard deviations size = true                        # of all patches,
//! like `normal` normal = true anchors = [1, 2, 3]                # patches of known position anchor_sd_m = 0.001 rays
//! = [4, 5]                      # patches of known direction from the laser ray_sd_rad = 0.002 station_sd_m = 0.0005
//! # of all stations but the laser's strips = { 21 = 4, 23 = 3 }        # hidden patches that are listed, and the
//! visible one over which each one's light leaves lobe = true                        # of patches that have one, with
//! `size` apart_max_m = 0.06                 # how far hidden patches are apart at most along = [1.0, 0.0, 0.0]
//! # in which direction they follow one another
//! ```
//!
//! A shortcut for studies of kernels: `snr = 20.0` in `[instrument]` (of one shot, all captures amplified to the same
//! height) replaces `[laser]`, `[optics]`, `noise_v` and `responsivity_a_w`; likewise `reference = { fwhm_ps, snr }`.
//! The truth marks such campaigns.
//!
//! Not modelled: paths over two consecutive mirrors, polarisation, interference, a beam that is wider than its patch.

mod calendar;
mod chain;
mod check_scene;
mod counts;
mod folder;
pub mod keys;
mod laboratory;
mod load_scene;
mod prior;
mod pulse;
mod raw_files;
mod recorder;
mod scene;
mod session;
pub mod transport;
mod truth;
pub mod wall;

use std::path::{Path, PathBuf};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use thiserror::Error;

use crate::tables::{Calibration, Onset, Patch, TrueCapture, TrueCentroid, TruePath};
use crate::units::PatchId;
pub use chain::{Chain, Setting};
pub use laboratory::Laboratory;
pub use load_scene::SceneError;
pub use pulse::Pulse;
use recorder::Recorder;
pub use scene::Scene;
pub use session::Shooting;

/// Why a campaign was not made.
#[derive(Debug, Error)]
pub enum SimulateError {
    /// The folder is in use.
    #[error("{} is not empty; choose another folder, or remove it", folder.display())]
    InUse {
        /// Folder.
        folder: PathBuf,
    },
    /// Light arrives outside the record.
    #[error(
        "light of lit {lit}, seen {seen} arrives at {time_ps:.0} ps, outside the record; change `samples` or `t0_ps` in [instrument]"
    )]
    Outside {
        /// Patch lit.
        lit: PatchId,
        /// Patch seen.
        seen: PatchId,
        /// Arrival in the record.
        time_ps: f64,
    },
    /// A file cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
}

/// Format of the raw files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// LeCroy sequence files: one segment per shot, each with the sub-sample time of its trigger.
    Trc,
    /// Tektronix FastFrame files: one frame per shot, each with the sub-sample time of its trigger.
    Wfm,
    /// Keysight segmented files in volts: one segment per shot, each with the sub-sample time of its trigger. Converter
    /// rails are lost.
    Bin,
    /// NumPy arrays of codes: one row per shot. The sub-sample time of the trigger is lost, as in many home-made
    /// set-ups.
    Npy,
    /// Comma-separated times and volts: one file per shot.
    Csv,
}

/// The truth of a simulated campaign.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Positions of the patches.
    pub patches: Vec<Patch>,
    /// Arrival times (the centroid over the patches' areas) and response heights.
    pub onsets: Vec<Onset>,
    /// True responses and latencies.
    pub calibration: Vec<Calibration>,
    /// All paths of light.
    pub paths: Vec<TruePath>,
    /// Centres of patches, with the centroids of their first bounces.
    pub centroids: Vec<TrueCentroid>,
    /// Properties of each capture.
    pub captures: Vec<TrueCapture>,
}

/// Makes a campaign in the folder `out`, which must be empty or absent. Equal scene, seed and format give equal files.
///
/// # Errors
/// When the folder is in use or cannot be written, or light arrives outside the record.
pub fn simulate(scene: &Scene, seed: u64, out: &Path, format: Format) -> Result<Truth, SimulateError> {
    folder::claim(out)?;
    record(&Laboratory::new(scene, seed)?, seed, out, format)
}

/// Records a scene whose light is already computed, with the laboratory's own seed.
///
/// # Errors
/// When the folder is in use or cannot be written.
pub fn record(laboratory: &Laboratory, seed: u64, out: &Path, format: Format) -> Result<Truth, SimulateError> {
    folder::claim(out)?;
    let (scene, chain) = (laboratory.scene, &laboratory.chain);
    let recorder = Recorder::new(scene, chain);
    laboratory.shootings.par_iter().try_for_each(|shooting| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(shooting.stream);
        if shooting.counts {
            let (light, factor) = (&shooting.light, shooting.factor);
            let cycles = shooting.shots as u64;
            let counts = counts::histogram(scene, &chain.pulse, light, factor, shooting.latency_ps, cycles, &mut rng);
            return raw_files::write_histogram(out, shooting, &counts);
        }
        let shots = recorder.shots(&shooting.exposure(), &mut rng);
        raw_files::write_shots(out, scene, chain, format, shooting, &shots)
    })?;
    let truth = laboratory.truth();
    folder::write_truth(out, scene, seed, &truth)?;
    // Comes last: without it a folder is no campaign, so that a simulation that was ended leaves nothing that looks
    // whole.
    folder::write_campaign(out, scene, seed, format, &laboratory.shootings)?;
    Ok(truth)
}
