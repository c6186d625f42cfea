//! Which file of a campaign folder is which exposure: applies the rules of campaign.toml to the files that exist.
//!
//! Nothing is dropped silently. The survey lists files without a rule, patterns and rows that match nothing, exposures
//! without their reference pulse, and excluded files. Two rules that claim the same record are an error.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::captures_table::{self, TableError};
use super::check_captures;
use super::claims::{self, Claim, Source};
use super::exclusions::Exclusions;
use super::exposure::{Exposure, exposure};
use super::keys::{Campaign, CaptureRule, RecordKeys, exclude_place, rule_place};
use super::pattern::{Bound, Pattern, Reading};
use super::references::References;
use super::walk;
use crate::formats::companions::companion;

/// The result of applying the rules to the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// The exposures, sorted by file, channel and segment.
    pub exposures: Vec<Exposure>,
    /// Exposures whose reference file is missing. They are not among `exposures`: without their reference, their times
    /// would be taken as relative to the trigger.
    pub missing_references: Vec<MissingReference>,
    /// Files that match no rule and are no reference.
    pub unmatched: Vec<PathBuf>,
    /// Patterns, rows of tables and exclusions that match nothing.
    pub empty: Vec<String>,
    /// Files that are excluded, or have an excluded record, each with the reason.
    pub excluded: Vec<(PathBuf, String)>,
}

/// An exposure without its reference.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingReference {
    /// The exposure's file, relative to the campaign folder.
    pub file: PathBuf,
    /// The pattern and the values for which no file exists.
    pub wanted: String,
}

impl Survey {
    /// The raw files of all exposures, references included, each once.
    #[must_use]
    pub fn files(&self) -> BTreeSet<&Path> {
        self.exposures.iter().flat_map(|exposure| exposure.files().map(PathBuf::as_path)).collect()
    }
}

/// Why the rules cannot be applied.
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
    /// A rule does not fit a file that it matches.
    #[error("{place}, file {}: {problem}", file.display())]
    File {
        /// The rule or row.
        place: String,
        /// The file, relative to the campaign folder.
        file: PathBuf,
        /// What is wrong, and how to fix it.
        problem: String,
    },
    /// Two rules claim the same record.
    #[error("{}: taken by {first}{}; narrow one of them, or name different channels", file.display(), and_by(first, second))]
    Clash {
        /// The file, relative to the campaign folder.
        file: PathBuf,
        /// One rule or row.
        first: String,
        /// The other.
        second: String,
    },
}

/// The second of two claims. A rule clashes with itself if its reference is one of its own files.
fn and_by(first: &str, second: &str) -> String {
    if first == second { " as signal and as reference".to_owned() } else { format!(" and by {second}") }
}

impl Campaign {
    /// Applies the rules to the files of the campaign folder.
    ///
    /// # Errors
    /// When a folder or table cannot be read, a file does not fit its rule, or two rules claim the same record.
    pub fn survey(&self) -> Result<Survey, SurveyError> {
        let raw_files = walk::files(&self.root).map_err(|(folder, source)| SurveyError::Folder { folder, source })?;
        let mut files: Vec<PathBuf> = raw_files.into_iter().map(|file| file.path).collect();
        files.retain(|file| self.settled.as_ref().is_none_or(|settled| settled.contains(file)));
        files.retain(|file| !self.captures.iter().any(|rule| rule.table.as_ref() == Some(file)));
        let mut paths: BTreeSet<&str> = files.iter().filter_map(|file| file.to_str()).collect();
        let companions: BTreeSet<PathBuf> = paths.iter().filter_map(|path| companion(Path::new(path))).collect();
        // A companion is no recording of its own, so no pattern may match it.
        let companions: BTreeSet<&str> = companions.iter().filter_map(|path| paths.take(path.to_str()?)).collect();
        let mut surveyor = Surveyor {
            campaign: self,
            exclusions: Exclusions::of(self),
            references: References::among(&paths),
            paths: &paths,
            companions: &companions,
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

/// The state of a survey in progress.
struct Surveyor<'a> {
    campaign: &'a Campaign,
    exclusions: Exclusions<'a>,
    references: References<'a>,
    paths: &'a BTreeSet<&'a str>,
    companions: &'a BTreeSet<&'a str>,
    claims: Vec<Claim>,
    /// Files that match a rule, and their references.
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

    /// Makes an exposure of a file. It ends up excluded, without its reference, or among the exposures.
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
        let missing =
            self.references.attach(rule, &mut exposure).map_err(|problem| self.error(source, file, problem))?;
        let companions = exposure.files().filter_map(|file| companion(file));
        let mut companions: Vec<PathBuf> =
            companions.filter(|file| file.to_str().is_some_and(|file| self.companions.contains(file))).collect();
        companions.dedup();
        exposure.companions = companions;
        self.taken.extend(exposure.files().cloned());
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
        if let Some((file, first, second)) = claims::first_clash(&self.claims) {
            return Err(SurveyError::Clash {
                file: file.to_owned(),
                first: first.place(self.campaign),
                second: second.place(self.campaign),
            });
        }
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

    fn error(&self, source: Source, file: &str, problem: String) -> SurveyError {
        SurveyError::File { place: source.place(self.campaign), file: file.into(), problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::keys::Role;
    use std::fs;

    const SENSOR: &str = "[campaign]\nname = 'c'\n[sensors.s1]\n";

    /// A folder with these files, each one byte, and this campaign file.
    fn folder(files: &[&str], rules: &str) -> (tempfile::TempDir, Campaign) {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let file = folder.path().join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "x").unwrap();
        }
        let campaign = Campaign::parse(folder.path(), &format!("{SENSOR}{rules}")).unwrap();
        (folder, campaign)
    }

    fn survey(files: &[&str], rules: &str) -> Result<Survey, String> {
        folder(files, rules).1.survey().map_err(|error| error.to_string())
    }

    fn names(files: &[PathBuf]) -> Vec<&str> {
        files.iter().map(|file| file.to_str().unwrap()).collect()
    }

    const SCENE: &str = "[[captures]]\nrole = 'scene'\nfiles = 'raw/C1_L{lit}_P{seen}.trc'\n\
                         reference = { files = 'raw/C2_L{lit}_P{seen}.trc' }\ndt_ps = 50\n";

    #[test]
    fn exposures_references_and_what_is_left_over() {
        let files = [
            "raw/C1_L1_P2.trc",
            "raw/C2_L001_P002.trc",
            "raw/C1_L2_P1.trc",
            "notes.txt",
            "raw/dark.npy",
            "raw/C1_L3_P1.trc",
            "raw/C2_L3_P1.trc",
            "papers/a.pdf",
        ];
        let rules = format!(
            "{SCENE}[[captures]]\nrole = 'dark'\nfiles = 'raw/*.npy'\n[[captures]]\nrole = 'response'\nfiles = 'r/*.npy'\n\
             [[exclude]]\nmatch = {{ lit = 3 }}\nreason = 'shutter'\n[[exclude]]\nmatch = {{ lit = 9 }}\nreason = 'none such'\n\
             [[exclude]]\nmatch = {{ file = 'papers/*' }}\nreason = 'no data'\n"
        );
        let survey = survey(&files, &rules).unwrap();
        let [scene, dark] = survey.exposures.as_slice() else { panic!("{survey:?}") };
        assert_eq!(scene.file, Path::new("raw/C1_L1_P2.trc"));
        assert_eq!((scene.lit, scene.seen, scene.shot), (Some(1), Some(2), None));
        assert_eq!((scene.sensor.as_deref(), scene.keys.dt_ps), (Some("s1"), Some(50.0)));
        let reference = scene.reference.as_ref().unwrap();
        assert_eq!(reference.file, Path::new("raw/C2_L001_P002.trc"));
        assert_eq!((dark.rule, dark.lit, dark.seen), (1, Some(0), Some(0)));
        assert_eq!(survey.missing_references[0].file, Path::new("raw/C1_L2_P1.trc"));
        let wanted = &survey.missing_references[0].wanted;
        assert_eq!(wanted, "raw/C2_L{lit}_P{seen}.trc with lit = 2, seen = 1");
        assert_eq!(names(&survey.unmatched), ["notes.txt"]);
        let empty = ["[[captures]] number 3: files = \"r/*.npy\"", "[[exclude]] number 2: reason = \"none such\""];
        assert_eq!(survey.empty, empty);
        let excluded = [("papers/a.pdf", "no data"), ("raw/C1_L3_P1.trc", "shutter")];
        assert_eq!(survey.excluded, excluded.map(|(file, why)| (file.into(), why.to_owned())));
        let files: Vec<&str> = survey.files().into_iter().map(|file| file.to_str().unwrap()).collect();
        assert_eq!(files, ["raw/C1_L1_P2.trc", "raw/C2_L001_P002.trc", "raw/dark.npy"]);
    }

    #[test]
    fn samples_beside_their_head_belong_to_it() {
        let files = ["L1_P2.bin", "L1_P2.Wfm.bin", "L2_P1.bin", "L3_P1.Wfm.bin"];
        let survey = survey(&files, "[[captures]]\nrole = 'scene'\nfiles = 'L{lit}_P*.bin'\nseen = 2\n").unwrap();
        assert_eq!(survey.exposures.len(), 3, "a companion without its head is a file that the rule takes");
        assert_eq!(survey.exposures[0].companions, [PathBuf::from("L1_P2.Wfm.bin")]);
        assert_eq!(survey.exposures[0].files().count(), 2);
        assert!(survey.unmatched.is_empty() && survey.exposures[1].companions.is_empty());
        assert_eq!(survey.files().len(), 4);
    }

    #[test]
    fn every_file_is_accounted_for() {
        let files: Vec<String> =
            (0..200).map(|i| format!("raw/C{}_L{}_P{}.trc", i % 3 + 1, i / 3 % 7 + 1, i / 21 + 1)).collect();
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        let rules = format!("{SCENE}[[exclude]]\nmatch = {{ lit = 4 }}\nreason = 'r'\n");
        let survey = survey(&files, &rules).unwrap();
        let mut seen: Vec<PathBuf> = survey.files().into_iter().map(Path::to_owned).collect();
        seen.extend(survey.unmatched.iter().cloned());
        seen.extend(survey.excluded.iter().map(|(file, _)| file.clone()));
        seen.extend(survey.excluded.iter().map(|(file, _)| file.to_str().unwrap().replace("C1", "C2").into()));
        seen.extend(survey.missing_references.iter().map(|missing| missing.file.clone()));
        seen.retain(|file| files.contains(&file.to_str().unwrap()));
        seen.sort();
        let mut expected: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
        expected.sort();
        assert_eq!(seen, expected);
    }

    #[test]
    fn a_table_says_what_a_pattern_cannot() {
        let table = "file,segment,lit,seen,role,dt_ps\nraw/a.trc,0,1,2,,\nraw/a.trc,1,2,1,,25\nraw/b.trc,,,,dark,\nraw/c.trc,,1,1,,\n";
        let (folder, campaign) =
            folder(&["raw/a.trc", "raw/b.trc"], "[[captures]]\nrole = 'scene'\ntable = 'captures.csv'\ndt_ps = 50\n");
        fs::write(folder.path().join("captures.csv"), table).unwrap();
        let survey = campaign.survey().unwrap();
        let rows: Vec<_> = survey.exposures.iter().map(|e| (e.segment, e.lit, e.seen, e.role, e.keys.dt_ps)).collect();
        let expected = [
            (Some(0), Some(1), Some(2), Role::Scene, Some(50.0)),
            (Some(1), Some(2), Some(1), Role::Scene, Some(25.0)),
            (None, Some(0), Some(0), Role::Dark, Some(50.0)),
        ];
        assert_eq!(rows, expected);
        assert_eq!(survey.empty, ["captures.csv, row 5: file = \"raw/c.trc\""]);
        assert!(survey.unmatched.is_empty());
        for (row, part) in [
            ("raw/b.trc,,,,,", "which patch is `lit`"),
            ("raw/b.trc,,1,2,,-5", "dt_ps must be above 0"),
            ("raw/a.trc,,1,2,,", "taken by captures.csv, row"),
        ] {
            fs::write(folder.path().join("captures.csv"), format!("{table}{row}\n")).unwrap();
            let error = campaign.survey().unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("captures.csv, row"), "{error}");
        }
    }

    #[test]
    fn axes_leave_coordinates_open() {
        let rules = "[[captures]]\nrole = 'scene'\nfiles = '*.npy'\nsegments = ['lit', 'seen', 'sensor', 'shot']\n\
                     [[exclude]]\nmatch = { lit = 3 }\nreason = 'r'\n";
        let survey = survey(&["a.npy"], rules).unwrap();
        let exposure = &survey.exposures[0];
        assert_eq!((exposure.lit, exposure.seen, &exposure.sensor), (None, None, &None));
        assert!(survey.empty.is_empty(), "the exclusion may mean a part of the array");
    }

    #[test]
    fn two_rules_may_share_a_file_only_by_channel() {
        let rule =
            |channel: &str| format!("[[captures]]\nrole = 'scene'\nfiles = 'L{{lit}}_P{{seen}}.trc'\n{channel}\n");
        let files = ["L1_P2.trc"];
        let both = rule("channel = 'C1'") + &rule("channel = 'C2'");
        assert_eq!(survey(&files, &both).unwrap().exposures.len(), 2);
        let error = survey(&files, &(rule("channel = 'C1'") + &rule(""))).unwrap_err();
        let expected = "L1_P2.trc: taken by [[captures]] number 2 and by [[captures]] number 1;";
        assert!(error.starts_with(expected), "{error}");
    }

    #[test]
    fn files_that_are_still_being_written_wait() {
        let (_folder, campaign) = folder(&["old.npy", "new.npy"], "[[captures]]\nrole = 'dark'\nfiles = '*.npy'\n");
        let settled = Some(BTreeSet::from([PathBuf::from("old.npy")]));
        let survey = Campaign { settled, ..campaign.clone() }.survey().unwrap();
        assert_eq!(survey.exposures.iter().map(|exposure| &exposure.file).collect::<Vec<_>>(), [Path::new("old.npy")]);
        assert!(survey.unmatched.is_empty());
        assert_eq!(campaign.survey().unwrap().exposures.len(), 2);
    }

    #[test]
    fn files_that_do_not_fit_their_rule_are_named() {
        let scene = |pattern: &str| format!("[[captures]]\nrole = 'scene'\nfiles = '{pattern}'\n");
        for (pattern, file, part) in [
            ("L{lit}_P{seen}.trc", "L0_P2.trc", "patches are numbered from 1"),
            ("L{lit}_P{seen}_{shot}.trc", "L1_P2_20231117093000.trc", "too large"),
            ("{sensor}_L{lit}_P{seen}.trc", "s2_L1_P2.trc", "add [sensors.s2]"),
            ("{sensor}x{range}/L{lit}_P{seen}.trc", "axbxc/L1_P2.trc", "in two ways"),
        ] {
            let error = survey(&[file], &scene(pattern)).unwrap_err();
            assert!(error.contains(part) && error.contains(file), "{error}");
        }
    }
}
