//! Stops a run that rejects too much, and says why.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

use crate::store::{Shelf, StoreError};
use crate::tables::{Reject, Row};

/// How much a run may reject.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MaxRejects {
    /// This many rows of `rejects`.
    Rows(u64),
    /// This share of the campaigns' records, from 0 to 1.
    Share(f64),
}

impl MaxRejects {
    /// The same in rows, for campaigns with this many records.
    #[must_use]
    pub fn most(self, records: u64) -> u64 {
        match self {
            Self::Rows(rows) => rows,
            Self::Share(share) => (share * records as f64) as u64,
        }
    }
}

impl FromStr for MaxRejects {
    type Err = String;

    /// Parses `20` and `5%`.
    fn from_str(text: &str) -> Result<Self, String> {
        let refused =
            || format!("`{text}` is neither a number of records, such as 20, nor a share of them, such as 5%");
        let Some(percent) = text.strip_suffix('%') else {
            return text.parse().map(Self::Rows).map_err(|_| refused());
        };
        let percent: f64 = percent.trim().parse().map_err(|_| refused())?;
        if (0.0..=100.0).contains(&percent) { Ok(Self::Share(percent / 100.0)) } else { Err(refused()) }
    }
}

/// The run rejected more than it may.
#[derive(Debug, Error)]
#[error(
    "{count} of {records} records were rejected, and --max-rejects allows {most}; {alike} of them alike: {example}. {rejects} lists all. \
     Fix that, or allow more: what is finished is kept"
)]
pub struct TooMany {
    /// Rejected rows so far.
    pub count: u64,
    /// Most rows that may be rejected.
    pub most: u64,
    /// Records of the campaigns.
    pub records: u64,
    /// Rows with the most common reason.
    pub alike: usize,
    /// One of these: its file and its reason.
    pub example: String,
    /// The view that lists them.
    pub rejects: PathBuf,
}

impl TooMany {
    /// Finds the most common reason in the present table `rejects`.
    pub(super) fn of(shelf: &Shelf, count: u64, most: u64, records: u64) -> Result<Self, StoreError> {
        let rows = rows(shelf)?;
        let (alike, example) = kinds(&rows).first().map(|(alike, row)| (*alike, words(row))).unwrap_or_default();
        Ok(Self { count, most, records, alike, example, rejects: shelf.out().join(Reject::TABLE) })
    }
}

/// The present table `rejects`.
///
/// # Errors
/// When it cannot be read.
pub fn rows(shelf: &Shelf) -> Result<Vec<Reject>, StoreError> {
    let batches = shelf.batches(Reject::TABLE)?;
    Ok(batches.iter().flat_map(|batch| Reject::rows(batch).expect("the runtime itself wrote these rows")).collect())
}

/// The reasons of each stage, most common first: number of rows, and the first of them.
#[must_use]
pub fn kinds(rows: &[Reject]) -> Vec<(usize, &Reject)> {
    let mut kinds: BTreeMap<(&str, String), (usize, &Reject)> = BTreeMap::new();
    for row in rows {
        kinds.entry((&row.stage, kind(row))).or_insert((0, row)).0 += 1;
    }
    let mut kinds: Vec<(usize, &Reject)> = kinds.into_values().collect();
    // The sort is stable: equally common reasons stay in alphabetical order.
    kinds.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    kinds
}

/// A row in words: its file, and why.
#[must_use]
pub fn words(row: &Reject) -> String {
    let file = row.file.as_ref().map_or(String::new(), |file| format!("{file}: "));
    format!("{file}{}", row.reason)
}

/// A reason without what is specific to one file: its name, and numbers.
fn kind(row: &Reject) -> String {
    let reason = row.file.as_ref().map_or(row.reason.to_string(), |file| row.reason.replace(&**file, ""));
    reason.chars().filter(|c| !c.is_ascii_digit()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_numbers_or_shares() {
        assert_eq!("20".parse(), Ok(MaxRejects::Rows(20)));
        assert_eq!("5%".parse(), Ok(MaxRejects::Share(0.05)));
        assert_eq!("0.5 %".parse::<MaxRejects>().unwrap().most(1000), 5);
        for text in ["", "%", "-1", "101%", "many", "5.5"] {
            assert!(text.parse::<MaxRejects>().unwrap_err().contains("such as 5%"), "{text}");
        }
    }

    #[test]
    fn reasons_that_differ_in_names_and_numbers_are_alike() {
        let row = |file: &str, reason: &str| Reject {
            stage: "traces".into(),
            campaign: "c".into(),
            file: Some(file.into()),
            segment: None,
            byte_offset: None,
            reason: reason.into(),
        };
        let rows = [
            row("a.trc", "is empty"),
            row("b1.trc", "b1.trc ends at byte 17"),
            row("b2.trc", "b2.trc ends at byte 2304"),
        ];
        let in_words = |rows: &[Reject]| -> Vec<(usize, String)> {
            kinds(rows).into_iter().map(|(count, row)| (count, words(row))).collect()
        };
        let expected = [(2, "b1.trc: b1.trc ends at byte 17".to_owned()), (1, "a.trc: is empty".to_owned())];
        assert_eq!(in_words(&rows), expected);
        assert_eq!(in_words(&[]), []);
    }
}
