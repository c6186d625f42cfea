//! What a stage is: its parameters plus one pure function over groups of rows; and how the runtime sees it.
//!
//! A stage is [`Apply`] when it wants a whole group of rows at once, or [`Fold`] when it must not (10^5 shots of a capture do not fit in
//! memory). The blanket implementations below turn either into an [`Operator`]: batch in, batch out, in parallel over captures, rows
//! in input order. [`Source`] is the same for what has no streamed input.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use arrow::array::{AsArray, Int32Array, RecordBatch, StringArray};
use arrow::compute::concat_batches;
use arrow::datatypes::{Int32Type, SchemaRef};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;
use thiserror::Error;

use crate::campaign::Campaign;
use crate::store::Digest;
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

/// Why a stage cannot go on. Bad data is a row with a flag and a bad file a row in `rejects`; this is for what stops a whole table.
#[derive(Debug, Error)]
pub enum StageError {
    /// An input table is not what its name says.
    #[error(transparent)]
    Schema(#[from] SchemaError),
    /// Arrow refused an operation on batches.
    #[error(transparent)]
    Arrow(#[from] arrow::error::ArrowError),
    /// The consumer is gone: another stage failed first.
    #[error("stopped because another stage failed")]
    Stopped,
    /// Anything else; the text names the place and the mend.
    #[error("{0}")]
    Refused(String),
}

/// A finished table that stands beside a stage's streamed input.
#[derive(Clone, Copy, Debug)]
pub struct Beside {
    /// Name in the pipeline file: `with = { name = "heading" }`.
    pub name: &'static str,
    /// Table that it must be.
    pub table: &'static str,
    /// Whether the stage cannot do without.
    pub required: bool,
}

/// The finished tables beside a stage, by their names in `with`.
#[derive(Clone, Debug, Default)]
pub struct BesideTables(pub BTreeMap<String, Vec<RecordBatch>>);

impl BesideTables {
    /// Rows of one of them; `None` where the pipeline gives none.
    ///
    /// # Errors
    /// When the table has other columns.
    pub fn rows<R: Row>(&self, name: &str) -> Result<Option<Vec<R>>, SchemaError> {
        let Some(batches) = self.0.get(name) else {
            return Ok(None);
        };
        let mut rows = Vec::new();
        for batch in batches {
            rows.extend(R::rows(batch)?);
        }
        Ok(Some(rows))
    }
}

/// A side table that a stage writes beside its main one.
#[derive(Clone, Copy, Debug)]
pub struct Side {
    /// Name: the view is `<heading>.<name>`.
    pub name: &'static str,
    /// Its schema.
    pub schema: fn() -> SchemaRef,
}

/// Something set aside.
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
    /// Why, and the mend.
    pub reason: String,
}

impl Rejection {
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
    /// What it set aside.
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
    /// Finished tables beside its input.
    const BESIDE: &'static [Beside] = &[];
    /// Side tables that it writes.
    const SIDES: &'static [Side] = &[];
    /// Row of the streamed input.
    type Input: Row;
    /// Row of the main table.
    type Output: Row;
    /// The fields of campaign.toml that it reads; only these enter its lineage.
    type Fields: Serialize;
    /// What it prepares once from fields and finished tables.
    type Context: Send + Sync;

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

/// Rows that came out of a batch: main table first, then side tables, then rejects.
#[derive(Default)]
pub struct Written {
    /// One entry a table in the order of [`Operator::tables`]; tables without rows may be left out at the end.
    pub tables: Vec<Vec<RecordBatch>>,
    /// What was set aside.
    pub rejections: Vec<Rejection>,
}

/// A table that a stage writes.
#[derive(Clone, Debug)]
pub struct WrittenTable {
    /// Name of the table in the shelf.
    pub name: String,
    /// Its schema.
    pub schema: SchemaRef,
}

/// A stage as the runtime sees it.
pub trait Operator: Send + Sync {
    /// Kind, as in the pipeline file.
    fn kind(&self) -> &'static str;
    /// Version.
    fn version(&self) -> u32;
    /// Grain.
    fn grain(&self) -> Grain;
    /// Parameters as parsed, defaults included.
    fn params(&self) -> Value;
    /// Fields of the campaigns that it reads.
    fn fields(&self, campaigns: &[Campaign]) -> Value;
    /// Table that it takes.
    fn input(&self) -> &'static str;
    /// Finished tables that it takes beside.
    fn beside(&self) -> &'static [Beside];
    /// Main table, then side tables.
    fn tables(&self) -> Vec<WrittenTable>;
    /// Gets ready for rows.
    ///
    /// # Errors
    /// When parameters, fields and finished tables do not go together.
    fn start<'a>(&'a self, campaigns: &[Campaign], beside: &BesideTables) -> Result<Box<dyn Running + 'a>, StageError>;
}

/// A stage at work.
pub trait Running: Send {
    /// Takes a batch; gives the rows of all groups that ended within it.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn push(&mut self, batch: &RecordBatch) -> Result<Written, StageError>;
    /// Ends the groups that are open: at the end of a part for grains that stream, at the end of all rows for the others.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn flush(&mut self) -> Result<Written, StageError>;
}

impl<S: Fold> Operator for S {
    fn kind(&self) -> &'static str {
        S::KIND
    }
    fn version(&self) -> u32 {
        S::VERSION
    }
    fn grain(&self) -> Grain {
        S::GRAIN
    }
    fn params(&self) -> Value {
        serde_json::to_value(self).expect("parameters are plain data")
    }
    fn fields(&self, campaigns: &[Campaign]) -> Value {
        serde_json::to_value(Stage::fields(self, campaigns)).expect("campaign fields are plain data")
    }
    fn input(&self) -> &'static str {
        S::Input::TABLE
    }
    fn beside(&self) -> &'static [Beside] {
        S::BESIDE
    }
    fn tables(&self) -> Vec<WrittenTable> {
        let main = WrittenTable { name: S::Output::TABLE.to_owned(), schema: S::Output::schema() };
        let sides = S::SIDES.iter().map(|side| WrittenTable { name: side.name.to_owned(), schema: (side.schema)() });
        std::iter::once(main).chain(sides).collect()
    }
    fn start<'a>(&'a self, campaigns: &[Campaign], beside: &BesideTables) -> Result<Box<dyn Running + 'a>, StageError> {
        let context = self.context(Stage::fields(self, campaigns), beside)?;
        Ok(Box::new(Groups { stage: self, context, open: BTreeMap::new() }))
    }
}

/// What tells two groups apart. Order of keys is order of output for grains that gather.
type GroupKey = (String, String, i32, i32, String);

/// A stage's groups: those that rows may still come for, by key.
struct Groups<'a, S: Fold> {
    stage: &'a S,
    context: S::Context,
    open: BTreeMap<GroupKey, S::State>,
}

impl<S: Fold> Groups<'_, S> {
    fn written(outcomes: Vec<Outcome<S::Output>>) -> Result<Written, StageError> {
        let mut rows = Vec::new();
        let mut sides: Vec<Vec<RecordBatch>> = vec![Vec::new(); S::SIDES.len()];
        let mut rejections = Vec::new();
        for outcome in outcomes {
            rows.extend(outcome.rows);
            sides.iter_mut().zip(outcome.sides).for_each(|(all, side)| all.push(side));
            rejections.extend(outcome.rejections);
        }
        let mut tables = vec![if rows.is_empty() { Vec::new() } else { vec![S::Output::to_batch(&rows)] }];
        for (side, batches) in S::SIDES.iter().zip(sides) {
            tables.push(if batches.is_empty() {
                Vec::new()
            } else {
                vec![concat_batches(&(side.schema)(), &batches)?]
            });
        }
        Ok(Written { tables, rejections })
    }
}

impl<S: Fold> Running for Groups<'_, S> {
    fn push(&mut self, batch: &RecordBatch) -> Result<Written, StageError> {
        let columns = S::Input::columns(batch)?;
        let groups = groups(batch, S::GRAIN);
        if !S::GRAIN.streams() {
            for (key, rows) in groups {
                let state = self
                    .open
                    .entry(key)
                    .or_insert_with(|| self.stage.begin(&self.context, S::Input::read(&columns, rows.start)));
                self.stage.step(&self.context, state, &columns, rows)?;
            }
            return Ok(Written::default());
        }
        let last = groups.last().map(|(key, _)| key.clone());
        let mut work: Vec<(GroupKey, Option<Range<usize>>, Option<S::State>)> = Vec::new();
        // The group that was open goes on with the first rows, or has ended before them.
        if let Some((key, state)) = self.open.pop_first() {
            if groups.first().is_some_and(|(first, _)| *first == key) {
                work.push((key, Some(groups[0].1.clone()), Some(state)));
                work.extend(groups.into_iter().skip(1).map(|(key, rows)| (key, Some(rows), None)));
            } else {
                work.push((key, None, Some(state)));
                work.extend(groups.into_iter().map(|(key, rows)| (key, Some(rows), None)));
            }
        } else {
            work.extend(groups.into_iter().map(|(key, rows)| (key, Some(rows), None)));
        }
        let (stage, context) = (self.stage, &self.context);
        let mut done: Vec<(GroupKey, S::State)> = work
            .into_par_iter()
            .map(|(key, rows, state)| {
                let Some(rows) = rows else {
                    return Ok((key, state.expect("a group without rows was open")));
                };
                let mut state = state.unwrap_or_else(|| stage.begin(context, S::Input::read(&columns, rows.start)));
                stage.step(context, &mut state, &columns, rows)?;
                Ok((key, state))
            })
            .collect::<Result<_, StageError>>()?;
        if done.last().map(|(key, _)| key) == last.as_ref() {
            self.open.extend(done.pop());
        }
        let outcomes = done.into_par_iter().map(|(_, state)| stage.finish(context, state)).collect::<Result<_, _>>()?;
        Self::written(outcomes)
    }

    fn flush(&mut self) -> Result<Written, StageError> {
        let states: Vec<_> = std::mem::take(&mut self.open).into_values().collect();
        let (stage, context) = (self.stage, &self.context);
        let outcomes = states.into_par_iter().map(|state| stage.finish(context, state)).collect::<Result<_, _>>()?;
        Self::written(outcomes)
    }
}

/// Columns that tell rows apart; what a table does not have is the same for all of its rows.
struct KeyColumns {
    campaign: Option<StringArray>,
    sensor: Option<StringArray>,
    role: Option<StringArray>,
    lit: Option<Int32Array>,
    seen: Option<Int32Array>,
}

impl KeyColumns {
    fn of(batch: &RecordBatch) -> Self {
        let text = |name: &str| batch.column_by_name(name).map(|column| column.as_string::<i32>().clone());
        let number = |name: &str| batch.column_by_name(name).map(|column| column.as_primitive::<Int32Type>().clone());
        Self {
            campaign: text("campaign"),
            sensor: text("sensor"),
            role: text("role"),
            lit: number("lit"),
            seen: number("seen"),
        }
    }

    /// What tells a row's group apart, borrowed.
    fn key(&self, grain: Grain, i: usize) -> (&str, &str, i32, i32, &str) {
        let text = |column| text_at(column, i);
        let number = |column: &Option<Int32Array>| column.as_ref().map_or(0, |column| column.value(i));
        let (lit, seen) = (number(&self.lit), number(&self.seen));
        match grain {
            Grain::All => ("", "", 0, 0, ""),
            Grain::Sensor => (text(self.campaign.as_ref()), text(self.sensor.as_ref()), 0, 0, ""),
            Grain::Capture => {
                (text(self.campaign.as_ref()), text(self.sensor.as_ref()), lit, seen, text(self.role.as_ref()))
            }
            Grain::Pair => (
                text(self.campaign.as_ref()),
                text(self.sensor.as_ref()),
                lit.min(seen),
                lit.max(seen),
                text(self.role.as_ref()),
            ),
        }
    }
}

fn text_at(column: Option<&StringArray>, i: usize) -> &str {
    column.map_or("", |column| column.value(i))
}

/// Runs of rows that belong together, in order.
fn groups(batch: &RecordBatch, grain: Grain) -> Vec<(GroupKey, Range<usize>)> {
    let columns = KeyColumns::of(batch);
    let mut groups = Vec::new();
    let mut start = 0;
    for i in 1..=batch.num_rows() {
        if i == batch.num_rows() || columns.key(grain, start) != columns.key(grain, i) {
            let (campaign, sensor, lit, seen, role) = columns.key(grain, start);
            groups.push(((campaign.to_owned(), sensor.to_owned(), lit, seen, role.to_owned()), start..i));
            start = i;
        }
    }
    groups
}

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
    /// Says how many raw bytes were read, for progress.
    fn read_bytes(&self, bytes: u64);
}

/// A part as a source knows it before reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourcePart {
    /// Digest of its raw content and of what the source makes of it, if all its files were hashed before.
    pub content: Option<Digest>,
    /// Raw bytes, for progress.
    pub bytes: u64,
}

/// What reading a part gave beside its rows.
pub struct PartRead {
    /// Digest of its raw content and of what the source makes of it.
    pub content: Digest,
    /// What was set aside.
    pub rejections: Vec<Rejection>,
}

/// A stage without streamed input.
pub trait Source: Send + Sync {
    /// Kind, as in the pipeline file.
    fn kind(&self) -> &'static str;
    /// Version.
    fn version(&self) -> u32;
    /// Parameters as parsed, defaults included.
    fn params(&self) -> Value;
    /// Fields of the campaigns that it reads.
    fn fields(&self, campaigns: &[Campaign]) -> Value;
    /// Its table.
    fn table(&self) -> WrittenTable;
    /// Surveys the campaigns: its parts, in order. What it learns of raw files it may note down in the folder `notes`.
    ///
    /// # Errors
    /// When a campaign folder cannot be read or is inconsistent.
    fn open<'a>(&'a self, campaigns: &'a [Campaign], notes: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError>;
}

/// A source that has surveyed its parts.
pub trait OpenSource: Send + Sync {
    /// Its parts, in order.
    fn parts(&self) -> &[SourcePart];
    /// What a user should know before the run: files that no rule matches, and the like.
    fn warnings(&self) -> &[String];
    /// Reads a part. Chunk and batch sizes are the caller's; the rows do not depend on them.
    ///
    /// # Errors
    /// When the run must stop; a bad file is a rejection, not an error.
    fn read(&self, part: usize, batch_bytes: usize, feed: &dyn Feed) -> Result<PartRead, StageError>;
    /// Remembers what was learnt of the raw files; called when a pass has ended, also when it has failed.
    ///
    /// # Errors
    /// When it cannot be written down.
    fn close(&self) -> Result<(), StageError>;
}
