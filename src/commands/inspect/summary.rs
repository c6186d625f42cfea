//! What is known of a record: its head, and a summary of its samples.

use std::collections::VecDeque;
use std::path::Path;

use periscope::signal::codes::Codes;
use periscope::waveform::Record;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// Number of values shown at either end.
const ENDS: usize = 5;

/// Running summary of a record, which may be larger than memory. Values are volts if the file has a scale, else those
/// of the file.
pub struct Summary {
    first: Vec<f64>,
    last: VecDeque<f64>,
    sum: f64,
    min: Option<f64>,
    max: Option<f64>,
    clipped: Option<usize>,
    sha: Sha256,
}

impl Summary {
    pub fn of(record: &Record) -> Self {
        Self {
            first: Vec::new(),
            last: VecDeque::new(),
            sum: 0.0,
            min: None,
            max: None,
            clipped: record.head.rails.map(|_| 0),
            sha: Sha256::new(),
        }
    }

    pub fn take(&mut self, record: &Record, codes: &[u8]) {
        let values = record.values(codes);
        let floats: Vec<u8> = values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect();
        self.sha.update(&floats);
        self.first.extend(&values[..values.len().min(ENDS - self.first.len())]);
        self.last.extend(&values[values.len().saturating_sub(ENDS)..]);
        self.last.drain(..self.last.len().saturating_sub(ENDS));
        self.sum = values.iter().fold(self.sum, |sum, value| sum + value);
        self.min = values.iter().copied().chain(self.min).reduce(f64::min);
        self.max = values.iter().copied().chain(self.max).reduce(f64::max);
        if let (Some(clipped), Some((low, high))) = (&mut self.clipped, record.head.rails) {
            let codes = Codes::of(record.head.code_type.name(), codes).expect("code types have one name everywhere");
            *clipped += codes.count_at_or_beyond(low, high);
        }
    }

    pub fn facts(self, file: &Path, record: &Record, remarks: &[String]) -> Value {
        let head = &record.head;
        let sha = self.sha.finalize().iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
        json!({
            "file": file.display().to_string(),
            "format": head.format,
            "kind": head.kind.name(),
            "instrument": head.instrument,
            "channel": head.channel,
            "segment": record.segment,
            "samples": head.samples,
            "dt_s": head.dt_s,
            "t0_s": record.t0_s,
            "t0_nominal": head.t0_nominal,
            "unit": head.unit,
            "gain": head.header_gain,
            "offset": head.header_offset,
            "acquired_at": head.acquired_at,
            "clipped": self.clipped,
            "first": self.first,
            "last": self.last,
            "mean": (head.samples > 0).then(|| self.sum / head.samples as f64),
            "min": self.min,
            "max": self.max,
            "sha256_f32le": sha,
            "remarks": remarks,
        })
    }
}
