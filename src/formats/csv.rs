//! Plain CSV: a column of times in seconds and one of volts (or volts alone), with or without one line of names.
//!
//! Fields are separated by comma, semicolon, tab or spaces. Times must be evenly spaced: dt is (last - first) / (n - 1), since printed times are
//! rounded. The dialects of vendors, with heads of their own, are not this format, and are refused with the line that says so.

use std::io::{self, BufRead, BufReader, Write};
use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record, Scale};

/// A time may lie this part of a step off its even place: rounding in print stays far below, a lost line does not.
const UNEVEN: f64 = 0.25;

/// The reader.
pub struct Csv;

impl Reader for Csv {
    fn format(&self) -> &'static str {
        "csv"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["csv", "txt", "tsv", "dat"]
    }
    fn recognises(&self, _: &[u8]) -> bool {
        false
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let Columns { first_line, times_s, values } = columns(&mut BufReader::new(input.stream()?))?;
        let (dt_s, t0_s) = match &times_s {
            Some(times_s) => {
                let (dt_s, t0_s) = time_base(first_line, times_s)?;
                (Some(dt_s), Some(t0_s))
            }
            None => (None, None),
        };
        Ok(vec![decoded(self.format(), &values, dt_s, t0_s, None, None)])
    }
}

/// A record of decoded values in volts.
pub(super) fn decoded(
    format: &'static str,
    values: &[f64],
    dt_s: Option<f64>,
    t0_s: Option<f64>,
    channel: Option<String>,
    acquired_at: Option<String>,
) -> Record {
    let head = Head {
        format,
        instrument: None,
        channel,
        unit: Some("V".to_owned()),
        code_type: CodeType::F64,
        samples: values.len(),
        dt_s,
        scale: Some(Scale { gain: 1.0, offset: 0.0 }),
        header_gain: None,
        header_offset: None,
        rails: None,
        acquired_at,
        shape: Vec::new(),
    };
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload: Payload::Decoded(bytes.into()) }
}

fn refuse(line: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Line { line, problem: problem.into() }
}

/// What the lines hold.
struct Columns {
    /// Line of the first numbers.
    first_line: u64,
    /// Times, if there is a column of them.
    times_s: Option<Vec<f64>>,
    values: Vec<f64>,
}

fn columns(text: &mut impl BufRead) -> Result<Columns, FormatError> {
    let (mut times_s, mut values, mut count) = (Vec::new(), Vec::new(), None);
    let mut line = Vec::new();
    let mut number = 0;
    let (mut blank, mut first_line) = (None, 1);
    loop {
        line.clear();
        if text.read_until(b'\n', &mut line)? == 0 {
            break;
        }
        number += 1;
        let line = std::str::from_utf8(&line).map_err(|_| refuse(number, "is no text: this is no CSV"))?;
        let fields = fields(line);
        if fields.iter().all(|field| field.is_empty()) {
            blank = blank.or(Some(number));
            continue;
        }
        if let Some(blank) = blank {
            return Err(refuse(blank, "is blank, but lines follow: one waveform a file"));
        }
        let numbers: Option<Vec<f64>> =
            fields.iter().map(|field| field.parse().ok().filter(|number: &f64| number.is_finite())).collect();
        let Some(numbers) = numbers else {
            if number == 1 && fields[0].parse::<f64>().is_err() {
                first_line = 2; // One line of names.
                continue;
            }
            return Err(refuse(
                number,
                format!(
                    "{:?} is no row of numbers; a plain CSV has one line of names at most, then times and volts",
                    line.trim_end()
                ),
            ));
        };
        let columns = *count.get_or_insert(numbers.len());
        match numbers[..] {
            _ if numbers.len() != columns => {
                return Err(refuse(number, format!("has {} fields, those before have {columns}", numbers.len())));
            }
            [value] => values.push(value),
            [time_s, value] => {
                times_s.push(time_s);
                values.push(value);
            }
            _ => {
                return Err(refuse(
                    number,
                    format!("has {columns} columns; a plain CSV has times and volts of one channel: split it"),
                ));
            }
        }
    }
    if values.is_empty() {
        return Err(refuse(number.max(1), "no line of numbers follows"));
    }
    Ok(Columns { first_line, times_s: (!times_s.is_empty()).then_some(times_s), values })
}

/// Fields of a line, without a byte order mark; blank cells at its end do not count.
fn fields(line: &str) -> Vec<&str> {
    let line = line.trim_start_matches('\u{feff}').trim();
    let separator = [',', ';', '\t'].into_iter().find(|separator| line.contains(*separator));
    let mut fields: Vec<&str> = match separator {
        Some(separator) => line.split(separator).map(str::trim).collect(),
        None => line.split_whitespace().collect(),
    };
    while fields.len() > 1 && fields.last().is_some_and(|field| field.is_empty()) {
        fields.pop();
    }
    fields
}

/// Step and start of evenly spaced times.
fn time_base(first_line: u64, times_s: &[f64]) -> Result<(f64, f64), FormatError> {
    let (first, last) = (times_s[0], times_s[times_s.len() - 1]);
    if times_s.len() < 2 {
        return Err(refuse(first_line, "a single time gives no step"));
    }
    let dt_s = (last - first) / (times_s.len() - 1) as f64;
    if !(dt_s > 0.0 && dt_s.is_finite()) {
        return Err(refuse(first_line, "times do not increase"));
    }
    let uneven =
        times_s.iter().enumerate().position(|(i, time_s)| (time_s - (first + i as f64 * dt_s)).abs() > UNEVEN * dt_s);
    match uneven {
        Some(row) => Err(refuse(
            first_line + row as u64,
            format!(
                "time {} s is off the even step of {dt_s} s; export the trace again with all its points",
                times_s[row]
            ),
        )),
        None => Ok((dt_s, first)),
    }
}

/// Writes times and values, with a line of names.
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
