//! Columns of numbers as text, of any scope. The header decides the dialect and the columns; the rows are read alike.
//!
//! | dialect | head | times |
//! |---|---|---|
//! | lecroy-csv | `LECROY...` / `Segments,n,SegmentSize,m` / `Segment,TrigTime,TimeSinceSegment1` / `#1,date,s` / `Time,Ampl` | column |
//! | lecroy-ascii | `"Record Length"`, `"Sample Interval"`, ... in the first columns of the rows | head |
//! | tek-csv | `Sample Interval,4e-11`, `Record Length,...`, ... / `TIME,CH1` | head, checked against the column |
//! | keysight-csv | `x-axis,1,2` / `second,Volt,Volt` | column |
//! | rigol-csv | `X,CH1,Start,Increment,` / `Sequence,Volt,-1e-6,1e-9`; `,CH1` / `Second,Volt` | head; column |
//! | csv | comments (# %), a line of names (`time_ns,ch1`), a line of units (`(us),(V)`), or nothing | column, if there is one |
//!
//! With only a column of times, dt is (last - first) / (rows - 1), since printed times are rounded; uneven times are
//! refused. A first column without a telling name holds times if it increases from row to row. The separator is a
//! comma, a semicolon, a tab or spaces; where it is not a comma, commas may be decimal marks. Units of times and
//! prefixes of units (`Time (ns)`, `ch1_mv`) are applied. Columns of counts (`counts`, `photons`) are histograms of
//! photons. A plain text without units has none: no time base where times have none, no scale where values have none.
//! A caller may give them (`unit`, `time_unit`), where no heading does. The dialects of scopes are in s and V.
//!
//! Not read: two time bases in one file, more than 256 columns, lines of more than 64 KiB, headers of other vendors. A
//! text that is cut between two rows is noticed only if its header gives the number of rows; one that is cut within its
//! last number is never noticed. Tested only on files that the tests build: lecroy-csv, FastFrame and logic channels of
//! tek-csv, decimal commas, units with prefixes.

use std::io::{self, BufReader, Write};
use std::sync::Arc;

use super::description::{Description, Key, Misfit};
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

mod dialects;
mod headless;
mod layout;
mod lecroy;
mod rows;
#[cfg(test)]
mod tests;
mod text;
mod times;
mod units;

use layout::{Layout, Role};
use text::Lines;

/// The reader.
pub struct Csv;

/// Upper limit of the memory that a record takes without its samples, in bytes.
const RECORD_BYTES: u64 = 256;

impl Reader for Csv {
    fn format(&self) -> &'static str {
        "csv"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["csv", "txt", "tsv", "dat"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        dialects::STARTS.iter().any(|start| head.starts_with(start))
    }

    fn keys(&self) -> &'static [Key] {
        &[Key::Unit, Key::TimeUnit]
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let length = input.length();
        let mut layout = dialects::layout(&mut Lines::new(BufReader::new(input.stream()?)), length)?;
        if layout.segments > (4 * length + (1 << 18)) / RECORD_BYTES {
            let problem = format!("{} segments are more than the file can hold; export it again", layout.segments);
            return Err(refuse(1, problem));
        }
        let survey = rows::survey(&mut Lines::new(BufReader::new(input.stream()?)), &layout)?;
        layout.decide(&survey);
        headless::give_units(&mut layout, input.description())?;
        let samples = survey.rows / layout.segments;
        let channels = layout.columns.iter().filter(|column| column.role == Role::Channel).count() as u64;
        let needed = (channels * layout.segments).saturating_mul(RECORD_BYTES + 8 * samples);
        if needed > 4 * length + (1 << 18) {
            let problem = format!(
                "{} segments of {channels} channels are too many for so few rows; export them in several files",
                layout.segments
            );
            return Err(refuse(1, problem));
        }
        let base = times::Base::new(&layout, &survey, samples)?;
        let codes = rows::fill(&mut Lines::new(BufReader::new(input.stream()?)), &layout, &base, samples as usize)?;
        input.uses(0..length);
        Ok(records(&layout, &base, &codes, samples as usize))
    }
}

/// Makes the records, channel by channel. `codes` holds segment after segment, and in each segment channel by channel.
fn records(layout: &Layout, base: &times::Base, codes: &[Arc<[u8]>], samples: usize) -> Vec<Record> {
    let channels: Vec<_> = layout.columns.iter().filter(|column| column.role == Role::Channel).collect();
    let mut records = Vec::with_capacity(codes.len());
    for (index, column) in channels.iter().enumerate() {
        let head = Arc::new(Head {
            kind: if layout.axis.spectrum { Kind::Spectrum } else { column.kind },
            instrument: layout.instrument.clone(),
            channel: column.name.clone(),
            unit: column.unit.name.clone(),
            dt_s: base.dt_s,
            scale: (column.unit.name.is_some() || column.kind == Kind::Digital)
                .then_some(Scale { gain: 1.0, offset: 0.0 }),
            acquired_at: layout.acquired_at.clone(),
            ..Head::new(layout.format, CodeType::F64, samples)
        });
        for (number, codes) in codes.iter().skip(index).step_by(channels.len()).enumerate() {
            records.push(Record {
                head: Arc::clone(&head),
                segment: (layout.segments > 1).then_some(number as u32),
                t0_s: base.t0_s[number],
                trigger_s: layout.triggers_s.get(number).copied(),
                payload: Payload::Decoded(Arc::clone(codes)),
            });
        }
    }
    records
}

/// Checks the units of a description, which a file need not be there for.
///
/// # Errors
/// When one of them is no unit that a heading may have.
pub fn check_units(description: &Description) -> Result<(), Misfit> {
    if let Some(text) = &description.unit {
        units::of_values(text).map_err(|problem| Key::Unit.refuse(problem))?;
    }
    if let Some(text) = &description.time_unit {
        units::of_times(text).map_err(|problem| Key::TimeUnit.refuse(problem))?;
    }
    Ok(())
}

fn refuse(line: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Line { line, problem: problem.into() }
}

/// Shortens a text for a message.
fn clip(text: &str) -> String {
    text.chars().take(80).collect()
}

/// Writes times and values below a line of names.
///
/// # Errors
/// When `out` cannot be written.
pub fn write(out: &mut impl Write, t0_s: f64, dt_s: f64, values_v: &[f64]) -> io::Result<()> {
    writeln!(out, "time_s,voltage_v")?;
    for (i, value_v) in values_v.iter().enumerate() {
        writeln!(out, "{:e},{value_v}", t0_s + i as f64 * dt_s)?;
    }
    Ok(())
}
