//! The thread at the root of a pass: reads a source, or replays a stored table.

use std::ops::Range;
use std::sync::{Arc, PoisonError};

use arrow_array::RecordBatch;
use crossbeam_channel::{Receiver, Sender};

use super::{Failure, Made, Message, Pass, Shared, send, step};
use crate::stages::operator::{OneGroup, Reducer, whole_captures};
use crate::stages::source::{CaptureInPlace, Credit, Feed, InPlace, PartRead, Reduced};
use crate::stages::stage::StageError;

/// The thread of the root: reads a source, or replays a table.
pub(super) fn read<'a>(
    shared: &Shared<'a>,
    pass: &Pass,
    children: &[Sender<Message>],
    reducers: Vec<(usize, Receiver<Option<Arc<dyn Reducer + 'a>>>)>,
) -> Result<(), Failure> {
    let plan = shared.plan;
    let announced = |(step, reducer): (usize, Receiver<Option<_>>)| {
        let reducer = reducer.recv().map_err(|_| Failure::Stopped)?;
        Ok(reducer.map(|reducer| (step, reducer)))
    };
    // All are heard before any is judged: a step that nobody hears has to stop.
    let reducers: Vec<Option<_>> = reducers.into_iter().map(announced).collect::<Result<_, Failure>>()?;
    let reducers: Option<Vec<_>> = reducers.into_iter().collect();
    // Rows that are to be stored or joined have to come by.
    let is_stored = pass.steps.contains(&pass.root) && plan.stands_in(pass.root);
    let reducers = reducers.filter(|_| !is_stored && pass.joined.is_none());
    let in_place = reducers.map(|reducers| InThreads { shared, children, reducers });
    for &part in &pass.parts {
        shared.go_on()?;
        if pass.steps.contains(&pass.root) {
            let source = &plan.sources[&pass.root];
            let stores = plan.spec.steps[pass.root].keep && !plan.stands_in(pass.root) && plan.lacks(pass.root, part);
            let feed = Channel { shared, children, stores, in_place: in_place.as_ref() };
            let part_read = match pass.joined.as_ref().zip(source.divisible()) {
                // A part with an exceptional shot cannot be joined from pieces; it is computed whole.
                Some((joined, pieces)) => {
                    pieces.join(part, &joined.learnt, &feed).map(|content| PartRead { content, rejections: Vec::new() })
                }
                None => shared.span_of_reader("read", || source.read(part, shared.settings.batch_bytes, &feed)),
            };
            let PartRead { content, rejections } = part_read.map_err(|error| shared.failed(pass.root, error))?;
            shared.content.lock().unwrap_or_else(PoisonError::into_inner).insert((pass.root, part), content);
            let beside = plan.beside(pass.root).expect("a source has nothing beside it");
            let lineage = plan.part_lineage(pass.root, &content, &beside);
            send(children, || Message::PartEnd(part, lineage, rejections.clone()))?;
        } else {
            shared.span_of_reader("read back", || replay(shared, pass.root, part, children, in_place.as_ref()))?;
        }
    }
    send(children, || Message::End)
}

/// Sends the rows of a stored part. Where the steps below take captures by themselves, those that a row group has as a
/// whole are reduced where it is decoded; its first and last one, which may go on in other groups, are sent as rows.
fn replay(
    shared: &Shared<'_>,
    root: usize,
    part: usize,
    children: &[Sender<Message>],
    in_place: Option<&InThreads<'_>>,
) -> Result<(), Failure> {
    let plan = shared.plan;
    let record = plan.tables[root].present[part].as_ref().expect("only finished parts are replayed");
    let table = &plan.stored_tables(root)[0].0;
    let rows = if in_place.is_some() { usize::MAX } else { shared.settings.replay_rows };
    let reduce = |batches: Vec<RecordBatch>| match in_place {
        Some(in_threads) => batches.iter().flat_map(|batch| in_threads.whole_captures(batch)).collect(),
        None => batches.into_iter().map(Replayed::Rows).collect::<Vec<_>>(),
    };
    for group in plan.shelf.read_groups(&plan.tables[root].id, record, table, rows, reduce)? {
        for replayed in group? {
            shared.go_on()?;
            let rows = match replayed {
                Replayed::Reduced(rows, outcomes) => {
                    step::hand_on(children, outcomes)?;
                    rows
                }
                Replayed::Rows(batch) => {
                    let bytes = batch.get_array_memory_size().min(shared.settings.memory_bytes / 2);
                    let credit = shared.budget.reserve(bytes).map_err(|_| Failure::Stopped)?;
                    send(children, || Message::Rows(batch.clone(), Some(credit.clone())))?;
                    batch.num_rows()
                }
            };
            shared.progress.advance(rows as u64);
        }
    }
    send(children, || Message::PartEnd(part, record.lineage, Vec::new()))
}

/// Rows of a stored table that come next.
enum Replayed {
    /// As they are.
    Rows(RecordBatch),
    /// How many, and what each step below made of them.
    Reduced(usize, Vec<Vec<Made>>),
}

/// Hands a source's rows to the first stages.
struct Channel<'a> {
    shared: &'a Shared<'a>,
    /// The source's own step alone, which hands rows on.
    children: &'a [Sender<Message>],
    /// Whether the part of its table is to be made, and does not have the rows that are sent on.
    stores: bool,
    in_place: Option<&'a InThreads<'a>>,
}

/// The steps right below a source, at work in its threads.
struct InThreads<'a> {
    shared: &'a Shared<'a>,
    /// As in [`Channel`].
    children: &'a [Sender<Message>],
    /// Each step.
    reducers: Vec<(usize, Arc<dyn Reducer + 'a>)>,
}

impl<'a> InPlace for InThreads<'a> {
    fn reduce(&self, batch: &RecordBatch) -> Reduced {
        let shared = self.shared;
        let reduce = |(step, reducer): &(usize, Arc<dyn Reducer + 'a>)| {
            shared.caught(*step, || reducer.reduce(batch).map_err(|error| shared.failed(*step, error)))
        };
        Reduced(Box::new(self.reducers.iter().map(reduce).collect::<Vec<Made>>()))
    }

    fn one(&self) -> Box<dyn CaptureInPlace + '_> {
        Box::new(OneInThread { of: self, groups: self.reducers.iter().map(|(_, reducer)| Ok(reducer.one())).collect() })
    }

    fn send(&self, reduced: Vec<Reduced>) -> Result<(), StageError> {
        let outcomes = self.by_step(reduced);
        let send = || self.children[0].send(Message::Reduced(outcomes));
        self.shared.span_of_reader("hand on", send).map_err(|_| StageError::Stopped)
    }
}

impl InThreads<'_> {
    /// Reduces the captures that begin and end within a batch.
    fn whole_captures(&self, batch: &RecordBatch) -> impl Iterator<Item = Replayed> + use<> {
        let whole = whole_captures(batch);
        let slice = |rows: Range<usize>| (!rows.is_empty()).then(|| batch.slice(rows.start, rows.len()));
        let (first, last) = (slice(0..whole.start), slice(whole.end..batch.num_rows()));
        let reduce = |rows: RecordBatch| Replayed::Reduced(rows.num_rows(), self.by_step(vec![self.reduce(&rows)]));
        let whole = slice(whole).map(reduce);
        [first.map(Replayed::Rows), whole, last.map(Replayed::Rows)].into_iter().flatten()
    }

    /// What each step made of captures, in their order.
    fn by_step(&self, reduced: Vec<Reduced>) -> Vec<Vec<Made>> {
        let mut outcomes: Vec<Vec<Made>> = self.reducers.iter().map(|_| Vec::new()).collect();
        for Reduced(made) in reduced {
            let made = *made.downcast::<Vec<Made>>().expect("made above");
            outcomes.iter_mut().zip(made).for_each(|(of_step, made)| of_step.push(made));
        }
        outcomes
    }
}

/// One capture in each step right below a source; a step that failed takes no more.
struct OneInThread<'a> {
    of: &'a InThreads<'a>,
    groups: Vec<Result<Box<dyn OneGroup + 'a>, Failure>>,
}

impl CaptureInPlace for OneInThread<'_> {
    fn take(&mut self, batch: &RecordBatch) {
        let shared = self.of.shared;
        for ((step, _), group) in self.of.reducers.iter().zip(&mut self.groups) {
            if let Ok(taking) = group {
                let taken = shared.caught(*step, || taking.take(batch).map_err(|error| shared.failed(*step, error)));
                if let Err(failure) = taken {
                    *group = Err(failure);
                }
            }
        }
    }

    fn finish(self: Box<Self>) -> Reduced {
        let shared = self.of.shared;
        let finish = |((step, _), group): (&(usize, _), Result<Box<dyn OneGroup + '_>, Failure>)| {
            group.and_then(|group| shared.caught(*step, || group.finish().map_err(|error| shared.failed(*step, error))))
        };
        Reduced(Box::new(self.of.reducers.iter().zip(self.groups).map(finish).collect::<Vec<Made>>()))
    }
}

impl Feed for Channel<'_> {
    fn most(&self) -> usize {
        self.shared.settings.memory_bytes
    }

    fn reserve(&self, bytes: usize) -> Result<Credit, StageError> {
        let bytes = bytes.min(self.shared.settings.memory_bytes / 2);
        self.shared.span_of_reader("wait for memory", || self.shared.budget.reserve(bytes))
    }

    fn send(&self, batch: RecordBatch, credit: Credit) -> Result<(), StageError> {
        let rows = || Message::Rows(batch.clone(), Some(credit.clone()));
        self.shared.span_of_reader("hand on", || send(self.children, rows)).map_err(|_| StageError::Stopped)
    }

    fn in_place(&self) -> Option<&dyn InPlace> {
        self.in_place.map(|in_place| in_place as &dyn InPlace)
    }

    fn read_bytes(&self, bytes: u64) {
        self.shared.progress.advance(bytes);
    }

    fn stores(&self) -> bool {
        self.stores
    }

    fn store(&self, batch: RecordBatch) -> Result<(), StageError> {
        send(self.children, || Message::Stored(batch.clone())).map_err(|_| StageError::Stopped)
    }
}
