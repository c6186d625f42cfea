//! Periscope: a streaming dataflow processor for recorded time-of-flight waveforms.
pub mod path;
pub mod tables;
pub mod units;
