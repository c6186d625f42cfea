//! `[[captures]]` and `[[exclude]]`: which records are which exposures, and which of them to omit.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::one_or_more;
use crate::formats::Description;
use crate::units::PatchId;

/// `[[captures]]`: a rule that says which records are which exposures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureRule {
    /// What was captured. A table may give it row by row.
    pub role: Option<Role>,
    /// Pattern of the files (see [`crate::campaign::pattern`]).
    pub files: Option<String>,
    /// Table with one row per record (see [`crate::campaign::captures_table`]), instead of `files`.
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
