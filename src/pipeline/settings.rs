//! How a run uses the machine, and what can stop it.

use std::sync::Arc;

use thiserror::Error;

use super::plan::PlanError;
use super::rejects::{MaxRejects, TooMany};
use super::responses::MissingResponse;
use super::timeline::Timeline;
use crate::cancel::Cancel;
use crate::stages::stage::StageError;
use crate::store::StoreError;

/// How a run uses the machine, and when it gives up. None of it changes a byte of the result.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Bytes of raw samples that may be under way.
    pub memory_bytes: usize,
    /// Bytes that a source reads at a time.
    pub batch_bytes: usize,
    /// Batches that a channel holds.
    pub channel_batches: usize,
    /// Rows that are read back from a stored table at a time.
    pub replay_rows: usize,
    /// How much may be rejected; without it, anything.
    pub max_rejects: Option<MaxRejects>,
    /// Ends the run from outside: what is under way is dropped, what is finished is kept.
    pub cancel: Cancel,
    /// Takes down what each thread does when.
    pub timeline: Option<Arc<Timeline>>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            memory_bytes: 64 << 20,
            batch_bytes: 4 << 20,
            channel_batches: 2,
            replay_rows: 256,
            max_rejects: None,
            cancel: Cancel::new(),
            timeline: None,
        }
    }
}

impl Settings {
    /// The least budget with which every stage and writer can hold its largest piece at once: beneath it a run could
    /// wait for itself.
    #[must_use]
    pub fn least_memory(&self) -> usize {
        // The writer of raw traces gathers a row group a worker before it lets go; the reader needs room for one batch
        // more.
        let groups = rayon::current_num_threads() + 1;
        groups * (crate::store::parquet::ROW_GROUP_BYTES + self.batch_bytes)
            + (self.channel_batches + 2) * self.batch_bytes
    }

    /// Whether they give memory enough.
    ///
    /// # Errors
    /// When they do not.
    pub fn check(&self) -> Result<(), RunError> {
        let (given, least) = (self.memory_bytes, self.least_memory());
        if given < least { Err(RunError::Memory { given, least }) } else { Ok(()) }
    }
}

/// What stops a run.
#[derive(Debug, Error)]
pub enum RunError {
    /// A stage cannot go on.
    #[error("[{heading}]")]
    Stage {
        /// Heading.
        heading: String,
        /// Cause.
        source: StageError,
    },
    /// A stage broke.
    #[error("[{heading}]: the stage broke: {message}. This is a defect of periscope; finished parts are kept")]
    Panic {
        /// Heading.
        heading: String,
        /// Message of the panic.
        message: String,
    },
    /// The system gives no thread.
    #[error(
        "[{heading}]: cannot start its thread; this user, or container, is at its limit of processes: raise it (`ulimit -u`)"
    )]
    Thread {
        /// Heading.
        heading: String,
        /// Cause.
        source: std::io::Error,
    },
    /// Its user ended it.
    #[error("{kept} are kept; the same command goes on from there")]
    Interrupted {
        /// What is finished, in words.
        kept: String,
    },
    /// More was rejected than the user allows.
    #[error(transparent)]
    Rejects(#[from] TooMany),
    /// The result folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The plan.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A stage needs a response that no file of a campaign shows.
    #[error(transparent)]
    Response(#[from] MissingResponse),
    /// Too little memory.
    #[error(
        "--memory {given} B is less than the {least} B that this run needs at least; give more, or fewer --threads"
    )]
    Memory {
        /// As given.
        given: usize,
        /// As needed.
        least: usize,
    },
}
