//! `periscope inspect`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use periscope::formats;
use periscope::signal::codes::Codes;
use periscope::waveform::Record;
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
    let mut source = formats::open(file)?;
    let records = formats::records(&mut source)?;
    if !as_json {
        let head = records.first().context("holds no waveform")?.head.clone();
        let instrument = head.instrument.as_deref().unwrap_or("unknown instrument");
        writeln!(out, "{}: {}, {instrument}, {} waveforms", file.display(), head.format, records.len())?;
    }
    for record in &records {
        let bytes = record.read(source.file())?;
        let facts = facts(file, record, &bytes);
        if as_json {
            writeln!(out, "{facts}")?;
        } else {
            writeln!(out, "  {}", line(&facts))?;
        }
    }
    Ok(())
}

/// What is in one waveform. Values are volts where the file has a scale, else what is in the file.
fn facts(file: &Path, record: &Record, bytes: &[u8]) -> Value {
    let head = &record.head;
    let values = record.values(bytes);
    let mut sha = Sha256::new();
    for value in &values {
        sha.update((*value as f32).to_le_bytes());
    }
    let sha = sha.finalize().iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
    let ends = 5.min(values.len());
    let codes = Codes::of(head.code_type.name(), bytes).expect("code types have one name everywhere");
    let clipped = head.rails.map(|(low, high)| codes.count_at_or_beyond(low, high));
    json!({
        "file": file.display().to_string(),
        "format": head.format,
        "instrument": head.instrument,
        "channel": head.channel,
        "segment": record.segment,
        "samples": head.samples,
        "dt_s": head.dt_s,
        "t0_s": record.t0_s,
        "unit": head.unit,
        "gain": head.header_gain,
        "offset": head.header_offset,
        "acquired_at": head.acquired_at,
        "clipped": clipped,
        "first": values[..ends],
        "last": values[values.len() - ends..],
        "mean": (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64),
        "min": values.iter().copied().reduce(f64::min),
        "max": values.iter().copied().reduce(f64::max),
        "sha256_f32le": sha,
    })
}

/// The facts that a person looks for first.
fn line(facts: &Value) -> String {
    let text = |key: &str| match &facts[key] {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    format!(
        "channel {:4} segment {:4} {:>8} samples  dt {} s  t0 {} s  {} to {} {}  clipped {}",
        text("channel"),
        text("segment"),
        text("samples"),
        text("dt_s"),
        text("t0_s"),
        text("min"),
        text("max"),
        text("unit"),
        text("clipped"),
    )
}
