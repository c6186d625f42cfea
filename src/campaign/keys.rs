//! The keys of `campaign.toml`, one struct a heading: a contract with the people who write these files.
//!
//! Right-handed frame, metres, picoseconds, radians; in flatland (`dimensions = 2`) z = 0. Every struct refuses unknown keys. The values
//! serialize, so that the parts of a campaign that a stage reads can enter its lineage; the folder itself never does.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::units::PatchId;

/// Name of the station where the light leaves.
pub const LASER: &str = "laser";

/// A campaign: what was set up, and which files hold which exposures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Campaign {
    /// The campaign folder. Not serialized: where a campaign lies must not change what follows from it.
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
    /// Mean size of a part, the piece in which work is done and kept, in bytes of raw files.
    pub part_bytes: u64,
    /// Where light leaves and arrives; holds at least [`LASER`].
    pub stations: BTreeMap<String, Station>,
    /// The detectors.
    pub sensors: BTreeMap<String, Sensor>,
    /// What is known of the patches beforehand.
    pub patches: BTreeMap<PatchId, Patch>,
    /// Numbers in `lit` and `seen` that stand for other footprints than the patch of that number.
    pub views: BTreeMap<PatchId, View>,
    /// What is known of the hidden patches.
    pub hidden: Hidden,
    /// Which records are which exposures.
    pub captures: Vec<CaptureRule>,
    /// What to leave out, and why.
    pub exclude: Vec<Exclude>,
    /// Raw files that changed later are still being written, and wait. Not a key: set by who follows a capture that is under way.
    #[serde(skip)]
    pub as_of: Option<SystemTime>,
}

impl Campaign {
    /// The station where the light leaves.
    #[must_use]
    pub fn source(&self) -> &Station {
        &self.stations[LASER]
    }

    /// The station of a sensor: a sensor that names none coincides with the laser. `None` if there is no such sensor.
    #[must_use]
    pub fn station_of(&self, sensor: &str) -> Option<&Station> {
        let station = self.sensors.get(sensor)?.station.as_deref();
        self.stations.get(station.unwrap_or(LASER))
    }

    /// A file's path on this machine from its path in the campaign.
    #[must_use]
    pub fn path_of(&self, file: &Path) -> PathBuf {
        self.root.join(file)
    }
}

/// `[stations.NAME]`: a point where light leaves or arrives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Station {
    /// Where it is.
    pub position_m: [f64; 3],
    /// Standard deviation of each coordinate; absent: exact (it defines the frame).
    pub sd_m: Option<f64>,
}

/// The stations of a campaign that names none: everything at the origin (`p0` of the paper).
#[must_use]
pub fn one_station() -> BTreeMap<String, Station> {
    let origin = Station { position_m: [0.0; 3], sd_m: None };
    BTreeMap::from([(LASER.to_owned(), origin)])
}

/// `[sensors.NAME]`: a detector.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Where it is; absent: it coincides with the laser.
    pub station: Option<String>,
    /// What its records are.
    #[serde(default)]
    pub kind: SensorKind,
    /// Laser pulses behind each histogram (kind counts).
    pub cycles: Option<u64>,
    /// Time for which a detection blinds the sensor (kind counts).
    pub dead_time_ps: Option<f64>,
    /// Prior of the delay between light and record.
    pub latency_ps: Option<f64>,
    /// Standard deviation of that prior.
    pub latency_sd_ps: Option<f64>,
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

/// `[patches.N]`: what is known of a patch beforehand.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Whether laser and sensor reach it directly.
    #[serde(default)]
    pub role: PatchRole,
    /// For people.
    pub label: Option<String>,
    /// Where it is: an anchor.
    pub position_m: Option<[f64; 3]>,
    /// Standard deviation of each coordinate of the anchor; absent: exact.
    pub sd_m: Option<f64>,
    /// Unit vector towards the lit side.
    pub normal: Option<[f64; 3]>,
    /// Diameter.
    pub size_m: Option<f64>,
    /// It is glossy: standard deviation of the angle about the mirror direction into which it reflects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lobe_rad: Option<f64>,
    /// Of a hidden patch: the visible one over which its light reaches the sensor, where a view covers several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub through: Option<PatchId>,
    /// The line on which it lies, from the angles of a galvo or a pixel.
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
    /// As campaign.toml and the table `patches` have it.
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

/// `[views.N]`: a pixel or a spot of another footprint than patch N.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// The patches that it covers.
    pub patches: Vec<PatchId>,
}

/// `[hidden]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hidden {
    /// Number of hidden patches; estimated when absent.
    pub count: Option<u32>,
    /// No two hidden patches are farther apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apart_max_m: Option<f64>,
    /// Direction in which hidden patches follow one another, in the order of their numbers.
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
    /// Table with one row a record (see [`super::captures_table`]), instead of `files`.
    pub table: Option<PathBuf>,
    /// Sensor, where neither pattern nor table say it; absent: the only one.
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
    /// What the segments of a file (or the leading axes of an array) are.
    #[serde(default = "shots", deserialize_with = "axes")]
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
    /// Sampling rate that the instrument is known to have: its inverse replaces a step that the file rounded.
    pub nominal_rate_hz: Option<f64>,
    /// Volts per code.
    pub gain_v: Option<f64>,
    /// Volts at code 0.
    pub offset_v: Option<f64>,
    /// Time of sample 0.
    pub t0_ps: Option<f64>,
    /// The samples that count: from the first, up to but without the second.
    pub samples: Option<[u64; 2]>,
}

impl CaptureRule {
    /// The keys that go on to every exposure of the rule.
    #[must_use]
    pub fn record_keys(&self) -> RecordKeys {
        RecordKeys {
            segments: self.segments.clone(),
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
        }
    }
}

/// What a rule (or a row of its table) says of a record; absent: as the file has it. Meanings as in [`CaptureRule`].
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
    /// Laser fires, beam stopped.
    Blocked,
    /// One fixed path, again and again.
    Fiducial,
}

impl Role {
    /// The word for it in campaign files and tables.
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

/// A coordinate of a record: as placeholder in a pattern, as key, as column, or as what the segments of a file count.
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
    /// All of them, in order.
    pub const ALL: [Self; 6] = [Self::Lit, Self::Seen, Self::Sensor, Self::Shot, Self::Range, Self::Channel];

    /// The word for it in campaign files.
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

/// `[[exclude]]`: exposures to leave out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exclude {
    /// Which: all keys given must hold.
    #[serde(rename = "match")]
    pub matches: Match,
    /// Why.
    pub reason: String,
}

/// Which exposures an [`Exclude`] means. Absent keys hold for all.
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

/// One axis (`"shot"`) or a list of them (`["lit", "seen", "shot"]`).
fn axes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Axis>, D::Error> {
    struct OneOrMore;

    impl<'de> Visitor<'de> for OneOrMore {
        type Value = Vec<Axis>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an axis such as \"shot\", or a list such as [\"lit\", \"seen\", \"shot\"]")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<Vec<Axis>, E> {
            let name = de::value::StrDeserializer::<E>::new(text);
            Ok(vec![Axis::deserialize(name)?])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<Axis>, A::Error> {
            let mut axes = Vec::new();
            while let Some(axis) = items.next_element()? {
                axes.push(axis);
            }
            Ok(axes)
        }
    }

    deserializer.deserialize_any(OneOrMore)
}
