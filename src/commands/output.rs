//! What commands print to standard output: text, or rows as a table, as JSON or as CSV.
//!
//! A closed pipe ends a command quietly: what is printed then fails as [`Closed`], which `main` turns into an exit
//! code.
//! Messages to standard error are dropped there, and the command goes on. Text for readers is made inert; rows as JSON
//! or CSV are for programs, and made inert where they go to a terminal.

use std::fmt;
use std::io::{self, ErrorKind, IsTerminal, Write};

use anstyle::{AnsiColor, Style};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
pub use periscope::campaign::count;
use serde::Serialize;
use serde_json::Value;

use super::inert;

/// Form of what a command prints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Text for the terminal
    #[default]
    Table,
    /// JSON: an array with an object per row, or one object
    Json,
    /// Comma-separated values with a header (RFC 4180); lists and objects as JSON
    Csv,
}

/// The option of every command that prints rows.
#[derive(Args)]
pub struct Output {
    /// Form of the output
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Nothing reads standard output any more.
#[derive(Debug, thiserror::Error)]
#[error("standard output is closed")]
pub struct Closed;

/// The error of a command whose output cannot be written.
pub fn failure(error: io::Error) -> anyhow::Error {
    match error.kind() {
        ErrorKind::BrokenPipe => Closed.into(),
        _ => anyhow::Error::new(error).context("cannot write to standard output"),
    }
}

/// Prints bytes as they are.
pub fn print(text: impl AsRef<[u8]>) -> Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_ref()).and_then(|()| out.flush()).map_err(failure)
}

/// Prints text for a reader.
pub fn print_text(text: &str) -> Result<()> {
    print(inert::lines(text).as_bytes())
}

/// Words that messages begin with, and their colours, which are those of clap.
const COLOURED: [(&str, Style); 3] = [
    ("error:", AnsiColor::Red.on_default().bold()),
    ("warning:", AnsiColor::Yellow.on_default().bold()),
    ("interrupted:", AnsiColor::Yellow.on_default().bold()),
];

/// Prints a message to standard error, in colours where these are wanted. That it is closed is no reason to stop.
pub fn message(text: fmt::Arguments<'_>) {
    let text = text.to_string();
    let text = inert::lines(&text);
    let mut out = anstream::stderr().lock();
    let first = COLOURED.iter().find_map(|(word, style)| Some((word, style, text.strip_prefix(word)?)));
    let _ = match first {
        Some((word, style, rest)) => writeln!(out, "{style}{word}{style:#}{rest}"),
        None => writeln!(out, "{text}"),
    };
}

/// Prints a line to standard output.
macro_rules! say {
    ($($text:tt)*) => { $crate::commands::output::print_text(&(format!($($text)*) + "\n")) };
}
pub(crate) use say;

/// Prints a line to standard error.
macro_rules! note {
    ($($text:tt)*) => { $crate::commands::output::message(format_args!($($text)*)) };
}
pub(crate) use note;

/// One object as JSON, with its fields in their order.
pub fn json(object: &impl Serialize) -> Result<String> {
    Ok(inert::json(&serde_json::to_string_pretty(object)?).into_owned() + "\n")
}

/// Rows of equal columns.
pub struct Rows {
    columns: Vec<&'static str>,
    rows: Vec<Vec<Value>>,
}

impl Rows {
    /// No rows yet.
    pub fn new(columns: &[&'static str]) -> Self {
        Self { columns: columns.to_vec(), rows: Vec::new() }
    }

    /// These fields of objects; a field that an object lacks is empty.
    pub fn of<T: Serialize>(columns: &[&'static str], objects: impl IntoIterator<Item = T>) -> Result<Self> {
        let mut rows = Self::new(columns);
        for object in objects {
            let object = serde_json::to_value(object).context("a row has names and plain values")?;
            rows.rows.push(columns.iter().map(|column| object[column].clone()).collect());
        }
        Ok(rows)
    }

    /// Adds a row: a value for each column, in order.
    pub fn push(&mut self, row: impl IntoIterator<Item = Value>) {
        let row: Vec<Value> = row.into_iter().collect();
        assert_eq!(row.len(), self.columns.len(), "a value for each column");
        self.rows.push(row);
    }

    /// Prints all rows.
    pub fn print(&self, format: Format) -> Result<()> {
        print(self.text(format)?)
    }

    fn text(&self, format: Format) -> Result<Vec<u8>> {
        if format == Format::Table {
            return Ok(self.table().into_bytes());
        }
        let mut text = Vec::new();
        let mut stream = Stream::start(&mut text, format, &self.columns)?;
        self.rows.iter().try_for_each(|row| stream.row(row))?;
        stream.end()?;
        Ok(text)
    }

    /// Columns as wide as their widest value; numbers stand at the right.
    fn table(&self) -> String {
        let cell = |value: &Value| inert::line(&plain(value)).into_owned();
        let cells: Vec<Vec<String>> = self.rows.iter().map(|row| row.iter().map(cell).collect()).collect();
        let is_number = |column: usize| {
            let mut values = self.rows.iter().map(|row| &row[column]).filter(|value| !value.is_null());
            values.clone().next().is_some() && values.all(Value::is_number)
        };
        let width = |column: usize| {
            let cells = cells.iter().map(|row| row[column].chars().count());
            cells.chain([self.columns[column].chars().count()]).max().unwrap_or(0)
        };
        let layout: Vec<(usize, bool)> =
            (0..self.columns.len()).map(|column| (width(column), is_number(column))).collect();
        let line = |cells: &[&str]| {
            let cells = cells.iter().zip(&layout).map(|(cell, &(width, is_number))| {
                if is_number { format!("{cell:>width$}") } else { format!("{cell:width$}") }
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
        };
        let rows = cells.iter().map(|row| line(&row.iter().map(String::as_str).collect::<Vec<_>>()));
        [line(&self.columns)].into_iter().chain(rows).collect()
    }
}

/// Rows that are printed as they come, as JSON or as CSV.
pub struct Stream<'a, W: Write> {
    out: W,
    format: Format,
    columns: &'a [&'static str],
    count: usize,
}

impl<'a, W: Write> Stream<'a, W> {
    /// Begins; a table needs all its rows at once.
    pub fn start(mut out: W, format: Format, columns: &'a [&'static str]) -> Result<Self> {
        match format {
            Format::Json => out.write_all(b"[").map_err(failure)?,
            Format::Csv => record(&mut out, columns)?,
            Format::Table => unreachable!("tables are not streamed"),
        }
        Ok(Self { out, format, columns, count: 0 })
    }

    /// A row: a value for each column, in order.
    pub fn row(&mut self, row: &[Value]) -> Result<()> {
        self.count += 1;
        if self.format == Format::Csv {
            let is_read = io::stdout().is_terminal();
            let cell = |value: &Value| if is_read { inert::line(&plain(value)).into_owned() } else { plain(value) };
            return record(&mut self.out, row.iter().map(cell));
        }
        let field = |(column, value): (&&str, &Value)| format!("\"{column}\":{}", inert::json(&value.to_string()));
        let fields: Vec<String> = self.columns.iter().zip(row).map(field).collect();
        let before = if self.count > 1 { ",\n" } else { "\n" };
        write!(self.out, "{before}{{{}}}", fields.join(",")).map_err(failure)
    }

    /// Ends.
    pub fn end(mut self) -> Result<()> {
        if self.format == Format::Json {
            let end = if self.count > 0 { "\n]\n" } else { "]\n" };
            self.out.write_all(end.as_bytes()).map_err(failure)?;
        }
        self.out.flush().map_err(failure)
    }
}

fn record(out: &mut impl Write, fields: impl IntoIterator<Item = impl AsRef<[u8]>>) -> Result<()> {
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    writer.write_record(fields)?;
    let record = writer.into_inner().expect("a vector takes all bytes");
    out.write_all(&record).map_err(failure)
}

/// A value without the quotes of JSON; nothing for null.
fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn text(rows: &Rows, format: Format) -> String {
        String::from_utf8(rows.text(format).unwrap()).unwrap()
    }

    fn rows() -> Rows {
        let mut rows = Rows::new(&["name", "count", "note"]);
        rows.push([json!("a"), json!(1), json!(null)]);
        rows.push([json!("say \"b\", c"), json!(20.5), json!([1, "x"])]);
        rows
    }

    #[test]
    fn tables_align_numbers_to_the_right() {
        assert_eq!(
            text(&rows(), Format::Table),
            "name        count  note\na               1\nsay \"b\", c   20.5  [1,\"x\"]\n"
        );
    }

    #[test]
    fn csv_is_quoted_where_it_must_be() {
        let expected = "name,count,note\r\na,1,\r\n\"say \"\"b\"\", c\",20.5,\"[1,\"\"x\"\"]\"\r\n";
        assert_eq!(text(&rows(), Format::Csv), expected);
        assert_eq!(text(&Rows::new(&["a", "b"]), Format::Csv), "a,b\r\n");
    }

    #[test]
    fn json_is_an_array_with_the_columns_in_order() {
        let printed = text(&rows(), Format::Json);
        assert!(printed.starts_with("[\n{\"name\":\"a\",\"count\":1,\"note\":null},\n"), "{printed}");
        let values: Vec<Value> = serde_json::from_str(&printed).unwrap();
        assert_eq!((values.len(), &values[1]["note"]), (2, &json!([1, "x"])));
        assert_eq!(text(&Rows::new(&["a"]), Format::Json), "[]\n");
    }
}
