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
//! values is an error, not a match. Matching backtracks over the tokens. Not supported: `?`, `[a-z]`, escapes, and
//! ignoring case.

use std::fmt;
use std::ops::Range;

use super::keys::Axis;
use super::suggest::hint;

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
    /// between them, or a stray `{`, `}` or `**`.
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
        let mut reader = Reader::new(path);
        reader.walk(false, &self.tokens, 0);
        match reader.readings.as_slice() {
            [] => Reading::No,
            [one] => Reading::Yes(*one),
            [one, two, ..] => Reading::Ambiguous(*one, *two),
        }
    }

    /// A matching path with `*` for each value of this placeholder: what files that differ only there have in common.
    #[must_use]
    pub fn starred(&self, path: &str, axis: Axis) -> String {
        let mut reader = Reader::new(path);
        reader.walk(false, &self.tokens, 0);
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

/// A backtracking reader. It collects readings with different values, and stops at the second.
struct Reader<'a> {
    path: &'a str,
    bound: Bound<'a>,
    /// Where the placeholders so far got their values.
    values: Vec<(Axis, Range<usize>)>,
    readings: Vec<Bound<'a>>,
    /// The places of the first reading.
    places: Vec<(Axis, Range<usize>)>,
}

impl<'a> Reader<'a> {
    fn new(path: &'a str) -> Self {
        Self { path, bound: Bound::default(), values: Vec::new(), readings: Vec::new(), places: Vec::new() }
    }

    /// Reads the path from byte `at` by `tokens`. `after_star`: a star precedes.
    fn walk(&mut self, after_star: bool, tokens: &[Token], at: usize) {
        if self.readings.len() > 1 {
            return;
        }
        let Some((token, rest)) = tokens.split_first() else {
            if at == self.path.len() && !self.readings.contains(&self.bound) {
                if self.readings.is_empty() {
                    self.places.clone_from(&self.values);
                }
                self.readings.push(self.bound);
            }
            return;
        };
        let tail = &self.path.as_bytes()[at..];
        match token {
            Token::Text(text) => {
                if tail.starts_with(text.as_bytes()) {
                    self.walk(false, rest, at + text.len());
                }
            }
            Token::Star => {
                let end = tail.iter().position(|b| *b == b'/').unwrap_or(tail.len());
                for length in 0..=end {
                    self.walk(true, rest, at + length);
                }
            }
            Token::Folders => {
                self.walk(false, rest, at);
                for (index, _) in tail.iter().enumerate().filter(|(_, b)| **b == b'/') {
                    self.walk(false, rest, at + index + 1);
                }
            }
            Token::Value(value) => {
                let cut = after_star && at > 0 && value.takes(self.path.as_bytes()[at - 1]);
                if !cut {
                    self.value(*value, rest, at);
                }
            }
        }
    }

    fn value(&mut self, value: Value, rest: &[Token], at: usize) {
        let path = self.path;
        let bytes = path.as_bytes()[at..].iter();
        let longest = bytes.take_while(|b| value.takes(**b)).count();
        // Before text any length is possible (`{sensor}x{channel}`). Before a star only the whole run is, or the star
        // would cut a number or a name in two.
        let before_text = matches!(rest.first(), Some(Token::Text(_)));
        let shortest = if before_text { 1 } else { longest.max(1) };
        let bound_before = self.bound;
        for length in (shortest..=longest).rev() {
            let mut text = &path[at..at + length];
            if value.axis.is_number() {
                text = without_leading_zeros(text);
            }
            if bound_before.get(value.axis).is_none_or(|bound_before| bound_before == text) {
                self.bound.0[value.axis as usize] = Some(text);
                self.values.push((value.axis, at..at + length));
                self.walk(false, rest, at + length);
                self.values.pop();
            }
        }
        self.bound = bound_before;
    }
}

fn without_leading_zeros(digits: &str) -> &str {
    let zeros = digits.bytes().take_while(|b| *b == b'0').count();
    &digits[zeros.min(digits.len() - 1)..]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn read(pattern: &str, path: &str) -> String {
        match Pattern::parse(pattern).unwrap().read(path) {
            Reading::No => "no".to_owned(),
            Reading::Yes(bound) => bound.to_string(),
            Reading::Ambiguous(a, b) => format!("{a} | {b}"),
        }
    }

    #[test]
    fn numbers_and_names_are_taken_whole() {
        let scene = "raw/scene/L{lit}_P{seen}.trc";
        assert_eq!(read(scene, "raw/scene/L007_P12.trc"), "lit = 7, seen = 12");
        assert_eq!(read(scene, "raw/scene/L000_P0.trc"), "lit = 0, seen = 0");
        assert_eq!(read(scene, "raw/scene/L7_P12.trc.bak"), "no");
        assert_eq!(read(scene, "raw/scene/L7_P.trc"), "no");
        assert_eq!(read("*{shot}*", "run12b"), "shot = 12");
        assert_eq!(read("{range}.csv", "high-2_b.csv"), "range = high-2_b");
        assert_eq!(read("{range}_L{lit}*.csv", "low-2_L3_x.csv"), "lit = 3, range = low-2");
        assert_eq!(read("{range}_L{lit}.csv", "low_2_L3.csv"), "no");
    }

    #[test]
    fn a_star_takes_the_place_of_a_value_wherever_it_stands() {
        let starred = |pattern: &str, path: &str| Pattern::parse(pattern).unwrap().starred(path, Axis::Shot);
        assert_eq!(starred("r/7_{shot}.trc", "r/7_007.trc"), "r/7_*.trc");
        assert_eq!(starred("r/{shot}/*_{shot}.trc", "r/03/3_3.trc"), "r/*/3_*.trc");
        assert_eq!(starred("r/*.trc", "r/03.trc"), "r/03.trc");
    }

    #[test]
    fn stars_stay_in_their_folder_and_double_stars_do_not() {
        assert_eq!(read("raw/*.npy", "raw/a.npy"), "");
        assert_eq!(read("raw/*.npy", "raw/day1/a.npy"), "no");
        assert_eq!(read("raw/**/*.npy", "raw/a.npy"), "");
        assert_eq!(read("raw/**/*.npy", "raw/day1/am/a.npy"), "");
        assert_eq!(read("**/L{lit}.npy", "day1/L3.npy"), "lit = 3");
        assert_eq!(read("*ä*/L{lit}.npy", "prä/L3.npy"), "lit = 3");
    }

    #[test]
    fn a_repeated_placeholder_must_agree_and_two_readings_are_told() {
        assert_eq!(read("L{lit}/L{lit}_{shot}.trc", "L04/L4_1.trc"), "lit = 4, shot = 1");
        assert_eq!(read("L{lit}/L{lit}_{shot}.trc", "L4/L5_1.trc"), "no");
        let two = read("{sensor}x{channel}", "axbxc");
        assert_eq!(two, "sensor = axb, channel = c | sensor = a, channel = bxc");
        assert_eq!(read("{sensor}ch{channel}", "s1ch2"), "sensor = s1, channel = 2");
    }

    #[test]
    fn bad_patterns_are_refused_with_the_fix() {
        for (pattern, part) in [
            ("raw/L{lt}.trc", "did you mean `lit`?"),
            ("raw/L{lit}{seen}.trc", "put a sign between"),
            ("raw/**.trc", "`**/`"),
            ("raw/L{lit.trc", "close"),
            ("raw/Llit}.trc", "open"),
            ("/raw/a.trc", "relative"),
            ("raw/../a.trc", "relative"),
            ("raw\\a.trc", "`/`"),
            ("", "empty"),
        ] {
            let text = Pattern::parse(pattern).unwrap_err().to_string();
            assert!(text.contains(part), "{text}");
        }
    }

    /// A piece of a pattern, the equivalent regular expression, and a text that matches.
    fn piece() -> impl Strategy<Value = (String, String, String)> {
        let text = prop::sample::select(vec!["_", "/", "L", "P_", ".trc", "a/b", "-"]);
        prop_oneof![
            text.prop_map(|t| (t.into(), regex_lite::escape(t), t.into())),
            "[a-c_.]{0,3}".prop_map(|t| ("*".into(), "[^/]*".into(), t)),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn matches_are_those_of_a_regular_expression(
            pieces in prop::collection::vec(piece(), 0..5),
            (lit, seen) in (0_u32..200, 0_u32..200),
            noise in "[LP_/.ab0-9-]{0,12}",
        ) {
            let part = |of: fn(&(String, String, String)) -> &String| {
                pieces.iter().map(of).map(String::as_str).collect::<String>()
            };
            // A bar separates the numbers from all else, so that pattern and regular expression agree on what a number
            // is.
            let pattern = format!("x|{{lit}}|{}|{{seen}}", part(|p| &p.0));
            prop_assume!(!pattern.contains("**") && !pattern.contains("//"));
            let regex = format!(r"^x\|([0-9]+)\|{}\|([0-9]+)$", part(|p| &p.1));
            let regex = regex_lite::Regex::new(&regex).unwrap();
            let parsed = Pattern::parse(&pattern).unwrap();
            for middle in [part(|p| &p.2), noise] {
                let path = format!("x|{lit:03}|{middle}|{seen}");
                let reading = parsed.read(&path);
                prop_assert_eq!(reading != Reading::No, regex.is_match(&path), "{} {}", pattern, path);
                if let Reading::Yes(bound) = reading {
                    let (lit, seen) = (lit.to_string(), seen.to_string());
                    prop_assert_eq!(bound.get(Axis::Lit), Some(lit.as_str()));
                    prop_assert_eq!(bound.get(Axis::Seen), Some(seen.as_str()));
                }
            }
        }
    }
}
