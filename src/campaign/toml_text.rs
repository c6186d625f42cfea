//! TOML text to values, with errors that name file, line, place, key and the nearest known key.
//!
//! Serde says what is wrong ("unknown field `postion_m`, expected one of ..."), the parser where (a span of bytes), and a second, untyped parse
//! says under which heading that span lies. An error of syntax has no heading, as the text has no tree then.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::suggest::hint;

/// What is wrong in a TOML file, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}, line {line}: {problem}", file.display())]
pub struct TomlError {
    /// The file, as the caller named it.
    pub file: PathBuf,
    /// Line, from 1.
    pub line: usize,
    /// What is wrong, under which heading, and the mend.
    pub problem: String,
}

/// Parses `text`, the content of `file`. Types that deny unknown fields give errors such as
/// "unknown key `postion_m` in [stations.laser]; did you mean `position_m`?".
///
/// # Errors
/// When the text is no TOML, or not of type `T`.
pub fn parse<T: DeserializeOwned>(file: &Path, text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        TomlError {
            file: file.to_owned(),
            line: text[..span.start].matches('\n').count() + 1,
            problem: problem(error.message(), &place(text, &span)) + &mend(error.message(), text, &span),
        }
    })
}

/// One step from the root of a document to a value.
#[derive(Clone)]
enum Step {
    Key(String),
    Item(usize),
}

/// Where a span lies: the table that holds it, and the key that it is (or whose value it is in).
#[derive(Default)]
struct Place {
    steps: Vec<Step>,
    key: Option<String>,
}

impl fmt::Display for Place {
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

/// What helps where the text is no TOML: the line as it stands, and the commonest cause.
fn mend(message: &str, text: &str, span: &Range<usize>) -> String {
    if DeTable::parse(text).is_ok() {
        return String::new();
    }
    let start = text[..span.start].rfind('\n').map_or(0, |at| at + 1);
    let line = text[start..].lines().next().unwrap_or_default().trim();
    // A word without quotes: the parser takes its first letter for that of `true`, `false`, `inf` or `nan`, or for a number.
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

fn place(text: &str, span: &Range<usize>) -> Place {
    let mut found = Place::default();
    if let Ok(document) = DeTable::parse(text) {
        search(document.get_ref(), span, &mut Vec::new(), &mut found);
    }
    found
}

/// Depth first. A key that is the span ends the search (true). Otherwise the deepest value that holds the span comes last and stays; headings
/// elsewhere in the text do not hold it.
fn search(table: &DeTable, span: &Range<usize>, steps: &mut Vec<Step>, found: &mut Place) -> bool {
    for (key, value) in table {
        let name = key.get_ref().to_string();
        let is_key = key.span() == *span;
        if is_key || holds(&value.span(), span) {
            found.steps.clone_from(steps);
            found.key = Some(name.clone());
        }
        if is_key {
            return true;
        }
        steps.push(Step::Key(name));
        let done = match value.get_ref() {
            DeValue::Table(inner) => {
                enter(&value.span(), span, steps, found);
                search(inner, span, steps, found)
            }
            DeValue::Array(items) => items.iter().enumerate().any(|(index, item)| {
                let DeValue::Table(inner) = item.get_ref() else {
                    return false;
                };
                steps.push(Step::Item(index));
                enter(&item.span(), span, steps, found);
                let done = search(inner, span, steps, found);
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

/// A span in a table, at none of its keys, is at the table itself.
fn enter(table: &Range<usize>, span: &Range<usize>, steps: &[Step], found: &mut Place) {
    if holds(table, span) {
        found.steps = steps.to_vec();
        found.key = None;
    }
}

fn holds(outer: &Range<usize>, inner: &Range<usize>) -> bool {
    outer.start <= inner.start && inner.end <= outer.end
}

/// Serde's message in the words of the file: keys and values instead of fields and variants, and one mend instead of a list.
fn problem(message: &str, place: &Place) -> String {
    let words = quoted(message);
    let of_key = match &place.key {
        Some(key) => format!("`{key}` in {place}"),
        None => place.to_string(),
    };
    match words.split_first() {
        Some((word, known)) if message.starts_with("unknown field") => {
            let hint = hint(word, known.iter().copied());
            format!("unknown key `{word}` in {place}; {hint}")
        }
        Some((word, known)) if message.starts_with("unknown variant") => {
            let hint = hint(word, known.iter().copied());
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
    fn errors_name_line_place_key_and_mend() {
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
