//! Periscope: a streaming dataflow processor for recorded time-of-flight waveforms.
pub mod campaign;
pub mod formats;
pub mod geometry;
pub mod path;
pub mod pipeline;
pub mod signal;
pub mod simulate;
pub mod stages;
pub mod store;
pub mod tables;
pub mod units;
pub mod waveform;
