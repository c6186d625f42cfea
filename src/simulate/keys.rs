//! The keys of a scene file, one struct per heading; the documentation of [`super`] explains them.

#![expect(missing_docs, reason = "what each key means stands in the documentation of `simulate`")]

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::campaign::keys::{PatchRole, SensorKind, Station, View, one_station};
use crate::units::PatchId;

/// A scene file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    pub campaign: Heading,
    #[serde(default = "one_station")]
    pub stations: BTreeMap<String, Station>,
    pub sensors: BTreeMap<String, Sensor>,
    pub patches: BTreeMap<PatchId, Disk>,
    #[serde(default)]
    pub views: BTreeMap<PatchId, View>,
    #[serde(default)]
    pub surfaces: BTreeMap<String, Rectangle>,
    pub laser: Option<Laser>,
    pub optics: Option<Optics>,
    pub instrument: Instrument,
    pub captures: Captures,
    #[serde(default, rename = "known")]
    pub prior: Prior,
}

/// `[known]`: prior knowledge that campaign.toml will contain.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Prior {
    pub size: bool,
    pub normal: bool,
    pub anchors: Vec<PatchId>,
    pub anchor_sd_m: f64,
    pub strips: BTreeMap<PatchId, PatchId>,
    pub lobe: bool,
    pub apart_max_m: Option<f64>,
    pub along: Option<[f64; 3]>,
    pub rays: Vec<PatchId>,
    pub ray_sd_rad: f64,
    pub station_sd_m: f64,
}

/// `[campaign]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heading {
    pub name: String,
    #[serde(default = "air")]
    pub group_index: f64,
    #[serde(default = "space")]
    pub dimensions: u8,
}

fn air() -> f64 {
    1.000_277
}

fn space() -> u8 {
    3
}

/// A detector.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its station; absent: the laser's.
    pub station: Option<String>,
    /// Voltages or photon histograms.
    #[serde(default)]
    pub kind: SensorKind,
    /// True delay from the arrival of light to the maximum of its response.
    #[serde(default)]
    pub latency_ps: f64,
    /// Patches and views that it looks at; empty: all that are seen.
    #[serde(default)]
    pub seen: Vec<PatchId>,
}

/// A disk: a patch.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disk {
    /// Centre.
    pub position_m: [f64; 3],
    /// Unit vector towards the lit side.
    pub normal: [f64; 3],
    /// Diameter.
    pub size_m: f64,
    /// Reflected share of the light.
    #[serde(default = "bright")]
    pub reflectance: f64,
    /// Visible; hidden from laser and sensor; or a perfect mirror.
    #[serde(default)]
    pub role: PatchRole,
    /// Glossy part of the reflection; absent: Lambertian.
    pub lobe: Option<Lobe>,
}

fn bright() -> f64 {
    0.8
}

/// A specular lobe of finite width, in addition to the Lambertian part.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lobe {
    /// Share of the reflected light in the lobe.
    pub share: f64,
    /// Standard deviation of the angle from the mirror direction.
    pub width_rad: f64,
}

/// An object in the room that is no patch: furniture, a wall. It blocks light, and may reflect some.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rectangle {
    /// A corner.
    pub corner_m: [f64; 3],
    /// The two edges from there, at right angles; their cross product points to the lit side.
    pub edges_m: [[f64; 3]; 2],
    /// Reflected share of the light; 0: it only blocks.
    #[serde(default)]
    pub reflectance: f64,
    /// Largest edge of its cells; required if it reflects light.
    pub cell_m: Option<f64>,
}

/// `[laser]`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laser {
    pub pulse_j: f64,
    pub wavelength_nm: f64,
    pub repetition_hz: f64,
    #[serde(default)]
    pub power_per_h: f64,
    #[serde(default)]
    pub power_sd: f64,
}

/// `[optics]`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    pub lens_m: f64,
    #[serde(default = "all")]
    pub transmission: f64,
    pub detector_m: Option<f64>,
    #[serde(default = "half")]
    pub numerical_aperture: f64,
    #[serde(default)]
    pub ambient_w: f64,
}

fn half() -> f64 {
    0.5
}

fn all() -> f64 {
    1.0
}

/// `[instrument]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Instrument {
    pub response: Shape,
    pub dt_ps: f64,
    pub samples: usize,
    pub t0_ps: f64,
    #[serde(default = "eight")]
    pub bits: u16,
    pub full_scale_v: f64,
    pub snr: Option<f64>,
    pub noise_v: Option<f64>,
    pub noise_bandwidth_ghz: Option<f64>,
    pub responsivity_a_w: Option<f64>,
    #[serde(default = "fifty")]
    pub load_ohm: f64,
    #[serde(default)]
    pub dark_a: f64,
    pub jitter_ps: f64,
    pub rate_hz: Option<f64>,
    pub reference: Option<Reference>,
    #[serde(default)]
    pub ranges: BTreeMap<String, Range>,
    pub counts: Option<Counts>,
    #[serde(default)]
    pub flaws: Flaws,
}

fn eight() -> u16 {
    8
}

fn fifty() -> f64 {
    50.0
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
    /// Height over noise of one shot, as a shortcut.
    pub snr: Option<f64>,
    /// Height.
    pub height_v: Option<f64>,
}

/// A vertical range of the oscilloscope.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Range of the converter.
    pub full_scale_v: f64,
    /// Noise of one sample.
    pub noise_v: f64,
    /// What its amplifier adds to the latency.
    #[serde(default)]
    pub latency_ps: f64,
}

/// `[instrument.counts]`: a photon counter.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counts {
    /// Detections per photon.
    pub efficiency: f64,
    /// Dark count rate.
    #[serde(default)]
    pub dark_hz: f64,
    /// Time after a detection in which the counter is blind.
    #[serde(default)]
    pub dead_time_ps: f64,
}

/// `[instrument.flaws]`: imperfections of real instruments; each is absent by default.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Flaws {
    pub saturation_v: Option<f64>,
    pub slew_ps: f64,
    pub cubic: f64,
    pub interleave: Option<Interleave>,
    pub pickup: Option<Pickup>,
    pub echo: Option<Echo>,
    pub tail: Option<Tail>,
    pub recovery: Option<Tail>,
    pub delay_ps_per_h: f64,
    pub delay_sd_ps: f64,
    pub delay_walk_ps: f64,
}

/// Mismatch of interleaved converters.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interleave {
    /// Number of interleaved converters.
    pub cores: usize,
    /// Standard deviation of their offsets.
    #[serde(default)]
    pub offset_v: f64,
    /// Standard deviation of their relative gains.
    #[serde(default)]
    pub gain: f64,
}

/// Electrical pick-up from the laser's firing, synchronous with it.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pickup {
    /// Amplitude at time 0.
    pub volts: f64,
    /// Frequency.
    pub frequency_ghz: f64,
    /// Time constant of its decay on both sides of time 0.
    pub decay_ps: f64,
}

/// A reflection in the cable: a second copy of the response.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Echo {
    /// Amplitude over that of the pulse.
    pub ratio: f64,
    /// Its delay.
    pub delay_ps: f64,
}

/// A slow exponential: the detector's diffusion tail (height over that of the pulse), or the amplifier's recovery from
/// clipping (share of the voltage beyond the rail).
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tail {
    /// Share.
    pub ratio: f64,
    /// Time constant.
    pub tau_ps: f64,
}

/// `[captures]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Captures {
    pub shots: usize,
    #[serde(default)]
    pub lit: Vec<PatchId>,
    #[serde(default)]
    pub seen: Vec<PatchId>,
    #[serde(default = "two")]
    pub bounces: usize,
    pub response_shots: usize,
    pub path_m: f64,
    pub path_sd_m: f64,
    #[serde(default)]
    pub response_od: f64,
    #[serde(default)]
    pub first_bounce_od: f64,
    #[serde(default)]
    pub dark_shots: usize,
    #[serde(default)]
    pub blocked_shots: usize,
    #[serde(default)]
    pub fiducials: Vec<Fiducial>,
    #[serde(default)]
    pub bad_shots: f64,
    #[serde(default)]
    pub lost_shots: f64,
    #[serde(default)]
    pub overhead_s: f64,
    #[serde(default)]
    pub ranges: Ranges,
}

fn two() -> usize {
    2
}

/// The vertical ranges at which a capture is recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ranges {
    /// The smallest that contains the signal.
    #[default]
    Auto,
    /// Each in turn.
    All,
}

/// Captures of a known path, once or repeatedly.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fiducial {
    /// Path to a white diffuser and back; alternatively `through`.
    pub path_m: Option<f64>,
    /// Patches that the light meets, first to last; their distances determine the path.
    #[serde(default)]
    pub through: Vec<PatchId>,
    /// Optical density in the beam.
    #[serde(default)]
    pub attenuation_od: f64,
    /// Shots per run.
    pub shots: usize,
    /// Number of runs.
    #[serde(default = "one")]
    pub runs: usize,
    /// Time from run to run.
    #[serde(default)]
    pub every_s: f64,
}

fn one() -> usize {
    1
}
