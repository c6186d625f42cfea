//! One pass: a source or a stored table streams through a tree of stages, one thread a stage, over bounded channels.
//!
//! A tree cannot deadlock: rows only go down. A table appears only on an explicit end; a closed channel without it
//! means that somebody failed, and the first cause is what the run reports.

mod root;
mod step;

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use arrow_array::RecordBatch;
use arrow_select::concat::concat_batches;
use crossbeam_channel::{Receiver, Sender, bounded};
use serde_json::Value;

use super::budget::Budget;
use super::plan::Plan;
use super::progress::Progress;
use super::settings::{RunError, Settings};
use super::timeline::Timeline;
use crate::cancel::{Cancel, Cancelled};
use crate::stages::Node;
use crate::stages::operator::{Outcomes, OutputBatches};
use crate::stages::source::Credit;
use crate::stages::stage::{Batches, BesideTables, Rejection, StageError, StoredTable};
use crate::store::{Digest, PartBatches, PartRecord, StoreError};

/// Batches of parts that are joined, and the mean size in bytes up to which they are.
const TOGETHER: usize = 256;
const SMALL: usize = 1 << 20;
/// Bytes of a stored table beyond which it is not held whole for a step, and how many of its rows are read at once.
const LARGE: u64 = 8 << 20;
const AT_ONCE: usize = 256;

/// What goes down a channel.
enum Message {
    /// Rows of the open part, and the hold on memory that they come with.
    Rows(RecordBatch, Option<Credit>),
    /// What each step below made of the next rows where these were read.
    Reduced(Vec<Vec<Made>>),
    /// Rows of the open part for the shelf alone.
    Stored(RecordBatch),
    /// The open part ends; its number, its lineage, and what its source rejected.
    PartEnd(usize, Digest, Vec<Rejection>),
    /// No more parts.
    End,
}

type Senders = BTreeMap<usize, Vec<Sender<Message>>>;

/// What a step made of some captures where these were read.
type Made = Result<Outcomes, Failure>;

/// A tree of steps: its root, and the steps that stream from one another below it.
pub struct Pass {
    /// A source to read, or a kept table to replay.
    pub root: usize,
    /// Steps to compute, each with its input before it.
    pub steps: Vec<usize>,
    /// Parts of the root that are to be streamed.
    pub parts: Vec<usize>,
    /// What pieces of its one part have joined to, where these were read and not the part.
    pub joined: Option<Joined>,
}

/// What the pieces of a part add up to.
#[derive(Clone)]
pub struct Joined {
    /// Source of the part.
    pub source: usize,
    /// What the pieces learnt of its raw files.
    pub learnt: Vec<Value>,
    /// Step below the source.
    pub step: usize,
    /// What that step makes of it.
    pub output: OutputBatches,
}

/// How a pass ended, if nothing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All its tables are whole.
    Whole,
    /// It was to stop.
    Interrupted,
    /// Too much was rejected.
    TooManyRejects,
}

/// Why a thread of the pass ended.
enum Failure {
    /// Somebody else failed.
    Stopped,
    /// The pass is to end here.
    Early(Ended),
    /// This is the cause.
    Cause(RunError),
}

/// Shared by the threads of a pass.
struct Shared<'a> {
    plan: &'a Plan<'a>,
    settings: &'a Settings,
    progress: &'a Progress,
    budget: Arc<Budget>,
    first: Mutex<Option<Failure>>,
    /// Whether a thread ended before its time because another one did.
    stopped: AtomicBool,
    content: Mutex<BTreeMap<(usize, usize), Digest>>,
    /// Rows that may still be rejected.
    allowed: Mutex<u64>,
}

impl Shared<'_> {
    fn failed(&self, step: usize, error: StageError) -> Failure {
        match error {
            StageError::Stopped => Failure::Stopped,
            source => Failure::Cause(RunError::Stage { heading: self.heading(step), source }),
        }
    }

    /// Whether the run goes on: asked before each batch.
    fn go_on(&self) -> Result<(), Failure> {
        if self.settings.cancel.is_cancelled() { Err(Failure::Early(Ended::Interrupted)) } else { Ok(()) }
    }

    fn heading(&self, step: usize) -> String {
        self.plan.spec.steps[step].heading.clone()
    }

    /// Does something on behalf of a step, as a span of its track in the timeline.
    fn span<T>(&self, step: usize, what: &str, body: impl FnOnce() -> T) -> T {
        Timeline::span(self.settings.timeline.as_deref(), &self.plan.spec.steps[step].heading, what, body)
    }

    /// The same on behalf of what reads the root of the pass.
    fn span_of_reader<T>(&self, what: &str, body: impl FnOnce() -> T) -> T {
        Timeline::span(self.settings.timeline.as_deref(), "reader", what, body)
    }

    /// Runs the body of a thread; the first failure stops everybody.
    fn guard(&self, step: usize, body: impl FnOnce() -> Result<(), Failure>) {
        match self.caught(step, body) {
            Ok(()) => {}
            Err(Failure::Stopped) => self.stopped.store(true, Ordering::Relaxed),
            Err(failure) => self.fail(failure),
        }
    }

    /// Does something on behalf of a step, whose failure a panic is.
    fn caught<T>(&self, step: usize, body: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
        match catch_unwind(AssertUnwindSafe(|| Cancel::catch(body))) {
            Ok(Ok(result)) => result,
            Ok(Err(Cancelled)) => Err(Failure::Early(Ended::Interrupted)),
            Err(panic) => {
                let message = panic_text(panic.as_ref());
                Err(Failure::Cause(RunError::Panic { heading: self.heading(step), message }))
            }
        }
    }

    /// The first failure counts; the others follow from it.
    fn fail(&self, failure: Failure) {
        self.first.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(failure);
        self.budget.stop();
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("no message").to_owned()
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Cause(RunError::Store(error))
    }
}

/// Runs a pass to its end, or until more than `allowed` rows are rejected. Content digests of the source parts that it
/// read join `content`, (step, part) to digest, also when it fails.
///
/// # Errors
/// The first failure of any of its threads.
pub fn run(
    plan: &Plan<'_>,
    pass: &Pass,
    settings: &Settings,
    allowed: u64,
    progress: &Progress,
    content: &mut BTreeMap<(usize, usize), Digest>,
) -> Result<Ended, RunError> {
    let shared = Shared {
        plan,
        settings,
        progress,
        budget: Budget::new(settings.memory_bytes),
        first: Mutex::new(None),
        stopped: AtomicBool::new(false),
        content: Mutex::default(),
        allowed: Mutex::new(allowed),
    };
    // A source's own table is a step of the pass too: a thread of its own writes it while another one reads.
    let mut beside = BTreeMap::new();
    for &step in &pass.steps {
        beside.insert(step, tables_beside(plan, step, &settings.cancel)?);
    }
    thread::scope(|scope| {
        let (mut senders, mut receivers) = channels(plan, pass, settings.channel_batches);
        let shared = &shared;
        let mut reducers = Vec::new();
        for &step in &pass.steps {
            let receiver = receivers.remove(&step).expect("each step has one channel");
            let children = senders.remove(&step).unwrap_or_default();
            let beside = beside.remove(&step).expect("collected above");
            let joined = pass.joined.as_ref().filter(|joined| joined.step == step);
            let announce = (plan.from(step) == Some(pass.root)).then(|| {
                let (announce, reducer) = bounded(1);
                reducers.push((step, reducer));
                announce
            });
            let ends = step::Ends { step, input: receiver, children, announce };
            let body = move || shared.guard(step, || step::work(shared, &ends, beside, joined));
            if let Err(source) = thread::Builder::new().spawn_scoped(scope, body) {
                shared.fail(Failure::Cause(RunError::Thread { heading: shared.heading(step), source }));
            }
        }
        let children = senders.remove(&usize::MAX).unwrap_or_default();
        shared.guard(pass.root, || root::read(shared, pass, &children, reducers));
        drop(children);
    });
    content.extend(std::mem::take(&mut *shared.content.lock().unwrap_or_else(PoisonError::into_inner)));
    let (heading, is_stopped) = (shared.heading(pass.root), shared.stopped.into_inner());
    match shared.first.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(Failure::Cause(error)) => Err(error),
        Some(Failure::Early(ended)) => Ok(ended),
        Some(Failure::Stopped) | None if is_stopped => {
            // Taken for whole, it would be planned again.
            Err(RunError::Panic { heading, message: "its threads stopped one another without a cause".to_owned() })
        }
        Some(Failure::Stopped) | None => Ok(Ended::Whole),
    }
}

/// The channels of a pass: senders by who sends (`usize::MAX` for who reads the root), receivers by step.
fn channels(plan: &Plan<'_>, pass: &Pass, batches: usize) -> (Senders, BTreeMap<usize, Receiver<Message>>) {
    let (mut senders, mut receivers) = (Senders::new(), BTreeMap::new());
    for &step in &pass.steps {
        let input =
            if step == pass.root { usize::MAX } else { plan.from(step).expect("a step below the root has an input") };
        let (sender, receiver) = bounded(batches);
        // Above the root's own writer stands the reader.
        let is_read = input == pass.root && !pass.steps.contains(&pass.root);
        senders.entry(if is_read { usize::MAX } else { input }).or_default().push(sender);
        receivers.insert(step, receiver);
    }
    (senders, receivers)
}

/// The whole tables that a step needs, from the shelf, and the token that ends it. One that is larger than the step
/// takes is left out.
pub(super) fn tables_beside(plan: &Plan<'_>, step: usize, cancel: &Cancel) -> Result<BesideTables, RunError> {
    let (mut tables, mut stored_tables) = (BTreeMap::new(), BTreeMap::new());
    for (name, heading) in &plan.spec.steps[step].with {
        let (input, table) = plan.spec.table(heading).expect("the pipeline was checked");
        let parts = || plan.tables[input].present.iter().flatten();
        let rows: u64 = parts().filter_map(|part| part.files.get(&table)).map(|file| file.rows).sum();
        if let Node::Operator(operator) = &plan.spec.steps[step].node
            && operator.rows_max().is_some_and(|(limited, most)| limited == name && rows > most)
        {
            continue;
        }
        if parts().filter_map(|part| part.files.get(&table)).map(|file| file.bytes).sum::<u64>() > LARGE {
            let readers = parts().map(|part| plan.shelf.reader(&plan.tables[input].id, part, &table, AT_ONCE));
            stored_tables.insert(name.clone(), read_when_asked(readers.collect()));
            continue;
        }
        let (mut batches, mut small) = (Vec::new(), Vec::new());
        for part in parts() {
            small.extend(stored(plan, input, &table, part)?);
            if small.len() >= TOGETHER {
                batches.extend(join(std::mem::take(&mut small)));
            }
        }
        batches.extend(join(small));
        tables.insert(name.clone(), batches);
    }
    Ok(BesideTables { tables, stored: stored_tables, cancel: cancel.clone() })
}

/// A table whose parts are read one after the other, each time that its rows are asked for.
fn read_when_asked<R>(readers: Vec<R>) -> StoredTable
where
    R: Fn() -> Result<PartBatches, StoreError> + Send + Sync + 'static,
{
    let (count, readers) = (readers.len(), Arc::new(readers));
    let refused = |error: StoreError| StageError::Refused(error.to_string());
    let batches = move || -> Batches {
        let readers = Arc::clone(&readers);
        let of_part = move |part: usize| -> Batches {
            match readers[part]() {
                Ok(batches) => Box::new(batches.map(move |batch| batch.map_err(refused))),
                Err(error) => Box::new(std::iter::once(Err(refused(error)))),
            }
        };
        Box::new((0..count).flat_map(of_part))
    };
    StoredTable(Arc::new(batches))
}

/// Joins batches of small parts: a batch of a single row holds many times the memory of the row.
fn join(small: Vec<RecordBatch>) -> Vec<RecordBatch> {
    let bytes: usize = small.iter().map(RecordBatch::get_array_memory_size).sum();
    match small.first() {
        Some(first) if bytes <= TOGETHER * SMALL => {
            vec![concat_batches(&first.schema(), &small).expect("batches of one table have its schema")]
        }
        _ => small,
    }
}

/// All batches of one table of one stored part.
fn stored(plan: &Plan<'_>, step: usize, table: &str, part: &PartRecord) -> Result<Vec<RecordBatch>, RunError> {
    Ok(plan.shelf.read(&plan.tables[step].id, part, table, usize::MAX >> 1)?.collect::<Result<_, _>>()?)
}

fn send(children: &[Sender<Message>], message: impl Fn() -> Message) -> Result<(), Failure> {
    children.iter().try_for_each(|child| child.send(message()).map_err(|_| Failure::Stopped))
}
