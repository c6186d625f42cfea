//! What has no streamed input: parts that are read from elsewhere, within the memory budget.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::operator::WrittenTable;
use super::stage::{Rejection, StageError};
use crate::campaign::{Campaign, LeftOut, Role};
use crate::store::Digest;
use crate::store::finite::NotJson;

/// A hold on part of the memory budget, given back when the last clone is dropped.
#[derive(Clone)]
pub struct Credit(#[expect(dead_code, reason = "it is held, not looked at")] Arc<dyn Send + Sync>);

impl Credit {
    /// Wraps what gives the memory back when it is dropped.
    pub fn new(hold: impl Send + Sync + 'static) -> Self {
        Self(Arc::new(hold))
    }
}

/// Where a source puts its rows.
pub trait Feed {
    /// Bytes that may be under way at most: what cannot be cut must be smaller.
    fn most(&self) -> usize;
    /// Waits until the memory budget has room for `bytes`.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn reserve(&self, bytes: usize) -> Result<Credit, StageError>;
    /// Hands rows on.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn send(&self, batch: RecordBatch, credit: Credit) -> Result<(), StageError>;
    /// What takes whole captures where they are read, while their samples are in the cache; `None` where rows are to be
    /// sent.
    fn in_place(&self) -> Option<&dyn InPlace> {
        None
    }
    /// Says how many raw bytes were read, for progress.
    fn read_bytes(&self, bytes: u64);
    /// Whether rows for the shelf are wanted too, of a source whose table does not stand in for it.
    fn stores(&self) -> bool {
        false
    }
    /// Hands rows over for the shelf, if these are wanted.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn store(&self, _batch: RecordBatch) -> Result<(), StageError> {
        Ok(())
    }
}

/// What the stages below a source made of some captures: the runtime's own business.
pub struct Reduced(pub Box<dyn Any + Send>);

/// The stages below a source, at work on whole captures in the source's own threads.
pub trait InPlace: Sync {
    /// Takes all rows of some captures. Calls may run side by side.
    fn reduce(&self, batch: &RecordBatch) -> Reduced;
    /// Takes the rows of one capture as they come.
    fn one(&self) -> Box<dyn CaptureInPlace + '_>;
    /// Hands on what was made of the captures that come next, in their order.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn send(&self, reduced: Vec<Reduced>) -> Result<(), StageError>;
}

/// A capture under way in the stages below a source.
pub trait CaptureInPlace {
    /// Takes the rows that come next.
    fn take(&mut self, batch: &RecordBatch);
    /// There are no more.
    fn finish(self: Box<Self>) -> Reduced;
}

/// A part as a source knows it before reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourcePart {
    /// Digest of its raw content and of what the source makes of it, if all its files were hashed before.
    pub content: Option<Digest>,
    /// Raw bytes, for progress.
    pub bytes: u64,
    /// Records: files, or shares of files, that are rejected one by one.
    pub records: u64,
}

/// A part for another process to read, which then need not survey the campaigns itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ticket {
    /// Captures that it has.
    pub captures: usize,
    /// Raw bytes.
    pub bytes: u64,
    /// Its raw files, each once.
    pub files: Vec<PathBuf>,
    /// The part, as its source alone understands it.
    pub part: Value,
}

/// A stretch of the records of a part, for another process to read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Piece {
    /// Captures of the part that it has records of, by their numbers there.
    pub captures: Range<usize>,
    /// Raw bytes.
    pub bytes: u64,
    /// Its raw files, each once.
    pub files: Vec<PathBuf>,
    /// Of files that it has a share of: its exposures, counted from 0.
    pub shots: BTreeMap<PathBuf, Range<usize>>,
    /// The stretch, as its source alone understands it.
    pub stretch: Value,
}

/// What reading a part gave, in addition to the rows.
pub struct PartRead {
    /// Digest of its raw content and of what the source makes of it.
    pub content: Digest,
    /// What was rejected.
    pub rejections: Vec<Rejection>,
}

/// A stage without streamed input.
pub trait Source: Send + Sync {
    /// Kind, as in the pipeline file.
    fn kind(&self) -> &'static str;
    /// Version.
    fn version(&self) -> u32;
    /// Parameters as parsed, defaults included.
    ///
    /// # Errors
    /// When one is not finite.
    fn params(&self) -> Result<Value, NotJson>;
    /// Fields of the campaigns that it reads.
    ///
    /// # Errors
    /// When one is not finite.
    fn fields(&self, campaigns: &[Campaign]) -> Result<Value, NotJson>;
    /// Its table.
    fn table(&self) -> WrittenTable;
    /// Whether `other` reads the same captures and more: then it reports what is wrong with them.
    fn is_sample_of(&self, _other: &dyn Source) -> bool {
        false
    }
    /// Whether its stored table has all that it sends on, so that it stands in for the source. One that does not is an
    /// index: its rows come by [`Feed::store`], and stages below take theirs from the source.
    fn stands_in(&self) -> bool {
        true
    }
    /// Surveys the campaigns: its parts, in order. What it learns of raw files it may note down in the folder `notes`.
    ///
    /// # Errors
    /// When a campaign folder cannot be read or is inconsistent.
    fn open<'a>(&'a self, campaigns: &'a [Campaign], notes: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError>;
    /// Takes parts up that [`OpenSource::ticket`] gave away, in this order; searches no folder.
    ///
    /// # Errors
    /// When a file has changed since, or a ticket is none of this source.
    fn take_up<'a>(
        &'a self,
        _campaigns: &'a [Campaign],
        _notes: &Path,
        _tickets: &[Ticket],
    ) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        Err(StageError::Refused(format!("`{}` gives no parts away", self.kind())))
    }
}

/// Where the records of a piece go, and those of the heads that it is judged by.
pub trait PieceFeed: Feed {
    /// Whether all is known by which later records of the capture are judged.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn is_primed(&self) -> Result<bool, StageError>;
    /// Ends a head: what it added up to does not count.
    ///
    /// # Errors
    /// When the run is being stopped.
    fn forget(&self) -> Result<(), StageError>;
}

/// A source whose parts can be cut between records.
pub trait Divisible {
    /// Into how many pieces a part can be cut.
    ///
    /// # Errors
    /// Why into none.
    fn most_pieces(&self, part: usize) -> Result<usize, String>;
    /// Cuts a part into `count` pieces of about as many bytes, or fewer, in the order of its records.
    ///
    /// # Errors
    /// As [`Divisible::most_pieces`].
    fn cut(&self, part: usize, count: usize) -> Result<Vec<Piece>, String>;
    /// Reads a piece: the head of the capture that began before it, then its own records. Gives what it learnt of the
    /// files.
    ///
    /// # Errors
    /// [`StageError::Indivisible`] when the part must be read whole; another when the run must stop, or a file has
    /// changed since the part was cut.
    fn read_piece(
        &self,
        part: usize,
        piece: &Piece,
        batch_bytes: usize,
        feed: &dyn PieceFeed,
    ) -> Result<Value, StageError>;
    /// Reads the head of one capture of a part.
    ///
    /// # Errors
    /// As [`Divisible::read_piece`].
    fn read_head(
        &self,
        part: usize,
        capture: usize,
        batch_bytes: usize,
        feed: &dyn PieceFeed,
    ) -> Result<(), StageError>;
    /// The content of a part, from what reading its pieces gave, in order; stores its rows, if these are wanted.
    ///
    /// # Errors
    /// When a file has changed since, or another content is on record.
    fn join(&self, part: usize, learnt: &[Value], feed: &dyn Feed) -> Result<Digest, StageError>;
}

/// A source that has surveyed its parts.
pub trait OpenSource: Send + Sync {
    /// Its parts, in order.
    fn parts(&self) -> &[SourcePart];
    /// What it leaves out of the campaigns: files that no rule matches, and the like.
    fn left_out(&self) -> &[LeftOut];
    /// Its captures by campaign (as counted in the run), sensor and role; `None` where only reading shows them.
    fn sensors(&self) -> Option<BTreeSet<(usize, String, Role)>> {
        None
    }
    /// Reads a part. Chunk and batch sizes are the caller's; the rows do not depend on them.
    ///
    /// # Errors
    /// When the run must stop; a bad file is a rejection, not an error.
    fn read(&self, part: usize, batch_bytes: usize, feed: &dyn Feed) -> Result<PartRead, StageError>;
    /// A part for another process; `None` from a source that is not worth sharing out.
    fn ticket(&self, _part: usize) -> Option<Ticket> {
        None
    }
    /// How its parts are cut between records; `None` from a source that reads parts whole.
    fn divisible(&self) -> Option<&dyn Divisible> {
        None
    }
    /// Remembers what was learnt of the raw files; called when a pass has ended, also when it has failed.
    ///
    /// # Errors
    /// When it cannot be written down.
    fn close(&self) -> Result<(), StageError>;
}
