//! Items of a batch that are read together: captures that share no file with others of the batch. What is made of whole
//! captures is made where they are read.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rayon::prelude::*;

use super::long::Long;
use super::part::{Done, read_items};
use super::raw_file::Reading;
use super::survey::{Capture, Item, Job, Surveyed};
use crate::campaign::Exposure;
use crate::formats::Description;
use crate::stages::source::{InPlace, Reduced};
use crate::tables::traces::Records;

/// Items of captures that follow one another.
pub struct Unit<'a> {
    /// The items, each with the number of its capture.
    pub jobs: Vec<(usize, Job<'a>)>,
    /// Whether it has all items of its captures.
    is_whole: bool,
}

/// What was read of a unit.
pub struct Read {
    /// Item by item, if it was read. Where the unit was reduced, the first one has the rows of all, without codes.
    pub done: Vec<Done>,
    /// What was made of its captures.
    pub reduced: Option<Reduced>,
}

/// The files of an exposure: they are opened once for all items that have the same.
type FilesKey<'a> = (usize, Vec<&'a PathBuf>);

fn files<'a>((_, job): &(usize, Job<'a>)) -> FilesKey<'a> {
    (job.capture.campaign, job.item.exposure.files().collect())
}

/// Splits a run of items, each with the number of its capture.
pub fn of<'a>(captures: &'a [Capture], items: &[(usize, &'a Item)]) -> Vec<Unit<'a>> {
    let job = |(index, item): &(usize, &'a Item)| (*index, Job { capture: &captures[*index], item, first_shot: 0 });
    let jobs: Vec<(usize, Job<'a>)> = items.iter().map(job).collect();
    let mut last: BTreeMap<(usize, &PathBuf), usize> = BTreeMap::new();
    for (at, (_, Job { capture, item, .. })) in jobs.iter().enumerate() {
        last.extend(item.exposure.files().map(|file| ((capture.campaign, file), at)));
    }
    let (mut units, mut unit, mut reach) = (Vec::new(), Vec::new(), 0);
    for (at, (index, job)) in jobs.into_iter().enumerate() {
        let goes_on = |(before, _): &(usize, Job<'_>)| *before == index || reach >= at;
        if !unit.last().is_none_or(goes_on) {
            units.push(Unit::new(std::mem::take(&mut unit)));
        }
        let of_job = job.item.exposure.files().map(|file| last[&(job.capture.campaign, file)]);
        reach = of_job.fold(reach, usize::max);
        unit.push((index, job));
    }
    units.extend((!unit.is_empty()).then(|| Unit::new(unit)));
    units
}

impl<'a> Unit<'a> {
    fn new(jobs: Vec<(usize, Job<'a>)>) -> Self {
        let is = |job: &Job<'_>, item: Option<&Item>| item.is_some_and(|item| std::ptr::eq(item, job.item));
        let begins = jobs.first().is_some_and(|(_, job)| is(job, job.capture.items.first()));
        let ends = jobs.last().is_some_and(|(_, job)| is(job, job.capture.items.last()));
        Self { jobs, is_whole: begins && ends }
    }

    /// Whether its rows need not be looked through for captures.
    fn is_one_capture(&self) -> bool {
        self.jobs.iter().all(|(index, _)| *index == self.jobs[0].0)
    }

    /// Reads the items, and reduces their captures if these are whole; `keeps` says whether their rows are wanted
    /// nevertheless. Captures whose files do not number exposures have `shots` so far.
    pub fn read(
        &self,
        surveyed: &Surveyed<'_>,
        in_place: Option<&dyn InPlace>,
        keeps: bool,
        shots: impl Fn(usize) -> i32,
    ) -> Read {
        let mut done = self.read_files(surveyed);
        let mut next: BTreeMap<usize, i32> = BTreeMap::new();
        let unnumbered = self.jobs.iter().zip(&mut done).filter(|((_, job), _)| !job.item.is_numbered());
        for ((index, _), done) in unnumbered {
            let next = next.entry(*index).or_insert_with(|| shots(*index));
            done.rows.number_from(*next);
            *next += done.shots;
        }
        let Some(in_place) = in_place.filter(|_| self.is_whole) else { return Read { done, reduced: None } };
        let mut rows = Records::default();
        done.iter_mut().for_each(|done| rows.append(std::mem::take(&mut done.rows)));
        let batch = rows.to_batch();
        let reduced = Some(if self.is_one_capture() && !rows.is_empty() {
            let mut capture = in_place.one();
            capture.take(&batch);
            capture.finish()
        } else {
            in_place.reduce(&batch)
        });
        if keeps {
            done[0].rows = rows.without_codes();
        }
        Read { done, reduced }
    }

    /// Reads the items of one capture in pieces, one after the other, and reduces it piece by piece; `bytes` are those
    /// of a piece, and the most that an exposure may have. Nothing comes of it where exposures are larger than pieces.
    pub fn read_long(&self, surveyed: &Surveyed<'_>, in_place: &dyn InPlace, keeps: bool, bytes: [usize; 2]) -> Read {
        let (mut capture, mut done, mut shots) = (in_place.one(), Vec::new(), 0);
        for (_, Job { capture: of, item, .. }) in &self.jobs {
            let job = &Job { capture: of, item, first_shot: if item.is_numbered() { 0 } else { shots } };
            let of_item = match Long::open(surveyed, job, Reading::Long, None, bytes) {
                Err(done) => *done,
                Ok(long) if long.piece_bytes(job).is_some_and(|piece| piece > bytes[0]) => {
                    return Read { done: Vec::new(), reduced: None };
                }
                Ok(mut long) => {
                    while let Some(rows) = long.next(surveyed, job) {
                        capture.take(&rows.to_batch());
                        if keeps {
                            long.keep(rows);
                        }
                    }
                    long.close(surveyed, job).0
                }
            };
            shots += of_item.shots;
            done.push(of_item);
        }
        Read { done, reduced: Some(capture.finish()) }
    }

    /// Reads the items file by file.
    fn read_files(&self, surveyed: &Surveyed<'_>) -> Vec<Done> {
        let mut by_files: BTreeMap<FilesKey<'_>, Vec<(Description, Vec<usize>)>> = BTreeMap::new();
        for (at, job) in self.jobs.iter().enumerate() {
            let Exposure { keys, .. } = &job.1.item.exposure;
            let readings = by_files.entry(files(job)).or_default();
            match readings.iter_mut().find(|(description, _)| *description == keys.description()) {
                Some((_, of_file)) => of_file.push(at),
                None => readings.push((keys.description(), vec![at])),
            }
        }
        let by_files: Vec<Vec<usize>> = by_files.into_values().flatten().map(|(_, of_file)| of_file).collect();
        let read = |of_file: &Vec<usize>| {
            let jobs: Vec<&Job<'_>> = of_file.iter().map(|at| &self.jobs[*at].1).collect();
            of_file.iter().copied().zip(read_items(surveyed, &jobs)).collect()
        };
        let done: Vec<Vec<(usize, Done)>> = by_files.par_iter().map(read).collect();
        let mut done: Vec<(usize, Done)> = done.into_iter().flatten().collect();
        done.sort_by_key(|(at, _)| *at);
        done.into_iter().map(|(_, done)| done).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::Role;

    fn capture(files: &[&str]) -> Capture {
        let item = |file: &&str| Item { exposure: Exposure::of_file(file), records: None, bytes: 1 };
        let items = files.iter().map(item).collect();
        Capture { campaign: 0, role: Role::Scene, run: None, sensor: "s".to_owned(), lit: 1, seen: 1, items }
    }

    /// Captures of one file each, of two files, of a file that two share, and of two files the second of which the next
    /// one shares: a unit is a run of captures that no file ties to others, and is whole if none was cut off.
    #[test]
    fn units_are_captures_that_no_file_ties_to_others() {
        let captures = [&["a"][..], &["b", "c"], &["d"], &["d"], &["e", "f"], &["f"], &["g", "h"]].map(capture);
        let items: Vec<(usize, &Item)> = captures
            .iter()
            .enumerate()
            .flat_map(|(n, capture)| capture.items.iter().map(move |item| (n, item)))
            .collect();
        let seen = |items: &[(usize, &Item)]| -> Vec<(Vec<usize>, bool)> {
            let of_unit = |unit: &Unit<'_>| (unit.jobs.iter().map(|(n, _)| *n).collect(), unit.is_whole);
            of(&captures, items).iter().map(of_unit).collect()
        };
        let whole = |captures: &[usize]| (captures.to_vec(), true);
        let cut = |captures: &[usize]| (captures.to_vec(), false);
        let middle = [whole(&[2, 3]), whole(&[4, 4, 5])];
        assert_eq!(seen(&items), [&[whole(&[0]), whole(&[1, 1])], &middle[..], &[whole(&[6, 6])]].concat());
        assert_eq!(seen(&items[2..9]), [&[cut(&[1])], &middle[..], &[cut(&[6])]].concat());
        assert!(seen(&[]).is_empty());
    }
}
