//! What a check found, as data: its fields are those of the JSON.

use serde::Serialize;

/// A whole check.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    pub campaign: String,
    /// What is to be mended, each with its mend; empty when all is well.
    pub mend: Vec<String>,
    /// Captures that the rules found, by role and sensor.
    pub captures: Vec<Captures>,
    /// Files that no rule takes.
    pub unmatched: Vec<String>,
    /// Patterns, rows and exclusions that take nothing.
    pub empty: Vec<String>,
    /// Files left out since their reference is missing, and what was wanted.
    pub missing_references: Vec<String>,
    /// Files and captures that were set aside, and why.
    pub set_aside: Vec<SetAside>,
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

/// A file or capture that was set aside.
#[derive(Debug, Serialize)]
pub struct SetAside {
    pub file: Option<String>,
    pub reason: String,
}

/// A patch that is lit and one that is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Pair {
    pub lit: i32,
    pub seen: i32,
}

/// What is known of one sensor.
#[derive(Debug, Default, Serialize)]
pub struct Sensor {
    pub name: String,
    /// Pairs that are absent from the rectangle of all lit and all seen patches so far.
    pub missing_pairs: Vec<Pair>,
    /// Pairs whose reciprocal is there and they are not, outside of that rectangle.
    pub missing_reciprocals: Vec<Pair>,
    /// Share of the shots that touch the converter's rails.
    pub clipped_share: Option<f64>,
    /// Least, middle and most shots of a capture of the scene.
    pub shots: Option<[i32; 3]>,
    /// Captures of the scene with fewer shots than the most.
    pub fewer_shots: Vec<(Pair, i32)>,
    /// Middle signal-to-noise ratio of the captures of the scene.
    pub snr_median: Option<f64>,
    /// The five faintest captures of the scene.
    pub faintest: Vec<(Pair, f64)>,
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
