//! A file that is read in pieces, because it is larger than a batch or is wanted in part only.

use std::ops::Range;

use super::files::Files;
use super::part::{Done, digests_of_bad, remarks};
use super::raw_file::{HashedStretch, Reading};
use super::survey::{Job, Surveyed};
use crate::stages::stage::StageError;
use crate::tables::traces::Records;

/// An item under way.
pub struct Long<'a> {
    files: Files,
    reading: Reading<'a>,
    /// Exposures that are still to be read, and how many of them are a piece.
    left: Range<usize>,
    per_piece: usize,
    done: Done,
}

impl<'a> Long<'a> {
    /// Opens the files of an item, some `exposures` of which are wanted, or all; pieces have about `piece_bytes`. What
    /// came of it if it cannot be read: of an exposure that exceeds `most` bytes, the run ends.
    pub fn open(
        surveyed: &Surveyed<'_>,
        job: &Job<'_>,
        reading: Reading<'a>,
        exposures: Option<Range<usize>>,
        [piece_bytes, most]: [usize; 2],
    ) -> Result<Self, Box<Done>> {
        let files = Files::open(surveyed, job, reading).map_err(|error| {
            let rejection = Some(error.rejection(surveyed, job));
            Box::new(Done { digests: digests_of_bad(surveyed, job), rejection, ..Done::default() })
        })?;
        let (count, bytes) = (files.exposures(), files.exposure_bytes(job));
        if bytes > most {
            let file = surveyed.campaigns[job.capture.campaign].path_of(&job.item.exposure.file);
            let why = format!(
                "{}: one exposure takes {bytes} bytes, the memory of the run is {most}; give more --memory, or the part that counts by samples = [first, last] in its [[captures]] rule",
                file.display(),
            );
            return Err(Box::new(Done { rejection: Some(Err(StageError::Refused(why))), ..Done::default() }));
        }
        let left = exposures.map_or(0..count, |exposures| exposures.start..exposures.end.min(count));
        let mut done = Done { shots: left.len() as i32, ..Done::default() };
        if left.start == 0 {
            match remarks(surveyed, job, &files) {
                Ok(remarks) => done.remarks = remarks,
                Err(error) => return Err(Box::new(Done { rejection: Some(Err(error)), ..done })),
            }
        }
        Ok(Self { files, reading, left, per_piece: (piece_bytes / bytes.max(1)).max(1), done })
    }

    fn piece(&self) -> Range<usize> {
        self.left.start..self.left.end.min(self.left.start + self.per_piece)
    }

    /// Bytes of the next piece; `None` at the end.
    pub fn piece_bytes(&self, job: &Job<'_>) -> Option<usize> {
        let piece = self.piece();
        (!piece.is_empty()).then(|| self.files.exposure_bytes(job) * piece.len())
    }

    /// The rows of the next piece. Where they cannot be read, none come after it.
    pub fn next(&mut self, surveyed: &Surveyed<'_>, job: &Job<'_>) -> Option<Records> {
        let piece = self.piece();
        if piece.is_empty() {
            return None;
        }
        match self.files.rows(surveyed, job, piece.clone()) {
            Ok(rows) => {
                self.left.start = piece.end;
                Some(rows)
            }
            Err(error) => {
                self.left.start = self.left.end;
                self.done.rejection = Some(error.rejection(surveyed, job));
                None
            }
        }
    }

    /// Keeps rows for an index, whose files have been read to their ends when it is stored.
    pub fn keep(&mut self, rows: Records) {
        self.done.rows.append(rows.without_codes());
    }

    /// Hashes what is left to be hashed; what came of the item, and stretches of its files if these were asked for.
    pub fn close(self, surveyed: &Surveyed<'_>, job: &Job<'_>) -> (Done, Vec<HashedStretch>) {
        let Self { mut files, reading, mut done, .. } = self;
        let mut stretches = Vec::new();
        let hashed = match reading {
            Reading::Stretch(_) => files.stretches().map(|of_files| stretches = of_files),
            Reading::Unhashed => Ok(()),
            Reading::Whole | Reading::Long => files.digests().map(|digests| done.digests = digests),
        };
        if let Err(error) = hashed {
            done.rejection.get_or_insert_with(|| error.rejection(surveyed, job));
        }
        (done, stretches)
    }
}
