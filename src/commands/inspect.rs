//! `periscope inspect`.

mod line;
mod plot;
mod summary;

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::formats::{self, Contents, Description, Input, Joined, Source, npy};
use periscope::waveform::Record;
use serde_json::json;

use super::output::{Closed, Format, Output, Rows, Stream, count, note, say};
use super::whole_file;
use line::{TIME, line, missing_units, with_unit};
use plot::Plot;
use summary::Summary;

/// Arguments of `inspect`.
#[derive(Args)]
pub struct Inspect {
    /// Scope files
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Only this channel
    #[arg(long, value_name = "NAME")]
    channel: Option<String>,
    /// Only this segment
    #[arg(long, value_name = "NUMBER")]
    segment: Option<u32>,
    /// Unit of the values of a text whose heading names none
    #[arg(long, value_name = "UNIT")]
    unit: Option<String>,
    /// Unit of its times
    #[arg(long, value_name = "UNIT")]
    time_unit: Option<String>,
    /// Array with the samples, in a file that holds several
    #[arg(long, value_name = "NAME")]
    variable: Option<String>,
    /// Names of its axes, with commas between; `time` counts samples
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    axes: Option<Vec<String>>,
    /// Width of the bins into which photon events are counted
    #[arg(long, value_name = "PS")]
    bin_ps: Option<f64>,
    /// Marker, from 1, at each of whose events a new histogram of photons begins
    #[arg(long, value_name = "NUMBER")]
    marker: Option<u32>,
    /// Pixels of a line, where that marker is the start of the lines of an image
    #[arg(long, value_name = "NUMBER", requires = "marker")]
    pixels: Option<u32>,
    /// Draw each waveform as a small plot
    #[arg(long)]
    plot: bool,
    /// Write the samples of the one waveform, with their times, to a CSV file
    #[arg(long, value_name = "FILE", conflicts_with = "npy")]
    csv: Option<PathBuf>,
    /// Write the samples of the waveforms, all of one length, as an array [waveform, sample] to an .npy file
    #[arg(long, value_name = "FILE")]
    npy: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// What is known of a waveform.
const COLUMNS: [&str; 22] = [
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
    "remarks",
];

/// What a table of many files shows of each.
const FILE_COLUMNS: [&str; 9] =
    ["file", "format", "instrument", "channels", "waveforms", "samples", "dt", "t0", "remarks"];

/// More waveforms than this are summed up by channel.
const LINES: usize = 1000;

/// The command. A file that cannot be decoded gives an error line, and the others continue.
pub fn inspect(args: &Inspect) -> Result<ExitCode> {
    if let Some(file) = args.csv.as_ref().or(args.npy.as_ref()) {
        return export(args, file);
    }
    let format = args.output.format;
    let stdout = || io::stdout().lock();
    let (mut stream, mut table) = match format {
        Format::Table if args.files.len() > 1 && !args.plot => (None, Some(Rows::new(&FILE_COLUMNS))),
        Format::Table => (None, None),
        Format::Json | Format::Csv => (Some(Stream::start(stdout(), format, &COLUMNS)?), None),
    };
    let mut failed = false;
    for file in &args.files {
        let inspected = match (&mut stream, &mut table) {
            (Some(stream), _) => rows_of_waveforms(args, file, stream),
            (None, Some(table)) => row_of_file(args, file, table),
            (None, None) => lines_of_file(args, file),
        };
        if let Err(error) = inspected {
            if error.is::<Closed>() {
                return Err(error);
            }
            note!("error: {}: {error:#}", file.display());
            failed = true;
        }
    }
    stream.map_or(Ok(()), Stream::end)?;
    table.map_or(Ok(()), |table| table.print(Format::Table))?;
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// A file that was opened, with the records that were asked for.
struct Opened {
    source: Source<Joined>,
    records: Vec<Record>,
    remarks: Vec<String>,
}

fn open(args: &Inspect, file: &Path) -> Result<Opened> {
    if file.is_dir() {
        bail!("is a folder; name the files in it, such as {}", file.join("*").display());
    }
    let Inspect { unit, time_unit, variable, axes, bin_ps, marker, pixels, .. } = args;
    let (unit, time_unit, variable, axes) = (unit.clone(), time_unit.clone(), variable.clone(), axes.clone());
    let mut source = Source::open(file)?.described(Description {
        unit,
        time_unit,
        variable,
        axes,
        bin_ps: *bin_ps,
        marker: *marker,
        pixels: *pixels,
    });
    let Contents { mut records, remarks } = formats::contents(&mut source)?;
    let is_asked_for = |record: &Record| {
        args.channel.as_ref().is_none_or(|channel| record.head.channel.as_ref() == Some(channel))
            && args.segment.is_none_or(|segment| record.segment.unwrap_or(0) == segment)
    };
    let channels = channels(&records).into_keys().collect::<Vec<_>>().join(", ");
    records.retain(is_asked_for);
    if records.is_empty() {
        bail!("holds no waveform of that channel and segment; its channels are {channels}");
    }
    let remark = |remark: &formats::Remark| format!("byte {}: {}", remark.byte_offset, remark.problem);
    Ok(Opened { source, records, remarks: remarks.iter().map(remark).collect() })
}

/// Channels with the number of their waveforms.
fn channels(records: &[Record]) -> BTreeMap<&str, usize> {
    let mut channels = BTreeMap::new();
    for record in records {
        *channels.entry(record.head.channel.as_deref().unwrap_or("-")).or_insert(0) += 1;
    }
    channels
}

/// A row for each waveform.
fn rows_of_waveforms<W: Write>(args: &Inspect, file: &Path, stream: &mut Stream<'_, W>) -> Result<()> {
    let Opened { mut source, records, remarks } = open(args, file)?;
    for record in &records {
        let mut summary = Summary::of(record);
        record.visit(source.file(), 0..record.head.samples, &mut |codes| summary.take(record, codes))?;
        let facts = summary.facts(file, record, &remarks);
        stream.row(&COLUMNS.map(|column| facts[column].clone()))?;
    }
    Ok(())
}

/// A row for the file. It reads no samples but those that are text.
fn row_of_file(args: &Inspect, file: &Path, table: &mut Rows) -> Result<()> {
    let Opened { records, remarks, .. } = open(args, file)?;
    let head = &records[0].head;
    let time = |time_s: Option<f64>| time_s.map(|time_s| with_unit(time_s, &TIME));
    let samples = records.iter().map(|record| record.head.samples);
    let samples = match (samples.clone().min(), samples.max()) {
        (Some(least), Some(most)) if least < most => json!(format!("{least} to {most}")),
        (least, _) => json!(least),
    };
    let names: Vec<&str> = channels(&records).into_keys().collect();
    table.push([
        json!(file.display().to_string()),
        json!(head.format),
        json!(head.instrument),
        json!(names.join(", ")),
        json!(records.len()),
        samples,
        json!(time(head.dt_s)),
        json!(time(records[0].t0_s)),
        json!(remarks.join("; ")),
    ]);
    Ok(())
}

/// A line for each waveform, or, of very many, for each channel.
fn lines_of_file(args: &Inspect, file: &Path) -> Result<()> {
    let Opened { mut source, records, remarks } = open(args, file)?;
    let head = &records[0].head;
    let instrument = head.instrument.as_deref().unwrap_or("unknown instrument");
    let waveforms = count(records.len(), "waveform", "waveforms");
    say!("{}: {}, {instrument}, {waveforms}", file.display(), head.format)?;
    for remark in &remarks {
        say!("  remark: {remark}")?;
    }
    if let Some(keys) = missing_units(&records) {
        say!("  {keys}")?;
    }
    if records.len() > LINES {
        return lines_of_channels(&mut source, &records);
    }
    for record in &records {
        let (mut summary, mut plot) = (Summary::of(record), Plot::of(record.head.samples));
        record.visit(source.file(), 0..record.head.samples, &mut |codes| {
            summary.take(record, codes);
            if args.plot {
                plot.take(&record.values(codes));
            }
        })?;
        say!("  {}", line(&summary.facts(file, record, &remarks)))?;
        if args.plot {
            plot.rows().iter().try_for_each(|row| say!("  |{row}|"))?;
        }
    }
    Ok(())
}

/// What the waveforms of a channel are together.
#[derive(Default)]
struct Together {
    waveforms: usize,
    sum: f64,
    extremes: Option<(f64, f64)>,
}

fn lines_of_channels(source: &mut Source<Joined>, records: &[Record]) -> Result<()> {
    let mut together: BTreeMap<&str, (&Record, Together)> = BTreeMap::new();
    for record in records {
        let name = record.head.channel.as_deref().unwrap_or("-");
        let (_, channel) = together.entry(name).or_insert((record, Together::default()));
        channel.waveforms += 1;
        record.visit(source.file(), 0..record.head.samples, &mut |codes| {
            for value in record.values(codes) {
                let (low, high) = channel.extremes.unwrap_or((value, value));
                (channel.sum, channel.extremes) = (channel.sum + value, Some((low.min(value), high.max(value))));
            }
        })?;
    }
    for (name, (record, Together { waveforms, sum, extremes })) in together {
        let head = &record.head;
        let axes = head.shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
        let shape = if axes.is_empty() { String::new() } else { format!(" ({axes})") };
        let time = |time_s: Option<f64>| time_s.map_or("-".to_owned(), |time_s| with_unit(time_s, &TIME));
        let (low, high) = extremes.unwrap_or_default();
        say!(
            "  {} channel {name}: {waveforms} waveforms{shape} of {} samples  dt {}  t0 {}  {low} to {high} {}  sum {sum}",
            head.kind.name(),
            head.samples,
            time(head.dt_s),
            time(record.t0_s),
            head.unit.as_deref().unwrap_or("(no unit)"),
        )?;
    }
    say!("  One line each: --format csv. One of them: --channel NAME --segment NUMBER.")
}

/// Writes samples to a file.
fn export(args: &Inspect, to: &Path) -> Result<ExitCode> {
    let [file] = args.files.as_slice() else { bail!("name one file whose samples are to be written") };
    let Opened { mut source, records, remarks } = open(args, file).with_context(|| file.display().to_string())?;
    remarks.iter().for_each(|remark| note!("{}: {remark}", file.display()));
    let samples = records[0].head.samples;
    if records.iter().any(|record| record.head.samples != samples) {
        bail!("{}: its waveforms have different lengths; choose one with --channel and --segment", file.display());
    }
    if args.csv.is_some() && records.len() > 1 {
        let channels = channels(&records).into_keys().collect::<Vec<_>>().join(", ");
        bail!(
            "{}: has {} waveforms; choose one with --channel ({channels}) and --segment, or write --npy",
            file.display(),
            records.len()
        );
    }
    whole_file::write(to, |out| {
        let written = if args.csv.is_some() {
            write_csv(out, &mut source, &records[0])
        } else {
            write_npy(out, &mut source, &records)
        };
        written.map_err(io::Error::other)
    })?;
    Ok(ExitCode::SUCCESS)
}

/// An array [waveform, sample].
fn write_npy(out: &mut impl Write, source: &mut Source<Joined>, records: &[Record]) -> Result<()> {
    npy::write_head::<f64>(out, &[records.len() as u64, records[0].head.samples as u64])?;
    for record in records {
        source.values(record)?.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
    }
    Ok(())
}

/// Times and values; numbers of samples where the file has no time base. What has no unit is headed `value`.
fn write_csv(out: &mut impl Write, source: &mut Source<Joined>, record: &Record) -> Result<()> {
    let is_timed = record.time_s(0).is_some();
    let unit = record.head.unit.as_deref().map_or(String::new(), |unit| format!(" ({unit})"));
    writeln!(out, "{},value{unit}", if is_timed { "time (s)" } else { "sample" })?;
    for (sample, value) in source.values(record)?.into_iter().enumerate() {
        match record.time_s(sample) {
            Some(time_s) => writeln!(out, "{time_s:e},{value}")?,
            None => writeln!(out, "{sample},{value}")?,
        }
    }
    Ok(())
}
