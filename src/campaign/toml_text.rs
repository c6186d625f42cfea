//! TOML text to values, with errors that name file, line, heading, key and the nearest valid key.
//!
//! Three sources make a message. Serde says what is wrong ("unknown field `postion_m`, expected one of ..."). The
//! parser says where (a span of bytes). A second, untyped parse finds the heading of that span. A syntax error has no
//! heading, since the text has no tree then.

use std::fmt;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::suggest::hint;
use crate::store::disk as fs;

/// Most bytes of a TOML file: a campaign of 65,536 patches with their positions takes 5 MB. A parsed file takes some
/// thirty times its size.
const MOST_BYTES: u64 = 16 << 20;

/// Most characters of a line that a message shows.
const SHOWN: usize = 120;

/// Reads a TOML file.
///
/// # Errors
/// When it cannot be read, is no regular file, is no text in UTF-8, or is too large.
pub fn read(file: &Path) -> io::Result<String> {
    let metadata = fs::metadata(file)?;
    if !metadata.is_file() && !metadata.is_dir() {
        // Opening a pipe would wait for whoever writes into it.
        return Err(io::Error::other("is a pipe or a device; copy what it holds to a file"));
    }
    if metadata.len() > MOST_BYTES {
        let size = metadata.len();
        return Err(io::Error::other(format!("has {size} bytes, and at most {MOST_BYTES} are read as TOML")));
    }
    fs::read_to_string(file)
}

/// What is wrong in a TOML file, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}, line {line}: {problem}", file.display())]
pub struct TomlError {
    /// The file, as the caller named it.
    pub file: PathBuf,
    /// Line, from 1.
    pub line: usize,
    /// What is wrong, under which heading, and how to fix it.
    pub problem: String,
}

/// Parses `text`, the content of `file`. Types that deny unknown fields give errors such as
/// "unknown key `postion_m` in [stations.laser]; did you mean `position_m`?".
///
/// # Errors
/// When the text is not valid TOML, or not of type `T`.
pub fn parse<T: DeserializeOwned>(file: &Path, text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        TomlError {
            file: file.to_owned(),
            line: text[..span.start].matches('\n').count() + 1,
            problem: problem(error.message(), &key_path(text, &span)) + &advice(error.message(), text, &span),
        }
    })
}

/// One step from the root of a document to a value.
#[derive(Clone)]
enum Step {
    Key(String),
    Item(usize),
}

/// The heading and key of a span of bytes: the table that contains it, and the key whose name or value contains it.
#[derive(Default)]
struct KeyPath {
    steps: Vec<Step>,
    key: Option<String>,
}

impl fmt::Display for KeyPath {
    /// `[stations.laser]`, `[[captures]] number 2`, `[patches.2] ray`, or `the top level`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(first) = self.steps.iter().position(|s| matches!(s, Step::Item(_))) else {
            return match self.steps.as_slice() {
                [] => f.write_str("the top level"),
                steps => write!(f, "[{}]", dotted(steps)),
            };
        };
        let (heading, rest) = self.steps.split_at(first);
        if let Some((Step::Item(index), rest)) = rest.split_first() {
            write!(f, "[[{}]] number {}", dotted(heading), index + 1)?;
            if !rest.is_empty() {
                write!(f, ", {}", dotted(rest))?;
            }
        }
        Ok(())
    }
}

/// Advice for text that is not TOML: the line itself, and the most common cause.
fn advice(message: &str, text: &str, span: &Range<usize>) -> String {
    if DeTable::parse(text).is_ok() {
        return String::new();
    }
    let start = text[..span.start].rfind('\n').map_or(0, |at| at + 1);
    let whole = text[start..].lines().next().unwrap_or_default().trim();
    let line: String = whole.chars().take(SHOWN).collect();
    // Text without quotes: the parser takes its first letter for the start of `true`, `false`, `inf`, `nan` or a
    // number.
    let bare =
        line.split_once('=').is_some_and(|(_, value)| value.trim().starts_with(|c: char| c.is_ascii_alphabetic()));
    let hint = if bare && message.starts_with("invalid") || message.contains("string values must be quoted") {
        "; put text in quotes"
    } else {
        ""
    };
    format!(", in `{line}`{hint}")
}

fn dotted(steps: &[Step]) -> String {
    let texts: Vec<String> = steps
        .iter()
        .map(|step| match step {
            Step::Key(key) => key.clone(),
            Step::Item(index) => (index + 1).to_string(),
        })
        .collect();
    texts.join(".")
}

fn key_path(text: &str, span: &Range<usize>) -> KeyPath {
    let mut path = KeyPath::default();
    if let Ok(document) = DeTable::parse(text) {
        search(document.get_ref(), span, &mut Vec::new(), &mut path);
    }
    path
}

/// Searches depth first. A key that equals the span ends the search (true). Otherwise the last match is the deepest
/// value that contains the span, and it stays: headings elsewhere do not contain it.
fn search(table: &DeTable, span: &Range<usize>, steps: &mut Vec<Step>, path: &mut KeyPath) -> bool {
    for (key, value) in table {
        let name = key.get_ref().to_string();
        let is_key = key.span() == *span;
        if is_key || holds(&value.span(), span) {
            path.steps.clone_from(steps);
            path.key = Some(name.clone());
        }
        if is_key {
            return true;
        }
        steps.push(Step::Key(name));
        let done = match value.get_ref() {
            DeValue::Table(inner) => {
                enter(&value.span(), span, steps, path);
                search(inner, span, steps, path)
            }
            DeValue::Array(items) => items.iter().enumerate().any(|(index, item)| {
                let DeValue::Table(inner) = item.get_ref() else {
                    return false;
                };
                steps.push(Step::Item(index));
                enter(&item.span(), span, steps, path);
                let done = search(inner, span, steps, path);
                steps.pop();
                done
            }),
            _ => false,
        };
        steps.pop();
        if done {
            return true;
        }
    }
    false
}

/// Moves to a table that contains the span. If none of its keys does, the span belongs to the table itself.
fn enter(table: &Range<usize>, span: &Range<usize>, steps: &[Step], path: &mut KeyPath) {
    if holds(table, span) {
        path.steps = steps.to_vec();
        path.key = None;
    }
}

fn holds(outer: &Range<usize>, inner: &Range<usize>) -> bool {
    outer.start <= inner.start && inner.end <= outer.end
}

/// Serde's message in the terms of the file: keys and values instead of fields and variants, and one suggestion instead
/// of a list.
fn problem(message: &str, place: &KeyPath) -> String {
    let words = quoted(message);
    let of_key = match &place.key {
        Some(key) => format!("`{key}` in {place}"),
        None => place.to_string(),
    };
    match words.split_first() {
        Some((word, candidates)) if message.starts_with("unknown field") => {
            let hint = hint(word, candidates.iter().copied());
            format!("unknown key `{word}` in {place}; {hint}")
        }
        Some((word, candidates)) if message.starts_with("unknown variant") => {
            let hint = hint(word, candidates.iter().copied());
            format!("unknown value `{word}` of {of_key}; {hint}")
        }
        Some((word, _)) if message.starts_with("missing field") => {
            format!("key `{word}` is missing in {place}; add it")
        }
        _ if message.starts_with("invalid digit") => format!("{of_key} is not a whole number"),
        _ if place.steps.is_empty() && place.key.is_none() => message.to_owned(),
        _ => format!("{of_key}: {message}"),
    }
}

/// The words between backticks.
fn quoted(message: &str) -> Vec<&str> {
    message.split('`').skip(1).step_by(2).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use serde::Deserialize;
    use std::collections::BTreeMap;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only whether it parses counts")]
    struct File {
        #[serde(default)]
        stations: BTreeMap<String, Station>,
        #[serde(default)]
        patches: BTreeMap<i32, Station>,
        #[serde(default)]
        captures: Vec<Station>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only whether it parses counts")]
    struct Station {
        position_m: [f64; 3],
        kind: Option<Kind>,
        inner: Option<Box<Station>>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Analog,
        Counts,
    }

    fn error(text: &str) -> String {
        parse::<File>(Path::new("c.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn errors_name_line_place_key_and_fix() {
        assert_eq!(
            error("[stations.laser]\npostion_m = [0, 0, 0]\n"),
            "c.toml, line 2: unknown key `postion_m` in [stations.laser]; did you mean `position_m`?"
        );
        assert_eq!(
            error("[[captures]]\nposition_m = [1, 2, 3]\n[[captures]]\nkind = 'analog'\n"),
            "c.toml, line 3: key `position_m` is missing in [[captures]] number 2; add it"
        );
        assert_eq!(
            error("[patches.1]\nposition_m = [1, 2, 3]\nkind = 'anlog'\n"),
            "c.toml, line 3: unknown value `anlog` of `kind` in [patches.1]; did you mean `analog`?"
        );
        assert_eq!(
            error("[patches.x]\nposition_m = [1, 2, 3]\n"),
            "c.toml, line 1: `x` in [patches] is not a whole number"
        );
        assert_eq!(
            error("[stations.a]\nposition_m = [1, 2, 3]\ninner = { position_m = [1, 2, 'x'] }\n"),
            "c.toml, line 3: `position_m` in [stations.a.inner]: invalid type: string \"x\", expected f64"
        );
        assert_eq!(
            error("[station.a]\n"),
            "c.toml, line 1: unknown key `station` in the top level; did you mean `stations`?"
        );
    }

    #[test]
    fn what_is_too_large_too_deep_or_a_pipe_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("c.toml");
        fs::File::create(&file).unwrap().set_len(MOST_BYTES + 1).unwrap();
        assert!(read(&file).unwrap_err().to_string().contains("at most 16777216 are read"));
        fs::remove_file(&file).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&file).status().unwrap().success());
        assert!(read(&file).unwrap_err().to_string().contains("is a pipe"));
        let text = error(&format!("stations = {}{}", "[".repeat(100_000), "]".repeat(100_000)));
        assert!(text.contains("c.toml, line 1: ") && text.len() < 500, "{}", text.len());
    }

    #[test]
    fn an_error_of_syntax_names_its_line() {
        let text = error("[stations.a]\nposition_m = = 3\n");
        assert!(text.starts_with("c.toml, line 2: "), "{text}");
    }

    #[test]
    fn the_right_item_of_several_is_named() {
        let good = "[[captures]]\nposition_m = [1, 2, 3]\n";
        let text = error(&format!("{good}{good}[[captures]]\nposition = 1\n"));
        assert!(text.contains("line 6") && text.contains("[[captures]] number 3"), "{text}");
    }
}
