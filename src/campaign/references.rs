//! The reference of an exposure: the file of its rule's reference pattern with the same lit, seen, shot, ...
//!
//! Each pattern reads all files once. A look-up then compares the values of placeholders, so that `L7` finds `C2_L007`.

use std::collections::{BTreeMap, BTreeSet};

use super::exposure::{Exposure, ReferenceSource};
use super::keys::{Axis, CaptureRule};
use super::pattern::{Bound, Pattern, Reading};

/// The files that may be references.
pub struct References<'a> {
    paths: &'a BTreeSet<&'a str>,
    by_pattern: BTreeMap<String, Index<'a>>,
}

/// The files of one pattern, by the values of its placeholders.
struct Index<'a> {
    axes: BTreeSet<Axis>,
    files: BTreeMap<Bound<'a>, Vec<&'a str>>,
}

impl<'a> References<'a> {
    /// Searches among these paths, relative to the campaign folder.
    #[must_use]
    pub fn among(paths: &'a BTreeSet<&'a str>) -> Self {
        Self { paths, by_pattern: BTreeMap::new() }
    }

    /// Adds the reference to the exposure if its rule names one. If no file exists, it returns what it searched for.
    ///
    /// # Errors
    /// When several files match, or the pattern reads one of them in two ways.
    pub fn attach(&mut self, rule: &CaptureRule, exposure: &mut Exposure) -> Result<Option<String>, String> {
        let Some(reference) = &rule.reference else {
            return Ok(None);
        };
        let (file, wanted) = match &reference.files {
            None => (exposure.file.to_str(), String::new()),
            Some(pattern) => self.find(pattern, exposure)?,
        };
        let Some(file) = file else {
            return Ok(Some(wanted));
        };
        exposure.reference = Some(ReferenceSource { file: file.into(), channel: reference.channel.clone() });
        Ok(None)
    }

    /// The file of the pattern at the coordinates of the exposure, and a description of the search.
    fn find(&mut self, text: &str, exposure: &Exposure) -> Result<(Option<&'a str>, String), String> {
        let pattern = Pattern::parse(text).map_err(|error| error.to_string())?;
        if let Some(path) = pattern.literal() {
            return Ok((self.paths.get(path).copied(), text.to_owned()));
        }
        if !self.by_pattern.contains_key(text) {
            let index = index(&pattern, text, self.paths)?;
            self.by_pattern.insert(text.to_owned(), index);
        }
        let index = &self.by_pattern[text];
        let values = index.axes.iter().filter_map(|axis| Some((*axis, coordinate(exposure, *axis)?)));
        let values: Vec<(Axis, String)> = values.collect();
        let sought = Bound::of(values.iter().map(|(axis, value)| (*axis, value.as_str())));
        let wanted = format!("{text} with {sought}");
        match answer(&index.files, &sought) {
            [] => Ok((None, wanted)),
            [file] => Ok((Some(file), wanted)),
            [one, two, ..] => Err(format!("its reference ({wanted}) may be {one} or {two}; narrow the pattern")),
        }
    }
}

/// The files of these values. The map is covariant in its keys, so a query with a shorter lifetime can be looked up.
fn answer<'q, 'a>(files: &'q BTreeMap<Bound<'q>, Vec<&'a str>>, sought: &Bound<'q>) -> &'q [&'a str] {
    files.get(sought).map_or(&[], Vec::as_slice)
}

fn index<'a>(pattern: &Pattern, text: &str, paths: &BTreeSet<&'a str>) -> Result<Index<'a>, String> {
    let mut files: BTreeMap<Bound, Vec<&str>> = BTreeMap::new();
    for path in paths {
        match pattern.read(path) {
            Reading::No => {}
            Reading::Yes(bound) => files.entry(bound).or_default().push(path),
            Reading::Ambiguous(one, two) => {
                return Err(format!(
                    "reference.files = `{text}` can read {path} in two ways: {one}; or {two}. Separate the placeholders by a sign that the names have not"
                ));
            }
        }
    }
    let axes = pattern.axes().collect();
    Ok(Index { axes, files })
}

fn coordinate(exposure: &Exposure, axis: Axis) -> Option<String> {
    match axis {
        Axis::Lit => exposure.lit.map(|lit| lit.to_string()),
        Axis::Seen => exposure.seen.map(|seen| seen.to_string()),
        Axis::Shot => exposure.shot.map(|shot| shot.to_string()),
        Axis::Sensor => exposure.sensor.clone(),
        Axis::Range => exposure.range.clone(),
        Axis::Channel => exposure.channel.clone(),
    }
}
