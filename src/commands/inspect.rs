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

/// Arguments of `inspect`.
#[derive(Args)]
pub struct Inspect {
    /// Scope files
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// One JSON object a waveform, one a line
    #[arg(long)]
    json: bool,
}

/// The command: a file that cannot be decoded is an error line, and the others go on.
pub fn inspect(args: &Inspect) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    let mut failed = false;
    for file in &args.files {
        if let Err(error) = inspect_file(file, args.json, &mut out) {
            if error
                .downcast_ref::<std::io::Error>()
                .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
            {
                return Err(error);
            }
            eprintln!("error: {}: {error:#}", file.display());
            failed = true;
        }
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn inspect_file(file: &Path, as_json: bool, out: &mut impl Write) -> Result<()> {
    if file.is_dir() {
        bail!("is a folder; name the files in it, such as {}", file.join("*").display());
    }
    let mut source = Source::open(file)?;
    let records = formats::records(&mut source)?;
    if !as_json {
        let head = records.first().context("holds no waveform")?.head.clone();
        let instrument = head.instrument.as_deref().unwrap_or("unknown instrument");
        writeln!(out, "{}: {}, {instrument}, {} waveforms", file.display(), head.format, records.len())?;
    }
    for record in &records {
        let mut seen = Seen::of(record);
        record.visit(source.file(), 0..record.head.samples, &mut |codes| seen.take(record, codes))?;
        let facts = seen.facts(file, record);
        if as_json {
            writeln!(out, "{facts}")?;
        } else {
            writeln!(out, "  {}", line(&facts))?;
        }
    }
    Ok(())
}

/// Values at either end that are shown.
const ENDS: usize = 5;

/// What was seen of a record so far, which may be larger than memory. Values are volts where the file has a scale, else what is in the file.
struct Seen {
    first: Vec<f64>,
    last: VecDeque<f64>,
    sum: f64,
    min: Option<f64>,
    max: Option<f64>,
    clipped: Option<usize>,
    sha: Sha256,
}

impl Seen {
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

/// The facts that a person looks for first.
fn line(facts: &Value) -> String {
    let text = |key: &str| match &facts[key] {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    format!(
        "{} channel {:4} segment {:4} {:>8} samples  dt {} {}  t0 {} s  {} to {} {}  clipped {}",
        text("kind"),
        text("channel"),
        text("segment"),
        text("samples"),
        text("dt_s"),
        if facts["kind"] == Kind::Spectrum.name() { "Hz" } else { "s" },
        text("t0_s") + if facts["t0_nominal"] == true { " (nominal)" } else { "" },
        text("min"),
        text("max"),
        text("unit"),
        text("clipped"),
    )
}
