//! The keys of `campaign.toml`, one struct per heading. Users write these files, so the keys are a contract.
//!
//! Frame: right-handed; metres, picoseconds, radians; in flatland (`dimensions = 2`) z = 0. Every struct refuses
//! unknown keys. The values can be serialized, so that the fields that a stage reads enter its lineage; the folder
//! itself never does.

mod one_or_more;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::formats::Description;
use crate::units::PatchId;

/// Name of the file that makes a folder a campaign.
pub const CAMPAIGN_FILE: &str = "campaign.toml";

/// Name of the station of the laser.
pub const LASER: &str = "laser";

/// A campaign: the set-up, and which files hold which exposures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Campaign {
    /// The campaign folder. Not serialized: results must not depend on where a campaign is stored.
    #[serde(skip)]
    pub root: PathBuf,
    /// Name, as in the tables.
    pub name: String,
    /// Group index of the medium: path = c * time / index.
    pub group_index: f64,
    /// Laser period, if profiles wrap around it.
    pub repetition_ps: Option<f64>,
    /// Standard deviation of that period.
    pub repetition_sd_ps: Option<f64>,
    /// 3, or 2 for flatland.
    pub dimensions: u8,
    /// Mean size of a part in bytes of raw files. A part is the unit in which the program works and stores results.
    pub part_bytes: u64,
    /// Positions of laser and sensors; contains at least [`LASER`].
    pub stations: BTreeMap<String, Station>,
    /// The detectors.
    pub sensors: BTreeMap<String, Sensor>,
    /// Prior information on the patches.
    pub patches: BTreeMap<PatchId, Patch>,
    /// Numbers in `lit` and `seen` that denote other footprints than the patch of that number.
    pub views: BTreeMap<PatchId, View>,
    /// Prior information on the hidden patches.
    pub hidden: Hidden,
    /// Rules that say which records are which exposures.
    pub captures: Vec<CaptureRule>,
    /// Exposures to omit, and why.
    pub exclude: Vec<Exclude>,
    /// The raw files that take part, relative to the folder; `None`: all. Not a key: `watch` sets it during a
    /// measurement, when other files are still being written.
    #[serde(skip)]
    pub settled: Option<BTreeSet<PathBuf>>,
}

impl Campaign {
    /// Whether all files are of a lidar: PulseWaves or LAS.
    #[must_use]
    pub fn is_of_lidar(&self) -> bool {
        let is_lidar = |files: &String| [".pls", ".las"].iter().any(|ending| files.to_lowercase().ends_with(ending));
        !self.captures.is_empty() && self.captures.iter().all(|rule| rule.files.as_ref().is_some_and(is_lidar))
    }

    /// The station of the laser.
    #[must_use]
    pub fn source(&self) -> &Station {
        &self.stations[LASER]
    }

    /// The station of a sensor, which defaults to the laser's; `None` if the campaign has no such sensor.
    #[must_use]
    pub fn station_of(&self, sensor: &str) -> Option<&Station> {
        let station = self.sensors.get(sensor)?.station.as_deref();
        self.stations.get(station.unwrap_or(LASER))
    }

    /// Converts a path in the campaign to a path on this machine.
    #[must_use]
    pub fn path_of(&self, file: &Path) -> PathBuf {
        self.root.join(file)
    }
}

/// `[stations.NAME]`: a point from which the laser shines, or to which a sensor looks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Station {
    /// Position.
    pub position_m: [f64; 3],
    /// Standard deviation of each coordinate; absent: exact (it defines the frame).
    pub sd_m: Option<f64>,
}

/// The stations of a campaign without `[stations]`: laser and sensors at the origin (`p0` of the paper).
#[must_use]
pub fn one_station() -> BTreeMap<String, Station> {
    let origin = Station { position_m: [0.0; 3], sd_m: None };
    BTreeMap::from([(LASER.to_owned(), origin)])
}

/// `[sensors.NAME]`: a detector.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its station; absent: that of the laser.
    pub station: Option<String>,
    /// What it records.
    #[serde(default)]
    pub kind: SensorKind,
    /// Laser pulses per histogram (kind counts).
    pub cycles: Option<u64>,
    /// Dead time after a detection (kind counts).
    pub dead_time_ps: Option<f64>,
    /// Prior of the delay between the arrival of light and its record.
    pub latency_ps: Option<f64>,
    /// Standard deviation of that prior.
    pub latency_sd_ps: Option<f64>,
    /// Of a relay wall: time behind the wall's own light from which on light counts; absent: the program finds it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gate_ps: Option<f64>,
}

/// What a sensor's records are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// Voltages over time.
    #[default]
    Analog,
    /// Photon histograms.
    Counts,
}

/// `[patches.N]`: prior information on a patch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Whether laser and sensor reach it directly.
    #[serde(default)]
    pub role: PatchRole,
    /// A label for readers.
    pub label: Option<String>,
    /// Known position: an anchor.
    pub position_m: Option<[f64; 3]>,
    /// Standard deviation of each coordinate of the anchor; absent: exact.
    pub sd_m: Option<f64>,
    /// Unit vector towards the lit side.
    pub normal: Option<[f64; 3]>,
    /// Diameter.
    pub size_m: Option<f64>,
    /// For a glossy patch: standard deviation of the angle around the mirror direction into which it reflects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lobe_rad: Option<f64>,
    /// For a hidden patch: the visible one from which its light reaches the sensor, where a view covers several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub through: Option<PatchId>,
    /// The line on which it is, from the angles of a galvo or a pixel.
    pub ray: Option<Ray>,
}

/// Role of a patch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PatchRole {
    /// Laser and sensor reach it.
    #[default]
    Visible,
    /// Around the corner.
    Hidden,
    /// Reflects like a mirror: no direct reflection comes back from it.
    Mirror,
}

impl PatchRole {
    /// The name in campaign.toml and in the table `patches`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Visible => "visible",
            Self::Hidden => "hidden",
            Self::Mirror => "mirror",
        }
    }
}

/// A half line from a station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ray {
    /// The station where it begins.
    pub from: String,
    /// Direction, of any length but zero.
    pub direction: [f64; 3],
    /// Standard deviation of each of its two angles; absent: exact.
    pub sd_rad: Option<f64>,
}

/// `[views.N]`: a pixel or a laser spot whose footprint differs from patch N.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// The patches that it covers.
    pub patches: Vec<PatchId>,
}

/// `[hidden]`: prior information on the hidden patches.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hidden {
    /// Number of hidden patches; estimated when absent.
    pub count: Option<u32>,
    /// Largest distance between any two hidden patches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apart_max_m: Option<f64>,
    /// Direction along which the numbers of hidden patches increase.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub along: Option<[f64; 3]>,
}

/// `[[captures]]`: a rule that says which records are which exposures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureRule {
    /// What was captured. A table may give it row by row.
    pub role: Option<Role>,
    /// Pattern of the files (see [`super::pattern`]).
    pub files: Option<String>,
    /// Table with one row per record (see [`super::captures_table`]), instead of `files`.
    pub table: Option<PathBuf>,
    /// Sensor, where neither pattern nor table give it; absent: the only one.
    pub sensor: Option<String>,
    /// Channel, where a file holds several.
    pub channel: Option<String>,
    /// Lit patch, for all files of the rule.
    pub lit: Option<PatchId>,
    /// Seen patch, for all files of the rule.
    pub seen: Option<PatchId>,
    /// Shot, for all files of the rule.
    pub shot: Option<u32>,
    /// Vertical range, for all files of the rule.
    pub range: Option<String>,
    /// The pulse that marks time zero of each shot; absent: the trigger.
    pub reference: Option<Reference>,
    /// What the segments of a file (or the leading axes of an array) count.
    #[serde(default = "shots", deserialize_with = "one_or_more::axes")]
    pub segments: Vec<Axis>,
    /// Shots that the oscilloscope averaged into each record.
    pub averaged_shots: Option<u32>,
    /// Optical density of the attenuator in the beam.
    pub attenuation_od: Option<f64>,
    /// Mean power of the laser.
    pub power_w: Option<f64>,
    /// Known path from source to sensor. A latency can be calibrated only from responses that have it.
    pub path_m: Option<f64>,
    /// Standard deviation of the known path.
    pub path_sd_m: Option<f64>,
    /// Bounces of the known path, for roles response and fiducial.
    pub bounces: Option<u32>,
    /// Time between samples.
    pub dt_ps: Option<f64>,
    /// Nominal sampling rate of the instrument: its inverse replaces a step that the file has rounded.
    pub nominal_rate_hz: Option<f64>,
    /// Volts per code.
    pub gain_v: Option<f64>,
    /// Volts at code 0.
    pub offset_v: Option<f64>,
    /// Time of sample 0.
    pub t0_ps: Option<f64>,
    /// The samples to use: from the first number up to, but without, the second.
    pub samples: Option<[u64; 2]>,
    /// Unit of values in a text whose heading names none.
    pub unit: Option<String>,
    /// Unit of times in a text whose heading names none.
    pub time_unit: Option<String>,
    /// The array with the samples, by its name or its path, in a file that holds several.
    pub variable: Option<String>,
    /// A name for each axis of that array: `time`, and what the others count, in place of `segments`.
    pub axes: Option<Vec<String>>,
    /// Width of the bins into which photon events are counted.
    pub bin_ps: Option<f64>,
    /// The marker at each of whose events a new histogram begins.
    pub marker: Option<u32>,
    /// Pixels of a line, where that marker is the start of the lines of an image.
    pub pixels: Option<u32>,
}

impl CaptureRule {
    /// What segments count: the names in `axes` but `time`, where these are given.
    #[must_use]
    pub fn counted(&self) -> Vec<Axis> {
        let Some(names) = &self.axes else { return self.segments.clone() };
        let named = |name: &String| Axis::ALL.into_iter().find(|axis| axis.name() == name);
        let axes: Vec<Axis> = names.iter().filter_map(named).collect();
        if axes.is_empty() { shots() } else { axes }
    }

    /// The keys that apply to every exposure of the rule.
    #[must_use]
    pub fn record_keys(&self) -> RecordKeys {
        RecordKeys {
            segments: self.counted(),
            averaged_shots: self.averaged_shots,
            attenuation_od: self.attenuation_od,
            power_w: self.power_w,
            path_m: self.path_m,
            path_sd_m: self.path_sd_m,
            bounces: self.bounces,
            dt_ps: self.dt_ps,
            nominal_rate_hz: self.nominal_rate_hz,
            gain_v: self.gain_v,
            offset_v: self.offset_v,
            t0_ps: self.t0_ps,
            samples: self.samples,
            unit: self.unit.clone(),
            time_unit: self.time_unit.clone(),
            variable: self.variable.clone(),
            axes: self.axes.clone(),
            bin_ps: self.bin_ps,
            marker: self.marker,
            pixels: self.pixels,
        }
    }
}

/// What a rule (or a row of its table) says about a record; absent: as in the file. Meanings as in [`CaptureRule`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "documented in CaptureRule")]
pub struct RecordKeys {
    pub segments: Vec<Axis>,
    pub averaged_shots: Option<u32>,
    pub attenuation_od: Option<f64>,
    pub power_w: Option<f64>,
    pub path_m: Option<f64>,
    pub path_sd_m: Option<f64>,
    pub bounces: Option<u32>,
    pub dt_ps: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal_rate_hz: Option<f64>,
    pub gain_v: Option<f64>,
    pub offset_v: Option<f64>,
    pub t0_ps: Option<f64>,
    pub samples: Option<[u64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_unit: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<Vec<String>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bin_ps: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub marker: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixels: Option<u32>,
}

impl RecordKeys {
    /// What they say to the reader of a file.
    #[must_use]
    pub fn description(&self) -> Description {
        let Self { unit, time_unit, variable, axes, bin_ps, marker, pixels, .. } = self.clone();
        Description { unit, time_unit, variable, axes, bin_ps, marker, pixels }
    }
}

/// What was captured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// The scene.
    Scene,
    /// The sensor's impulse response, over a known path.
    Response,
    /// Laser off.
    Dark,
    /// Laser fires, beam blocked.
    Blocked,
    /// One fixed path, repeatedly.
    Fiducial,
}

impl Role {
    /// The name in campaign files and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Response => "response",
            Self::Dark => "dark",
            Self::Blocked => "blocked",
            Self::Fiducial => "fiducial",
        }
    }
}

/// The pulse that marks time zero: a channel of the same file, or files of their own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Channel of the exposure's own file.
    pub channel: Option<String>,
    /// Pattern of the files, with the exposure's placeholders.
    pub files: Option<String>,
}

/// A coordinate of a record: a placeholder in a pattern, a key, a column, or what the segments of a file count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// Patch that the laser lit.
    Lit,
    /// Patch that the sensor saw.
    Seen,
    /// Sensor.
    Sensor,
    /// Number of the exposure within its capture.
    Shot,
    /// Vertical range.
    Range,
    /// Channel of the oscilloscope.
    Channel,
}

impl Axis {
    /// All axes, in order.
    pub const ALL: [Self; 6] = [Self::Lit, Self::Seen, Self::Sensor, Self::Shot, Self::Range, Self::Channel];

    /// The name in campaign files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lit => "lit",
            Self::Seen => "seen",
            Self::Sensor => "sensor",
            Self::Shot => "shot",
            Self::Range => "range",
            Self::Channel => "channel",
        }
    }

    /// Whether its values are whole numbers rather than names.
    #[must_use]
    pub const fn is_number(self) -> bool {
        matches!(self, Self::Lit | Self::Seen | Self::Shot)
    }
}

/// `[[exclude]]`: exposures to omit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exclude {
    /// Which ones: all given keys must match.
    #[serde(rename = "match")]
    pub matches: Match,
    /// Why.
    pub reason: String,
}

/// Which exposures an [`Exclude`] matches. Absent keys match everything.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Match {
    /// What was captured.
    pub role: Option<Role>,
    /// Sensor.
    pub sensor: Option<String>,
    /// Lit patch.
    pub lit: Option<PatchId>,
    /// Seen patch.
    pub seen: Option<PatchId>,
    /// Shot.
    pub shot: Option<u32>,
    /// Vertical range.
    pub range: Option<String>,
    /// Channel.
    pub channel: Option<String>,
    /// Pattern of files, with `*` and `**/` but without placeholders.
    pub file: Option<String>,
}

/// The place of a rule in messages: `[[captures]] number 2`.
#[must_use]
pub fn rule_place(index: usize) -> String {
    format!("[[captures]] number {}", index + 1)
}

/// The place of an exclusion in messages: `[[exclude]] number 1`.
#[must_use]
pub fn exclude_place(index: usize) -> String {
    format!("[[exclude]] number {}", index + 1)
}

fn shots() -> Vec<Axis> {
    vec![Axis::Shot]
}
