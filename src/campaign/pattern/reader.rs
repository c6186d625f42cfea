//! Reads paths by patterns.
//!
//! Matching backtracks over the tokens, but never into a dead end twice. A table says, for each token and place, if the
//! rest can match where every placeholder may have any value; only such states are entered, and each once for the same
//! values so far. Without a repeated placeholder every state that is entered leads to a reading, and the second reading
//! ends the search: steps are at most some number of tokens times length of the path squared. Each repeated placeholder
//! adds a factor of at most the number of its possible values in the path.

use std::collections::BTreeSet;
use std::ops::Range;

use super::{Bound, Token, Value};
use crate::campaign::keys::Axis;

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
pub(super) struct Reader<'a, 't> {
    tokens: &'t [Token],
    path: &'a str,
    reach: Reach,
    /// States that were entered: token, place, whether a star precedes, and the values so far.
    pub(super) entered: BTreeSet<(usize, usize, bool, Bound<'a>)>,
    bound: Bound<'a>,
    /// Where the placeholders so far got their values.
    values: Vec<(Axis, Range<usize>)>,
    pub(super) readings: Vec<Bound<'a>>,
    /// The places of the first reading.
    pub(super) places: Vec<(Axis, Range<usize>)>,
}

impl<'a, 't> Reader<'a, 't> {
    /// Reads the whole path.
    pub(super) fn of(tokens: &'t [Token], path: &'a str) -> Self {
        let mut reader = Self {
            tokens,
            path,
            reach: Reach::new(tokens, path),
            entered: BTreeSet::new(),
            bound: Bound::default(),
            values: Vec::new(),
            readings: Vec::new(),
            places: Vec::new(),
        };
        reader.walk(false, 0, 0);
        reader
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
