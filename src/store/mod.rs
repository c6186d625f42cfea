//! The store: tables on disk under the lineage that made them. It knows lineages, schemas and batches; it knows no stage.

pub mod damage;
pub mod failure;
pub mod lineage;
mod page_checksums;
pub mod parquet;
#[cfg(feature = "query")]
pub mod query;
pub mod record;
pub mod runs;
pub mod shelf;
pub mod verify;

pub use failure::StoreError;
pub use lineage::Digest;
pub use parquet::{FileRecord, TableWriter};
pub use shelf::{PartRecord, Shelf, StageId, TableRecord};
