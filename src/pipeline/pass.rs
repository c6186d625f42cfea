//! One pass: a source or a stored table streams through a tree of stages, one thread a stage, over bounded channels.
//!
//! A tree cannot deadlock: rows only go down. A table appears only on an explicit end; a closed channel without it
//! means that somebody failed, and the first cause is what the run reports.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
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
use crate::cancel::{Cancel, Cancelled};
use crate::stages::Node;
use crate::stages::operator::{OutputBatches, Running};
use crate::stages::source::{Credit, Feed, PartRead};
use crate::stages::stage::{BesideTables, Rejection, StageError};
use crate::store::shelf::PartWriter;
use crate::store::{Digest, PartRecord, StoreError, TableRecord};
use crate::tables::{Reject, Row};

/// Batches of parts that are joined, and the mean size in bytes up to which they are.
const TOGETHER: usize = 256;
const SMALL: usize = 1 << 20;

/// What goes down a channel.
enum Message {
    /// Rows of the open part, and the hold on memory that they come with.
    Rows(RecordBatch, Option<Credit>),
    /// Rows of the open part for the shelf alone.
    Stored(RecordBatch),
    /// The open part ends; its number, its lineage, and what its source rejected.
    PartEnd(usize, Digest, Vec<Rejection>),
    /// No more parts.
    End,
}

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

    /// Runs the body of a thread; the first failure stops everybody.
    fn guard(&self, step: usize, body: impl FnOnce() -> Result<(), Failure>) {
        let failure = match catch_unwind(AssertUnwindSafe(|| Cancel::catch(body))) {
            Ok(Ok(Ok(()) | Err(Failure::Stopped))) => return,
            Ok(Ok(Err(failure))) => failure,
            Ok(Err(Cancelled)) => Failure::Early(Ended::Interrupted),
            Err(panic) => {
                let message = panic_text(panic.as_ref());
                Failure::Cause(RunError::Panic { heading: self.heading(step), message })
            }
        };
        self.fail(failure);
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
        content: Mutex::default(),
        allowed: Mutex::new(allowed),
    };
    // A source's own table is a step of the pass too: a thread of its own writes it while another one reads.
    let mut beside = BTreeMap::new();
    for &step in &pass.steps {
        beside.insert(step, tables_beside(plan, step, &settings.cancel)?);
    }
    thread::scope(|scope| {
        let mut senders: BTreeMap<usize, Vec<Sender<Message>>> = BTreeMap::new();
        let mut receivers: BTreeMap<usize, Receiver<Message>> = BTreeMap::new();
        for &step in &pass.steps {
            let input = if step == pass.root {
                usize::MAX
            } else {
                plan.from(step).expect("a step below the root has an input")
            };
            let (sender, receiver) = bounded(settings.channel_batches);
            // Above the root's own writer stands the reader.
            senders
                .entry(if input == pass.root && !pass.steps.contains(&pass.root) { usize::MAX } else { input })
                .or_default()
                .push(sender);
            receivers.insert(step, receiver);
        }
        let shared = &shared;
        for &step in &pass.steps {
            let receiver = receivers.remove(&step).expect("each step has one channel");
            let children = senders.remove(&step).unwrap_or_default();
            let beside = beside.remove(&step).expect("collected above");
            let joined = pass.joined.as_ref().filter(|joined| joined.step == step);
            let body = move || shared.guard(step, || work(shared, step, &receiver, &children, beside, joined));
            if let Err(source) = thread::Builder::new().spawn_scoped(scope, body) {
                shared.fail(Failure::Cause(RunError::Thread { heading: shared.heading(step), source }));
            }
        }
        let children = senders.remove(&usize::MAX).unwrap_or_default();
        shared.guard(pass.root, || read(shared, pass, &children));
        drop(children);
    });
    content.extend(shared.content.into_inner().unwrap_or_else(PoisonError::into_inner));
    match shared.first.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(Failure::Cause(error)) => Err(error),
        Some(Failure::Early(ended)) => Ok(ended),
        Some(Failure::Stopped) | None => Ok(Ended::Whole),
    }
}

/// The whole tables that a step needs, from the shelf, and the token that ends it. One that is larger than the step
/// takes is left out.
pub(super) fn tables_beside(plan: &Plan<'_>, step: usize, cancel: &Cancel) -> Result<BesideTables, RunError> {
    let mut tables = BTreeMap::new();
    for (name, heading) in &plan.spec.steps[step].with {
        let (input, table) = plan.spec.table(heading).expect("the pipeline was checked");
        let parts = || plan.tables[input].present.iter().flatten();
        let rows: u64 = parts().filter_map(|part| part.files.get(&table)).map(|file| file.rows).sum();
        if let Node::Operator(operator) = &plan.spec.steps[step].node
            && operator.rows_max().is_some_and(|(limited, most)| limited == name && rows > most)
        {
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
    Ok(BesideTables { tables, cancel: cancel.clone() })
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

/// The thread of the root: reads a source, or replays a table.
fn read(shared: &Shared<'_>, pass: &Pass, children: &[Sender<Message>]) -> Result<(), Failure> {
    let plan = shared.plan;
    for &part in &pass.parts {
        shared.go_on()?;
        if pass.steps.contains(&pass.root) {
            let source = &plan.sources[&pass.root];
            let stores = plan.spec.steps[pass.root].keep && !plan.stands_in(pass.root) && plan.lacks(pass.root, part);
            let feed = Channel { shared, children, stores };
            let part_read = match pass.joined.as_ref().zip(source.divisible()) {
                // A part with an exceptional shot cannot be joined from pieces; it is computed whole.
                Some((joined, pieces)) => {
                    pieces.join(part, &joined.learnt, &feed).map(|content| PartRead { content, rejections: Vec::new() })
                }
                None => source.read(part, shared.settings.batch_bytes, &feed),
            };
            let PartRead { content, rejections } = part_read.map_err(|error| shared.failed(pass.root, error))?;
            shared.content.lock().unwrap_or_else(PoisonError::into_inner).insert((pass.root, part), content);
            let beside = plan.beside(pass.root).expect("a source has nothing beside it");
            let lineage = plan.part_lineage(pass.root, &content, &beside);
            send(children, || Message::PartEnd(part, lineage, rejections.clone()))?;
        } else {
            replay(shared, pass.root, part, children)?;
        }
    }
    send(children, || Message::End)
}

fn replay(shared: &Shared<'_>, root: usize, part: usize, children: &[Sender<Message>]) -> Result<(), Failure> {
    let plan = shared.plan;
    let record = plan.tables[root].present[part].as_ref().expect("only finished parts are replayed");
    let table = &plan.stored_tables(root)[0].0;
    for batch in plan.shelf.read(&plan.tables[root].id, record, table, shared.settings.replay_rows)? {
        let batch = batch?;
        shared.go_on()?;
        let credit = shared
            .budget
            .reserve(batch.get_array_memory_size().min(shared.settings.memory_bytes / 2))
            .map_err(|_| Failure::Stopped)?;
        send(children, || Message::Rows(batch.clone(), Some(credit.clone())))?;
        shared.progress.advance(batch.num_rows() as u64);
    }
    send(children, || Message::PartEnd(part, record.lineage, Vec::new()))
}

/// Hands a source's rows to the first stages.
struct Channel<'a> {
    shared: &'a Shared<'a>,
    /// The source's own step alone, which hands rows on.
    children: &'a [Sender<Message>],
    /// Whether the part of its table is to be made, and does not have the rows that are sent on.
    stores: bool,
}

impl Feed for Channel<'_> {
    fn most(&self) -> usize {
        self.shared.settings.memory_bytes
    }

    fn reserve(&self, bytes: usize) -> Result<Credit, StageError> {
        self.shared.budget.reserve(bytes.min(self.shared.settings.memory_bytes / 2))
    }

    fn send(&self, batch: RecordBatch, credit: Credit) -> Result<(), StageError> {
        send(self.children, || Message::Rows(batch.clone(), Some(credit.clone()))).map_err(|_| StageError::Stopped)
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

/// The thread of one step: takes rows, writes its tables, hands its main table on.
fn work(
    shared: &Shared<'_>,
    step: usize,
    input: &Receiver<Message>,
    children: &[Sender<Message>],
    tables: BesideTables,
    joined: Option<&Joined>,
) -> Result<(), Failure> {
    let plan = shared.plan;
    let streams = plan.streams(step);
    let failed = |error| shared.failed(step, error);
    let mut running: Box<dyn Running + '_> = match (joined, &plan.spec.steps[step].node) {
        (Some(joined), _) => Box::new(Given(joined.output.clone())),
        (_, Node::Source(_)) => Box::new(Through),
        (_, Node::Operator(operator)) => operator.start(plan.campaigns, &tables).map_err(failed)?,
    };
    // The stage has taken what it needs; whole tables would stay in memory until it ends.
    drop(tables);
    let beside = plan.beside(step).expect("tables beside a step are finished before its pass");
    let mut inputs = Vec::new();
    let mut writer = None;
    loop {
        let message = input.recv().map_err(|_| Failure::Stopped)?;
        shared.go_on()?;
        match message {
            Message::Rows(batch, credit) => {
                let output = running.push(&batch).map_err(failed)?;
                emit(shared, step, &mut writer, output, children, credit.as_ref())?;
            }
            Message::Stored(batch) => open(shared, step, &mut writer)?.write(0, &batch)?,
            Message::PartEnd(part, lineage, rejections) if streams => {
                let mut output = running.flush().map_err(failed)?;
                output.rejections.extend(rejections);
                emit(shared, step, &mut writer, output, children, None)?;
                let lineage = match &plan.spec.steps[step].node {
                    Node::Source(_) => lineage,
                    Node::Operator(_) => plan.part_lineage(step, &lineage, &beside),
                };
                end_part(shared, step, &mut writer, part, lineage, children)?;
            }
            Message::PartEnd(_, lineage, _) => inputs.push(lineage),
            Message::End => break,
        }
    }
    if !streams {
        let output = running.flush().map_err(failed)?;
        emit(shared, step, &mut writer, output, children, None)?;
        let lineage = plan.part_lineage(step, &TableRecord::lineage_of(&inputs), &beside);
        end_part(shared, step, &mut writer, 0, lineage, children)?;
    }
    send(children, || Message::End)
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
        shared.progress.set_aside(rows.len() as u64);
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
