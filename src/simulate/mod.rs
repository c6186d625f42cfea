//! The forward model: a scene description becomes a campaign of scope files, with truth beside it.
//!
//! First and second bounces by integrals over the areas of Lambertian patches, an instrument with response, latency, trigger jitter, noise and
//! converter, and shots that went wrong. It shares no code with the estimators (`signal`, `geometry`, `stages`): nothing is tested against itself.
//!
//! ```toml
//! [campaign]
//! name = "two-patches"
//! group_index = 1.000277             # optional
//! dimensions = 3                     # optional
//! [stations.laser]                   # optional: at the origin
//! position_m = [0.0, 0.0, 0.0]
//! [sensors.s1]
//! station = "laser"                  # optional
//! latency_ps = 1250.0                # true delay from arrival to the response's maximum
//! [patches.1]                        # a disk
//! position_m = [0.3, 0.2, 1.0]
//! normal = [0.0, 0.0, -1.0]
//! size_m = 0.005                     # diameter
//! reflectance = 0.8                  # optional
//! [instrument]
//! response = { kind = "emg", sigma_ps = 33.0, tau_ps = 112.0 }   # or { kind = "gaussian", fwhm_ps = 250.0 }
//! dt_ps = 50.0
//! samples = 320
//! t0_ps = -1000.0                    # nominal time of sample 0 after the trigger
//! bits = 8                           # of the converter, 8 to 16
//! full_scale_v = 1.0                 # range of the converter
//! snr = 20.0                         # of one shot; a shortcut: every capture is amplified to the same height. Or noise_v and volts
//! jitter_ps = 80.0                   # of the trigger, standard deviation
//! reference = { fwhm_ps = 200.0, snr = 50.0 }   # optional: a second channel with the pulse that marks time zero
//! [captures]
//! shots = 100
//! response_shots = 400
//! path_m = 1.0                       # known path of the response captures; the true one differs by its sd
//! path_sd_m = 0.0003
//! bad_shots = 0.02                   # optional: share of shots without light or with far too much
//! ```
//!
//! With `noise_v` (standard deviation of a sample) in place of `snr`, `volts` is the height of a first bounce from a white patch at 1 m, lit and seen
//! head on, and signals have the heights that geometry gives them.
//!
//! Not modelled yet: third and later bounces, hidden and mirror patches, occluders, specular reflection, ambient light, drift, non-linearity,
//! correlated noise, the laser's period. Scenes that ask for them are refused.

mod folder;
mod instrument;
mod scene;
mod transport;
mod truth;

use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use thiserror::Error;

use crate::tables::{Calibration, Onset, Patch};
use crate::units::{self, PatchId};
use instrument::{Digitizer, Pulse};
pub use scene::{Scene, SceneError};
use transport::Light;

/// Why a campaign was not made.
#[derive(Debug, Error)]
pub enum SimulateError {
    /// The folder is in use.
    #[error("{} is not empty; choose another folder, or remove it", folder.display())]
    InUse {
        /// Folder.
        folder: PathBuf,
    },
    /// Light outside the record.
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
    /// LeCroy sequence files, a segment a shot, each with the sub-sample time of its trigger.
    Trc,
    /// NumPy arrays of codes, a row a shot; the sub-sample time of the trigger is lost, as in many home-made set-ups.
    Npy,
}

/// What is true of a simulated campaign.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Where the patches are.
    pub patches: Vec<Patch>,
    /// When their light arrives (the centroid over the patches' areas), and how high the response stands.
    pub onsets: Vec<Onset>,
    /// True responses and latencies.
    pub calibration: Vec<Calibration>,
}

/// What one file pair is to hold.
struct Shooting {
    /// Number of its random stream.
    stream: u64,
    /// Beginning of its file names, relative to the campaign.
    stem: String,
    light: Light,
    shots: usize,
    latency_ps: f64,
}

/// Makes a campaign in the folder `out`, which must be empty or absent. Equal scene, seed and format give equal files.
///
/// # Errors
/// When the folder is in use or cannot be written, or light arrives outside the record.
pub fn simulate(scene: &Scene, seed: u64, out: &Path, format: Format) -> Result<Truth, SimulateError> {
    folder::claim(out)?;
    let pulse = Pulse::of(&scene.instrument.response);
    let mut shootings = Vec::new();
    let mut truth = Truth { patches: scene.true_patches(), onsets: Vec::new(), calibration: Vec::new() };
    for (number, (name, sensor)) in scene.sensors.iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number as u64);
        let normal: f64 = StandardNormal.sample(&mut rng);
        let path_m = scene.captures.path_m + scene.captures.path_sd_m * normal;
        let light = Light::at(units::time_ps(path_m, scene.group_index), scene.instrument.volts.unwrap_or(1.0));
        let stem = format!("raw/response/{name}");
        shootings.push(Shooting {
            stream: rng.random(),
            stem,
            light,
            shots: scene.captures.response_shots,
            latency_ps: sensor.latency_ps,
        });
        truth.calibration.push(scene.true_calibration(name, sensor.latency_ps, &pulse));
        for lit in scene.patches.keys() {
            for seen in scene.patches.keys() {
                let light = transport::light(scene, name, *lit, *seen);
                let stem = format!("raw/scene/{name}_L{lit}_P{seen}");
                truth.onsets.push(scene.true_onset(name, *lit, *seen, &light));
                shootings.push(Shooting {
                    stream: rng.random(),
                    stem,
                    light,
                    shots: scene.captures.shots,
                    latency_ps: sensor.latency_ps,
                });
                scene.check_record(*lit, *seen, &shootings[shootings.len() - 1].light, sensor.latency_ps)?;
            }
        }
    }
    let digitizer = Digitizer::new(&scene.instrument, scene.captures.bad_shots, &pulse);
    shootings.par_iter().try_for_each(|shooting| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(shooting.stream);
        let shots = digitizer.shots(&shooting.light, shooting.latency_ps, shooting.shots, &mut rng);
        folder::write_shots(out, &shooting.stem, scene, format, &shots)
    })?;
    folder::write_campaign(out, scene, format)?;
    folder::write_truth(out, scene, seed, &truth)?;
    Ok(truth)
}
