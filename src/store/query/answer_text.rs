//! Answers of queries as text.

use std::io::{self, Write};

use polars::prelude::{AnyValue, Column, CsvWriter, DataFrame, DataType, NamedFrom, PolarsResult, SerWriter, Series};

/// Most values of a list in a table for the terminal.
const LIST_SHOWN: usize = 6;
/// Digits of a number in a table for the terminal.
const DIGITS: i32 = 7;
/// Blanks between columns.
const GAP: usize = 2;

/// Prints columns side by side, all rows, numbers right-aligned. Columns beyond `width` characters are listed below.
pub fn table(answer: &DataFrame, width: Option<usize>, out: &mut impl Write) -> io::Result<()> {
    let columns: Vec<(bool, Vec<String>)> = answer.columns().iter().map(column_text).collect();
    let letters = |(_, cells): &(bool, Vec<String>)| cells.iter().map(|cell| cell.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = columns.iter().map(letters).collect();
    let mut end = 0;
    let fits = |&&letters: &&usize| {
        end += letters;
        let fits = width.is_none_or(|width| end <= width);
        end += GAP;
        fits
    };
    let fitting = widths.iter().take_while(fits).count().max(1).min(columns.len());
    for row in 0..=answer.height() {
        let mut line = String::new();
        for ((is_number, cells), width) in columns.iter().zip(&widths).take(fitting) {
            let cell = &cells[row];
            line += &if *is_number { format!("{cell:>width$}") } else { format!("{cell:width$}") };
            line += &" ".repeat(GAP);
        }
        writeln!(out, "{}", line.trim_end())?;
    }
    if fitting < columns.len() {
        let names: Vec<&str> = columns[fitting..].iter().map(|(_, cells)| cells[0].as_str()).collect();
        writeln!(out, "not shown, for want of room: {}", names.join(", "))?;
    }
    Ok(())
}

/// Name and cells of a column, and whether they are numbers.
fn column_text(column: &Column) -> (bool, Vec<String>) {
    let largest = column.as_materialized_series().cast(&DataType::Float64).ok().and_then(|numbers| {
        let numbers = numbers.f64().ok()?.iter().flatten().filter(|x| x.is_finite());
        numbers.map(f64::abs).reduce(f64::max)
    });
    let is_float = column.dtype().is_float();
    let number = |x: f64| readable(x, largest.unwrap_or(0.0));
    let cells = column.as_materialized_series().iter().map(|value| match value {
        AnyValue::Float64(x) if is_float => number(x),
        AnyValue::Float32(x) if is_float => number(f64::from(x)),
        value => text(value, Some(LIST_SHOWN)),
    });
    let cells = std::iter::once(column.name().to_string()).chain(cells).collect();
    (column.dtype().is_primitive_numeric(), cells)
}

/// A number with as many decimals as the largest of its column allows; very small ones get an exponent.
fn readable(x: f64, largest: f64) -> String {
    let magnitude = if largest > 0.0 { largest.log10().floor() as i32 } else { 0 };
    if !x.is_finite() || x == 0.0 {
        return x.to_string();
    }
    if !(-4..DIGITS + 2).contains(&magnitude) {
        return format!("{x:.4e}");
    }
    let decimals = (DIGITS - 1 - magnitude.max(0)).max(0) as usize;
    if x.abs() < 10f64.powi(3 - decimals as i32) && decimals > 3 {
        format!("{x:.3e}")
    } else {
        format!("{x:.decimals$}")
    }
}

/// Comma-separated values; lists and structs become text.
pub fn csv(answer: &DataFrame, out: &mut impl Write) -> PolarsResult<()> {
    let is_single = |column: &Column| !column.dtype().is_nested() && *column.dtype() != DataType::Binary;
    let mut plain = as_text(answer.clone(), is_single)?;
    CsvWriter::new(out).finish(&mut plain)
}

/// Columns of bytes as hexadecimal digits.
pub fn without_bytes(answer: DataFrame) -> PolarsResult<DataFrame> {
    as_text(answer, |column| *column.dtype() != DataType::Binary)
}

/// Converts columns to text, except those that `may_stay` accepts.
fn as_text(mut answer: DataFrame, may_stay: impl Fn(&Column) -> bool) -> PolarsResult<DataFrame> {
    let others: Vec<Column> = answer.columns().iter().filter(|column| !may_stay(column)).cloned().collect();
    for column in others {
        let cell = |value: AnyValue<'_>| (!value.is_null()).then(|| text(value, None));
        let cells: Vec<Option<String>> = column.as_materialized_series().iter().map(cell).collect();
        answer.with_column(Series::new(column.name().clone(), cells).into())?;
    }
    Ok(answer)
}

/// A value as text, lists and structs as in JSON. Of a list it prints at most `most` values; of bytes then only their
/// number.
fn text(value: AnyValue<'_>, most: Option<usize>) -> String {
    match value {
        AnyValue::Null => if most.is_some() { "-" } else { "null" }.to_owned(),
        AnyValue::String(text) => text.to_owned(),
        AnyValue::StringOwned(text) => text.to_string(),
        AnyValue::Binary(bytes) => match most {
            Some(_) => format!("{} bytes", bytes.len()),
            None => bytes.iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}")),
        },
        AnyValue::List(values) | AnyValue::Array(values, _) => {
            let all = values.len();
            let visible = most.filter(|most| all > *most).unwrap_or(all);
            let mut cells: Vec<String> = values.iter().take(visible).map(|value| in_list(value, most)).collect();
            if visible < all {
                cells.push(format!("... {all} values"));
            }
            format!("[{}]", cells.join(", "))
        }
        AnyValue::StructOwned(value) => {
            let (values, fields) = *value;
            let pairs = fields.iter().zip(values);
            let cells: Vec<String> =
                pairs.map(|(field, value)| format!("\"{}\": {}", field.name(), in_list(value, most))).collect();
            format!("{{{}}}", cells.join(", "))
        }
        value @ AnyValue::Struct(..) => text(value.into_static(), most),
        AnyValue::Float32(x) if most.is_some() => readable(f64::from(x), f64::from(x).abs()),
        AnyValue::Float64(x) if most.is_some() => readable(x, x.abs()),
        AnyValue::Float32(x) => x.to_string(),
        AnyValue::Float64(x) => x.to_string(),
        other => other.to_string(),
    }
}

/// A value within a list: texts get quotes.
fn in_list(value: AnyValue<'_>, most: Option<usize>) -> String {
    match value {
        AnyValue::Null => "null".to_owned(),
        AnyValue::String(text) => format!("{text:?}"),
        AnyValue::StringOwned(text) => format!("{:?}", text.as_str()),
        value => text(value, most),
    }
}

#[cfg(test)]
mod tests {
    use super::readable;

    #[test]
    fn numbers_of_a_column_have_the_decimals_that_its_largest_leaves_room_for() {
        assert_eq!(readable(3335.640_951, 12_000.0), "3335.64");
        assert_eq!(readable(-0.35, 1.2), "-0.350000");
        assert_eq!(readable(7.0e-8, 1.2), "7.000e-8");
        assert_eq!(readable(2.5e-9, 3.1e-9), "2.5000e-9");
        assert_eq!(readable(0.0, 5.0), "0");
        assert_eq!(readable(f64::INFINITY, 5.0), "inf");
    }
}
