//! The rows: counted first, then read into memory of exactly that size.

use std::io::BufRead;
use std::sync::Arc;

use super::super::reader::FormatError;
use super::layout::{Layout, Role, Survey};
use super::text::{Lines, Numbers, digits};
use super::times::Base;
use super::{clip, refuse};

/// Counts the rows.
pub(super) fn survey(lines: &mut Lines<impl BufRead>, layout: &Layout) -> Result<Survey, FormatError> {
    let x = layout.columns.iter().position(|column| matches!(column.role, Role::Time | Role::Perhaps));
    let mut numbers = Numbers::new(layout.separator);
    let mut survey =
        Survey { rows: 0, ends: Vec::with_capacity(layout.segments as usize), digits: 1, increasing: true };
    let (mut blank, mut before): (Option<(u64, &str)>, f64) = (None, f64::NEG_INFINITY);
    let (segment_rows, _) = layout.samples.unwrap_or((u64::MAX, ""));
    skip_head(lines, layout)?;
    let mut line_number = layout.first_line;
    while let Some(line) = lines.next()? {
        if layout.separator.is_blank(line) || (layout.blank_end && has_blank_cell(line, layout)) {
            blank = blank.or(Some((line_number, "is blank, or has blank cells")));
            line_number += 1;
            continue;
        }
        if let Some((number, what)) = blank {
            return Err(refuse(number, format!("{what}, but lines follow; one waveform a file, and all its samples")));
        }
        if let Some(x) = x {
            let cell = layout.separator.cells(line).nth(x).unwrap_or_default();
            let value = numbers.read(cell).ok_or_else(|| no_number(line_number, cell, x))?;
            survey.increasing &= value > before;
            before = value;
            survey.digits = survey.digits.max(digits(cell));
            let segment = survey.rows / segment_rows;
            // More rows than the header gives are refused below.
            if segment < layout.segments {
                if survey.rows.is_multiple_of(segment_rows) {
                    survey.ends.push((value, value));
                }
                survey.ends[segment as usize].1 = value;
            }
        }
        survey.rows += 1;
        line_number += 1;
    }
    if survey.rows == 0 {
        return Err(refuse(lines.number.max(1), "no line of numbers follows; export the trace with its samples"));
    }
    if let Some((samples, name)) = layout.samples
        && samples.checked_mul(layout.segments) != Some(survey.rows)
    {
        let problem = format!(
            "the head says {name} = {samples} in {} segments, but the file has {} rows; copy it from the instrument again",
            layout.segments, survey.rows
        );
        return Err(refuse(layout.first_line, problem));
    }
    Ok(survey)
}

/// Reads the lines before the first row.
fn skip_head(lines: &mut Lines<impl BufRead>, layout: &Layout) -> Result<(), FormatError> {
    while lines.number + 1 < layout.first_line && lines.next()?.is_some() {}
    Ok(())
}

fn has_blank_cell(line: &[u8], layout: &Layout) -> bool {
    layout.separator.cells(line).take(layout.columns.len()).any(<[u8]>::is_empty)
}

fn no_number(line: u64, cell: &[u8], column: usize) -> FormatError {
    let text = clip(&String::from_utf8_lossy(cell));
    let problem = if text.is_empty() {
        format!("has a blank cell in column {}; export the trace again with all its points", column + 1)
    } else {
        format!("{text:?} in column {} is no number; export the trace again", column + 1)
    };
    refuse(line, problem)
}

/// Reads all values as little-endian f64: segment after segment, and in each segment channel by channel.
pub(super) fn fill(
    lines: &mut Lines<impl BufRead>,
    layout: &Layout,
    base: &Base,
    samples: usize,
) -> Result<Vec<Arc<[u8]>>, FormatError> {
    let channels = layout.columns.iter().filter(|column| column.role == Role::Channel).count();
    let mut filled = Vec::with_capacity(channels * layout.segments as usize);
    let mut numbers = Numbers::new(layout.separator);
    skip_head(lines, layout)?;
    for segment in 0..layout.segments as usize {
        let start = filled.len();
        // Allocated in place: converting a vector into an `Arc` would copy it.
        filled.extend((0..channels).map(|_| std::iter::repeat_n(0_u8, samples * 8).collect::<Arc<[u8]>>()));
        let mut columns: Vec<&mut [u8]> =
            filled[start..].iter_mut().map(|codes| Arc::get_mut(codes).expect("made here")).collect();
        for index in 0..samples {
            let line_number = lines.number + 1;
            let Some(line) = lines.next()? else {
                return Err(refuse(
                    line_number,
                    "is missing, though it was there a moment ago: the file is being changed",
                ));
            };
            row(line, line_number, layout, &mut numbers, &mut |column, value| match column {
                Some(channel) => {
                    columns[channel][8 * index..8 * index + 8].copy_from_slice(&value.to_le_bytes());
                    Ok(())
                }
                None => base.check(segment, index, value).map_err(|problem| refuse(line_number, problem)),
            })?;
        }
    }
    Ok(filled)
}

/// Passes on the numbers of a row: the values of its channels, with their index, and x.
fn row(
    line: &[u8],
    number: u64,
    layout: &Layout,
    numbers: &mut Numbers,
    take: &mut dyn FnMut(Option<usize>, f64) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let mut cells = layout.separator.cells(line);
    let (mut channel, mut x) = (0, &line[..0]);
    for (index, column) in layout.columns.iter().enumerate() {
        let Some(cell) = cells.next() else {
            let count = layout.columns.len();
            return Err(refuse(
                number,
                format!("has {index} fields, those before have {count}; export the trace again"),
            ));
        };
        match column.role {
            Role::Skip => {}
            Role::SameTime if cell == x => {}
            Role::SameTime => {
                return Err(refuse(number, "has two times that differ; export the traces in two files"));
            }
            Role::Time | Role::Perhaps => {
                x = cell;
                take(None, numbers.read(cell).ok_or_else(|| no_number(number, cell, index))?)?;
            }
            Role::Channel => {
                let value = numbers.read(cell).map(|value| column.unit.scale(value)).filter(|value| value.is_finite());
                take(Some(channel), value.ok_or_else(|| no_number(number, cell, index))?)?;
                channel += 1;
            }
        }
    }
    let surplus = cells.filter(|cell| !cell.is_empty()).count();
    if surplus > 0 {
        let count = layout.columns.len();
        return Err(refuse(number, format!("has {} fields, those before have {count}", count + surplus)));
    }
    Ok(())
}
