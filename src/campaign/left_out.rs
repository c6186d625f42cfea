//! What a run does not use of a campaign, and what to do about it: words that `run`, `plan` and `check` share.

use std::fmt;
use std::path::{Path, PathBuf};

use super::manifest::Manifest;
use super::survey::Survey;

/// Number of examples in one line.
const EXAMPLES: usize = 3;

/// Why files, or lines of campaign.toml, do not enter a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// A pattern, a row of a table or an exclusion matches no file.
    MatchesNothing,
    /// A file matches no rule, and is no reference.
    NoRule,
    /// The reference of a file is missing.
    NoReference,
    /// A file is younger than the seal of its campaign.
    NotSealed,
}

impl Cause {
    /// What is wrong with so many of them, behind their number.
    #[must_use]
    pub fn words(self, count: usize) -> String {
        let (one, many) = match self {
            Self::MatchesNothing => {
                ("pattern of campaign.toml matches no file", "patterns of campaign.toml match no file")
            }
            Self::NoRule => (
                "file matches no rule of campaign.toml and is left out",
                "files match no rule of campaign.toml and are left out",
            ),
            Self::NoReference => (
                "file is left out, since its reference is missing",
                "files are left out, since their reference is missing",
            ),
            Self::NotSealed => (
                "file came since the campaign was sealed and is left out",
                "files came since the campaign was sealed and are left out",
            ),
        };
        format!("{count} {}", if count == 1 { one } else { many })
    }

    /// What to do.
    #[must_use]
    pub fn fix(self) -> &'static str {
        match self {
            Self::MatchesNothing => "Correct `files`, `file` or `match` there, or copy the files that it means.",
            Self::NoRule => "Add a [[captures]] rule that takes them, or an [[exclude]] with the reason.",
            Self::NoReference => "Copy the reference files too, or correct `reference` in the [[captures]] rule.",
            Self::NotSealed => "Take them in with `periscope seal --update`, or exclude them.",
        }
    }
}

/// What one campaign leaves out, for one cause.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LeftOut {
    /// Folder of the campaign.
    pub campaign: PathBuf,
    /// Why.
    pub cause: Cause,
    /// The files or lines, in words; never empty.
    pub items: Vec<String>,
}

/// One line: how many, why, and the first of them.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (campaign, count) = (self.campaign.display(), self.items.len());
        let more = if count > EXAMPLES { ", ..." } else { "" };
        let examples = self.items[..count.min(EXAMPLES)].join(", ");
        write!(f, "{campaign}: {}: {examples}{more}", self.cause.words(count))
    }
}

/// What the survey of a campaign leaves out, by cause. `seal`: content hashes that the campaign was sealed with.
#[must_use]
pub fn left_out(campaign: &Path, survey: &Survey, seal: Option<&Manifest>) -> Vec<LeftOut> {
    let text = |file: &Path| file.display().to_string();
    let missing = survey.missing_references.iter();
    let files = survey.files().into_iter();
    let unsealed = files.filter(|file| seal.is_some_and(|seal| seal.get(file).is_none()));
    let causes = [
        (Cause::MatchesNothing, survey.empty.clone()),
        (Cause::NoRule, survey.unmatched.iter().map(|file| text(file)).collect()),
        (
            Cause::NoReference,
            missing.map(|missing| format!("{} (wanted {})", text(&missing.file), missing.wanted)).collect(),
        ),
        (Cause::NotSealed, unsealed.map(text).collect()),
    ];
    let entry = |(cause, items): (Cause, Vec<String>)| LeftOut { campaign: campaign.to_owned(), cause, items };
    causes.into_iter().map(entry).filter(|entry| !entry.items.is_empty()).collect()
}
