//! LeCroy CSV: `LECROYmodel,id,Waveform`, `Segments,n,SegmentSize,m`, `Segment,TrigTime,TimeSinceSegment1`, a line
//! `#1,03-May-2017 11:41:40,0` for each segment, `Time,Ampl`, and the rows of all segments.

use std::io::BufRead;

use super::super::reader::FormatError;
use super::layout::{Head, Layout, columns};
use super::text::{Lines, Separator, texts};
use super::{RECORD_BYTES, refuse};

const MONTHS: [&str; 12] = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/// Reads the rest of the header after its first line.
pub(super) fn layout(lines: &mut Lines<impl BufRead>, first: &[u8], length: u64) -> Result<Layout, FormatError> {
    let separator = Separator::of(first);
    let second = cells(lines, separator, "Segments")?;
    let number = |index: usize, name: &str| {
        let is_named = second.get(index - 1).is_some_and(|cell| cell == name);
        let count = second.get(index).filter(|_| is_named).and_then(|cell| cell.parse::<u64>().ok());
        let count = count.filter(|count| (1..1 << 50).contains(count));
        count.ok_or_else(|| refuse(2, format!("has no count under {name}; save the trace again")))
    };
    let (segments, samples) = (number(1, "Segments")?, number(3, "SegmentSize")?);
    if segments > (4 * length + (1 << 18)) / RECORD_BYTES {
        return Err(refuse(2, format!("Segments = {segments} are more than the file can hold; save the trace again")));
    }
    cells(lines, separator, "Segment")?;
    let (mut triggers_s, mut acquired_at) = (Vec::new(), None);
    for segment in 1..=segments {
        let cells = cells(lines, separator, &format!("#{segment}"))?;
        let last = cells.last().and_then(|cell| since(cell)).filter(|_| cells.len() > 2);
        let Some(trigger_s) = last else {
            let problem = format!("has no TimeSinceSegment1 of segment {segment}; save the trace again");
            return Err(refuse(lines.number, problem));
        };
        if segment == 1 {
            acquired_at = iso(&cells[1..cells.len() - 1].join(" "));
        }
        if segments > 1 {
            triggers_s.push(trigger_s);
        }
    }
    let names_line = lines.next()?.unwrap_or_default().to_vec();
    let line = lines.number;
    let head = Head::read(lines, names_line)?;
    let [(_, _)] = &head.lines[..] else {
        return Err(refuse(line, "is no single line of names above the rows; save the trace again"));
    };
    let (columns, axis) = columns(Some(&head.lines[0].1), None, head.count, line)?;
    let layout = Layout::new("lecroy-csv", head.separator, head.first_line, columns, axis);
    let samples = Some((samples, "SegmentSize"));
    Ok(Layout { instrument: model(first, separator), acquired_at, samples, segments, triggers_s, ..layout })
}

/// Cells of the next line, whose first cell must be `begin`.
fn cells(lines: &mut Lines<impl BufRead>, separator: Separator, begin: &str) -> Result<Vec<String>, FormatError> {
    let cells = texts(separator, lines.next()?.unwrap_or_default());
    if cells.first().is_some_and(|cell| cell == begin) {
        return Ok(cells);
    }
    Err(refuse(
        lines.number,
        format!("does not begin with {begin}, as the head of a LeCroy CSV does; save the trace again"),
    ))
}

/// The model. The bytes that follow it have no meaning.
fn model(first: &[u8], separator: Separator) -> Option<String> {
    let cell = separator.cells(first).next()?;
    let end = cell.iter().position(|byte| !byte.is_ascii_graphic()).unwrap_or(cell.len());
    String::from_utf8(cell[..end].to_vec()).ok()
}

/// Converts `03-May-2017 11:41:40` to ISO 8601.
fn iso(text: &str) -> Option<String> {
    let (date, time) = text.split_once(' ')?;
    let [day, month, year] = date.split('-').collect::<Vec<_>>()[..] else { return None };
    let month = MONTHS.iter().position(|name| *name == month)? + 1;
    let number = |text: &str, digits: usize| text.len() == digits && text.bytes().all(|byte| byte.is_ascii_digit());
    let (clock, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let parts: Vec<&str> = clock.split(':').collect();
    let sound = number(day, 2) && number(year, 4) && parts.len() == 3 && parts.iter().all(|part| number(part, 2));
    let sound = sound && number(fraction, fraction.len()) && fraction.len() < 13;
    sound.then(|| format!("{year}-{month:02}-{day}T{time}"))
}

/// A time in the header; its decimal mark is a comma where the separator is another.
fn since(cell: &str) -> Option<f64> {
    cell.replace(',', ".").parse().ok().filter(|time_s: &f64| time_s.is_finite())
}
