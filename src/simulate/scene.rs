//! The scene file: its keys, and what they must satisfy.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use crate::campaign::keys::{self, LASER, PatchRole, Station, one_station};
use crate::campaign::toml_text::{self, TomlError};
use crate::campaign::{Fault, check_setup};
use crate::units::PatchId;

/// What is wrong with a scene file.
#[derive(Debug, Error)]
pub enum SceneError {
    /// It cannot be read.
    #[error("cannot read scene {}", file.display())]
    Read {
        /// File.
        file: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// A value that cannot be.
    #[error("{}: {fault}", file.display())]
    Setup {
        /// File.
        file: PathBuf,
        /// What, and the mend.
        fault: Fault,
    },
    /// A value that cannot be, or that is not simulated yet.
    #[error("{}: {problem}", file.display())]
    Value {
        /// File.
        file: PathBuf,
        /// What, and the mend.
        problem: String,
    },
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    campaign: Heading,
    #[serde(default = "one_station")]
    stations: BTreeMap<String, Station>,
    sensors: BTreeMap<String, Sensor>,
    patches: BTreeMap<PatchId, Disk>,
    instrument: Instrument,
    captures: Captures,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Heading {
    name: String,
    #[serde(default = "air")]
    group_index: f64,
    #[serde(default = "space")]
    dimensions: u8,
}

fn air() -> f64 {
    1.000_277
}

fn space() -> u8 {
    3
}

/// A scene, checked.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the campaign.
    pub name: String,
    /// Group index of the medium.
    pub group_index: f64,
    /// 3, or 2 for flatland.
    pub dimensions: u8,
    /// Where light leaves and arrives.
    pub stations: BTreeMap<String, Station>,
    /// Detectors.
    pub sensors: BTreeMap<String, Sensor>,
    /// Surfaces.
    pub patches: BTreeMap<PatchId, Disk>,
    /// What records.
    pub instrument: Instrument,
    /// What is captured.
    pub captures: Captures,
    /// The file as it was.
    pub text: String,
}

/// A detector of a scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Where it is; absent: with the laser.
    pub station: Option<String>,
    /// True delay from the arrival of light to the maximum of its response.
    #[serde(default)]
    pub latency_ps: f64,
}

/// A Lambertian disk.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disk {
    /// Centre.
    pub position_m: [f64; 3],
    /// Towards the lit side, of length 1.
    pub normal: [f64; 3],
    /// Diameter.
    pub size_m: f64,
    /// Share of the light that it gives back.
    #[serde(default = "bright")]
    pub reflectance: f64,
    /// Must be visible.
    #[serde(default)]
    pub role: PatchRole,
}

fn bright() -> f64 {
    0.8
}

/// `[instrument]`; see the module's documentation.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Instrument {
    pub response: Shape,
    pub dt_ps: f64,
    pub samples: usize,
    pub t0_ps: f64,
    pub bits: u16,
    pub full_scale_v: f64,
    pub snr: Option<f64>,
    pub noise_v: Option<f64>,
    pub volts: Option<f64>,
    pub jitter_ps: f64,
    pub reference: Option<Reference>,
}

/// Shape of an impulse response.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Shape {
    /// Gaussian of this full width at half maximum.
    Gaussian {
        /// Full width at half maximum.
        fwhm_ps: f64,
    },
    /// Gaussian, then exponential decay.
    Emg {
        /// Standard deviation of the Gaussian.
        sigma_ps: f64,
        /// Time constant of the decay.
        tau_ps: f64,
    },
}

/// The channel with the pulse that marks time zero.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Full width at half maximum.
    pub fwhm_ps: f64,
    /// Height over noise of one shot.
    pub snr: f64,
}

/// `[captures]`; see the module's documentation.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Captures {
    pub shots: usize,
    pub response_shots: usize,
    pub path_m: f64,
    pub path_sd_m: f64,
    #[serde(default)]
    pub bad_shots: f64,
}

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// When it cannot be read, or anything in it is refused.
    pub fn load(file: &Path) -> Result<Self, SceneError> {
        let text =
            std::fs::read_to_string(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
        Self::parse(file, &text)
    }

    /// Parses the text of a scene file, called `file` in messages.
    ///
    /// # Errors
    /// When anything in it is refused.
    pub fn parse(file: &Path, text: &str) -> Result<Self, SceneError> {
        let keys: SceneFile = toml_text::parse(file, text)?;
        let scene = Self {
            name: keys.campaign.name,
            group_index: keys.campaign.group_index,
            dimensions: keys.campaign.dimensions,
            stations: keys.stations,
            sensors: keys.sensors,
            patches: keys.patches,
            instrument: keys.instrument,
            captures: keys.captures,
            text: text.to_owned(),
        };
        let sensors = scene.sensors.iter().map(|(name, sensor)| {
            (name.clone(), keys::Sensor { station: sensor.station.clone(), ..keys::Sensor::default() })
        });
        let patch = |disk: &Disk| keys::Patch {
            position_m: Some(disk.position_m),
            normal: Some(disk.normal),
            size_m: Some(disk.size_m),
            ..keys::Patch::default()
        };
        let patches = scene.patches.iter().map(|(id, disk)| (*id, patch(disk))).collect();
        let setup = check_setup::setup(&scene.stations, &sensors.collect(), &patches, scene.dimensions);
        setup.map_err(|fault| SceneError::Setup { file: file.to_owned(), fault })?;
        scene.check().map_err(|problem| SceneError::Value { file: file.to_owned(), problem })?;
        Ok(scene)
    }

    fn check(&self) -> Result<(), String> {
        for (id, disk) in &self.patches {
            if disk.role != PatchRole::Visible {
                return Err(format!(
                    "[patches.{id}]: role: hidden and mirror patches are not simulated yet; take it out"
                ));
            }
            if !(0.0..=1.0).contains(&disk.reflectance) {
                return Err(format!("[patches.{id}]: reflectance = {} is not from 0 to 1", disk.reflectance));
            }
        }
        let instrument = &self.instrument;
        let mut positive =
            vec![("[instrument]: dt_ps", instrument.dt_ps), ("[instrument]: full_scale_v", instrument.full_scale_v)];
        match instrument.response {
            Shape::Gaussian { fwhm_ps } => positive.push(("[instrument]: response.fwhm_ps", fwhm_ps)),
            Shape::Emg { sigma_ps, tau_ps } => {
                positive
                    .extend([("[instrument]: response.sigma_ps", sigma_ps), ("[instrument]: response.tau_ps", tau_ps)]);
            }
        }
        positive.extend(instrument.reference.iter().flat_map(|reference| {
            [("[instrument]: reference.fwhm_ps", reference.fwhm_ps), ("[instrument]: reference.snr", reference.snr)]
        }));
        positive.extend(instrument.snr.map(|snr| ("[instrument]: snr", snr)));
        positive.extend(instrument.volts.map(|volts| ("[instrument]: volts", volts)));
        positive.push(("[captures]: path_m", self.captures.path_m));
        if let Some((place, value)) = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Err(format!("{place} = {value} must be above 0"));
        }
        let not_negative = [
            ("[instrument]: jitter_ps", instrument.jitter_ps),
            ("[instrument]: noise_v", instrument.noise_v.unwrap_or(0.0)),
            ("[captures]: path_sd_m", self.captures.path_sd_m),
        ];
        if let Some((place, value)) = not_negative.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0))
        {
            return Err(format!("{place} = {value} must not be negative"));
        }
        if !(8..=16).contains(&instrument.bits) {
            return Err(format!("[instrument]: bits = {}; converters of 8 to 16 bits are simulated", instrument.bits));
        }
        if !(16..=10_000_000).contains(&instrument.samples) {
            return Err(format!("[instrument]: samples = {} is not from 16 to 10,000,000", instrument.samples));
        }
        if self.captures.shots == 0 || self.captures.response_shots == 0 {
            return Err("[captures]: shots and response_shots must be at least 1".to_owned());
        }
        if !(0.0..1.0).contains(&self.captures.bad_shots) {
            return Err(format!(
                "[captures]: bad_shots = {} is a share from 0 up to, not including, 1",
                self.captures.bad_shots
            ));
        }
        match (instrument.snr, instrument.noise_v, instrument.volts) {
            (Some(_), None, None) | (None, Some(_), Some(_)) => Ok(()),
            _ => Err("[instrument]: give either `snr`, or `noise_v` and `volts`".to_owned()),
        }
    }

    /// Where a sensor is.
    ///
    /// # Panics
    /// When the scene has no such sensor.
    #[must_use]
    pub fn sensor_m(&self, sensor: &str) -> [f64; 3] {
        let station = self.sensors[sensor].station.as_deref().unwrap_or(LASER);
        self.stations[station].position_m
    }
}

impl Instrument {
    /// Share of the range at which every signal stands, when the signal-to-noise ratio is set.
    pub const HEIGHT: f64 = 0.6;

    /// Height of the response to light of this strength.
    #[must_use]
    pub fn height_v(&self, strength: f64) -> f64 {
        if self.snr.is_some() { Self::HEIGHT * self.full_scale_v } else { strength }
    }

    /// Noise of one sample.
    #[must_use]
    pub fn sample_noise_v(&self) -> f64 {
        match self.snr {
            Some(snr) => Self::HEIGHT * self.full_scale_v / snr,
            None => self.noise_v.unwrap_or(0.0),
        }
    }

    /// Volts per code.
    #[must_use]
    pub fn gain_v(&self) -> f64 {
        self.full_scale_v / f64::from(1_u32 << self.bits)
    }

    /// Volts at code 0: the baseline stands a fifth of the range above the lower rail.
    #[must_use]
    pub fn offset_v(&self) -> f64 {
        0.3 * self.full_scale_v
    }
}
