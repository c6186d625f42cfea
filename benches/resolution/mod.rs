//! Parts of the study of time resolution: what is drawn, what is possible, and a file a table.

pub mod counts;
pub mod coverage;
pub mod draw;
pub mod false_pulses;
pub mod information;
pub mod many;
pub mod methods;
pub mod mismatch;
pub mod pairs;
pub mod score;
pub mod shape;
pub mod shots;
pub mod single;
pub mod speed;
