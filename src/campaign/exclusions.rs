//! Applies the `[[exclude]]` headings: which exposures to omit, and why.

use std::path::Path;

use super::exposure::Exposure;
use super::keys::{Campaign, Exclude, Match};
use super::pattern::{Pattern, Reading};

/// The exclusions of a campaign, with parsed patterns.
#[derive(Clone, Debug)]
pub struct Exclusions<'a>(Vec<(&'a Exclude, Option<Pattern>)>);

impl<'a> Exclusions<'a> {
    /// Those of a checked campaign.
    #[must_use]
    pub fn of(campaign: &'a Campaign) -> Self {
        let parsed = |exclude: &'a Exclude| {
            let file = exclude.matches.file.as_deref();
            let pattern = file.map(|file| Pattern::parse(file).expect("checked when the campaign was loaded"));
            (exclude, pattern)
        };
        Self(campaign.exclude.iter().map(parsed).collect())
    }

    /// The first exclusion that certainly matches this exposure: its number (from 0) and its reason. A coordinate that
    /// comes from the segments of the file is not known here: call this again for each segment, with the coordinate
    /// filled in.
    #[must_use]
    pub fn of_exposure(&self, exposure: &Exposure) -> Option<(usize, &'a str)> {
        self.first(|exclude, pattern| means(&exclude.matches, pattern, exposure) == Some(true))
    }

    /// The first exclusion that gives only files, this one among them.
    #[must_use]
    pub fn of_file(&self, file: &Path) -> Option<(usize, &'a str)> {
        self.first(|exclude, pattern| {
            let mut rest = exclude.matches.clone();
            rest.file = None;
            rest == Match::default() && pattern.is_some_and(|p| takes(p, file))
        })
    }

    /// Whether exclusion `number` matches this exposure, or may match some segments of its file.
    #[must_use]
    pub fn may_mean(&self, number: usize, exposure: &Exposure) -> bool {
        let (exclude, pattern) = &self.0[number];
        means(&exclude.matches, pattern.as_ref(), exposure) != Some(false)
    }

    fn first(&self, holds: impl Fn(&Exclude, Option<&Pattern>) -> bool) -> Option<(usize, &'a str)> {
        let index = self.0.iter().position(|(exclude, pattern)| holds(exclude, pattern.as_ref()))?;
        Some((index, self.0[index].0.reason.as_str()))
    }
}

/// Whether the keys match; `None` if the exposure leaves a coordinate to the segments of its file.
fn means(keys: &Match, pattern: Option<&Pattern>, exposure: &Exposure) -> Option<bool> {
    let verdicts = [
        same(keys.role.as_ref(), Some(&exposure.role)),
        same(keys.sensor.as_ref(), exposure.sensor.as_ref()),
        same(keys.lit.as_ref(), exposure.lit.as_ref()),
        same(keys.seen.as_ref(), exposure.seen.as_ref()),
        same(keys.shot.as_ref(), exposure.shot.as_ref()),
        same(keys.range.as_ref(), exposure.range.as_ref()),
        same(keys.channel.as_ref(), exposure.channel.as_ref()),
        Some(pattern.is_none_or(|pattern| takes(pattern, &exposure.file))),
    ];
    if verdicts.contains(&Some(false)) {
        return Some(false);
    }
    verdicts.iter().all(Option::is_some).then_some(true)
}

fn same<T: PartialEq>(key: Option<&T>, value: Option<&T>) -> Option<bool> {
    match (key, value) {
        (None, _) => Some(true),
        (Some(key), Some(value)) => Some(key == value),
        (Some(_), None) => None,
    }
}

fn takes(pattern: &Pattern, file: &Path) -> bool {
    file.to_str().is_some_and(|file| pattern.read(file) != Reading::No)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exposure() -> Exposure {
        Exposure { sensor: Some("s1".into()), lit: Some(1), ..Exposure::of_file("raw/L1.trc") }
    }

    fn campaign(matches: &[&str]) -> Campaign {
        let exclude = |keys: &&str| format!("[[exclude]]\nmatch = {{ {keys} }}\nreason = 'r'\n");
        let excludes: String = matches.iter().map(exclude).collect();
        let text = format!("[campaign]\nname = 'c'\n[sensors.s1]\n[sensors.s2]\n{excludes}");
        Campaign::parse(Path::new("."), &text).unwrap()
    }

    #[test]
    fn all_keys_must_hold_and_an_open_coordinate_decides_nothing() {
        for (keys, sure, may) in [
            ("lit = 1", true, true),
            ("lit = 2", false, false),
            ("lit = 1, sensor = 's2'", false, false),
            ("lit = 1, seen = 4", false, true),
            ("lit = 2, seen = 4", false, false),
            ("role = 'scene', file = 'raw/L1*'", true, true),
            ("role = 'dark'", false, false),
            ("file = '**/L2.trc'", false, false),
        ] {
            let campaign = campaign(&[keys]);
            let exclusions = Exclusions::of(&campaign);
            assert_eq!(exclusions.of_exposure(&exposure()).is_some(), sure, "{keys}");
            assert_eq!(exclusions.may_mean(0, &exposure()), may, "{keys}");
        }
        let filled = Exposure { seen: Some(4), ..exposure() };
        let campaign = campaign(&["lit = 1, seen = 4"]);
        assert_eq!(Exclusions::of(&campaign).of_exposure(&filled), Some((0, "r")));
    }

    #[test]
    fn only_an_exclusion_of_files_means_files_that_no_rule_takes() {
        let campaign = campaign(&["lit = 1, file = 'notes/*'", "file = 'notes/*'"]);
        let exclusions = Exclusions::of(&campaign);
        assert_eq!(exclusions.of_file(Path::new("notes/a.pdf")), Some((1, "r")));
        assert_eq!(exclusions.of_file(Path::new("raw/a.pdf")), None);
    }
}
