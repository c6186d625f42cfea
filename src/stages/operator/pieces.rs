//! A stage as the runtime sees it where groups are computed in pieces: rows of a piece in, subtotals out; or heads and
//! subtotals in, rows out.

use arrow_array::RecordBatch;

use super::{Groups, OutputBatches, Running, groups};
use crate::stages::stage::{Fold, InPieces, StageError};

/// What is done with pieces of groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Their rows are added up.
    Save,
    /// Their subtotals are joined.
    Join,
}

/// A stage at work on groups in pieces.
pub trait Joining: Running {
    /// Whether all is known by which later rows of the group are judged.
    fn is_primed(&self) -> bool;
    /// Forgets what the head of the group has added up.
    fn forget(&mut self);
    /// Adds subtotals: those of the open group among them.
    ///
    /// # Errors
    /// When they do not fit.
    fn absorb(&mut self, subtotals: &RecordBatch) -> Result<(), StageError>;
}

/// Groups that are computed in pieces; one is open at a time.
pub(super) struct Pieces<'a, S: Fold> {
    pub(super) groups: Groups<'a, S>,
    pub(super) pieces: &'a dyn InPieces<S>,
}

impl<S: Fold> Running for Pieces<'_, S> {
    fn push(&mut self, batch: &RecordBatch) -> Result<OutputBatches, StageError> {
        self.groups.push(batch)
    }
    fn flush(&mut self) -> Result<OutputBatches, StageError> {
        self.groups.flush()
    }
}

impl<S: Fold> Joining for Pieces<'_, S> {
    fn is_primed(&self) -> bool {
        self.groups.open.values().all(|state| self.pieces.is_primed(&self.groups.ready.context, state))
    }

    fn forget(&mut self) {
        self.groups.open.values_mut().for_each(|state| self.pieces.forget(state));
    }

    fn absorb(&mut self, subtotals: &RecordBatch) -> Result<(), StageError> {
        for (key, rows) in groups(subtotals, S::GRAIN) {
            if let Some(state) = self.groups.open.get_mut(&key) {
                let absorbed = self.pieces.absorb(state, &subtotals.slice(rows.start, rows.len()));
                absorbed.map_err(StageError::Indivisible)?;
            }
        }
        Ok(())
    }
}
