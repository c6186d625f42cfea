//! Parts of the study of coordinates: what is drawn, what is estimated from it, and a file a table.

use periscope::geometry::{Point, dense};

pub mod chi_square;
pub mod estimate;
pub mod measured;
pub mod methods;
pub mod missing;
pub mod scale;
pub mod separate;
pub mod thirds;

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../../src/geometry/room.rs"]
mod room;
#[allow(dead_code, reason = "the study of resolution uses more of it")]
#[path = "../resolution/score.rs"]
mod score;
