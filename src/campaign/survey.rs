//! Which file of a campaign folder is which exposure: the rules of campaign.toml laid over the files that are there.
//!
//! Nothing is dropped in silence: files that no rule takes, patterns and rows that take nothing, exposures whose reference pulse is missing,
//! and what an exclusion leaves out are all listed. Two rules that take the same record are an error.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use super::captures_table::{self, TableError};
use super::check_captures;
use super::exclusions::Exclusions;
use super::exposure::Exposure;
use super::keys::{Axis, Campaign, CaptureRule, RecordKeys, Role, exclude_place, rule_place};
use super::pattern::{Bound, Pattern, Reading};
use super::references::References;
use super::walk;
use crate::units::PatchId;

/// What the rules make of the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// The exposures, sorted by file, channel and segment.
    pub exposures: Vec<Exposure>,
    /// Exposures whose reference file is not there. They are not among `exposures`: without their reference they would be taken as
    /// relative to the trigger.
    pub missing_references: Vec<MissingReference>,
    /// Files that no rule takes and that are no reference.
    pub unmatched: Vec<PathBuf>,
    /// Patterns, rows of tables and exclusions that take nothing.
    pub empty: Vec<String>,
    /// Files left out, or of which a record is left out, each with the reason.
    pub excluded: Vec<(PathBuf, String)>,
}

/// An exposure without its reference.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingReference {
    /// The exposure's file, relative to the campaign folder.
    pub file: PathBuf,
    /// The pattern and the values for which no file is there.
    pub wanted: String,
}

impl Survey {
    /// The raw files of all exposures, their references included, each once.
    #[must_use]
    pub fn files(&self) -> BTreeSet<&Path> {
        let own = self.exposures.iter().map(|e| e.file.as_path());
        let references = self.exposures.iter().filter_map(|e| e.reference.as_ref());
        own.chain(references.map(|r| r.file.as_path())).collect()
    }
}

/// Why the files cannot be told apart.
#[derive(Debug, thiserror::Error)]
pub enum SurveyError {
    /// A folder cannot be read.
    #[error("{}: cannot be read; check that it exists and its permissions", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A table of captures is wrong.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A rule does not fit a file that it takes.
    #[error("{place}, file {}: {problem}", file.display())]
    File {
        /// The rule or row.
        place: String,
        /// The file, relative to the campaign folder.
        file: PathBuf,
        /// What is wrong, and the mend.
        problem: String,
    },
    /// Two rules take the same record.
    #[error("{}: taken by {first} and by {second}; narrow one of them, or name different channels", file.display())]
    Clash {
        /// The file, relative to the campaign folder.
        file: PathBuf,
        /// One rule or row.
        first: String,
        /// The other.
        second: String,
    },
}

impl Campaign {
    /// Lays the rules over the files of the campaign folder.
    ///
    /// # Errors
    /// When a folder or table cannot be read, a file does not fit the rule that takes it, or two rules take the same record.
    pub fn survey(&self) -> Result<Survey, SurveyError> {
        let mut files = walk::files(&self.root)
            .map_err(|(folder, source)| SurveyError::Folder { folder, source })?;
        files.retain(|file| !self.captures.iter().any(|rule| rule.table.as_ref() == Some(file)));
        let paths: BTreeSet<&str> = files.iter().filter_map(|file| file.to_str()).collect();
        let mut surveyor = Surveyor {
            campaign: self,
            exclusions: Exclusions::of(self),
            references: References::among(&paths),
            paths: &paths,
            claims: Vec::new(),
            taken: BTreeSet::new(),
            excludes_used: BTreeSet::new(),
            survey: Survey::default(),
        };
        for (index, rule) in self.captures.iter().enumerate() {
            if let Some(files) = &rule.files {
                surveyor.lay_pattern(index, rule, files)?;
            }
            if let Some(table) = &rule.table {
                surveyor.lay_table(index, rule, table)?;
            }
        }
        surveyor.finish(&files)
    }
}

/// A survey in the making.
struct Surveyor<'a> {
    campaign: &'a Campaign,
    exclusions: Exclusions<'a>,
    references: References<'a>,
    paths: &'a BTreeSet<&'a str>,
    claims: Vec<Claim>,
    /// Files that a rule took, and their references.
    taken: BTreeSet<PathBuf>,
    excludes_used: BTreeSet<usize>,
    survey: Survey,
}

impl Surveyor<'_> {
    fn lay_pattern(&mut self, index: usize, rule: &CaptureRule, files: &str) -> Result<(), SurveyError> {
        let pattern = Pattern::parse(files).expect("checked when the campaign was loaded");
        let keys = Arc::new(rule.record_keys());
        let source = Source { rule: index, row: None };
        let mut matched = false;
        for path in self.paths {
            let bound = match pattern.read(path) {
                Reading::No => continue,
                Reading::Yes(bound) => bound,
                Reading::Ambiguous(one, two) => {
                    let problem = format!(
                        "`{files}` can be read in two ways: {one}; or {two}. Separate the placeholders by a sign that the names have not"
                    );
                    return Err(self.error(source, path, problem));
                }
            };
            matched = true;
            self.take(source, rule, &keys, path, &bound, None)?;
        }
        if !matched {
            self.survey.empty.push(format!("{}: files = \"{files}\"", rule_place(index)));
        }
        Ok(())
    }

    fn lay_table(&mut self, index: usize, rule: &CaptureRule, table: &Path) -> Result<(), SurveyError> {
        for row in captures_table::read(&self.campaign.root, table, rule)? {
            let source = Source { rule: index, row: Some(row.number) };
            let place = source.place(self.campaign);
            if !self.paths.contains(row.file.as_str()) {
                self.survey.empty.push(format!("{place}: file = \"{}\"", row.file));
                continue;
            }
            check_captures::rule(&row.rule, &place, &self.campaign.sensors)
                .map_err(|fault| self.error(source, &row.file, fault.problem))?;
            let keys = Arc::new(row.rule.record_keys());
            self.take(source, &row.rule, &keys, &row.file, &Bound::default(), row.segment)?;
        }
        Ok(())
    }

    /// Makes an exposure of a file, and puts it where it belongs: left out, without its reference, or among the exposures.
    fn take(
        &mut self,
        source: Source,
        rule: &CaptureRule,
        keys: &Arc<RecordKeys>,
        file: &str,
        bound: &Bound,
        segment: Option<u32>,
    ) -> Result<(), SurveyError> {
        let mut exposure = exposure(self.campaign, source.rule, rule, keys, file, bound)
            .map_err(|problem| self.error(source, file, problem))?;
        exposure.segment = segment;
        let missing = self.references.attach(rule, &mut exposure)
            .map_err(|problem| self.error(source, file, problem))?;
        self.taken.insert(exposure.file.clone());
        if let Some(reference) = &exposure.reference {
            self.taken.insert(reference.file.clone());
        }
        if let Some((number, reason)) = self.exclusions.of_exposure(&exposure) {
            self.excludes_used.insert(number);
            self.survey.excluded.push((exposure.file, reason.to_owned()));
        } else if let Some(wanted) = missing {
            self.survey.missing_references.push(MissingReference { file: exposure.file, wanted });
        } else {
            self.claims.push(Claim { exposure, source });
        }
        Ok(())
    }

    fn finish(mut self, files: &[PathBuf]) -> Result<Survey, SurveyError> {
        self.claims.sort_by(|a, b| a.order().cmp(&b.order()));
        self.refuse_clashes()?;
        for file in files.iter().filter(|file| !self.taken.contains(*file)) {
            match self.exclusions.of_file(file) {
                Some((number, reason)) => {
                    self.excludes_used.insert(number);
                    self.survey.excluded.push((file.clone(), reason.to_owned()));
                }
                None => self.survey.unmatched.push(file.clone()),
            }
        }
        for (number, exclude) in self.campaign.exclude.iter().enumerate() {
            let may_mean = |claim: &Claim| self.exclusions.may_mean(number, &claim.exposure);
            if !self.excludes_used.contains(&number) && !self.claims.iter().any(may_mean) {
                let place = exclude_place(number);
                self.survey.empty.push(format!("{place}: reason = \"{}\"", exclude.reason));
            }
        }
        self.survey.excluded.sort();
        self.survey.excluded.dedup();
        self.survey.exposures = self.claims.into_iter().map(|claim| claim.exposure).collect();
        Ok(self.survey)
    }

    /// No record may be two exposures, and no file of references an exposure.
    fn refuse_clashes(&self) -> Result<(), SurveyError> {
        let clash = |file: &Path, first: &Claim, second: String| SurveyError::Clash {
            file: file.to_owned(),
            first: first.source.place(self.campaign),
            second,
        };
        for records in self.claims.chunk_by(|a, b| a.exposure.file == b.exposure.file) {
            if let Some((first, second)) = same_record(records) {
                let second = second.source.place(self.campaign);
                return Err(clash(&first.exposure.file, first, second));
            }
        }
        let of_files = |claim: &&Claim| matches!(&claim.exposure.reference, Some(r) if r.channel.is_none());
        for claim in self.claims.iter().filter(of_files) {
            let Some(reference) = &claim.exposure.reference else { continue };
            let at = self.claims.partition_point(|other| other.exposure.file < reference.file);
            if let Some(other) = self.claims.get(at).filter(|o| o.exposure.file == reference.file) {
                let second = format!("{} as a reference", claim.source.place(self.campaign));
                return Err(clash(&reference.file, other, second));
            }
        }
        Ok(())
    }

    fn error(&self, source: Source, file: &str, problem: String) -> SurveyError {
        SurveyError::File { place: source.place(self.campaign), file: file.into(), problem }
    }
}

/// The rule, or the row of its table, that speaks of a file.
#[derive(Clone, Copy, Debug)]
struct Source {
    rule: usize,
    row: Option<u64>,
}

impl Source {
    fn place(self, campaign: &Campaign) -> String {
        match (self.row, &campaign.captures[self.rule].table) {
            (Some(row), Some(table)) => format!("{}, row {row}", table.display()),
            _ => rule_place(self.rule),
        }
    }
}

struct Claim {
    exposure: Exposure,
    source: Source,
}

impl Claim {
    fn order(&self) -> (&Path, Option<&str>, Option<u32>, usize) {
        let Exposure { file, channel, segment, rule, .. } = &self.exposure;
        (file, channel.as_deref(), *segment, *rule)
    }
}

/// Two claims to the same record of one file: a claim without channel (or segment) claims all of them.
fn same_record(claims: &[Claim]) -> Option<(&Claim, &Claim)> {
    // Each claim is entered as what it is, and as one of any channel, of any segment, of any of both; so that a search never has to look at all of them.
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

