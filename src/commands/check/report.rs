//! The results of a check as data; the fields are those of the JSON.

use serde::Serialize;

/// A whole check.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    pub campaign: String,
    /// What needs to be fixed, each with how; empty if all is well.
    pub fix: Vec<String>,
    /// Captures that match the rules, by role and sensor.
    pub captures: Vec<Captures>,
    /// Files that match no rule.
    pub unmatched: Vec<String>,
    /// Patterns, rows and exclusions that match nothing.
    pub empty: Vec<String>,
    /// Files without their reference, and which reference is missing.
    pub missing_references: Vec<String>,
    /// Rejected files and captures, and why.
    pub rejected: Vec<Rejected>,
    pub sensors: Vec<Sensor>,
}

/// Captures of one role and sensor.
#[derive(Debug, Serialize)]
pub struct Captures {
    pub role: String,
    pub sensor: String,
    /// Captures of the scene, or runs.
    pub count: usize,
    pub files: usize,
}

/// A rejected file or capture.
#[derive(Debug, Serialize)]
pub struct Rejected {
    pub file: Option<String>,
    pub reason: String,
}

/// A lit patch and a seen patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Pair {
    pub lit: i32,
    pub seen: i32,
}

/// The results for one sensor.
#[derive(Debug, Default, Serialize)]
pub struct Sensor {
    pub name: String,
    /// Pairs that are missing in the rectangle of all lit and all seen patches so far.
    pub missing_pairs: Vec<Pair>,
    /// Missing pairs outside that rectangle whose reciprocal exists.
    pub missing_reciprocals: Vec<Pair>,
    /// Share of the shots that touch the converter's rails.
    pub clipped_share: Option<f64>,
    /// Least, median and most shots of a capture of the scene.
    pub shots: Option<[i32; 3]>,
    /// Captures of the scene with fewer shots than the largest number.
    pub fewer_shots: Vec<(Pair, i32)>,
    /// Median signal-to-noise ratio of the captures of the scene.
    pub snr_median: Option<f64>,
    /// The five faintest captures of the scene.
    pub faintest: Vec<(Pair, f64)>,
    /// Of a lidar, its echoes.
    pub echoes: Option<usize>,
    /// Pulses of a lidar that have some.
    pub pulses_with_echoes: Option<usize>,
    /// Median standard deviation of the ranges of echoes.
    pub range_sd_m: Option<f64>,
    /// Share of the echoes that touch the converter's rail.
    pub clipped_echoes: Option<f64>,
    /// Verdicts of the instrument check.
    pub checks: Vec<CheckOfSensor>,
}

/// A row of the table `checks`.
#[derive(Debug, Serialize)]
pub struct CheckOfSensor {
    pub check: String,
    pub verdict: String,
    pub value: Option<f64>,
    pub sd: Option<f64>,
    pub expected: Option<f64>,
    pub tolerance: Option<f64>,
    pub unit: String,
    pub cause: String,
}

impl Report {
    /// The entry of a sensor.
    pub fn sensor(&mut self, name: &str) -> &mut Sensor {
        let place = self.sensors.iter().position(|sensor| sensor.name == name).unwrap_or_else(|| {
            self.sensors.push(Sensor { name: name.to_owned(), ..Sensor::default() });
            self.sensors.len() - 1
        });
        &mut self.sensors[place]
    }
}

/// Pairs as text, the first few of them.
pub fn listed(pairs: &[Pair]) -> String {
    const SHOWN: usize = 8;
    let mut texts: Vec<String> =
        pairs.iter().take(SHOWN).map(|Pair { lit, seen }| format!("({lit}, {seen})")).collect();
    if pairs.len() > SHOWN {
        texts.push("...".to_owned());
    }
    texts.join(" ")
}
