//! The runtime: spec -> plan -> run. It handles record batches and lineages, and no physics.

pub mod arithmetic;
pub mod budget;
mod cut;
#[cfg(test)]
mod faulty_disk;
pub mod pass;
pub mod plan;
pub mod progress;
mod recipe;
pub mod recorded;
pub mod rejects;
pub mod responses;
pub mod roots;
pub mod run;
pub mod settings;
pub mod shards;
pub mod spec;
pub mod timeline;
