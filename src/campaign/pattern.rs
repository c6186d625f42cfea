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
//!
//! Matching backtracks over the tokens, but never into a dead end twice. A table says, for each token and place, if the
//! rest can match where every placeholder may have any value; only such states are entered, and each once for the same
//! values so far. Without a repeated placeholder every state that is entered leads to a reading, and the second reading
//! ends the search: steps are at most some number of tokens times length of the path squared. Each repeated placeholder
//! adds a factor of at most the number of its possible values in the path.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Range;

use super::keys::Axis;
use super::suggest::hint;

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
        let mut reader = Reader::new(&self.tokens, path);
        reader.walk(false, 0, 0);
        match reader.readings.as_slice() {
            [] => Reading::No,
            [one] => Reading::Yes(*one),
            [one, two, ..] => Reading::Ambiguous(*one, *two),
        }
    }

    /// A matching path with `*` for each value of this placeholder: what files that differ only there have in common.
    #[must_use]
    pub fn starred(&self, path: &str, axis: Axis) -> String {
        let mut reader = Reader::new(&self.tokens, path);
        reader.walk(false, 0, 0);
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

/// Which states can lead to the end of the path, if every placeholder may have any value.
struct Reach {
    /// By token and place: without a star before it, and with one.
    ends: Vec<[bool; 2]>,
    places: usize,
}

impl Reach {
    fn new(tokens: &[Token], path: &str) -> Self {
        let (bytes, places) = (path.as_bytes(), path.len() + 1);
        let mut reach = Self { ends: vec![[false; 2]; (tokens.len() + 1) * places], places };
        reach.ends[tokens.len() * places + path.len()] = [true; 2];
        for (index, token) in tokens.iter().enumerate().rev() {
            // For a star: whether some place from here to the end of the folder does; for folders: one behind a `/`.
            let mut further = false;
            for at in (0..places).rev() {
                let next = bytes.get(at);
                let ends = match token {
                    Token::Text(text) => {
                        bytes[at..].starts_with(text.as_bytes()) && reach.from(index + 1, at + text.len(), false)
                    }
                    Token::Star => {
                        further = reach.from(index + 1, at, true) || (further && next != Some(&b'/'));
                        further
                    }
                    Token::Folders => {
                        further |= next == Some(&b'/') && reach.from(index + 1, at + 1, false);
                        further || reach.from(index + 1, at, false)
                    }
                    Token::Value(value) => lengths(*value, tokens.get(index + 1), &bytes[at..])
                        .any(|length| reach.from(index + 1, at + length, false)),
                };
                let cut = matches!(token, Token::Value(value) if is_cut(*value, bytes, at));
                reach.ends[index * places + at] = [ends, ends && !cut];
            }
        }
        reach
    }

    fn from(&self, token: usize, at: usize, after_star: bool) -> bool {
        self.ends[token * self.places + at][usize::from(after_star)]
    }
}

/// Possible lengths of a value at the start of `tail`. Before text any length is possible (`{sensor}x{channel}`).
/// Before a star only the whole run is, or the star would cut a number or a name in two.
fn lengths(value: Value, next: Option<&Token>, tail: &[u8]) -> impl DoubleEndedIterator<Item = usize> + use<> {
    let longest = tail.iter().take_while(|byte| value.takes(**byte)).count();
    let shortest = if matches!(next, Some(Token::Text(_))) { 1 } else { longest.max(1) };
    shortest..=longest
}

/// Whether a value here, behind a star, would be the rest of a longer one.
fn is_cut(value: Value, path: &[u8], at: usize) -> bool {
    at > 0 && value.takes(path[at - 1])
}

/// A backtracking reader. It collects readings with different values, and stops at the second.
struct Reader<'a, 't> {
    tokens: &'t [Token],
    path: &'a str,
    reach: Reach,
    /// States that were entered: token, place, whether a star precedes, and the values so far.
    entered: BTreeSet<(usize, usize, bool, Bound<'a>)>,
    bound: Bound<'a>,
    /// Where the placeholders so far got their values.
    values: Vec<(Axis, Range<usize>)>,
    readings: Vec<Bound<'a>>,
    /// The places of the first reading.
    places: Vec<(Axis, Range<usize>)>,
}

impl<'a, 't> Reader<'a, 't> {
    fn new(tokens: &'t [Token], path: &'a str) -> Self {
        Self {
            tokens,
            path,
            reach: Reach::new(tokens, path),
            entered: BTreeSet::new(),
            bound: Bound::default(),
            values: Vec::new(),
            readings: Vec::new(),
            places: Vec::new(),
        }
    }

    /// Reads the path from byte `at` by the tokens from `index` on. `after_star`: a star precedes.
    fn walk(&mut self, after_star: bool, index: usize, at: usize) {
        let is_over = self.readings.len() > 1 || !self.reach.from(index, at, after_star);
        if is_over || !self.entered.insert((index, at, after_star, self.bound)) {
            return;
        }
        let Some(token) = self.tokens.get(index) else {
            if !self.readings.contains(&self.bound) {
                if self.readings.is_empty() {
                    self.places.clone_from(&self.values);
                }
                self.readings.push(self.bound);
            }
            return;
        };
        let tail = &self.path.as_bytes()[at..];
        match token {
            Token::Text(text) => self.walk(false, index + 1, at + text.len()),
            Token::Star => {
                let end = tail.iter().position(|b| *b == b'/').unwrap_or(tail.len());
                for length in 0..=end {
                    self.walk(true, index + 1, at + length);
                }
            }
            Token::Folders => {
                self.walk(false, index + 1, at);
                for (length, _) in tail.iter().enumerate().filter(|(_, b)| **b == b'/') {
                    self.walk(false, index + 1, at + length + 1);
                }
            }
            Token::Value(value) => self.value(*value, index, at),
        }
    }

    fn value(&mut self, value: Value, index: usize, at: usize) {
        let path = self.path;
        let bound_before = self.bound;
        for length in lengths(value, self.tokens.get(index + 1), &path.as_bytes()[at..]).rev() {
            let mut text = &path[at..at + length];
            if value.axis.is_number() {
                text = without_leading_zeros(text);
            }
            if bound_before.get(value.axis).is_none_or(|bound_before| bound_before == text) {
                self.bound.0[value.axis as usize] = Some(text);
                self.values.push((value.axis, at..at + length));
                self.walk(false, index + 1, at + length);
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
    fn no_pattern_takes_long() {
        let started = std::time::Instant::now();
        let long = "a".repeat(200);
        assert_eq!(read(&"*a".repeat(30), &format!("{long}b")), "no");
        assert_eq!(read(&("*a".repeat(30) + "*{lit}"), &format!("{long}7")), "lit = 7");
        assert_eq!(read(&("**/".repeat(60) + "x"), &("a/".repeat(200) + "y")), "no");
        assert_eq!(read("*{sensor}*{channel}*{range}*.x", &"a.".repeat(100)), "no");
        let equal = read("*{sensor}*{channel}*{range}*", &"a.".repeat(100));
        assert_eq!(equal, "sensor = a, range = a, channel = a");
        let two = read("*{sensor}*{channel}*{range}*", &"a.b.".repeat(50));
        assert!(two.contains('|'), "{two}");
        let distinct = (0..60).map(|n| format!("a{n}")).collect::<Vec<_>>().join(".");
        assert_eq!(read("*{sensor}*{sensor}*{range}*{range}*", &distinct), "no");
        assert!(started.elapsed().as_secs() < 2, "{:?}", started.elapsed());
        let text = Pattern::parse(&"a*".repeat(40)).unwrap_err().to_string();
        assert!(text.contains("64 are enough"), "{text}");
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
