//! The dialects with short headers: Tektronix, Keysight, Rigol, plain, and LeCroy's ASCII.

use std::io::BufRead;

use super::super::reader::FormatError;
use super::layout::{Axis, Column, Head, Layout, Role, columns, not_a_row};
use super::text::{Lines, Separator, texts};
use super::units::Unit;
use super::{clip, lecroy, refuse};
use crate::waveform::Kind;

/// Start of LeCroy's ASCII files.
const LECROY_ASCII: &[u8] = b"\"Record Length\"\t";

/// Start of LeCroy's CSV files, before the name of the model.
const LECROY: &[u8] = b"LECROY";

/// First bytes that identify a dialect whatever the extension.
pub(super) const STARTS: [&[u8]; 6] = [LECROY_ASCII, LECROY, b"Model,", b"x-axis,", b"X,CH", b",CH1"];

/// Most header lines of LeCroy's ASCII files; real files have five.
const ASCII_KEYS: usize = 16;

/// Reads the header and the first row of a text of `length` bytes.
pub(super) fn layout(lines: &mut Lines<impl BufRead>, length: u64) -> Result<Layout, FormatError> {
    let first = lines.next()?.unwrap_or_default().to_vec();
    if first.starts_with(LECROY_ASCII) {
        return lecroy_ascii(lines, first);
    }
    if first.starts_with(LECROY) {
        return lecroy::layout(lines, &first, length);
    }
    of_head(&Head::read(lines, first)?)
}

/// The layout of the rows below a header.
fn of_head(head: &Head) -> Result<Layout, FormatError> {
    let has = |key: &str| head.lines.iter().any(|(_, cells)| cells[0] == key);
    if has("Sample Interval") && (has("Model") || has("Waveform Type")) {
        return Tek { head }.layout();
    }
    if let [(line, names), (_, units)] = &head.lines[..] {
        if names.ends_with(&["Start".to_owned(), "Increment".to_owned()]) {
            return rigol_sequence(head, *line, names, units);
        }
        let format = match (&names[0][..], &units[0][..]) {
            ("x-axis", _) => Some("keysight-csv"),
            ("", "Second") => Some("rigol-csv"),
            _ => None,
        };
        if let Some(format) = format {
            let (columns, axis) = columns(Some(names), Some(units), head.count.max(names.len()), *line)?;
            let layout = Layout::new(format, head.separator, head.first_line, columns, axis);
            return Ok(Layout { blank_end: format == "keysight-csv", ..layout });
        }
    }
    plain(head)
}

/// Comments, names and units, each optional. A comment directly above the rows that names all columns is a line of
/// names.
fn plain(head: &Head) -> Result<Layout, FormatError> {
    let comment = |cells: &[String]| cells[0].starts_with(['#', '%']);
    let lines: Vec<_> = head.lines.iter().filter(|(_, cells)| !comment(cells)).collect();
    let (columns, axis) = match lines[..] {
        [] => {
            let mut names = head.lines.last().map(|(_, cells)| cells.clone()).unwrap_or_default();
            if let Some(first) = names.first_mut() {
                *first = first.trim_start_matches(['#', '%', ' ']).to_owned();
            }
            let names = Some(&names[..]).filter(|names| names.len() == head.count);
            columns(names, None, head.count, head.first_line)?
        }
        // A line that starts with a number is a damaged row, not a line of names.
        [(line, names)] if names[0].replace(',', ".").parse::<f64>().is_ok() => {
            return Err(not_a_row(*line, &names.join(" ")));
        }
        [(line, names)] => columns(Some(names), None, head.count, *line)?,
        [(line, names), (_, units)] if units.iter().all(|unit| is_unit(unit)) => {
            columns(Some(names), Some(units), head.count, *line)?
        }
        [_, (line, cells), ..] => return Err(not_a_row(*line, &cells.join(" "))),
    };
    Ok(Layout::new("csv", head.separator, head.first_line, columns, axis).only_given_units())
}

fn is_unit(text: &str) -> bool {
    let bare = text.trim_matches(['(', ')', '[', ']']);
    Unit::parse(bare).is_some() || (bare.len() < text.len() && bare.parse::<f64>().is_err())
}

/// `X,CH1,CH2,Start,Increment` above `Sequence,Volt,Volt,-1e-6,1e-9`: the first column numbers the samples.
fn rigol_sequence(head: &Head, line: u64, names: &[String], units: &[String]) -> Result<Layout, FormatError> {
    let count = names.len() - 2;
    let number = |index: usize, name: &str| {
        let number = units.get(index).and_then(|text| text.parse().ok()).filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| refuse(line + 1, format!("has no number under {name}; export the trace again")))
    };
    let (start_s, increment_s) = (number(count, "Start")?, number(count + 1, "Increment")?);
    if increment_s <= 0.0 {
        return Err(refuse(line + 1, format!("Increment = {increment_s} s is no step; export the trace again")));
    }
    if names[0] != "X" || units[0] != "Sequence" || count != head.count {
        return Err(refuse(line, format!("names {count} columns from X on, but the rows have {}", head.count)));
    }
    let (mut columns, _) = columns(Some(&names[..count]), Some(&units[..count]), count, line)?;
    columns[0].role = Role::Time;
    let (dt_s, t0_s) = (Some(increment_s), Some(start_s));
    let axis = Axis { unit: Unit::plain("s"), spectrum: false, sequence: true, dt_s, t0_s };
    Ok(Layout::new("rigol-csv", head.separator, head.first_line, columns, axis))
}

/// Tektronix: lines of a key and values, above the channels that they describe. Next to the analog channels there may
/// be others, with keys and a column of times of their own.
struct Tek<'a> {
    head: &'a Head,
}

impl Tek<'_> {
    fn layout(&self) -> Result<Layout, FormatError> {
        let (line, names) = self.head.lines.last().expect("a head with keys has lines");
        let mut padded = names.clone();
        padded.resize(self.head.count.max(names.len()), String::new());
        let (mut columns, mut axis) = columns(Some(&padded), None, padded.len(), *line)?;
        let mut group = 0;
        for (index, (column, name)) in columns.iter_mut().zip(&padded).enumerate() {
            match column.role {
                Role::Channel if name.is_empty() => column.role = Role::Skip,
                Role::Channel | Role::Perhaps => self.describe(column, group, index),
                Role::SameTime | Role::Time => group = index,
                Role::Skip => {}
            }
            if column.role == Role::SameTime {
                for key in ["Sample Interval", "Record Length", "Horizontal Units"] {
                    if self.value(key, 0, 1) != self.value(key, index, index + 1) {
                        return Err(refuse(*line, format!("has columns of two {key}s; export them in two files")));
                    }
                }
            }
        }
        if columns[0].role != Role::Time {
            return Err(refuse(*line, "does not name TIME first; export the trace again"));
        }
        match self.value("Horizontal Units", 0, 1).unwrap_or("s") {
            "s" | "S" => {}
            "Hz" => (axis.spectrum, axis.unit) = (true, Unit::plain("Hz")),
            unit => return Err(refuse(*line, format!("Horizontal Units are {}, neither s nor Hz", clip(unit)))),
        }
        let dt_s = self.number("Sample Interval")?.filter(|dt_s| *dt_s > 0.0);
        let Some(dt_s) = dt_s else {
            return Err(refuse(self.line("Sample Interval"), "Sample Interval is no step; export the trace again"));
        };
        let segments = self.count("FastFrame Count")?.unwrap_or(1).max(1);
        axis.dt_s = Some(dt_s);
        // Each frame has a trigger of its own, so that only its column of times gives its origin.
        axis.t0_s = self.number("Zero Index")?.filter(|_| segments == 1).map(|index| -index * dt_s);
        let samples = self.count("Record Length")?.map(|count| (count, "Record Length"));
        if samples.is_some_and(|(count, _)| count == 0) {
            return Err(refuse(self.line("Record Length"), "Record Length = 0; export the trace with its samples"));
        }
        if segments > 1 && samples.is_none() {
            return Err(refuse(self.line("FastFrame Count"), "the head has no Record Length; export the trace again"));
        }
        let layout = Layout::new("tek-csv", self.head.separator, self.head.first_line, columns, axis);
        Ok(Layout { instrument: self.value("Model", 0, 1).map(str::to_owned), samples, segments, ..layout })
    }

    /// The value of a key at `group` for the column at `index`.
    fn value(&self, key: &str, group: usize, index: usize) -> Option<&str> {
        let cells = |cells: &&Vec<String>| cells.get(group).is_some_and(|cell| cell == key);
        let cells = self.head.lines.iter().map(|(_, cells)| cells).find(cells)?;
        let value = |index: usize| cells.get(index).filter(|cell| !cell.is_empty()).map(String::as_str);
        value(index).or_else(|| value(group + 1))
    }

    fn line(&self, key: &str) -> u64 {
        self.head.lines.iter().find(|(_, cells)| cells[0] == key).map_or(1, |(line, _)| *line)
    }

    fn number(&self, key: &str) -> Result<Option<f64>, FormatError> {
        let Some(text) = self.value(key, 0, 1) else { return Ok(None) };
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.map(Some).ok_or_else(|| refuse(self.line(key), format!("{key} = {:?} is no number", clip(text))))
    }

    fn count(&self, key: &str) -> Result<Option<u64>, FormatError> {
        let Some(count) = self.number(key)? else { return Ok(None) };
        let sound = count.fract() == 0.0 && (0.0..1e15).contains(&count);
        let problem = || refuse(self.line(key), format!("{key} = {count} is no count"));
        sound.then_some(Some(count as u64)).ok_or_else(problem)
    }

    /// Kind and unit of a channel.
    fn describe(&self, column: &mut Column, group: usize, index: usize) {
        let form = self.value("Waveform Type", group, index).unwrap_or_default();
        let envelope = self.value("Point Format", group, index).is_some_and(|format| format.starts_with("ENV"));
        column.kind = match form {
            "DIGITAL" => Kind::Digital,
            _ if form.contains("IQ") => Kind::Iq,
            _ if envelope => Kind::Envelope,
            _ => column.kind,
        };
        column.unit = match self.value("Vertical Units", group, index) {
            _ if column.kind == Kind::Digital => Unit::none(),
            // The numbers are in this unit as printed; a prefix letter in it does not scale them.
            Some(unit) => Unit::plain(unit),
            None => column.unit.clone(),
        };
    }
}

/// LeCroy's ASCII. `"Trigger Time"` is a fraction of a sample, although the file calls it seconds: sample 0 is at
/// -(Trigger Point + Trigger Time) * Sample Interval. The printed times have only seven digits and are not used.
fn lecroy_ascii(lines: &mut Lines<impl BufRead>, first: Vec<u8>) -> Result<Layout, FormatError> {
    let separator = Separator::Byte(b'\t');
    let mut entries: Vec<Vec<String>> = Vec::new();
    let mut line = Some(first);
    while let Some(text) = line.filter(|text| entries.len() < ASCII_KEYS && text.starts_with(b"\"")) {
        entries.push(texts(separator, &text));
        line = lines.next()?.map(<[u8]>::to_vec);
    }
    let entry = |name: &'static str| {
        let entry = entries.iter().zip(1..).find(|(cells, _)| cells.first().is_some_and(|cell| cell == name));
        let (cells, line) = entry.ok_or_else(|| refuse(1, format!("the head has no \"{name}\"")))?;
        let number = cells.get(1).and_then(|cell| cell.parse().ok()).filter(|number: &f64| number.is_finite());
        let number = number.ok_or_else(|| refuse(line, format!("{name} is no number; save the trace again")))?;
        Ok::<_, FormatError>((number, cells.get(2).cloned().unwrap_or_default()))
    };
    let ((samples, _), (dt_s, unit)) = (entry("Record Length")?, entry("Sample Interval")?);
    let ((point, _), (fraction, _)) = (entry("Trigger Point")?, entry("Trigger Time")?);
    let t0_s = -(point + fraction) * dt_s;
    if !(dt_s > 0.0 && t0_s.is_finite()) {
        return Err(refuse(2, format!("a sample interval of {dt_s} s gives no time base; save the trace again")));
    }
    if samples.fract() != 0.0 || !(1.0..1e15).contains(&samples) {
        return Err(refuse(1, format!("Record Length = {samples} is no count; save the trace again")));
    }
    let spectrum = unit == "Hz";
    let axis = Axis { unit: Unit::plain("s"), spectrum, sequence: false, dt_s: Some(dt_s), t0_s: Some(t0_s) };
    let skip = || Column { role: Role::Skip, name: None, unit: Unit::none(), has_unit: true, kind: Kind::Waveform };
    let value = Column { role: Role::Channel, unit: Unit::plain("V"), ..skip() };
    let layout = Layout::new("lecroy-ascii", separator, 1, vec![skip(), skip(), skip(), skip(), value], axis);
    Ok(Layout { samples: Some((samples as u64, "Record Length")), ..layout })
}
