//! One integration binary, a file a concern.

mod accuracy;
mod bound;
mod determinism;
mod house;
mod lab;
mod lineage;
mod schema;
