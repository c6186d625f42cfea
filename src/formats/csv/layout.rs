//! What the header of a text says about its rows.

use std::io::BufRead;

use super::super::reader::FormatError;
use super::text::{Lines, Numbers, Separator, texts};
use super::units::{COUNTS, Unit, is_time, split};
use super::{clip, refuse};
use crate::waveform::Kind;

/// Most lines before the first row. A LeCroy header may have more, one for each segment.
const HEAD_LINES: usize = 64;

/// Most columns.
const COLUMNS: usize = 256;

/// What a column is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Ignored.
    Skip,
    /// x: times, frequencies or numbers of samples.
    Time,
    /// A copy of x.
    SameTime,
    /// Times if they increase from row to row, else a channel.
    Perhaps,
    /// Values.
    Channel,
}

/// A column.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub role: Role,
    pub name: Option<String>,
    pub unit: Unit,
    /// Whether the header gives the unit; else it is that of most scopes, V or s.
    pub has_unit: bool,
    pub kind: Kind,
}

/// The x axis.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    /// Unit of the column.
    pub unit: Unit,
    /// Whether x is a frequency, not a time.
    pub spectrum: bool,
    /// Whether x is the number of a sample.
    pub sequence: bool,
    /// Step of x, where the header gives it.
    pub dt_s: Option<f64>,
    /// First x, where the header gives it; for a sequence, x of number 0.
    pub t0_s: Option<f64>,
}

/// How to read the rows.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub format: &'static str,
    pub instrument: Option<String>,
    pub acquired_at: Option<String>,
    pub separator: Separator,
    pub columns: Vec<Column>,
    pub axis: Axis,
    /// Line of the first row.
    pub first_line: u64,
    /// Rows of a segment, where the header gives them, and the name of that field.
    pub samples: Option<(u64, &'static str)>,
    pub segments: u64,
    /// Times of the triggers of several segments, after the first one's.
    pub triggers_s: Vec<f64>,
    /// Whether a last row with blank cells is to be ignored.
    pub blank_end: bool,
}

impl Layout {
    /// A layout with these columns and no further information.
    pub(super) fn new(
        format: &'static str,
        separator: Separator,
        first_line: u64,
        columns: Vec<Column>,
        axis: Axis,
    ) -> Self {
        Self {
            format,
            instrument: None,
            acquired_at: None,
            separator,
            columns,
            axis,
            first_line,
            samples: None,
            segments: 1,
            triggers_s: Vec::new(),
            blank_end: false,
        }
    }

    /// Takes off the units that the header does not give: they would be a guess.
    pub(super) fn only_given_units(mut self) -> Self {
        for column in &mut self.columns {
            if !column.has_unit {
                column.unit = Unit::none();
                if [Role::Time, Role::Perhaps].contains(&column.role) {
                    self.axis.unit = Unit::none();
                }
            }
        }
        self
    }

    /// Decides whether the undecided column is x.
    pub(super) fn decide(&mut self, survey: &Survey) {
        for column in self.columns.iter_mut().filter(|column| column.role == Role::Perhaps) {
            column.role = if survey.increasing { Role::Time } else { Role::Channel };
        }
    }
}

/// What must be known about the rows before they are read.
#[derive(Debug)]
pub(super) struct Survey {
    pub rows: u64,
    /// First and last x of each segment, as printed; empty without a column of x.
    pub ends: Vec<(f64, f64)>,
    /// Largest number of digits of an x.
    pub digits: usize,
    /// Whether x increases from row to row.
    pub increasing: bool,
}

/// The lines before the first row of numbers.
#[derive(Debug)]
pub(super) struct Head {
    /// Number and cells of each line that is not blank.
    pub lines: Vec<(u64, Vec<String>)>,
    pub separator: Separator,
    /// Cells of the first row, without blank ones at its end.
    pub count: usize,
    /// Number of its line.
    pub first_line: u64,
}

impl Head {
    /// Reads on after the first line.
    pub(super) fn read(lines: &mut Lines<impl BufRead>, first: Vec<u8>) -> Result<Self, FormatError> {
        let mut before: Vec<(u64, Vec<u8>)> = Vec::new();
        let mut line = Some(first);
        while let Some(text) = line {
            let separator = Separator::of(&text);
            if let Some(count) = row(separator, &text) {
                if count > COLUMNS {
                    return Err(refuse(lines.number, format!("has {count} columns, more than {COLUMNS}: split them")));
                }
                let cells = |(number, line): &(u64, Vec<u8>)| (*number, texts(separator, line));
                let lines_before = before.iter().map(cells).filter(|(_, cells)| !cells.is_empty());
                return Ok(Self { lines: lines_before.collect(), separator, count, first_line: lines.number });
            }
            if before.len() == HEAD_LINES {
                return Err(not_a_row(before[0].0, &String::from_utf8_lossy(&before[0].1)));
            }
            before.push((lines.number, text));
            line = lines.next()?.map(<[u8]>::to_vec);
        }
        Err(refuse(lines.number.max(1), "no line of numbers follows; export the trace with its samples"))
    }
}

/// An error about a line in a header.
pub(super) fn not_a_row(line: u64, text: &str) -> FormatError {
    let text = clip(text.trim());
    refuse(
        line,
        format!("{text:?} is no row of numbers; a plain CSV has one line of names and one of units at most, then rows"),
    )
}

/// Number of cells in a row of numbers. The first must be a number; the others are numbers or blank.
fn row(separator: Separator, line: &[u8]) -> Option<usize> {
    let mut numbers = Numbers::new(separator);
    let (mut count, mut index) = (0, 0);
    for cell in separator.cells(line) {
        index += 1;
        if !cell.is_empty() {
            numbers.read(cell)?;
            count = index;
        } else if index == 1 {
            return None;
        }
    }
    (count > 0).then_some(count)
}

/// Names that only say that a column holds values.
const NAMELESS: [&str; 9] = ["", "ampl", "amplitude", "v", "value", "volt", "voltage", "volts", "y"];

/// Names of columns that number the samples.
const NUMBERING: [&str; 8] = ["#", "index", "n", "no", "no.", "nr", "point", "sample"];

/// The columns, and the x axis, from the names and units above them; `line` is where these are.
pub(super) fn columns(
    names: Option<&[String]>,
    units: Option<&[String]>,
    count: usize,
    line: u64,
) -> Result<(Vec<Column>, Axis), FormatError> {
    if let Some(cells) = [names, units].into_iter().flatten().find(|cells| cells.len() != count) {
        let problem =
            format!("names {} columns, but the rows have {count}; name each of them, in one word", cells.len());
        return Err(refuse(line, problem));
    }
    let mut columns = Vec::with_capacity(count);
    let mut axis = Axis { unit: Unit::plain("s"), spectrum: false, sequence: false, dt_s: None, t0_s: None };
    for index in 0..count {
        let header = names.map_or("", |names| &names[index]);
        let (name, unit) = split(header);
        let unit = units.map(|units| units[index].trim_matches(['(', ')', '[', ']'])).or(unit);
        let parsed_unit = unit.and_then(Unit::parse);
        let is = |base: &str| index == 0 && parsed_unit.as_ref().is_some_and(|unit| unit.is(base));
        let frequencies = ["f", "freq", "frequency"].contains(&&name.to_lowercase()[..]) || is("Hz");
        let role = if is_time(name) || frequencies || is("s") {
            if columns.iter().any(|column: &Column| column.role == Role::Time) { Role::SameTime } else { Role::Time }
        } else if NUMBERING.contains(&&name.to_lowercase()[..]) {
            Role::Skip
        } else {
            Role::Channel
        };
        if role == Role::Time {
            axis.spectrum = frequencies || parsed_unit.as_ref().is_some_and(|unit| unit.is("Hz"));
            axis.unit = x_unit(parsed_unit, unit, axis.spectrum).map_err(|problem| refuse(line, problem))?;
            let has_unit = unit.is_some_and(|unit| !unit.is_empty()) || Unit::of_name(name).is_some();
            columns.push(Column { role, name: None, unit: axis.unit.clone(), has_unit, kind: Kind::Waveform });
            continue;
        }
        if unit == Some("MV") {
            return Err(refuse(line, format!("the unit MV of {:?} may mean mV; write mV, or V", clip(name))));
        }
        let given = parsed_unit.or_else(|| unit.filter(|unit| !unit.is_empty()).map(Unit::plain));
        let given = given.or_else(|| Unit::of_name(name));
        let has_unit = given.is_some();
        let unit = given.unwrap_or_else(|| Unit::plain("V"));
        columns.push(Column { has_unit, ..channel(role, name, unit, names.is_none().then_some(index)) });
    }
    // Without a telling name, the rows must decide: x increases.
    let telling = |name: &str| name.to_lowercase().starts_with("ch");
    if count > 1
        && columns.iter().all(|column| column.role == Role::Channel)
        && !names.is_some_and(|names| telling(&names[0]))
    {
        columns[0].role = Role::Perhaps;
    }
    if !columns.iter().any(|column| column.role == Role::Channel) {
        return Err(refuse(line, "has no column of values next to that of times; export the trace again"));
    }
    Ok((columns, axis))
}

/// Unit of a column of times or frequencies.
fn x_unit(parsed_unit: Option<Unit>, text: Option<&str>, spectrum: bool) -> Result<Unit, String> {
    let base = if spectrum { "Hz" } else { "s" };
    match (parsed_unit, text.filter(|text| !text.is_empty())) {
        (Some(unit), _) if unit.is(base) => Ok(unit),
        (None, None) => Ok(Unit::plain(base)),
        (_, text) => {
            Err(format!("{:?} is no unit of times; write s, ms, us, ns or ps", clip(text.unwrap_or_default())))
        }
    }
}

/// A column of values; without a name it gets that of its place.
fn channel(role: Role, name: &str, unit: Unit, index: Option<usize>) -> Column {
    let logic = name.strip_prefix('D').is_some_and(|digits| digits.parse::<u8>().is_ok());
    let name = match index {
        Some(index) => Some(format!("col{index}")),
        None => (!NAMELESS.contains(&&name.to_lowercase()[..])).then(|| name.to_owned()),
    };
    let (unit, kind) = match unit {
        _ if logic => (Unit::none(), Kind::Digital),
        unit if unit.is(COUNTS) => (unit, Kind::Counts),
        unit => (unit, Kind::Waveform),
    };
    Column { role, name, unit, has_unit: true, kind }
}
