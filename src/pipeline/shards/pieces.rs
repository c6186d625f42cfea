//! Pieces of parts: a capture that is too large for one worker is divided by its shots. Each piece leaves subtotals
//! next to the shards. The gathering run joins them to the part, with the lineage and the bytes that one process would
//! give that reads all of it.
//!
//! A piece with an exceptional record (one to be rejected, for example) cannot be merged; then the part is computed
//! whole.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use arrow_array::RecordBatch;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Made, Shard, ShardError, absent, make};
use crate::cancel::Cancel;
use crate::pipeline::pass::{Joined, tables_beside};
use crate::pipeline::plan::Plan;
use crate::pipeline::progress::{Amount, Progress};
use crate::pipeline::settings::{RunError, Settings};
use crate::stages::Node;
use crate::stages::operator::{Joining, Operator, OutputBatches, Task};
use crate::stages::source::{Credit, Divisible, Feed, Piece, PieceFeed};
use crate::stages::stage::StageError;
use crate::store::{Digest, PieceRecord, Shelf, StoreError};
use crate::tables::{Row, Subtotal};

/// A piece of the one part of a shard, for one process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// Key of the shard of the whole part.
    pub of: String,
    /// Its number among the pieces of the part, from 1.
    pub number: usize,
    /// Number of pieces of the part.
    pub count: usize,
    /// The piece.
    pub piece: Piece,
}

/// The step that sums what a source reads, part by part and in pieces.
///
/// # Errors
/// Why there is none, in words that follow the heading of the source.
pub fn adder(plan: &Plan<'_>, source: usize) -> Result<usize, String> {
    if plan.stands_in(source) && plan.tables[source].wanted {
        let heading = &plan.spec.steps[source].heading;
        return Err(format!(
            "all rows of a capture lie in one part, and {heading} archives them (`--set {heading}.keep=false` does not)"
        ));
    }
    let below: Vec<usize> =
        (0..plan.tables.len()).filter(|&i| plan.tables[i].wanted && plan.from(i) == Some(source)).collect();
    match below[..] {
        [step] if operator(plan, step).is_some_and(|operator| operator.subtotals().is_some()) => Ok(step),
        _ => {
            let kinds: Vec<&str> = below.iter().map(|&i| plan.spec.steps[i].heading.as_str()).collect();
            Err(format!("only one `average` can take its shots in pieces, and it streams to {}", kinds.join(", ")))
        }
    }
}

fn operator<'a>(plan: &Plan<'a>, step: usize) -> Option<&'a dyn Operator> {
    match &plan.spec.steps[step].node {
        Node::Operator(operator) => Some(operator.as_ref()),
        Node::Source(_) => None,
    }
}

/// Passes what a source reads to the step that sums it.
struct Adding<'a> {
    running: RefCell<Box<dyn Joining + 'a>>,
    output: RefCell<OutputBatches>,
    /// Whether rows have arrived since the last query.
    is_fed: Cell<bool>,
    settings: &'a Settings,
    progress: &'a Progress,
}

impl<'a> Adding<'a> {
    fn start(
        plan: &'a Plan<'a>,
        step: usize,
        task: Task,
        settings: &'a Settings,
        progress: &'a Progress,
    ) -> Result<Self, RunError> {
        let operator = operator(plan, step).expect("the step that adds up");
        let beside = tables_beside(plan, step, &settings.cancel)?;
        let running = Cancel::catch(|| operator.start_in_pieces(plan.campaigns, &beside, task));
        let running = running.map_err(StageError::from).flatten().map_err(|source| failed(plan, step, source))?;
        let (running, output) = (RefCell::new(running), RefCell::default());
        Ok(Self { running, output, is_fed: Cell::new(false), settings, progress })
    }

    fn absorb(&self, subtotals: &RecordBatch) -> Result<(), StageError> {
        self.running.borrow_mut().absorb(subtotals)
    }

    /// Ends the last group; returns all output.
    fn end(self) -> Result<OutputBatches, StageError> {
        let output = Cancel::catch(|| self.running.borrow_mut().flush())??;
        self.output.borrow_mut().append(output);
        Ok(self.output.into_inner())
    }
}

impl Feed for Adding<'_> {
    fn most(&self) -> usize {
        self.settings.memory_bytes
    }

    fn reserve(&self, _: usize) -> Result<Credit, StageError> {
        // Only one batch is in flight at a time, so there is no need for a budget.
        Ok(Credit::new(()))
    }

    fn send(&self, batch: RecordBatch, _: Credit) -> Result<(), StageError> {
        if self.settings.cancel.is_cancelled() {
            return Err(StageError::Stopped);
        }
        self.is_fed.set(true);
        let output = Cancel::catch(|| self.running.borrow_mut().push(&batch))??;
        self.output.borrow_mut().append(output);
        Ok(())
    }

    fn read_bytes(&self, bytes: u64) {
        self.progress.advance(bytes);
    }
}

impl PieceFeed for Adding<'_> {
    fn is_primed(&self) -> Result<bool, StageError> {
        Ok(self.running.borrow().is_primed())
    }

    fn forget(&self) -> Result<(), StageError> {
        self.running.borrow_mut().forget();
        Ok(())
    }
}

fn failed(plan: &Plan<'_>, step: usize, source: StageError) -> RunError {
    match source {
        StageError::Stopped => RunError::Interrupted { kept: "finished shards".to_owned() },
        source => RunError::Stage { heading: plan.spec.steps[step].heading.clone(), source },
    }
}

/// The source of the one part of a divided shard.
fn divisible<'a>(plan: &'a Plan<'_>) -> Option<(usize, &'a dyn Divisible)> {
    let (&source, open) = plan.sources.iter().next()?;
    Some((source, open.divisible()?))
}

impl Cut {
    /// Makes the piece, if it is not finished yet.
    ///
    /// # Errors
    /// The first failure, or that it was interrupted: then nothing of it remains.
    pub fn make(&self, key: &str, shelf: &Shelf, settings: &Settings, progress: &Progress) -> Result<Made, ShardError> {
        let shard: Shard = shelf.shard(&self.of)?.ok_or_else(|| absent(shelf, &self.of))?;
        let spec = shard.work.spec()?;
        let campaigns = shard.campaigns()?;
        let plan = shard.plan(&spec, &campaigns, shelf)?;
        let (before, now) = match intact(shelf, key) {
            Some(record) => (1, record),
            None => (0, self.compute(key, &plan, settings, progress)?),
        };
        Ok(Made {
            key: key.to_owned(),
            captures: self.piece.captures.len(),
            parts: 0,
            computed: 1 - before,
            rejects: 0,
            rows: BTreeMap::from([(Subtotal::TABLE.to_owned(), now.subtotals.rows)]),
            digest: Digest::of(&json!(now)),
        })
    }

    fn compute(
        &self,
        key: &str,
        plan: &Plan<'_>,
        settings: &Settings,
        progress: &Progress,
    ) -> Result<PieceRecord, ShardError> {
        settings.check().map_err(ShardError::Run)?;
        let (source, parts) = divisible(plan).ok_or_else(|| absent(plan.shelf, key))?;
        let step = adder(plan, source).map_err(|_| absent(plan.shelf, key))?;
        let schema = operator(plan, step).and_then(Operator::subtotals).expect("it adds up");
        let headings = [plan.spec.steps[step].heading.as_str()];
        progress.pass(&headings, Amount::Bytes(self.piece.bytes), 0, 1);
        let adding = Adding::start(plan, step, Task::Save, settings, progress)?;
        let read = parts.read_piece(0, &self.piece, settings.batch_bytes, &adding);
        let read = read.and_then(|learnt| Ok((learnt, adding.end()?)));
        let (learnt, subtotals, indivisible) = match read {
            Ok((learnt, output)) => (learnt, output.tables.into_iter().next().unwrap_or_default(), None),
            Err(StageError::Indivisible(why)) => (json!(null), Vec::new(), Some(why)),
            Err(error) => return Err(failed(plan, source, error).into()),
        };
        progress.finish();
        Ok(plan.shelf.write_piece(key, &schema, &subtotals, learnt, indivisible)?)
    }
}

/// The results of a piece, if its files match their record.
fn intact(shelf: &Shelf, key: &str) -> Option<PieceRecord> {
    let record = shelf.piece(key).ok().flatten()?;
    let is_sound = shelf.subtotals(key, &record).is_ok_and(|mut batches| batches.all(|batch| batch.is_ok()));
    is_sound.then_some(record)
}

impl Shard {
    /// Makes the part from its pieces, if all are finished. If one of them requires it, computes the part whole, and
    /// passes the reason to `tell`.
    ///
    /// # Errors
    /// The first failure, or that it was interrupted; finished pieces are kept.
    pub fn join(
        &self,
        keys: &[String],
        shelf: &Shelf,
        settings: &Settings,
        progress: &Progress,
        tell: &mut dyn FnMut(&str),
    ) -> Result<(), ShardError> {
        let spec = self.work.spec()?;
        let campaigns = self.campaigns()?;
        let mut plan = self.plan(&spec, &campaigns, shelf)?;
        if plan.tables.iter().all(|table| !table.wanted || table.complete()) {
            return Ok(());
        }
        let mut pieces = Vec::new();
        for key in keys {
            let damaged = |source| ShardError::Damaged {
                key: key.clone(),
                out: shelf.out().to_owned(),
                source: Box::new(source),
            };
            match shelf.piece(key).map_err(damaged)?.zip(shelf.cut::<Cut>(key)?) {
                Some((record, cut)) => pieces.push((key.as_str(), cut.piece, record)),
                None => return Ok(()),
            }
        }
        let joined = match joined(&plan, &pieces, settings, progress) {
            Ok(joined) => Some(joined),
            Err(ShardError::Run(RunError::Stage { source: StageError::Indivisible(why), .. })) => {
                let file = self.tickets().flat_map(|ticket| &ticket.files).next();
                let file = file.map_or(String::new(), |file| format!(" of {}", file.display()));
                tell(&format!("the part{file} was cut into {} pieces, but is computed whole: {why}", keys.len()));
                None
            }
            Err(error) => return Err(error),
        };
        make(&mut plan, settings, progress, joined.as_ref())?;
        Ok(())
    }
}

/// Joins the pieces. It reads the heads of all captures again; here they decide only about their own records.
fn joined(
    plan: &Plan<'_>,
    pieces: &[(&str, Piece, PieceRecord)],
    settings: &Settings,
    progress: &Progress,
) -> Result<Joined, ShardError> {
    let (source, parts) = divisible(plan).expect("a part that was cut has a source that cuts");
    let run = |error| ShardError::Run(failed(plan, source, error));
    if let Some(why) = pieces.iter().find_map(|(_, _, record)| record.indivisible.clone()) {
        return Err(run(StageError::Indivisible(why)));
    }
    let step = adder(plan, source).map_err(|why| run(StageError::Indivisible(why)))?;
    let adding = Adding::start(plan, step, Task::Join, settings, progress)?;
    for capture in 0..pieces.iter().map(|(_, piece, _)| piece.captures.end).max().unwrap_or(0) {
        adding.is_fed.set(false);
        parts.read_head(0, capture, settings.batch_bytes, &adding).map_err(run)?;
        let of_capture = pieces.iter().filter(|(_, piece, _)| piece.captures.contains(&capture) && adding.is_fed.get());
        for (key, _, record) in of_capture {
            let damaged = |source: StoreError| ShardError::Damaged {
                key: (*key).to_owned(),
                out: plan.shelf.out().to_owned(),
                source: Box::new(source),
            };
            for batch in plan.shelf.subtotals(key, record).map_err(damaged)? {
                adding.absorb(&batch.map_err(damaged)?).map_err(run)?;
            }
        }
    }
    let output = adding.end().map_err(run)?;
    // The pass compares the files with what the pieces read, including those whose heads were read here.
    let learnt = pieces.iter().map(|(_, _, record)| record.learnt.clone()).collect();
    Ok(Joined { source, learnt, step, output })
}
