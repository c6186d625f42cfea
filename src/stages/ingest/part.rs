//! Reading a part: its files in batches within the memory budget, small ones side by side, large ones in pieces.

use std::collections::BTreeMap;
use std::iter::from_fn;
use std::ops::Range;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use rayon::prelude::*;

use super::content::{self, FileDigests};
use super::files::Files;
use super::long::Long;
use super::raw_file::{Bad, Hashed, HashedStretch, Reading};
use super::runs::Runs;
use super::survey::{Capture, Item, Job, Surveyed, chain};
use super::units::{self, Read, Unit};
use crate::campaign::{Campaign, Stamp, hash_file};
use crate::stages::source::{Credit, Feed, PartRead};
use crate::stages::stage::{Rejection, StageError};
use crate::store::Digest;
use crate::store::disk;
use crate::tables::traces::Records;

/// Items that are sent on together: what is made of small ones takes many times their own bytes.
const ITEMS_SENT: usize = 64;
/// Batches that are read together where captures are reduced in place: what is made of them is small, and threads wait
/// for one another less often.
const IN_PLACE_BATCHES: usize = 4;
/// Items that are read together at most: what is made of captures of one shot has many times their bytes.
const ITEMS_TOGETHER: usize = 512;
/// Of captures in larger files one thread reads and the next one averages; up to this size they are averaged where they
/// are read.
const LONG_BYTES: u64 = 64 << 20;
/// Pieces of these at most: one is read, hashed and added up while it is in the second cache.
const PIECE_BYTES: usize = 2 << 20;
/// Rows of an index that are stored together: in all forms that they take on their way, some megabytes.
pub const INDEX_ROWS: usize = 1 << 11;

/// What came of a job.
#[derive(Default)]
pub struct Done {
    pub rows: Records,
    /// Exposures.
    pub shots: i32,
    pub digests: Vec<Hashed>,
    pub rejection: Option<Result<Rejection, StageError>>,
    /// What is to be said about the files, though their records are used.
    pub remarks: Vec<Rejection>,
}

/// Reads a part, in batches of about `batch_bytes`.
pub fn read_part(
    surveyed: &Surveyed<'_>,
    part: usize,
    batch_bytes: usize,
    feed: &dyn Feed,
) -> Result<PartRead, StageError> {
    let captures = &surveyed.parts[part];
    let mut reader = Reader::new(surveyed, batch_bytes, feed);
    reader.read(captures, items(captures).map(|(index, _, item)| Share { index, item, of_file: None }))?;
    Ok(PartRead { content: content(surveyed, captures, reader.digests)?, rejections: reader.rejections })
}

/// The items of captures, in order: number of the capture, number of the item in it.
pub fn items(captures: &[Capture]) -> impl Iterator<Item = (usize, usize, &Item)> {
    captures
        .iter()
        .enumerate()
        .flat_map(|(index, capture)| capture.items.iter().enumerate().map(move |(at, item)| (index, at, item)))
}

/// What is to be read of an item.
pub struct Share<'a> {
    /// Number of its capture.
    pub index: usize,
    pub item: &'a Item,
    /// Where not all: which exposures, and which bytes of its files are hashed.
    pub of_file: Option<(Range<usize>, &'a BTreeMap<PathBuf, Range<u64>>)>,
}

/// Items that are read side by side.
#[derive(Default)]
struct Together<'a> {
    items: Vec<(usize, &'a Item)>,
    /// Bytes that they hold at a time.
    held: usize,
    /// Whether they are files larger than a batch, which are read in pieces: those of one capture one after the other.
    is_long: bool,
}

impl Together<'_> {
    fn has_a_file_of(&self, capture: &Capture) -> bool {
        let is_of = |file: &PathBuf| self.items.iter().any(|(_, other)| other.exposure.files().any(|of| of == file));
        capture.items.iter().any(|item| item.exposure.files().any(is_of))
    }

    /// Whether the last item is one of this capture.
    fn is_at(&self, capture: usize) -> bool {
        self.items.last().is_some_and(|(index, _)| *index == capture)
    }
}

/// Whether a capture is reduced piece by piece, next to others: it is in files of its own, all larger than a batch, and
/// not so large that others wait long for it.
fn is_long(capture: &Capture, batch_bytes: usize) -> bool {
    let is_long = |item: &Item| item.bytes as usize > batch_bytes && !item.is_share();
    capture.items.iter().all(is_long) && capture.items.iter().map(|item| item.bytes).sum::<u64>() <= LONG_BYTES
}

/// Reads items in batches.
pub struct Reader<'a> {
    surveyed: &'a Surveyed<'a>,
    batch_bytes: usize,
    feed: &'a dyn Feed,
    pub digests: FileDigests,
    /// Of files that were read in part.
    pub stretches: Vec<HashedStretch>,
    pub rejections: Vec<Rejection>,
    /// Samples at the rails of each row that was sent, in order.
    pub clipped: Runs,
    /// Exposures so far of each capture whose files do not number them.
    shots: BTreeMap<usize, i32>,
}

impl<'a> Reader<'a> {
    pub fn new(surveyed: &'a Surveyed<'a>, batch_bytes: usize, feed: &'a dyn Feed) -> Self {
        Self {
            surveyed,
            batch_bytes,
            feed,
            digests: BTreeMap::new(),
            stretches: Vec::new(),
            rejections: Vec::new(),
            clipped: Runs::default(),
            shots: BTreeMap::new(),
        }
    }
}

impl Reader<'_> {
    /// Reads items of these captures, in order.
    pub fn read<'i>(
        &mut self,
        captures: &[Capture],
        shares: impl Iterator<Item = Share<'i>>,
    ) -> Result<(), StageError> {
        let in_place = self.feed.in_place().is_some();
        let batches = if in_place { IN_PLACE_BATCHES } else { 1 };
        let mut group = Together::default();
        for share in shares {
            let item = share.item;
            let is_large = share.of_file.is_some() || item.bytes as usize > self.batch_bytes;
            let capture = &captures[share.index];
            let is_long = in_place && share.of_file.is_none() && is_long(capture, self.batch_bytes);
            let is_alone = is_large && !is_long;
            let goes_on = is_long && group.is_long && group.is_at(share.index);
            let held = match is_long {
                true if goes_on => 0,
                true => self.piece_bytes(),
                false => (item.bytes as usize).min(self.batch_bytes),
            };
            let is_apart = is_alone || is_long != group.is_long || (is_long && group.has_a_file_of(capture));
            let is_full = group.items.len() == ITEMS_TOGETHER || group.held + held > batches * self.batch_bytes;
            if !goes_on && (is_apart || is_full) {
                self.side_by_side(captures, &std::mem::take(&mut group))?;
            }
            if is_alone {
                self.large(captures, &share)?;
            } else {
                group.is_long = is_long;
                group.items.push((share.index, item));
                group.held += held;
            }
        }
        self.side_by_side(captures, &group)
    }

    fn piece_bytes(&self) -> usize {
        PIECE_BYTES.min(self.batch_bytes)
    }

    /// Items that fit in one batch together, or are read in pieces that do: side by side.
    fn side_by_side(&mut self, captures: &[Capture], group: &Together<'_>) -> Result<(), StageError> {
        let Together { items, held, is_long } = group;
        if items.is_empty() {
            return Ok(());
        }
        let credit = self.feed.reserve(*held)?;
        let units = units::of(captures, items);
        let (surveyed, in_place, keeps, shots) = (self.surveyed, self.feed.in_place(), self.feed.stores(), &self.shots);
        let so_far = |capture: usize| shots.get(&capture).copied().unwrap_or(0);
        let of_piece = [self.piece_bytes(), self.feed.most()];
        let read = |unit: &Unit<'_>| match in_place.filter(|_| *is_long) {
            Some(in_place) => unit.read_long(surveyed, in_place, keeps, of_piece),
            None => unit.read(surveyed, in_place, keeps, so_far),
        };
        let read: Vec<Read> = units.par_iter().map(read).collect();
        let mut read = units.iter().zip(read).peekable();
        if *is_long {
            drop(credit);
            return read.try_for_each(|(unit, read)| self.hand_on_long(captures, unit, read));
        }
        while let Some((_, Read { reduced: next, .. })) = read.peek() {
            let is_reduced = next.is_some();
            let run = from_fn(|| read.next_if(|(_, Read { reduced, .. })| reduced.is_some() == is_reduced)).collect();
            if is_reduced { self.hand_on(run)? } else { self.send_rows(run, &credit)? }
        }
        self.feed.read_bytes(items.iter().map(|(_, item)| item.bytes).sum());
        Ok(())
    }

    /// Hands on what was made of large files piece by piece; reads each by itself if exposures are larger than pieces.
    fn hand_on_long(&mut self, captures: &[Capture], unit: &Unit<'_>, read: Read) -> Result<(), StageError> {
        if read.reduced.is_none() {
            let mut jobs = unit.jobs.iter();
            return jobs.try_for_each(|(index, job)| {
                self.large(captures, &Share { index: *index, item: job.item, of_file: None })
            });
        }
        self.hand_on(vec![(unit, read)])?;
        self.feed.read_bytes(unit.jobs.iter().map(|(_, job)| job.item.bytes).sum());
        Ok(())
    }

    /// Hands on what was made of captures where they were read.
    fn hand_on(&mut self, units: Vec<(&Unit<'_>, Read)>) -> Result<(), StageError> {
        let in_place = self.feed.in_place().expect("it has reduced them");
        let (campaign, mut rows, mut all) = (units[0].0.jobs[0].1.capture.campaign, Records::default(), Vec::new());
        for (unit, Read { done, reduced }) in units {
            for ((index, job), done) in unit.jobs.iter().zip(done) {
                rows.append(self.take(*index, job, done)?);
            }
            all.extend(reduced);
        }
        in_place.send(all)?;
        self.store_runs(campaign, &rows)
    }

    /// Sends rows on as they are.
    fn send_rows<'u>(&mut self, units: Vec<(&'u Unit<'u>, Read)>, credit: &Credit) -> Result<(), StageError> {
        let items = |(unit, read): (&'u Unit<'u>, Read)| unit.jobs.iter().zip(read.done);
        let mut items = units.into_iter().flat_map(items).peekable();
        while let Some(((_, Job { capture, .. }), _)) = items.peek() {
            let (campaign, mut rows) = (capture.campaign, Records::default());
            for ((index, job), done) in items.by_ref().take(ITEMS_SENT) {
                rows.append(self.take(*index, job, done)?);
            }
            if !rows.is_empty() {
                let batch = self.send(&rows, credit.clone())?;
                if self.feed.stores() {
                    self.store(campaign, &rows, &batch)?;
                }
            }
        }
        Ok(())
    }

    /// A file that is larger than a batch, or that is wanted in part only: read in pieces.
    fn large(&mut self, captures: &[Capture], share: &Share<'_>) -> Result<(), StageError> {
        let Share { index: number, item, of_file } = share;
        let (number, capture) = (*number, &captures[*number]);
        let job = Job { capture, item, first_shot: self.shots.get(&number).copied().unwrap_or(0) };
        let reading = match of_file {
            Some((_, hashed)) => Reading::Stretch(hashed),
            None if item.is_share() && was_read(self.surveyed, &job) => Reading::Unhashed,
            None => Reading::Long,
        };
        let exposures = of_file.as_ref().map(|(shots, _)| shots.clone());
        let done = match Long::open(self.surveyed, &job, reading, exposures, [self.batch_bytes, self.feed.most()]) {
            Err(done) => *done,
            Ok(mut long) => {
                while let Some(bytes) = long.piece_bytes(&job) {
                    let credit = self.feed.reserve(bytes)?;
                    let Some(rows) = long.next(self.surveyed, &job) else { break };
                    self.send(&rows, credit)?;
                    if self.feed.stores() {
                        long.keep(rows);
                    }
                    self.feed.read_bytes(bytes as u64);
                }
                let (done, stretches) = long.close(self.surveyed, &job);
                self.stretches.extend(stretches);
                done
            }
        };
        let rows = self.take(number, &job, done)?;
        self.store_runs(capture.campaign, &rows)
    }

    /// Stores rows of an index that hold no codes.
    fn store_runs(&self, campaign: usize, rows: &Records) -> Result<(), StageError> {
        rows.runs(INDEX_ROWS).try_for_each(|rows| self.store(campaign, &rows, &rows.to_batch()))
    }

    /// Sends rows on, and notes what only their codes say.
    fn send(&mut self, rows: &Records, credit: Credit) -> Result<RecordBatch, StageError> {
        rows.clipped().for_each(|clipped| self.clipped.push(clipped));
        let batch = rows.to_batch();
        self.feed.send(batch.clone(), credit)?;
        Ok(batch)
    }

    /// Stores the rows of an index; their files have been read to their ends.
    fn store(&self, campaign: usize, rows: &Records, batch: &RecordBatch) -> Result<(), StageError> {
        let digest = |file: &str| {
            let file = PathBuf::from(file);
            let of_part = self.digests.get(&(campaign, file.clone())).copied();
            // Another part may have read it.
            of_part.or_else(|| self.surveyed.digest_of(campaign, &file).ok()?).map(|digest| digest.to_string().into())
        };
        self.feed.store(rows.to_index(batch, digest))
    }

    /// Notes the digests of files that were read to their ends.
    pub fn note(&mut self, campaign: usize, digests: Vec<Hashed>) -> Result<(), StageError> {
        for Hashed { file, digest, metadata } in digests {
            // What changed while it was read is not what was hashed, and goes down in no notes.
            let now = disk::metadata(self.surveyed.campaigns[campaign].path_of(&file));
            if !now.is_ok_and(|now| Stamp::of(&now) == Stamp::of(&metadata)) {
                continue;
            }
            self.surveyed.hold(campaign, &file, digest)?;
            self.surveyed.record(campaign, &file, digest, &metadata);
            self.digests.insert((campaign, file), digest.into());
        }
        Ok(())
    }

    /// Notes what came of a job. A file with another content on record stops the run before anything that was made of
    /// it counts.
    fn take(&mut self, index: usize, job: &Job<'_>, done: Done) -> Result<Records, StageError> {
        let campaign = job.capture.campaign;
        self.rejections.extend(done.rejection.transpose()?);
        for remark in done.remarks {
            if !self.rejections.contains(&remark) {
                self.rejections.push(remark);
            }
        }
        self.note(campaign, done.digests)?;
        if !job.item.is_numbered() {
            *self.shots.entry(index).or_insert(0) += done.shots;
        }
        Ok(done.rows)
    }
}

/// Content of a part, from the digests of its files; notes these down.
pub fn content(surveyed: &Surveyed<'_>, captures: &[Capture], mut digests: FileDigests) -> Result<Digest, StageError> {
    for (campaign, file) in content::files(captures) {
        let key = (campaign, file.to_owned());
        if digests.contains_key(&key) {
            continue;
        }
        let digest = surveyed.digest_of(campaign, file)?.ok_or_else(|| unread(&surveyed.campaigns[campaign], file))?;
        digests.insert(key, digest);
    }
    let campaign = captures[0].campaign;
    let saved = surveyed.records[campaign].save_slip(captures);
    saved.map_err(|error| StageError::Refused(chain(&surveyed.campaigns[campaign].root, &error)))?;
    Ok(content::digest(surveyed.campaigns, captures, &digests))
}

/// Why a file has no digest after its part was read: without one, nothing that is made of it has a lineage.
pub fn unread(campaign: &Campaign, file: &Path) -> StageError {
    let path = campaign.path_of(file);
    StageError::Refused(match hash_file(&path) {
        Ok(_) => format!("{} changed while it was read; run again when the capture has ended", path.display()),
        Err(error) => chain(&campaign.root, &error),
    })
}

/// Items of one file, with one reference: read whole where they take up most of it, else share by share, and hashed to
/// its end unless this run has done so.
pub fn read_items(surveyed: &Surveyed<'_>, jobs: &[&Job<'_>]) -> Vec<Done> {
    let first = jobs[0];
    let is_share = jobs.len() > 1 || first.item.is_share();
    let reject_all = |error: &Bad| -> Vec<Done> {
        let rejected =
            |job: &&Job<'_>| Done { rejection: Some(error.clone().rejection(surveyed, job)), ..Done::default() };
        let mut done: Vec<Done> = jobs.iter().map(rejected).collect();
        done[0].digests = digests_of_bad(surveyed, first);
        done
    };
    let is_hashed = is_share && was_read(surveyed, first);
    let reading = match is_share {
        true if is_hashed => Reading::Unhashed,
        true if !is_most_of_its_file(surveyed, jobs) => Reading::Long,
        _ => Reading::Whole,
    };
    let mut files = match Files::open(surveyed, first, reading) {
        Ok(files) => files,
        Err(error) => return reject_all(&error),
    };
    let mut done: Vec<Done> = jobs.iter().map(|job| read_item(surveyed, &mut files, job)).collect();
    if !is_hashed {
        match files.digests() {
            Ok(digests) => done[0].digests = digests,
            Err(error) => return reject_all(&error),
        }
    }
    done
}

/// Whether items take up more than half of their file.
fn is_most_of_its_file(surveyed: &Surveyed<'_>, jobs: &[&Job<'_>]) -> bool {
    let Job { capture, item, .. } = jobs[0];
    let bytes: u64 = jobs.iter().map(|job| job.item.bytes).sum();
    let file = disk::metadata(surveyed.campaigns[capture.campaign].path_of(&item.exposure.file));
    file.is_ok_and(|file| bytes > file.len() / 2)
}

fn read_item(surveyed: &Surveyed<'_>, files: &mut Files, job: &Job<'_>) -> Done {
    let mut done = Done::default();
    let rows = files.turn_to(job).and_then(|()| {
        done.shots = files.exposures() as i32;
        files.rows(surveyed, job, 0..files.exposures())
    });
    match rows {
        Ok(rows) => {
            done.rows = rows;
            match remarks(surveyed, job, files) {
                Ok(remarks) => done.remarks = remarks,
                Err(error) => done.rejection = Some(Err(error)),
            }
        }
        Err(error) => done.rejection = Some(error.rejection(surveyed, job)),
    }
    done
}

/// What is to be said about the files of an item whose records are used.
pub fn remarks(surveyed: &Surveyed<'_>, job: &Job<'_>, files: &Files) -> Result<Vec<Rejection>, StageError> {
    files.remarks().into_iter().map(|remark| remark.rejection(surveyed, job)).collect()
}

/// Whether this run has read all files of an item to their ends before.
fn was_read(surveyed: &Surveyed<'_>, job: &Job<'_>) -> bool {
    job.item.exposure.files().all(|file| surveyed.was_read(job.capture.campaign, file))
}

/// Digests of files that do not decode: they are part of the content all the same.
pub fn digests_of_bad(surveyed: &Surveyed<'_>, job: &Job<'_>) -> Vec<Hashed> {
    let campaign = &surveyed.campaigns[job.capture.campaign];
    let hashed = |file: &PathBuf| {
        let path = campaign.path_of(file);
        let metadata = disk::metadata(&path).ok()?;
        Some(Hashed { file: file.clone(), digest: hash_file(&path).ok()?, metadata })
    };
    job.item.exposure.files().filter_map(hashed).collect()
}
