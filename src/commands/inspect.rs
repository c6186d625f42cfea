//! `periscope inspect`.

use std::collections::VecDeque;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::formats::{self, Input, Source};
use periscope::signal::codes::Codes;
use periscope::waveform::{Kind, Record};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::output::{Closed, Format, Output, Stream, note, say};

/// Arguments of `inspect`.
#[derive(Args)]
pub struct Inspect {
    /// Scope files
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// What is known of a waveform.
const COLUMNS: [&str; 21] = [
    "file",
    "format",
    "kind",
    "instrument",
    "channel",
    "segment",
    "samples",
    "dt_s",
    "t0_s",
    "t0_nominal",
    "unit",
    "gain",
    "offset",
    "acquired_at",
    "clipped",
    "first",
    "last",
    "mean",
    "min",
    "max",
    "sha256_f32le",
];

/// The command. A file that cannot be decoded gives an error line, and the others continue.
pub fn inspect(args: &Inspect) -> Result<ExitCode> {
    let format = args.output.format;
    let stdout = || std::io::stdout().lock();
    let mut stream = match format {
        Format::Table => None,
        Format::Json | Format::Csv => Some(Stream::start(stdout(), format, &COLUMNS)?),
    };
    let mut failed = false;
    for file in &args.files {
        if let Err(error) = inspect_file(file, stream.as_mut()) {
            if error.is::<Closed>() {
                return Err(error);
            }
            note!("error: {}: {error:#}", file.display());
            failed = true;
        }
    }
    stream.map_or(Ok(()), Stream::end)?;
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn inspect_file<W: Write>(file: &Path, mut stream: Option<&mut Stream<W>>) -> Result<()> {
    if file.is_dir() {
        bail!("is a folder; name the files in it, such as {}", file.join("*").display());
    }
    let mut source = Source::open(file)?;
    let records = formats::records(&mut source)?;
    if stream.is_none() {
        let head = records.first().context("holds no waveform")?.head.clone();
        let instrument = head.instrument.as_deref().unwrap_or("unknown instrument");
        say!("{}: {}, {instrument}, {} waveforms", file.display(), head.format, records.len())?;
    }
    for record in &records {
        let mut summary = Summary::of(record);
        record.visit(source.file(), 0..record.head.samples, &mut |codes| summary.take(record, codes))?;
        let facts = summary.facts(file, record);
        match &mut stream {
            Some(stream) => stream.row(&COLUMNS.map(|column| facts[column].clone()))?,
            None => say!("  {}", line(&facts))?,
        }
    }
    Ok(())
}

/// Number of values shown at either end.
const ENDS: usize = 5;

/// Running summary of a record, which may be larger than memory. Values are volts if the file has a scale, else those
/// of the file.
struct Summary {
    first: Vec<f64>,
    last: VecDeque<f64>,
    sum: f64,
    min: Option<f64>,
    max: Option<f64>,
    clipped: Option<usize>,
    sha: Sha256,
}

impl Summary {
    fn of(record: &Record) -> Self {
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

    fn take(&mut self, record: &Record, codes: &[u8]) {
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

    fn facts(self, file: &Path, record: &Record) -> Value {
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
        })
    }
}

/// The most important facts, for people.
fn line(facts: &Value) -> String {
    let text = |key: &str| match &facts[key] {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let with =
        |key: &str, units: &[(&str, f64)]| facts[key].as_f64().map_or("-".to_owned(), |value| with_unit(value, units));
    let step = if facts["kind"] == Kind::Spectrum.name() { &FREQUENCY[..] } else { &TIME };
    let value = |key: &str| match facts["unit"].as_str() {
        Some("V") => with(key, &VOLTAGE),
        unit => format!("{} {}", text(key), unit.unwrap_or_default()).trim_end().to_owned(),
    };
    format!(
        "{} channel {:4} segment {:4} {:>8} samples  dt {}  t0 {}  {} to {}  clipped {}",
        text("kind"),
        text("channel"),
        text("segment"),
        text("samples"),
        with("dt_s", step),
        with("t0_s", &TIME) + if facts["t0_nominal"] == true { " (nominal)" } else { "" },
        value("min"),
        value("max"),
        text("clipped"),
    )
}

const TIME: [(&str, f64); 5] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("ps", 1e-12)];
const FREQUENCY: [(&str, f64); 4] = [("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0)];
const VOLTAGE: [(&str, f64); 3] = [("V", 1.0), ("mV", 1e-3), ("uV", 1e-6)];

/// A value in the largest unit in which it is at least one, else in the smallest, with up to seven digits. JSON and CSV
/// have all digits.
fn with_unit(value: f64, units: &[(&str, f64)]) -> String {
    let is_enough = |(_, one): &&(&str, f64)| value == 0.0 || value.abs() >= (1.0 - 1e-7) * one;
    let (unit, one) = units.iter().find(is_enough).or(units.last()).expect("there are units");
    let seven: f64 = format!("{:.6e}", value / one).parse().expect("a number as it is printed");
    format!("{seven} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_shown_in_the_unit_that_fits() {
        let time = |value| with_unit(value, &TIME);
        assert_eq!(time(50e-12), "50 ps");
        assert_eq!(time(1e-9 * (1.0 + 2e-8)), "1 ns");
        assert_eq!(time(1e-12 * (1.0 - 4e-9)), "1 ps");
        assert_eq!(time(-2.007_329_1e-6), "-2.007329 us");
        assert_eq!(time(0.0), "0 s");
        assert_eq!(time(1.5e-14), "0.015 ps");
        assert_eq!(with_unit(2.5e6, &FREQUENCY), "2.5 MHz");
        assert_eq!(with_unit(-0.0125, &VOLTAGE), "-12.5 mV");
    }
}
