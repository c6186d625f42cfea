//! Errors of shards, and how to fix them.

use std::path::PathBuf;

use thiserror::Error;

use crate::campaign::CampaignError;
use crate::pipeline::plan::PlanError;
use crate::pipeline::settings::RunError;
use crate::pipeline::spec::SpecError;
use crate::store::{Shelf, StoreError};

/// Why a shard failed.
#[derive(Debug, Error)]
pub enum ShardError {
    /// Its pipeline.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A campaign.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// The plan.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The result folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// This process would make parts other than the planned ones.
    #[error(
        "[{heading}]: planned and made here differ: {}; shards are made by the program that planned them, with campaign.toml as it was, on one kind of CPU",
        changes.join("; ")
    )]
    Unlike {
        /// Heading.
        heading: String,
        /// What differs.
        changes: Vec<String>,
    },
    /// No such shard.
    #[error(
        "{out} has no shard {key}: it was gathered already, or planned anew; `periscope plan PIPELINE --campaign DIR --out {out} --shards N` lists what is missing"
    )]
    Absent {
        /// Result folder.
        out: PathBuf,
        /// Requested key.
        key: String,
    },
    /// The results of a piece differ from their record.
    #[error("what shard {key} has left is damaged; `periscope run-shard {key} --out {out}` makes it again")]
    Damaged {
        /// Key of the piece.
        key: String,
        /// Result folder.
        out: PathBuf,
        /// Where the damage is.
        source: Box<StoreError>,
    },
    /// Nothing to gather.
    #[error("{0} has no shards to gather; `periscope plan PIPELINE --campaign DIR --out {0} --shards N` makes some")]
    NoJob(PathBuf),
    /// Shards are not finished.
    #[error("{missing} of {parts} parts of {heading} are missing{}; what is finished is kept", unfinished(keys))]
    Unfinished {
        /// Heading of the table.
        heading: String,
        /// Parts that are missing.
        missing: usize,
        /// Number of its parts.
        parts: usize,
        /// Unfinished shards.
        keys: Vec<String>,
    },
}

fn unfinished(keys: &[String]) -> String {
    match keys {
        [] => ", and belong to no shard: the campaign has changed since it was planned; plan again".to_owned(),
        [first, ..] => format!(
            ": {} shards are not finished ({}); run them, such as `periscope run-shard {first} --out ...`",
            keys.len(),
            keys.iter().take(3).map(String::as_str).collect::<Vec<_>>().join(", ")
        ),
    }
}

/// The error that there is no shard with this key.
#[must_use]
pub fn absent(shelf: &Shelf, key: &str) -> ShardError {
    ShardError::Absent { out: shelf.out().to_owned(), key: key.to_owned() }
}
