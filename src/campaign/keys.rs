//! The keys of `campaign.toml`, one struct per heading. Users write these files, so the keys are a contract.
//!
//! Frame: right-handed; metres, picoseconds, radians; in flatland (`dimensions = 2`) z = 0. Every struct refuses
//! unknown keys. The values can be serialized, so that the fields that a stage reads enter its lineage; the folder
//! itself never does.

mod captures;
mod one_or_more;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use captures::{Axis, CaptureRule, Exclude, Match, RecordKeys, Reference, Role, exclude_place, rule_place};

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
    /// What errors the set-up of a relay wall has.
    pub wall: Wall,
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

/// `[wall]`: standard deviations of errors that all points of a relay wall share; absent: none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Of its points along the wall, over their distance from its middle: both scales, shear and turn, each.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_sd: Option<f64>,
    /// Of its height over its points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relief_sd_m: Option<f64>,
    /// Length over which this height changes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relief_length_m: Option<f64>,
    /// Of the delay of all light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay_sd_ps: Option<f64>,
    /// Of the delay for each factor of e by which light is stronger than in the mean of the wall.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub walk_sd_ps: Option<f64>,
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
