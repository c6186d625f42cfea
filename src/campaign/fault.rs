//! A fault in the values of a campaign file, and the checks of single values that find most faults.

use std::collections::BTreeMap;

use super::keys::Station;
use super::pattern::Pattern;
use super::suggest::hint;

/// Longest name, so that a file system takes it with what is added.
const NAME_BYTES: usize = 100;

/// Something wrong in the values of a campaign file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct Fault {
    /// The heading.
    pub place: String,
    /// What is wrong, and how to fix it.
    pub problem: String,
}

/// A heading, and checks of the values under it.
pub(super) struct At<'a>(pub(super) &'a str);

impl At<'_> {
    pub(super) fn fault(&self, problem: String) -> Fault {
        Fault { place: self.0.to_owned(), problem }
    }

    pub(super) fn check(&self, holds: bool, problem: impl FnOnce() -> String) -> Result<(), Fault> {
        if holds { Ok(()) } else { Err(self.fault(problem())) }
    }

    pub(super) fn finite(&self, key: &str, value: Option<f64>) -> Result<(), Fault> {
        self.check(value.is_none_or(f64::is_finite), || {
            format!("{key} is not a finite number; give one, or take it out")
        })
    }

    pub(super) fn positive(&self, key: &str, value: Option<f64>) -> Result<(), Fault> {
        self.finite(key, value)?;
        self.check(value.is_none_or(|v| v > 0.0), || {
            format!("{key} must be above 0; give a positive number, or take it out")
        })
    }

    pub(super) fn point(&self, key: &str, point: Option<[f64; 3]>, flat: bool) -> Result<(), Fault> {
        let Some(point) = point else { return Ok(()) };
        self.check(point.iter().all(|x| x.is_finite()), || {
            format!("{key} has a coordinate that is not finite; give three numbers")
        })?;
        self.check(!flat || point[2] == 0.0, || {
            format!("{key} leaves flatland (dimensions = 2); set its third number to 0")
        })
    }

    pub(super) fn needs(&self, key: &str, given: bool, other: &str, other_given: bool) -> Result<(), Fault> {
        self.check(!given || other_given, || format!("{key} stands without {other}; add {other}, or take {key} out"))
    }

    /// A name that becomes part of a path: of the folder of notes, or of files that are written for other programs.
    pub(super) fn name(&self, key: &str, name: &str) -> Result<(), Fault> {
        let is_plain = |c: char| c.is_alphanumeric() || matches!(c, ' ' | '.' | '-' | '_' | '+');
        let fits = name.starts_with(char::is_alphanumeric) && name.chars().all(is_plain) && name.len() <= NAME_BYTES;
        self.check(fits, || {
            format!(
                "{key} is not a plain name; begin with a letter or a digit, and go on with letters, digits, blanks, `.`, \
                 `-`, `_` and `+`, {NAME_BYTES} bytes at most"
            )
        })
    }

    /// A name that a file or an instrument may have given.
    pub(super) fn label(&self, key: &str, label: Option<&str>) -> Result<(), Fault> {
        let fits = |label: &str| !label.is_empty() && !label.contains(|c: char| c.is_control() || c == '/');
        self.check(label.is_none_or(fits), || format!("{key} is empty or has `/` in it; give a plain name"))
    }

    pub(super) fn station(
        &self,
        key: &str,
        name: Option<&str>,
        stations: &BTreeMap<String, Station>,
    ) -> Result<(), Fault> {
        let Some(name) = name else { return Ok(()) };
        self.check(stations.contains_key(name), || {
            let hint = hint(name, stations.keys().map(String::as_str));
            format!("{key} names the station `{name}`, which is not declared; add [stations.{name}] ({hint})")
        })
    }

    pub(super) fn pattern(&self, text: &str) -> Result<Pattern, Fault> {
        Pattern::parse(text).map_err(|error| self.fault(error.to_string()))
    }
}
