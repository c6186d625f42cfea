//! Claims of rules on records, and where two of them clash.

use std::collections::BTreeMap;
use std::path::Path;

use super::exposure::{Exposure, ReferenceSource};
use super::keys::{Campaign, rule_place};

/// The rule, or the row of its table, that claims a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    pub(super) rule: usize,
    pub(super) row: Option<u64>,
}

impl Source {
    pub(super) fn place(self, campaign: &Campaign) -> String {
        match (self.row, &campaign.captures[self.rule].table) {
            (Some(row), Some(table)) => format!("{}, row {row}", table.display()),
            _ => rule_place(self.rule),
        }
    }
}

/// An exposure, and the rule that claims it.
#[derive(Clone, Debug)]
pub(super) struct Claim {
    pub(super) exposure: Exposure,
    pub(super) source: Source,
}

impl Claim {
    /// The order of exposures in a survey.
    pub(super) fn order(&self) -> (&Path, Option<&str>, Option<u32>, usize) {
        let Exposure { file, channel, segment, rule, .. } = &self.exposure;
        (file, channel.as_deref(), *segment, *rule)
    }
}

/// The first clash: the file, and its two claims. Either both claim the same record, or one claims an exposure and the
/// other uses it as a reference. The claims must be sorted by [`Claim::order`].
pub(super) fn first_clash(claims: &[Claim]) -> Option<(&Path, Source, Source)> {
    for records in claims.chunk_by(|a, b| a.exposure.file == b.exposure.file) {
        if let Some((first, second)) = same_record(records) {
            return Some((&first.exposure.file, first.source, second.source));
        }
    }
    for claim in claims {
        // A reference with a channel is in the exposure's own file.
        let Some(ReferenceSource { file, channel: None }) = &claim.exposure.reference else {
            continue;
        };
        let at = claims.partition_point(|other| other.exposure.file < *file);
        if let Some(other) = claims.get(at).filter(|other| other.exposure.file == *file) {
            return Some((file, other.source, claim.source));
        }
    }
    None
}

/// Two claims on the same record of one file. A claim without channel (or segment) claims all of them.
fn same_record(claims: &[Claim]) -> Option<(&Claim, &Claim)> {
    // Each claim is entered four times: as itself, for any channel, for any segment, for any of both. Look-ups then
    // replace a search through all claims.
    let mut entered: BTreeMap<(Part<&str>, Part<u32>), &Claim> = BTreeMap::new();
    for claim in claims {
        let (channel, segment) = (claim.exposure.channel.as_deref(), claim.exposure.segment);
        for channel in clashing(channel) {
            for segment in clashing(segment) {
                if let Some(other) = entered.get(&(channel, segment)) {
                    return Some((other, claim));
                }
            }
        }
        for channel in [Part::Any, Part::Is(channel)] {
            for segment in [Part::Any, Part::Is(segment)] {
                entered.entry((channel, segment)).or_insert(claim);
            }
        }
    }
    None
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Part<T> {
    Any,
    Is(Option<T>),
}

fn clashing<T: Copy>(part: Option<T>) -> Vec<Part<T>> {
    match part {
        None => vec![Part::Any],
        some => vec![Part::Is(some), Part::Is(None)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(rule: usize, file: &str, channel: Option<&str>, segment: Option<u32>) -> Claim {
        Claim {
            exposure: Exposure { rule, channel: channel.map(str::to_owned), segment, ..Exposure::of_file(file) },
            source: Source { rule, row: None },
        }
    }

    #[test]
    fn clashes_are_those_of_a_comparison_of_all_pairs() {
        let parts = [None, Some(0), Some(1)];
        let records: Vec<(Option<&str>, Option<u32>)> = [None, Some("C1"), Some("C2")]
            .into_iter()
            .flat_map(|channel| parts.map(|segment| (channel, segment)))
            .collect();
        let meet = |a: usize, b: usize| {
            let ((ca, sa), (cb, sb)) = (records[a], records[b]);
            (ca == cb || ca.is_none() || cb.is_none()) && (sa == sb || sa.is_none() || sb.is_none())
        };
        let count = records.len();
        for (a, b, c) in (0..count.pow(3)).map(|n| (n % count, n / count % count, n / count / count)) {
            let chosen = [a, b, c].map(|i| claim(i, "f", records[i].0, records[i].1));
            let expected = meet(a, b) || meet(a, c) || meet(b, c);
            assert_eq!(same_record(&chosen).is_some(), expected, "{a} {b} {c}");
        }
    }

    #[test]
    fn a_reference_that_is_an_exposure_clashes_unless_it_is_a_channel() {
        let mut claims = [claim(0, "a", None, None), claim(1, "b", None, None)];
        assert!(first_clash(&claims).is_none());
        let reference =
            |channel: Option<&str>| ReferenceSource { file: "b".into(), channel: channel.map(str::to_owned) };
        claims[1].exposure.reference = Some(reference(Some("C2")));
        assert!(first_clash(&claims).is_none());
        claims[0].exposure.reference = Some(reference(None));
        let (file, first, second) = first_clash(&claims).unwrap();
        assert_eq!((file, first.rule, second.rule), (Path::new("b"), 1, 0));
    }
}
