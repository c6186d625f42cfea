//! LeCroy ASCII: tab-separated text whose head stands in the first three columns beside the first rows of data.
//!
//! `"Trigger Time"` is a fraction of a sample although the file calls it seconds: sample 0 lies at -(Trigger Point + Trigger Time) * Sample
//! Interval. The printed times have seven digits only and are not used.

use std::io::{BufRead, BufReader};

use super::csv::decoded;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::Record;

/// The reader.
pub struct LecroyAscii;

impl Reader for LecroyAscii {
    fn format(&self) -> &'static str {
        "lecroy-ascii"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(b"\"Record Length\"\t")
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let text = BufReader::new(input.stream()?);
        let mut values = Vec::new();
        let mut entries: Vec<(String, f64)> = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let refuse = |problem: &str| FormatError::Line { line: number as u64 + 1, problem: problem.to_owned() };
            let line = line.map_err(|_| refuse("is no text"))?;
            if line.trim().is_empty() {
                continue;
            }
            let fields: Vec<&str> = line.trim_end().split('\t').collect();
            let [key, entry, _, _, value] = fields[..] else {
                return Err(refuse("has not the five columns of a LeCroy ASCII file; save the trace again"));
            };
            if !key.trim().is_empty() {
                let entry = entry.trim().parse().map_err(|_| refuse("has a head entry that is no number"))?;
                entries.push((key.trim_matches('"').to_owned(), entry));
            }
            values.push(
                value
                    .trim()
                    .parse::<f64>()
                    .ok()
                    .filter(|value| value.is_finite())
                    .ok_or_else(|| refuse("has a value that is no number"))?,
            );
        }
        let entry = |name: &'static str| {
            let found = entries.iter().find(|(key, _)| key == name).map(|(_, value)| *value);
            found.ok_or_else(|| FormatError::Line { line: 1, problem: format!("the head has no \"{name}\"") })
        };
        let (length, dt_s) = (entry("Record Length")?, entry("Sample Interval")?);
        let (point, fraction) = (entry("Trigger Point")?, entry("Trigger Time")?);
        if length != values.len() as f64 {
            let problem = format!(
                "the head says {length} points, the file has {}; copy it from the instrument again",
                values.len()
            );
            return Err(FormatError::Line { line: 1, problem });
        }
        let t0_s = -(point + fraction) * dt_s;
        if !(dt_s > 0.0 && dt_s.is_finite() && t0_s.is_finite()) {
            return Err(FormatError::Line {
                line: 2,
                problem: format!("a sample interval of {dt_s} s gives no time base"),
            });
        }
        Ok(vec![decoded(self.format(), &values, Some(dt_s), Some(t0_s), None, None)])
    }
}
