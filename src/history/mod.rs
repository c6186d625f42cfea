//! Origins of finished tables: from a row back to the raw exposures ([`explanation`]), and the differences between two
//! result folders with their causes ([`comparison`]). Everything is read from the tables and their lineage; nothing is
//! computed again.
//!
//! | file | question |
//! |---|---|
//! | `ancestry` | which table was made from which? |
//! | `target` | which row is meant by `patch=3`? |
//! | `gather`, `explanation` | which onsets contribute to it? |
//! | `behind`, `sensors` | what do the tables say about these onsets, their captures and sensors? |
//! | `exposures` | in which raw files are they, and in which segments? |
//! | `sql` | how does DuckDB answer the same? |
//! | `side`, `comparison`, `causes` | which tables of two folders differ, and why? |
//! | `matching`, `differences` | which rows, in which columns, by how much? |

pub mod ancestry;
pub mod behind;
mod causes;
pub mod comparison;
mod differences;
pub mod explanation;
mod exposures;
mod gather;
mod matching;
pub mod sensors;
mod side;
mod sql;
pub mod target;
mod values;

use thiserror::Error;

use crate::campaign::{CampaignError, ManifestError};
use crate::stages::stage::StageError;
use crate::store::StoreError;
use crate::tables::SchemaError;

/// Why a request fails; the text names the place and the fix.
#[derive(Debug, Error)]
pub enum HistoryError {
    /// The result folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A table lacks the columns that its name implies.
    #[error(transparent)]
    Schema(#[from] SchemaError),
    /// Arrow refused an operation on batches.
    #[error(transparent)]
    Arrow(#[from] arrow_schema::ArrowError),
    /// A campaign folder.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// The record of raw files.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The raw files of a campaign.
    #[error(transparent)]
    Raw(#[from] StageError),
    /// Anything else.
    #[error("{0}")]
    Refused(String),
}
