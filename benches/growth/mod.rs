//! Parts of the study of growth: a curve, and a file a job.

pub mod curve;
pub mod label;
pub mod refine;
pub mod sparse;

use std::path::Path;

use periscope::campaign::Campaign;
use periscope::stages::stage::{Apply, BesideTables};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A campaign with the laser and one sensor in one point.
pub fn campaign() -> Campaign {
    Campaign::parse(Path::new("c"), "[campaign]\nname = 'c'\ngroup_index = 1.0\n[sensors.s1]\n").expect("a campaign")
}

/// What a stage prepares from that campaign and its side tables.
pub fn context<S: Apply>(stage: &S, beside: &BesideTables) -> S::Context {
    stage.context(stage.fields(&[campaign()]), beside).expect("parameters and tables go together")
}

/// A standard normal number.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
