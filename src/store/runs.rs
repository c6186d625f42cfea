//! Run records: when, where and from what a run was made. They are next to the tables, never in them.
//!
//! Each run has a file `OUT/.shelf/runs/20260314T091500Z-4711.json`, named by its start (UTC) and its process. A record
//! without an end belongs to a run that still works, or was killed.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::Digest;
use super::disk as fs;
use super::failure::{At, StoreError};
use super::lock::Holder;
use super::record;
use super::shelf::Shelf;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// Every requested table is complete.
    Done,
    /// An error stopped it.
    Failed,
    /// The user stopped it.
    Interrupted,
}

/// One pass of a run: the tables that it made from one reading of its input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassRecord {
    /// Headings of the tables.
    pub tables: Vec<String>,
    /// Bytes of raw files read; 0 for a pass over stored tables.
    pub raw_bytes: u64,
    /// Elapsed time in seconds.
    pub seconds: f64,
}

/// One run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of the program.
    pub periscope: String,
    /// Pipeline: the absolute path of its file, or the name of one in the program.
    pub pipeline: PathBuf,
    /// Parameters changed on the command line, as typed.
    pub set: Vec<String>,
    /// Campaign folders, absolute, by the campaign's name.
    pub campaigns: BTreeMap<String, PathBuf>,
    /// Name of the machine.
    pub host: String,
    /// Number of the process on it.
    pub process: u32,
    /// Start (UTC, ISO 8601).
    pub started: String,
    /// End.
    pub ended: Option<String>,
    /// How it ended.
    pub ending: Option<Ending>,
    /// What stopped it, if it failed.
    pub failure: Option<String>,
    /// Rejected rows in all its tables.
    pub rejects: u64,
    /// What the campaigns have and no table is made from, a line for each cause.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// Lineages of the tables that were complete at its end, by view.
    pub tables: BTreeMap<String, Digest>,
    /// All views at its end, each with the folder of its table, relative to the result folder.
    #[serde(default)]
    pub views: BTreeMap<String, PathBuf>,
    /// Its passes, in order; empty for a run that failed.
    #[serde(default)]
    pub passes: Vec<PassRecord>,
}

impl RunRecord {
    /// A run of this process that starts now. `pipeline`: absolute path or name; `campaigns`: name and folder of each.
    ///
    /// # Errors
    /// When the current folder is gone, so that relative paths have no base.
    pub fn start<'a>(
        pipeline: PathBuf,
        set: &[String],
        campaigns: impl IntoIterator<Item = (&'a str, &'a Path)>,
    ) -> io::Result<Self> {
        let absolute = |(name, root): (&str, &Path)| Ok((name.to_owned(), std::path::absolute(root)?));
        let Holder { host, process, started } = Holder::here();
        Ok(Self {
            periscope: env!("CARGO_PKG_VERSION").to_owned(),
            pipeline,
            set: set.to_vec(),
            campaigns: campaigns.into_iter().map(absolute).collect::<io::Result<_>>()?,
            host,
            process,
            started,
            ended: None,
            ending: None,
            failure: None,
            rejects: 0,
            left_out: Vec::new(),
            tables: BTreeMap::new(),
            views: BTreeMap::new(),
            passes: Vec::new(),
        })
    }

    /// Ends the run now.
    pub fn end(&mut self, ending: Ending) {
        (self.ended, self.ending) = (Some(utc(SystemTime::now())), Some(ending));
    }

    fn file(&self, shelf: &Shelf) -> PathBuf {
        folder(shelf).join(format!("{}-{}.json", self.started.replace(['-', ':'], ""), self.process))
    }
}

fn folder(shelf: &Shelf) -> PathBuf {
    shelf.out().join(".shelf/runs")
}

impl Shelf {
    /// Writes a run's record, and replaces an earlier one of the same run.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_run(&self, run: &RunRecord) -> Result<(), StoreError> {
        let folder = folder(self);
        fs::create_dir_all(&folder).at("create", &folder)?;
        self.write_json(&run.file(self), run)
    }

    /// Records of all runs in this folder, oldest first; those of one second in the order of their processes' numbers.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn runs(&self) -> Result<Vec<RunRecord>, StoreError> {
        let folder = folder(self);
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.at("read", &folder)?,
        };
        let files = entries.map(|entry| Ok(entry.at("read", &folder)?.path()));
        let mut files = files.collect::<Result<Vec<PathBuf>, StoreError>>()?;
        files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
        let read = files.iter().map(|file| record::read(file));
        let mut runs = read.filter_map(Result::transpose).collect::<Result<Vec<RunRecord>, StoreError>>()?;
        runs.sort_by(|a, b| (&a.started, a.process).cmp(&(&b.started, b.process)));
        Ok(runs)
    }
}

/// A moment as date and time of day (UTC), ISO 8601, to the second.
#[must_use]
pub fn utc(moment: SystemTime) -> String {
    let seconds = moment.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() as i64);
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    // Civil date from days since 1970 in the proleptic Gregorian calendar; counting years from March puts leap days
    // last.
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_shifted = (5 * day_of_year + 2) / 153;
    let (day, month) = (
        day_of_year - (153 * month_shifted + 2) / 5 + 1,
        if month_shifted < 10 { month_shifted + 3 } else { month_shifted - 9 },
    );
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", rest / 3600, rest % 3600 / 60, rest % 60)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn record(started: u64) -> RunRecord {
        RunRecord {
            periscope: "0.1.0".to_owned(),
            pipeline: "/lab/all-visible.toml".into(),
            set: vec!["onsets.threshold_sigma=6".to_owned()],
            campaigns: BTreeMap::from([("corner".to_owned(), PathBuf::from("/lab/corner"))]),
            host: "bench".to_owned(),
            process: 4711,
            started: utc(UNIX_EPOCH + Duration::from_secs(started)),
            ..RunRecord::default()
        }
    }

    #[test]
    fn days_of_the_calendar() {
        let at = |seconds| utc(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01T00:00:00Z");
        assert_eq!(at(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(at(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(at(1_773_479_700), "2026-03-14T09:15:00Z");
    }

    #[test]
    fn runs_read_back_in_their_order_and_an_end_takes_the_place_of_its_start() {
        let folder = tempfile::tempdir().unwrap();
        let shelf = Shelf::open(folder.path()).unwrap();
        assert_eq!(shelf.runs().unwrap(), []);
        let (first, later) = (record(1_000_000_000), record(1_700_000_000));
        shelf.write_run(&later).unwrap();
        shelf.write_run(&first).unwrap();
        let ended = RunRecord { ended: Some("2023-11-14T22:15:00Z".to_owned()), ending: Some(Ending::Done), ..later };
        shelf.write_run(&ended).unwrap();
        assert_eq!(shelf.runs().unwrap(), [first, ended]);
    }

    #[test]
    fn runs_of_one_second_are_in_the_order_of_their_processes() {
        let folder = tempfile::tempdir().unwrap();
        let shelf = Shelf::open(folder.path()).unwrap();
        let runs = [9999, 10_000].map(|process| RunRecord { process, ..record(1_000_000_000) });
        for run in &runs {
            shelf.write_run(run).unwrap();
        }
        assert_eq!(shelf.runs().unwrap(), runs);
    }
}
