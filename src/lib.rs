//! Periscope: a streaming dataflow processor for recorded time-of-flight waveforms.
pub mod path;
pub mod store;
pub mod tables;
pub mod units;
