//! One integration binary, a file a concern.

mod accuracy;
mod averaging;
mod barcode;
mod bound;
mod characterize;
mod check;
mod cli;
mod corner;
mod determinism;
mod failures;
mod faint;
mod formats;
mod hidden;
mod hidden_plane;
mod house;
mod ingest;
mod inter_reflections;
mod lab;
mod laws;
mod lineage;
mod methods;
mod mirror;
mod missed;
mod monte_carlo;
#[cfg(feature = "query")]
mod query;
mod real_files;
mod rectangles;
mod resolution;
mod rooms;
mod schema;
mod scope_samples;
mod session;
mod simulate;
mod surface;
mod version;
