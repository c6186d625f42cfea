//! The store: tables on disk under the lineage that made them. It knows lineages, schemas and batches; it knows no stage.

pub mod failure;
pub mod lineage;
pub mod lock;
pub mod parquet;
pub mod prune;
#[cfg(feature = "query")]
pub mod query;
pub mod runs;
pub mod shelf;
mod sweep;

pub use failure::StoreError;
pub use lineage::Digest;
pub use parquet::{FileRecord, TableWriter};
pub use shelf::{PartRecord, Shelf, StageId, TableRecord};
