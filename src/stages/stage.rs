//! What a stage is: its parameters plus one pure function over groups of rows.
//!
//! A stage is [`Apply`] when it wants a whole group of rows at once, or [`Fold`] when it must not: 10^5 shots of a
//! capture do not fit in memory. A blanket implementation turns either into what the runtime sees (`operator.rs`); what
//! has no streamed input is a source (`source.rs`).

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use serde::Serialize;
use thiserror::Error;

use crate::campaign::Campaign;
use crate::cancel::{Cancel, Cancelled};
use crate::parameter::{Condition, Conflict};
use crate::tables::{Name, Reject, Row, SchemaError};

/// Which rows a stage must see together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grain {
    /// All rows of one capture: same campaign, sensor, lit and seen.
    Capture,
    /// All rows of a capture and its reciprocal: (lit, seen) and (seen, lit).
    Pair,
    /// All rows of one sensor.
    Sensor,
    /// All rows.
    All,
}

impl Grain {
    /// Whether groups of this grain never straddle two parts, so that the stage streams.
    #[must_use]
    pub fn streams(self) -> bool {
        matches!(self, Self::Capture | Self::Pair)
    }
}

/// Why a stage cannot go on. Bad data is a row with a flag and a bad file a row in `rejects`; this is for what stops a
/// whole table.
#[derive(Debug, Error)]
pub enum StageError {
    /// An input table is not what its name says.
    #[error(transparent)]
    Schema(#[from] SchemaError),
    /// Arrow refused an operation on batches.
    #[error(transparent)]
    Arrow(#[from] arrow_schema::ArrowError),
    /// The consumer is gone: another stage failed first, or the user ended the run.
    #[error("stopped because another stage failed")]
    Stopped,
    /// A group that was to be computed in pieces must be computed whole; the text says why.
    #[error("{0}")]
    Indivisible(String),
    /// Anything else; the text names the place and the fix.
    #[error("{0}")]
    Refused(String),
}

impl From<Cancelled> for StageError {
    fn from(_: Cancelled) -> Self {
        Self::Stopped
    }
}

/// A finished table that a stage takes whole, in addition to its streamed input.
#[derive(Clone, Copy, Debug)]
pub struct Beside {
    /// Name in the pipeline file: `with = { name = "heading" }`.
    pub name: &'static str,
    /// Table that it must be.
    pub table: &'static str,
    /// Whether the stage cannot do without.
    pub required: bool,
}

/// What a stage is started with: finished tables, and the token of cancelling.
#[derive(Clone, Debug, Default)]
pub struct BesideTables {
    /// Finished tables, by their names in `with`.
    pub tables: BTreeMap<String, Vec<RecordBatch>>,
    /// Those of them that are too large to be held: they are read when a stage asks for them.
    pub stored: BTreeMap<String, StoredTable>,
    /// Ends the stage: a context keeps a clone and hands it to the kernels.
    pub cancel: Cancel,
}

impl<const N: usize> From<[(String, Vec<RecordBatch>); N]> for BesideTables {
    fn from(tables: [(String, Vec<RecordBatch>); N]) -> Self {
        Self { tables: tables.into(), ..Self::default() }
    }
}

impl BesideTables {
    /// Rows of one of them; `None` where the pipeline gives none.
    ///
    /// # Errors
    /// When the table has other columns, or cannot be read.
    pub fn rows<R: Row>(&self, name: &str) -> Result<Option<Vec<R>>, StageError> {
        if !self.tables.contains_key(name) && !self.stored.contains_key(name) {
            return Ok(None);
        }
        let mut rows = Vec::new();
        for batch in self.batches(name) {
            rows.extend(batch?);
        }
        Ok(Some(rows))
    }

    /// Rows of one of them batch by batch, for tables whose rows take much memory; none where the pipeline gives none.
    pub fn batches<R: Row>(&self, name: &str) -> impl Iterator<Item = Result<Vec<R>, StageError>> {
        let held = self.tables.get(name).into_iter().flatten().map(|batch| Ok(R::rows(batch)?));
        let stored = self.stored.get(name).into_iter().flat_map(|table| (table.0)()).map(|batch| Ok(R::rows(&batch?)?));
        held.chain(stored)
    }
}

/// Batches of a stored table, one after the other.
pub type Batches = Box<dyn Iterator<Item = Result<RecordBatch, StageError>>>;

/// A finished table that is read when its batches are asked for.
#[derive(Clone)]
pub struct StoredTable(pub Arc<dyn Fn() -> Batches + Send + Sync>);

impl fmt::Debug for StoredTable {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("StoredTable")
    }
}

/// A side table that a stage writes in addition to its main one.
#[derive(Clone, Copy, Debug)]
pub struct Side {
    /// Name: the view is `<heading>.<name>`.
    pub name: &'static str,
    /// Its schema.
    pub schema: fn() -> SchemaRef,
}

/// A record, capture or value that was rejected.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejection {
    /// Campaign.
    pub campaign: Name,
    /// Raw file, if it is about one.
    pub file: Option<Name>,
    /// Segment of the file.
    pub segment: Option<i32>,
    /// Where in the file.
    pub byte_offset: Option<i64>,
    /// Why, and the fix.
    pub reason: String,
}

impl Rejection {
    /// About no file.
    #[must_use]
    pub fn new(campaign: &str, reason: String) -> Self {
        Self { campaign: campaign.into(), file: None, segment: None, byte_offset: None, reason }
    }

    /// As a row of the table `rejects`.
    #[must_use]
    pub fn row(self, heading: &str) -> Reject {
        Reject {
            stage: heading.into(),
            campaign: self.campaign,
            file: self.file,
            segment: self.segment,
            byte_offset: self.byte_offset,
            reason: self.reason.into(),
        }
    }
}

/// What a stage makes of one group.
pub struct Outcome<R> {
    /// Rows of its main table.
    pub rows: Vec<R>,
    /// Rows of its side tables, in the order of [`Stage::SIDES`]; shorter when there are none.
    pub sides: Vec<RecordBatch>,
    /// What it rejected.
    pub rejections: Vec<Rejection>,
}

impl<R> Outcome<R> {
    /// Rows of the main table and nothing else.
    #[must_use]
    pub fn rows(rows: Vec<R>) -> Self {
        Self { rows, sides: Vec::new(), rejections: Vec::new() }
    }

    /// Nothing but a rejection.
    #[must_use]
    pub fn rejected(rejection: Rejection) -> Self {
        Self { rows: Vec::new(), sides: Vec::new(), rejections: vec![rejection] }
    }
}

/// What every stage declares. Its own fields are its parameters.
pub trait Stage: Serialize + Send + Sync + 'static {
    /// Name in the pipeline file.
    const KIND: &'static str;
    /// Raised whenever equal input and parameters give other rows.
    const VERSION: u32;
    /// Rows that it must see together.
    const GRAIN: Grain;
    /// Finished tables that it takes whole.
    const BESIDE: &'static [Beside] = &[];
    /// One of these, by its name, and the number of rows up to which it is taken: a larger one is not there for the
    /// stage.
    const ROWS_MAX: Option<(&'static str, u64)> = None;
    /// Which of these has the response of each sensor, if the stage refuses a sensor that has none.
    const RESPONSES: Option<&'static Beside> = None;
    /// Side tables that it writes.
    const SIDES: &'static [Side] = &[];
    /// Parameters that have an effect only with some values of another one.
    const CONDITIONS: &'static [Condition] = &[];
    /// Row of the streamed input.
    type Input: Row;
    /// Row of the main table.
    type Output: Row;
    /// The fields of campaign.toml that it reads; only these enter its lineage.
    type Fields: Serialize;
    /// What it prepares once from fields and finished tables.
    type Context: Send + Sync;

    /// A parameter whose value does not go together with the others', beyond [`Stage::CONDITIONS`].
    fn conflict(&self) -> Option<Conflict> {
        None
    }

    /// Picks its fields out of the campaigns.
    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields;

    /// Prepares what all groups share.
    ///
    /// # Errors
    /// When parameters, fields and finished tables do not go together.
    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Self::Context, StageError>;
}

/// A stage that takes a whole group of rows at once.
pub trait Apply: Stage {
    /// The pure function.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn apply(&self, context: &Self::Context, group: Vec<Self::Input>) -> Result<Outcome<Self::Output>, StageError>;
}

/// A stage that takes a group of rows in chunks, in order.
pub trait Fold: Stage {
    /// What it remembers of a group so far.
    type State: Send;
    /// Starts a group whose first row is given.
    fn begin(&self, context: &Self::Context, first: Self::Input) -> Self::State;
    /// Takes the next rows of the group.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn step(
        &self,
        context: &Self::Context,
        state: &mut Self::State,
        columns: &<Self::Input as Row>::Columns,
        rows: Range<usize>,
    ) -> Result<(), StageError>;
    /// Ends the group.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn finish(&self, context: &Self::Context, state: Self::State) -> Result<Outcome<Self::Output>, StageError>;
    /// How its groups are computed in pieces; `None` where a group must be seen in one go.
    fn in_pieces(&self) -> Option<&dyn InPieces<Self>>
    where
        Self: Sized,
    {
        None
    }
}

/// A fold whose groups can be computed in pieces, each a run of the group's rows, on different machines.
///
/// Later rows may be judged by the first ones, the *head* of the group. So a piece sees the head first, until it is
/// primed, and forgets what that added up to; then it takes its own rows, and saves their subtotals. To join the
/// pieces, a fold sees the head too, forgets, absorbs the subtotals of all pieces in order, and finishes the group. The
/// result is to the bit that of one pass over all rows.
pub trait InPieces<S: Fold>: Sync {
    /// Schema of the subtotals; they begin with the columns that distinguish groups.
    fn schema(&self) -> SchemaRef;
    /// Starts a piece of a group whose first row is given: a state that can be saved.
    fn begin(&self, context: &S::Context, first: S::Input) -> S::State;
    /// Whether all is known by which rows of the kind seen last are judged.
    fn is_primed(&self, context: &S::Context, state: &S::State) -> bool;
    /// Forgets what was added up, and keeps what later rows are judged by. Of the kinds of rows seen so far, all that
    /// belongs to their heads was seen.
    fn forget(&self, state: &mut S::State);
    /// What a piece adds up to.
    ///
    /// # Errors
    /// When its subtotals would depend on the order in which they are absorbed; the text says why.
    fn save(&self, state: S::State) -> Result<RecordBatch, String>;
    /// Adds the subtotals of the next piece.
    ///
    /// # Errors
    /// When they do not belong to this group, or the sum would not be exact; the text says why.
    fn absorb(&self, state: &mut S::State, subtotals: &RecordBatch) -> Result<(), String>;
}

impl<S: Apply> Fold for S {
    type State = Vec<S::Input>;

    fn begin(&self, _: &S::Context, _: S::Input) -> Self::State {
        Vec::new()
    }

    fn step(
        &self,
        _: &S::Context,
        state: &mut Self::State,
        columns: &<S::Input as Row>::Columns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        state.extend(rows.map(|i| S::Input::read(columns, i)));
        Ok(())
    }

    fn finish(&self, context: &S::Context, state: Self::State) -> Result<Outcome<S::Output>, StageError> {
        self.apply(context, state)
    }
}
