//! The store: tables on disk under their lineage. It handles lineages, schemas and batches, but no stages.

mod changes;
pub mod damage;
mod digesting;
pub mod disk;
pub mod failure;
pub mod finite;
pub mod lineage;
pub mod lock;
mod page_checksums;
pub mod parquet;
pub mod prune;
#[cfg(feature = "query")]
pub mod query;
pub mod record;
pub mod runs;
pub mod scan;
mod shards;
pub mod shelf;
mod shown;
pub mod sql_names;
mod sweep;
pub mod verify;
mod views;
pub mod whole;

pub use failure::StoreError;
pub use lineage::Digest;
pub use parquet::{FileRecord, TableWriter, uncompressed, vacant};
pub use shards::{Gathered, PieceRecord};
pub use shelf::{PartBatches, PartRecord, Shelf, StageId, TableRecord};
pub use sweep::Left;
