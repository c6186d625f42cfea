//! Patterns of file paths: `raw/{sensor}/L{lit}_P{seen}_*.trc`.
//!
//! | in a pattern | matches |
//! |---|---|
//! | `{lit}` `{seen}` `{shot}` | a number: all adjacent digits; leading zeros do not count |
//! | `{sensor}` `{range}` `{channel}` | a name of letters, digits, `-` and `_`, without the sign next to it in the pattern; without both next to a `*` |
//! | `*` | anything, also nothing, within one folder or file name |
//! | `**/` | any number of folders, also none |
//! | all else | itself |
//!
//! A repeated placeholder must have the same value everywhere. A path that can be read in two ways with different
//! values is an error, not a match. Not supported: `?`, `[a-z]`, escapes, and ignoring case.

mod reader;

use std::fmt;

use super::keys::Axis;
use super::suggest::hint;
use reader::Reader;

/// Most tokens of a pattern.
const TOKENS: usize = 64;

/// Why a text is not a valid pattern.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("pattern `{pattern}`: {problem}")]
pub struct PatternError {
    pattern: String,
    problem: String,
}

/// A parsed pattern.
#[derive(Clone, Debug)]
pub struct Pattern {
    tokens: Vec<Token>,
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Text(String),
    Value(Value),
    Star,
    Folders,
}

/// A placeholder, and which of the signs `-` and `_` its values may hold.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Value {
    axis: Axis,
    dash: bool,
    underscore: bool,
}

impl Value {
    fn takes(self, byte: u8) -> bool {
        match byte {
            b'-' => self.dash,
            b'_' => self.underscore,
            _ if self.axis.is_number() => byte.is_ascii_digit(),
            _ => byte.is_ascii_alphanumeric(),
        }
    }
}

/// The values of a pattern's placeholders in a path; numbers without leading zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bound<'a>([Option<&'a str>; Axis::ALL.len()]);

impl<'a> Bound<'a> {
    /// The value of a placeholder; `None` if the pattern does not have it.
    #[must_use]
    pub fn get(&self, axis: Axis) -> Option<&'a str> {
        self.0[axis as usize]
    }

    /// Values given one by one.
    pub fn of(values: impl IntoIterator<Item = (Axis, &'a str)>) -> Self {
        let mut bound = Self::default();
        for (axis, value) in values {
            bound.0[axis as usize] = Some(value);
        }
        bound
    }
}

impl fmt::Display for Bound<'_> {
    /// `lit = 4, channel = C1`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let given = Axis::ALL.into_iter().filter_map(|axis| Some((axis.name(), self.get(axis)?)));
        for (index, (name, value)) in given.enumerate() {
            let comma = if index > 0 { ", " } else { "" };
            write!(f, "{comma}{name} = {value}")?;
        }
        Ok(())
    }
}

/// How a pattern reads a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading<'a> {
    /// No match.
    No,
    /// A match with these values.
    Yes(Bound<'a>),
    /// Two ways to match, with different values.
    Ambiguous(Bound<'a>, Bound<'a>),
}

impl Pattern {
    /// Parses a pattern.
    ///
    /// # Errors
    /// When it is not relative to the campaign folder, has an unknown placeholder, two placeholders without a sign
    /// between them, a stray `{`, `}` or `**`, or too many parts.
    pub fn parse(text: &str) -> Result<Self, PatternError> {
        let fail = |problem: String| PatternError { pattern: text.to_owned(), problem };
        check_path(text).map_err(fail)?;
        let mut tokens = Vec::new();
        let mut rest = text;
        while !rest.is_empty() {
            let (token, length) = token(rest, tokens.last()).map_err(fail)?;
            tokens.push(token);
            rest = &rest[length..];
        }
        if tokens.len() > TOKENS {
            return Err(fail(format!("has {} texts, stars and placeholders; {TOKENS} are enough", tokens.len())));
        }
        for index in 0..tokens.len() {
            let Token::Value(mut value) = tokens[index] else {
                continue;
            };
            let before = index.checked_sub(1).map(|i| &tokens[i]);
            let after = tokens.get(index + 1);
            value.dash = !value.axis.is_number() && !touches(before, after, '-');
            value.underscore = !value.axis.is_number() && !touches(before, after, '_');
            tokens[index] = Token::Value(value);
        }
        Ok(Self { tokens })
    }

    /// The placeholders, each as often as it occurs.
    pub fn axes(&self) -> impl Iterator<Item = Axis> {
        self.tokens.iter().filter_map(|token| match token {
            Token::Value(value) => Some(value.axis),
            _ => None,
        })
    }

    /// The one path that the pattern can match, if it has neither placeholders nor stars.
    #[must_use]
    pub fn literal(&self) -> Option<&str> {
        match self.tokens.as_slice() {
            [Token::Text(text)] => Some(text),
            _ => None,
        }
    }

    /// Reads a path: relative to the campaign folder, with `/` between its parts.
    #[must_use]
    pub fn read<'a>(&self, path: &'a str) -> Reading<'a> {
        let reader = Reader::of(&self.tokens, path);
        match reader.readings.as_slice() {
            [] => Reading::No,
            [one] => Reading::Yes(*one),
            [one, two, ..] => Reading::Ambiguous(*one, *two),
        }
    }

    /// A matching path with `*` for each value of this placeholder: what files that differ only there have in common.
    #[must_use]
    pub fn starred(&self, path: &str, axis: Axis) -> String {
        let reader = Reader::of(&self.tokens, path);
        let (mut starred, mut rest) = (String::new(), 0);
        for (_, range) in reader.places.iter().filter(|(of, _)| *of == axis) {
            starred.push_str(&path[rest..range.start]);
            starred.push('*');
            rest = range.end;
        }
        starred + &path[rest..]
    }
}

/// Checks that a text is a path inside the campaign folder; if not, returns why.
pub(super) fn check_path(text: &str) -> Result<(), String> {
    if text.is_empty() {
        return Err("is empty; give a path such as raw/L{lit}_P{seen}.trc".into());
    }
    if text.contains('\\') {
        return Err("has a backslash; separate folders by `/`".into());
    }
    if text.split('/').any(|part| matches!(part, "" | "." | "..")) {
        return Err(
            "must be a plain path relative to the campaign folder, without a leading `/`, `//`, `.` or `..`".into()
        );
    }
    Ok(())
}

/// The first token of a text that is not empty, and its length in bytes.
fn token(text: &str, before: Option<&Token>) -> Result<(Token, usize), String> {
    let starts_folder = match before {
        None | Some(Token::Folders) => true,
        Some(Token::Text(text)) => text.ends_with('/'),
        _ => false,
    };
    if text.starts_with("**/") && starts_folder {
        return Ok((Token::Folders, 3));
    }
    if text.starts_with("**") {
        return Err("`**` must be a whole folder name: write `**/`, or a single `*`".into());
    }
    if text.starts_with('*') {
        return Ok((Token::Star, 1));
    }
    if let Some(inner) = text.strip_prefix('{') {
        let Some((word, _)) = inner.split_once('}') else {
            return Err("`{` without `}`; close the placeholder".into());
        };
        let Some(axis) = Axis::ALL.into_iter().find(|axis| axis.name() == word) else {
            let hint = hint(word, Axis::ALL.map(Axis::name));
            return Err(format!("unknown placeholder `{{{word}}}`; {hint}"));
        };
        if matches!(before, Some(Token::Value(_))) {
            return Err(format!("nothing separates `{{{word}}}` from the placeholder before it; put a sign between"));
        }
        let value = Value { axis, dash: false, underscore: false };
        return Ok((Token::Value(value), word.len() + 2));
    }
    let length = text.find(['*', '{', '}']).unwrap_or(text.len());
    if length == 0 {
        return Err("`}` without `{`; open the placeholder".into());
    }
    Ok((Token::Text(text[..length].to_owned()), length))
}

fn touches(before: Option<&Token>, after: Option<&Token>, sign: char) -> bool {
    let left = match before {
        Some(Token::Text(text)) => text.ends_with(sign),
        Some(Token::Star) => true,
        _ => false,
    };
    let right = match after {
        Some(Token::Text(text)) => text.starts_with(sign),
        Some(Token::Star) => true,
        _ => false,
    };
    left || right
}

#[cfg(test)]
mod tests;
