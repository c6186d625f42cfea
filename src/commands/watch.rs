//! `periscope run --watch`: follows a measurement in progress, pass after pass.
//!
//! The campaign of a pass is every file that exists when the pass begins and was the same at all looks for [`SETTLED`]:
//! size, times and inode. Whether clocks agree does not matter. Later files join the next pass. Only parts with new
//! files, and the tables of all patches, are computed again. Results that they replace are removed, so that the result
//! folder does not grow with each pass.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use periscope::campaign::left_out::left_out;
use periscope::campaign::{Campaign, Manifest, Stamp, walk};
use periscope::pipeline::run::{Outcome, RunError};
use periscope::store::runs::RunRecord;

use super::check::report::Report;
use super::check::{self, coverage};
use super::interrupt::is_interruption;
use super::output::{count, note};
use super::run::{Job, campaigns};

/// A file that changed less than this ago may still be open for writing.
const SETTLED: Duration = Duration::from_secs(2);
/// Time between two looks at the campaign folders.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

/// Settled files of a campaign folder, by path in it.
type Settled = BTreeMap<PathBuf, Stamp>;

/// Everything that was seen of a campaign folder.
struct Watched<'a> {
    folder: &'a Path,
    /// Each file with the look at which it first had its stamp.
    seen: BTreeMap<PathBuf, (Stamp, Instant)>,
}

impl Watched<'_> {
    /// Looks at the folder; returns the settled files, and the number of the others.
    fn look(&mut self) -> Result<(Settled, usize)> {
        let now = Instant::now();
        let files = walk::files(self.folder)
            .map_err(|(folder, error)| error_at(&folder, error))
            .with_context(|| format!("campaign {}", self.folder.display()))?;
        let mut seen = BTreeMap::new();
        let (mut settled, mut waiting) = (Settled::new(), 0);
        for walk::RawFile { path, stamp } in files {
            let since = match self.seen.get(&path) {
                Some((before, since)) if *before == stamp => *since,
                _ => now,
            };
            if now.duration_since(since) >= SETTLED {
                settled.insert(path.clone(), stamp);
            } else {
                waiting += 1;
            }
            seen.insert(path, (stamp, since));
        }
        self.seen = seen;
        Ok((settled, waiting))
    }
}

fn error_at(folder: &Path, error: std::io::Error) -> anyhow::Error {
    anyhow::Error::new(error).context(format!("cannot read {}", folder.display()))
}

/// Runs `job` over the campaigns in `folders` whenever files have arrived, until Ctrl-C, or until none has arrived for
/// `idle`. Returns the last outcome.
pub fn follow(job: &Job<'_>, folders: &[PathBuf], idle: Option<Duration>) -> Result<Outcome> {
    let mut record = job.record()?;
    let mut watched: Vec<Watched<'_>> =
        folders.iter().map(|folder| Watched { folder, seen: BTreeMap::new() }).collect();
    let (mut before, mut passes) = (vec![Settled::new(); folders.len()], 0);
    let mut last: Option<Result<Outcome>> = None;
    let mut changed = Instant::now();
    loop {
        let looks = watched.iter_mut().map(Watched::look).collect::<Result<Vec<_>>>()?;
        let waiting: usize = looks.iter().map(|(_, waiting)| waiting).sum();
        let settled: Vec<Settled> = looks.into_iter().map(|(settled, _)| settled).collect();
        if waiting > 0 {
            changed = Instant::now();
        }
        // The first pass does not begin in the middle of what is there already.
        if (last.is_none() && waiting == 0) || settled != before {
            passes += 1;
            changed = Instant::now();
            let outcome = campaigns(folders).and_then(|mut campaigns| {
                for (campaign, settled) in campaigns.iter_mut().zip(&settled) {
                    campaign.settled = Some(settled.keys().cloned().collect());
                }
                pass(job, &campaigns, &mut record)
            });
            if let Err(error) = &outcome
                && is_interruption(error)
            {
                return outcome;
            }
            tell(passes, &before, &settled, waiting, &outcome);
            last = Some(outcome);
            before = settled;
        }
        let is_cancelled = job.settings.cancel.is_cancelled();
        let is_over = is_cancelled || idle.is_some_and(|idle| changed.elapsed() >= idle);
        match last {
            Some(outcome) if is_over => return outcome,
            None if is_cancelled => return Err(RunError::Interrupted { kept: "0 tables".to_owned() }.into()),
            _ => thread::sleep(LOOK_AGAIN),
        }
    }
}

/// Reports a pass.
fn tell(number: usize, before: &[Settled], settled: &[Settled], waiting: usize, outcome: &Result<Outcome>) {
    let files: usize = settled.iter().map(BTreeMap::len).sum();
    let of_folder = |(settled, before): (&Settled, &Settled)| {
        settled.iter().filter(|(path, stamp)| before.get(*path) != Some(*stamp)).count()
    };
    let new: usize = settled.iter().zip(before).map(of_folder).sum();
    let state = match outcome {
        Ok(_) => "its tables are complete".to_owned(),
        Err(error) => format!("not yet: {error:#}"),
    };
    let files = count(files, "file", "files");
    note!("pass {number}: {files}, {new} new or changed, {waiting} still being written: {state}");
}

fn pass(job: &Job<'_>, campaigns: &[Campaign], record: &mut RunRecord) -> Result<Outcome> {
    for campaign in campaigns {
        check::forget_changed(campaign, job.shelf)?;
    }
    let outcome = Job { campaigns, ..job.clone() }.execute(record)?;
    job.shelf.remove(&job.shelf.replaced(&outcome.behind)?)?;
    for campaign in campaigns {
        let mut report = Report::default();
        let survey = campaign.survey()?;
        let left_out = left_out(&campaign.root, &survey, Manifest::load(&campaign.root)?.as_ref());
        coverage::fill(&mut report, campaign, &survey, &[], &left_out, &BTreeSet::new());
        report.fix.iter().for_each(|missing| note!("still missing in {}: {missing}", campaign.name));
    }
    Ok(outcome)
}
