//! A stage as the runtime sees it: batch in, batch out, in parallel over captures, rows in input order.

mod pieces;

use std::any::Any;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::Int32Type;
use arrow_array::{Int32Array, RecordBatch, StringArray};
use arrow_schema::SchemaRef;
use arrow_select::concat::concat_batches;
use rayon::prelude::*;
use serde_json::Value;

use super::stage::{Beside, BesideTables, Fold, Grain, InPieces, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::store::finite::{self, NotJson};
use crate::tables::Row;
use pieces::Pieces;
pub use pieces::{Joining, Task};

/// Rows that came out of a batch: main table first, then side tables, then rejects.
#[derive(Clone, Default)]
pub struct OutputBatches {
    /// One entry a table in the order of [`Operator::tables`]; tables without rows may be left out at the end.
    pub tables: Vec<Vec<RecordBatch>>,
    /// What was rejected.
    pub rejections: Vec<Rejection>,
}

impl OutputBatches {
    /// Adds what came out next.
    pub fn append(&mut self, next: Self) {
        self.tables.resize(self.tables.len().max(next.tables.len()), Vec::new());
        self.tables.iter_mut().zip(next.tables).for_each(|(table, batches)| table.extend(batches));
        self.rejections.extend(next.rejections);
    }
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
    ///
    /// # Errors
    /// When one is not finite.
    fn params(&self) -> Result<Value, NotJson>;
    /// Fields of the campaigns that it reads.
    ///
    /// # Errors
    /// When one is not finite.
    fn fields(&self, campaigns: &[Campaign]) -> Result<Value, NotJson>;
    /// Table that it takes.
    fn input(&self) -> &'static str;
    /// Finished tables that it takes whole.
    fn beside(&self) -> &'static [Beside];
    /// One of them, and the number of rows up to which it is taken.
    fn rows_max(&self) -> Option<(&'static str, u64)>;
    /// Which of them has the response of each sensor, if a sensor without one is refused.
    fn response_of_each(&self) -> Option<&'static Beside>;
    /// Main table, then side tables.
    fn tables(&self) -> Vec<WrittenTable>;
    /// Gets ready for rows.
    ///
    /// # Errors
    /// When parameters, fields and finished tables do not go together.
    fn start<'a>(&'a self, campaigns: &[Campaign], beside: &BesideTables) -> Result<Started<'a>, StageError>;
    /// Schema of what pieces of its groups add up to; `None` where a group must be seen in one go.
    fn subtotals(&self) -> Option<SchemaRef>;
    /// Gets ready for a piece of a group, whose subtotals come out as its main table; or, to join pieces, for heads and
    /// subtotals.
    ///
    /// # Errors
    /// As [`Operator::start`].
    ///
    /// # Panics
    /// When a group must be seen in one go.
    fn start_in_pieces<'a>(
        &'a self,
        campaigns: &[Campaign],
        beside: &BesideTables,
        task: Task,
    ) -> Result<Box<dyn Joining + 'a>, StageError>;
}

/// A stage that is ready for rows.
pub struct Started<'a> {
    /// What takes them in their order.
    pub running: Box<dyn Running + 'a>,
    /// What takes captures by themselves, where these are the groups.
    pub reducer: Option<Arc<dyn Reducer + 'a>>,
}

/// What a [`Reducer`] made of groups, in the stage's own type.
pub type Outcomes = Box<dyn Any + Send>;

/// A stage at work on groups that are there as a whole: side by side, wherever their rows are.
pub trait Reducer: Send + Sync {
    /// Takes all rows of some groups.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn reduce(&self, batch: &RecordBatch) -> Result<Outcomes, StageError>;
    /// Takes the rows of one group as they come.
    fn one(&self) -> Box<dyn OneGroup + '_>;
    /// The rows of what it made, in this order.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    ///
    /// # Panics
    /// When another stage made it.
    fn rows(&self, outcomes: Vec<Outcomes>) -> Result<OutputBatches, StageError>;
}

/// A group under way.
pub trait OneGroup {
    /// Takes the rows that come next.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn take(&mut self, batch: &RecordBatch) -> Result<(), StageError>;
    /// Ends it; nothing comes of a group without rows.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn finish(self: Box<Self>) -> Result<Outcomes, StageError>;
}

/// A stage at work.
pub trait Running: Send {
    /// Takes a batch; gives the rows of all groups that ended within it.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn push(&mut self, batch: &RecordBatch) -> Result<OutputBatches, StageError>;
    /// Ends the groups that are open: at the end of a part for grains that stream, at the end of all rows for the
    /// others.
    ///
    /// # Errors
    /// When the table as a whole cannot be made.
    fn flush(&mut self) -> Result<OutputBatches, StageError>;
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
    fn params(&self) -> Result<Value, NotJson> {
        finite::to_json(self)
    }
    fn fields(&self, campaigns: &[Campaign]) -> Result<Value, NotJson> {
        finite::to_json(&Stage::fields(self, campaigns))
    }
    fn input(&self) -> &'static str {
        S::Input::TABLE
    }
    fn beside(&self) -> &'static [Beside] {
        S::BESIDE
    }
    fn rows_max(&self) -> Option<(&'static str, u64)> {
        S::ROWS_MAX
    }
    fn response_of_each(&self) -> Option<&'static Beside> {
        S::RESPONSES
    }
    fn tables(&self) -> Vec<WrittenTable> {
        let main = WrittenTable { name: S::Output::TABLE.to_owned(), schema: S::Output::schema() };
        let sides = S::SIDES.iter().map(|side| WrittenTable { name: side.name.to_owned(), schema: (side.schema)() });
        std::iter::once(main).chain(sides).collect()
    }
    fn start<'a>(&'a self, campaigns: &[Campaign], beside: &BesideTables) -> Result<Started<'a>, StageError> {
        let context = self.context(Stage::fields(self, campaigns), beside)?;
        let ready = Arc::new(Ready { stage: self, context, cancel: beside.cancel.clone() });
        let reducer = (S::GRAIN == Grain::Capture).then(|| Arc::clone(&ready) as Arc<dyn Reducer + 'a>);
        Ok(Started { running: Box::new(Groups { ready, open: BTreeMap::new(), saves: None }), reducer })
    }
    fn subtotals(&self) -> Option<SchemaRef> {
        self.in_pieces().map(InPieces::schema)
    }
    fn start_in_pieces<'a>(
        &'a self,
        campaigns: &[Campaign],
        beside: &BesideTables,
        task: Task,
    ) -> Result<Box<dyn Joining + 'a>, StageError> {
        let context = self.context(Stage::fields(self, campaigns), beside)?;
        let pieces = self.in_pieces().expect("a stage whose groups can be computed in pieces");
        let saves = (task == Task::Save).then_some(pieces);
        let ready = Arc::new(Ready { stage: self, context, cancel: beside.cancel.clone() });
        Ok(Box::new(Pieces { groups: Groups { ready, open: BTreeMap::new(), saves }, pieces }))
    }
}

/// What identifies a group. Order of keys is order of output for grains that gather.
type GroupKey = (String, String, i32, i32, String, String);

/// A stage with what all its groups share.
struct Ready<'a, S: Fold> {
    stage: &'a S,
    context: S::Context,
    /// Polled before each group.
    cancel: Cancel,
}

impl<S: Fold> Ready<'_, S> {
    fn finish(&self, state: S::State) -> Result<Outcome<S::Output>, StageError> {
        self.cancel.check();
        self.stage.finish(&self.context, state)
    }
}

impl<S: Fold> Reducer for Ready<'_, S> {
    fn reduce(&self, batch: &RecordBatch) -> Result<Outcomes, StageError> {
        let columns = S::Input::columns(batch)?;
        let reduce = |(_, rows): (GroupKey, Range<usize>)| {
            self.cancel.check();
            let mut state = self.stage.begin(&self.context, S::Input::read(&columns, rows.start));
            self.stage.step(&self.context, &mut state, &columns, rows)?;
            self.stage.finish(&self.context, state)
        };
        let outcomes: Vec<_> = groups(batch, S::GRAIN).into_par_iter().map(reduce).collect::<Result<_, _>>()?;
        Ok(Box::new(outcomes))
    }

    fn one(&self) -> Box<dyn OneGroup + '_> {
        Box::new(One { ready: self, state: None })
    }

    fn rows(&self, outcomes: Vec<Outcomes>) -> Result<OutputBatches, StageError> {
        let own = |outcomes: Outcomes| *outcomes.downcast::<Vec<Outcome<S::Output>>>().expect("made by this stage");
        batches::<S>(outcomes.into_iter().flat_map(own).collect())
    }
}

/// A group of a stage, from its first row on.
struct One<'r, 'a, S: Fold> {
    ready: &'r Ready<'a, S>,
    state: Option<S::State>,
}

impl<S: Fold> OneGroup for One<'_, '_, S> {
    fn take(&mut self, batch: &RecordBatch) -> Result<(), StageError> {
        let Ready { stage, context, cancel } = self.ready;
        cancel.check();
        let columns = S::Input::columns(batch)?;
        let state = self.state.get_or_insert_with(|| stage.begin(context, S::Input::read(&columns, 0)));
        stage.step(context, state, &columns, 0..batch.num_rows())
    }

    fn finish(self: Box<Self>) -> Result<Outcomes, StageError> {
        let outcomes = self.state.map(|state| self.ready.finish(state)).into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok(Box::new(outcomes))
    }
}

/// A stage's groups: those that rows may still come for, by key.
struct Groups<'a, S: Fold> {
    ready: Arc<Ready<'a, S>>,
    open: BTreeMap<GroupKey, S::State>,
    /// Where groups are pieces, which are saved and not finished.
    saves: Option<&'a dyn InPieces<S>>,
}

impl<S: Fold> Groups<'_, S> {
    /// What starts a group at its first row.
    fn begin(&self) -> impl Fn(S::Input) -> S::State + Sync {
        let (ready, saves) = (&*self.ready, self.saves);
        move |first| match saves {
            Some(pieces) => pieces.begin(&ready.context, first),
            None => ready.stage.begin(&ready.context, first),
        }
    }

    /// Takes the rows of each group, side by side.
    fn steps(
        &self,
        work: Vec<(GroupKey, Option<Range<usize>>, Option<S::State>)>,
        columns: &<S::Input as Row>::Columns,
    ) -> Result<Vec<(GroupKey, S::State)>, StageError> {
        let (ready, begin) = (&*self.ready, self.begin());
        let step = |(key, rows, state): (GroupKey, Option<Range<usize>>, Option<S::State>)| {
            ready.cancel.check();
            let Some(rows) = rows else {
                return Ok((key, state.expect("a group without rows was open")));
            };
            let mut state = state.unwrap_or_else(|| begin(S::Input::read(columns, rows.start)));
            ready.stage.step(&ready.context, &mut state, columns, rows)?;
            Ok((key, state))
        };
        work.into_par_iter().map(step).collect()
    }

    /// Ends groups.
    fn end(&self, states: Vec<S::State>) -> Result<OutputBatches, StageError> {
        let Some(pieces) = self.saves else {
            let ready = &*self.ready;
            let outcomes = states.into_par_iter().map(|state| ready.finish(state)).collect::<Result<_, _>>()?;
            return batches::<S>(outcomes);
        };
        let saved = states.into_iter().map(|state| pieces.save(state).map_err(StageError::Indivisible));
        Ok(OutputBatches { tables: vec![saved.collect::<Result<_, _>>()?], rejections: Vec::new() })
    }
}

impl<S: Fold> Running for Groups<'_, S> {
    fn push(&mut self, batch: &RecordBatch) -> Result<OutputBatches, StageError> {
        let columns = S::Input::columns(batch)?;
        let groups = groups(batch, S::GRAIN);
        if !S::GRAIN.streams() {
            for (key, rows) in groups {
                let state = self.open.remove(&key);
                let mut state = state.unwrap_or_else(|| self.begin()(S::Input::read(&columns, rows.start)));
                self.ready.stage.step(&self.ready.context, &mut state, &columns, rows)?;
                self.open.insert(key, state);
            }
            return Ok(OutputBatches::default());
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
        let mut done = self.steps(work, &columns)?;
        if done.last().map(|(key, _)| key) == last.as_ref() {
            self.open.extend(done.pop());
        }
        self.end(done.into_iter().map(|(_, state)| state).collect())
    }

    fn flush(&mut self) -> Result<OutputBatches, StageError> {
        let states: Vec<_> = std::mem::take(&mut self.open).into_values().collect();
        self.end(states)
    }
}

/// The rows of what became of groups.
fn batches<S: Fold>(outcomes: Vec<Outcome<S::Output>>) -> Result<OutputBatches, StageError> {
    let mut rows = Vec::new();
    let mut sides: Vec<Vec<RecordBatch>> = vec![Vec::new(); S::SIDES.len()];
    let mut rejections = Vec::new();
    for outcome in outcomes {
        // One outcome of millions of rows is not copied.
        if rows.is_empty() {
            rows = outcome.rows;
        } else {
            rows.extend(outcome.rows);
        }
        sides.iter_mut().zip(outcome.sides).for_each(|(all, side)| all.push(side));
        rejections.extend(outcome.rejections);
    }
    let mut tables = vec![if rows.is_empty() { Vec::new() } else { vec![S::Output::to_batch(&rows)] }];
    for (side, batches) in S::SIDES.iter().zip(sides) {
        tables.push(if batches.is_empty() { Vec::new() } else { vec![concat_batches(&(side.schema)(), &batches)?] });
    }
    Ok(OutputBatches { tables, rejections })
}

/// Columns that the groups of rows differ in. A column that a table lacks is the same for all of its rows.
struct KeyColumns {
    campaign: Option<StringArray>,
    sensor: Option<StringArray>,
    role: Option<StringArray>,
    run: Option<StringArray>,
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
            run: text("run"),
            lit: number("lit"),
            seen: number("seen"),
        }
    }

    /// What identifies the group of a row, borrowed.
    fn key(&self, grain: Grain, i: usize) -> (&str, &str, i32, i32, &str, &str) {
        let text = |column| text_at(column, i);
        let number = |column: &Option<Int32Array>| column.as_ref().map_or(0, |column| column.value(i));
        let (lit, seen) = (number(&self.lit), number(&self.seen));
        let (first, second) = match grain {
            Grain::All => return ("", "", 0, 0, "", ""),
            Grain::Sensor => return (text(self.campaign.as_ref()), text(self.sensor.as_ref()), 0, 0, "", ""),
            Grain::Capture => (lit, seen),
            Grain::Pair => (lit.min(seen), lit.max(seen)),
        };
        (
            text(self.campaign.as_ref()),
            text(self.sensor.as_ref()),
            first,
            second,
            text(self.role.as_ref()),
            text(self.run.as_ref()),
        )
    }
}

fn text_at(column: Option<&StringArray>, i: usize) -> &str {
    column.map_or("", |column| column.value(i))
}

/// The rows of captures that neither the rows before a batch nor those after it can belong to.
#[must_use]
pub fn whole_captures(batch: &RecordBatch) -> Range<usize> {
    let (columns, rows) = (KeyColumns::of(batch), batch.num_rows());
    let key = |i: usize| columns.key(Grain::Capture, i);
    let start = (1..rows).find(|i| key(*i) != key(0)).unwrap_or(rows);
    let end = (start..rows).rev().find(|i| key(*i) != key(rows - 1)).map_or(start, |i| i + 1);
    start..end
}

/// Runs of rows that belong together, in order.
fn groups(batch: &RecordBatch, grain: Grain) -> Vec<(GroupKey, Range<usize>)> {
    let columns = KeyColumns::of(batch);
    let (mut groups, mut start, rows) = (Vec::new(), 0, batch.num_rows());
    while start < rows {
        let first = columns.key(grain, start);
        let end = (start + 1..rows).find(|i| columns.key(grain, *i) != first).unwrap_or(rows);
        let (campaign, sensor, lit, seen, role, run) = first;
        groups.push(((campaign.to_owned(), sensor.to_owned(), lit, seen, role.to_owned(), run.to_owned()), start..end));
        start = end;
    }
    groups
}
