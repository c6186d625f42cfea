//! `periscope run --watch`: follows a measurement in progress, pass after pass.
//!
//! The campaign of a pass is every file that exists when the pass begins and has not changed for [`SETTLED`]; later
//! files join the next pass. Only parts with new files, and the tables of all patches, are computed again. Results that
//! they replace are removed, so that the result folder does not grow with each pass.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, Result};
use periscope::campaign::left_out::left_out;
use periscope::campaign::{Campaign, Manifest, walk};
use periscope::pipeline::run::Outcome;
use periscope::store::runs::RunRecord;

use super::check::report::Report;
use super::check::{self, coverage};
use super::interrupt::is_interruption;
use super::output::note;
use super::run::{Job, campaigns};

/// A file that changed less than this ago may still be open for writing.
const SETTLED: Duration = Duration::from_secs(2);
/// Time between two looks at the campaign folders.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

/// The files of the campaign folders at some moment.
#[derive(Default, PartialEq)]
struct Files {
    settled: BTreeSet<(PathBuf, SystemTime)>,
    waiting: usize,
}

impl Files {
    fn of(folders: &[PathBuf], as_of: SystemTime) -> Result<Self> {
        let mut files = Self::default();
        for folder in folders {
            let found = walk::files(folder)
                .map_err(|(folder, error)| error_at(&folder, error))
                .with_context(|| format!("campaign {}", folder.display()))?;
            for walk::RawFile { path, modified } in found {
                if modified <= as_of {
                    files.settled.insert((folder.join(path), modified));
                } else {
                    files.waiting += 1;
                }
            }
        }
        Ok(files)
    }
}

fn error_at(folder: &Path, error: std::io::Error) -> anyhow::Error {
    anyhow::Error::new(error).context(format!("cannot read {}", folder.display()))
}

/// Runs `job` over the campaigns in `folders` whenever files have arrived, until Ctrl-C, or until none has arrived for
/// `idle`. Returns the last outcome.
pub fn follow(job: &Job<'_>, folders: &[PathBuf], idle: Option<Duration>) -> Result<Outcome> {
    let mut record = job.record()?;
    let (mut seen, mut passes) = (Files::default(), 0);
    let mut last: Option<Result<Outcome>> = None;
    let mut changed = Instant::now();
    loop {
        let as_of = SystemTime::now() - SETTLED;
        let files = Files::of(folders, as_of)?;
        if files.waiting > 0 {
            changed = Instant::now();
        }
        if last.is_none() || files.settled != seen.settled {
            passes += 1;
            changed = Instant::now();
            let new = files.settled.difference(&seen.settled).count();
            let now = campaigns(folders).map(|mut campaigns| {
                campaigns.iter_mut().for_each(|campaign| campaign.as_of = Some(as_of));
                campaigns
            });
            let outcome = now.and_then(|campaigns| pass(job, &campaigns, &mut record));
            if let Err(error) = &outcome
                && is_interruption(error)
            {
                return outcome;
            }
            let state = match &outcome {
                Ok(_) => "its tables are whole".to_owned(),
                Err(error) => format!("not yet: {error:#}"),
            };
            let (count, waiting) = (files.settled.len(), files.waiting);
            note!("pass {passes}: {count} files, {new} new or changed, {waiting} still being written: {state}");
            last = Some(outcome);
            seen = files;
        }
        let is_over = idle.is_some_and(|idle| changed.elapsed() >= idle);
        if is_over || job.settings.cancel.is_cancelled() {
            return last.expect("there was a pass");
        }
        thread::sleep(LOOK_AGAIN);
    }
}

fn pass(job: &Job<'_>, campaigns: &[Campaign], record: &mut RunRecord) -> Result<Outcome> {
    for campaign in campaigns {
        check::forget_changed(campaign, job.shelf)?;
    }
    let outcome = Job { campaigns, ..job.clone() }.execute(record)?;
    job.shelf.remove(&job.shelf.replaced()?)?;
    for campaign in campaigns {
        let mut report = Report::default();
        let survey = campaign.survey()?;
        let left_out = left_out(&campaign.root, &survey, Manifest::load(&campaign.root)?.as_ref());
        coverage::fill(&mut report, campaign, &survey, &[], &left_out, &BTreeSet::new());
        report.mend.iter().for_each(|missing| note!("still missing in {}: {missing}", campaign.name));
    }
    Ok(outcome)
}
