//! The thread of one step of a pass: takes rows, writes its tables, hands its main table on.

use std::sync::{Arc, PoisonError};

use arrow_array::RecordBatch;
use crossbeam_channel::{Receiver, Sender};

use super::{Ended, Failure, Joined, Made, Message, Plan, Shared, send};
use crate::stages::Node;
use crate::stages::operator::{OutputBatches, Reducer, Running, Started};
use crate::stages::source::Credit;
use crate::stages::stage::{BesideTables, StageError};
use crate::store::shelf::PartWriter;
use crate::store::{Digest, TableRecord};
use crate::tables::{Reject, Row};

/// Rows pass through unchanged: the work of a source's own step, which only writes.
struct Through;

impl Running for Through {
    fn push(&mut self, batch: &RecordBatch) -> Result<OutputBatches, StageError> {
        Ok(OutputBatches { tables: vec![vec![batch.clone()]], rejections: Vec::new() })
    }
    fn flush(&mut self) -> Result<OutputBatches, StageError> {
        Ok(OutputBatches::default())
    }
}

/// What was joined of pieces comes as the rows of a part.
struct Given(OutputBatches);

impl Running for Given {
    fn push(&mut self, _: &RecordBatch) -> Result<OutputBatches, StageError> {
        Ok(OutputBatches::default())
    }
    fn flush(&mut self) -> Result<OutputBatches, StageError> {
        Ok(std::mem::take(&mut self.0))
    }
}

/// A step with its channels.
pub(super) struct Ends<'a> {
    pub step: usize,
    pub input: Receiver<Message>,
    pub children: Vec<Sender<Message>>,
    /// Where the step says how its rows are made where they are read, if the root of the pass may do so.
    pub announce: Option<Sender<Option<Arc<dyn Reducer + 'a>>>>,
}

/// The thread of one step: takes rows, writes its tables, hands its main table on.
pub(super) fn work<'a>(
    shared: &Shared<'a>,
    ends: &Ends<'a>,
    tables: BesideTables,
    joined: Option<&Joined>,
) -> Result<(), Failure> {
    let Ends { step, input, children, announce } = ends;
    let (plan, step) = (shared.plan, *step);
    let streams = plan.streams(step);
    let failed = |error| shared.failed(step, error);
    let Started { mut running, reducer } = start(plan, step, &tables, joined).map_err(failed)?;
    if let Some(announce) = announce {
        announce.send(reducer.clone()).map_err(|_| Failure::Stopped)?;
    }
    // The stage has taken what it needs; whole tables would stay in memory until it ends.
    drop(tables);
    let beside = plan.beside(step).expect("tables beside a step are finished before its pass");
    let mut inputs = Vec::new();
    let mut writer = None;
    loop {
        let message = shared.span(step, "wait for rows", || input.recv()).map_err(|_| Failure::Stopped)?;
        shared.go_on()?;
        match message {
            Message::Rows(batch, credit) => {
                let output = shared.span(step, "compute", || running.push(&batch)).map_err(failed)?;
                shared.span(step, "write and hand on", || {
                    emit(shared, step, &mut writer, output, children, credit.as_ref())
                })?;
            }
            Message::Reduced(outcomes) => {
                let Some(reducer) = &reducer else {
                    hand_on(children, outcomes)?;
                    continue;
                };
                let outcomes = outcomes.into_iter().flatten().collect::<Result<_, _>>()?;
                let rows = || -> Result<OutputBatches, StageError> {
                    // The group that was open has ended before these.
                    let mut output = running.flush()?;
                    output.append(reducer.rows(outcomes)?);
                    Ok(output)
                };
                let output = shared.span(step, "compute", rows).map_err(failed)?;
                shared.span(step, "write and hand on", || emit(shared, step, &mut writer, output, children, None))?;
            }
            Message::Stored(batch) => open(shared, step, &mut writer)?.write(0, &batch)?,
            Message::PartEnd(part, lineage, rejections) if streams => {
                let mut output = shared.span(step, "compute", || running.flush()).map_err(failed)?;
                output.rejections.extend(rejections);
                shared.span(step, "write and hand on", || emit(shared, step, &mut writer, output, children, None))?;
                let lineage = match &plan.spec.steps[step].node {
                    Node::Source(_) => lineage,
                    Node::Operator(_) => plan.part_lineage(step, &lineage, &beside),
                };
                shared.span(step, "end of a part", || end_part(shared, step, &mut writer, part, lineage, children))?;
            }
            Message::PartEnd(_, lineage, _) => inputs.push(lineage),
            Message::End => break,
        }
    }
    if !streams {
        let output = shared.span(step, "compute", || running.flush()).map_err(failed)?;
        shared.span(step, "write and hand on", || emit(shared, step, &mut writer, output, children, None))?;
        let lineage = plan.part_lineage(step, &TableRecord::lineage_of(&inputs), &beside);
        shared.span(step, "end of a part", || end_part(shared, step, &mut writer, 0, lineage, children))?;
    }
    send(children, || Message::End)
}

/// Gets a step ready for rows.
fn start<'a>(
    plan: &Plan<'a>,
    step: usize,
    tables: &BesideTables,
    joined: Option<&Joined>,
) -> Result<Started<'a>, StageError> {
    let plain = |running| Started { running, reducer: None };
    match (joined, &plan.spec.steps[step].node) {
        (Some(joined), _) => Ok(plain(Box::new(Given(joined.output.clone())))),
        (_, Node::Source(_)) => Ok(plain(Box::new(Through))),
        (_, Node::Operator(operator)) => operator.start(plan.campaigns, tables),
    }
}

/// Hands to each child what was made for it.
pub(super) fn hand_on(children: &[Sender<Message>], outcomes: Vec<Vec<Made>>) -> Result<(), Failure> {
    let mut children = children.iter().zip(outcomes);
    children.try_for_each(|(child, own)| child.send(Message::Reduced(vec![own])).map_err(|_| Failure::Stopped))
}

/// Writes what a stage made, and hands its main table on.
fn emit<'a>(
    shared: &Shared<'a>,
    step: usize,
    writer: &mut Option<PartWriter<'a>>,
    output: OutputBatches,
    children: &[Sender<Message>],
    credit: Option<&Credit>,
) -> Result<(), Failure> {
    let plan = shared.plan;
    let tables = plan.stored_tables(step).len();
    if plan.stands_in(step) {
        let writer = open(shared, step, writer)?;
        for (table, batches) in output.tables.iter().enumerate() {
            batches.iter().try_for_each(|batch| writer.write(table, batch))?;
        }
    }
    if !output.rejections.is_empty() {
        let heading = &plan.spec.steps[step].heading;
        let rows: Vec<Reject> = output.rejections.into_iter().map(|rejection| rejection.row(heading)).collect();
        shared.progress.rejected(rows.len() as u64);
        open(shared, step, writer)?.write(tables - 1, &Reject::to_batch(&rows))?;
    }
    let Some(main) = output.tables.into_iter().next() else {
        return Ok(());
    };
    // Rows that a source read hold its memory until the last stage that sees them as they are has let go.
    let passed = matches!(plan.spec.steps[step].node, Node::Source(_));
    main.iter()
        .try_for_each(|batch| send(children, || Message::Rows(batch.clone(), credit.filter(|_| passed).cloned())))
}

fn open<'a, 'b>(
    shared: &Shared<'a>,
    step: usize,
    writer: &'b mut Option<PartWriter<'a>>,
) -> Result<&'b mut PartWriter<'a>, Failure> {
    let plan = shared.plan;
    if writer.is_none() {
        *writer = Some(plan.shelf.begin(&plan.tables[step].id, &plan.stored_tables(step))?);
    }
    Ok(writer.as_mut().expect("made above"))
}

/// Commits a part, and ends it for the steps below. These end theirs meanwhile; but where rows are not kept, the list
/// of rejects counts first: once all that is made of the rows is there, no run would look for it again.
fn end_part<'a>(
    shared: &Shared<'a>,
    step: usize,
    writer: &mut Option<PartWriter<'a>>,
    part: usize,
    lineage: Digest,
    children: &[Sender<Message>],
) -> Result<(), Failure> {
    let end = || send(children, || Message::PartEnd(part, lineage, Vec::new()));
    if shared.plan.spec.steps[step].keep {
        end()?;
        commit(shared, step, writer, lineage)
    } else {
        commit(shared, step, writer, lineage)?;
        end()
    }
}

fn commit<'a>(
    shared: &Shared<'a>,
    step: usize,
    writer: &mut Option<PartWriter<'a>>,
    lineage: Digest,
) -> Result<(), Failure> {
    // A part that was on the shelf before stays as it is, and its rejects are counted already: rows that are not stored
    // are computed again for the steps that need them.
    if shared.plan.tables[step].present.iter().flatten().any(|part| part.lineage == lineage) {
        *writer = None;
        return Ok(());
    }
    open(shared, step, writer)?;
    let writer = writer.take().expect("opened above");
    let part = writer.commit(lineage)?;
    let rejects = part.files.get(Reject::TABLE).map_or(0, |file| file.rows);
    let mut allowed = shared.allowed.lock().unwrap_or_else(PoisonError::into_inner);
    *allowed = allowed.checked_sub(rejects).ok_or(Failure::Early(Ended::TooManyRejects))?;
    Ok(())
}
