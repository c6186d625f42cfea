//! The tables: one file for each kind of row, each declared once. `data-schema/` publishes these declarations.

pub mod calibration;
pub mod cell;
pub mod checks;
pub mod contract;
pub mod decisions;
pub mod distances;
pub mod echoes;
pub mod gaps;
pub mod hypotheses;
pub mod keys;
pub mod labels;
pub mod measurements;
pub mod meshes;
pub mod omissions;
pub mod onsets;
pub mod patches;
pub mod planes;
pub mod predictions;
pub mod profiles;
pub mod pulses;
pub mod rejects;
pub mod row;
pub mod scenes;
pub mod searches;
pub mod session;
pub mod shapes;
pub mod solution;
pub mod stir;
pub mod subtotals;
pub mod surface_points;
pub mod traces;
pub mod truth;
pub mod voxels;

use arrow_schema::SchemaRef;

pub use calibration::Calibration;
pub use cell::{Codes, Name, Samples};
pub use checks::Check;
pub use decisions::Decision;
pub use distances::{Covariance, Distance};
pub use echoes::Echo;
pub use gaps::Gap;
pub use hypotheses::Hypothesis;
pub use keys::key_of;
pub use labels::Label;
pub use measurements::Measurement;
pub use meshes::{Mesh, Vertex};
pub use omissions::Omission;
pub use onsets::Onset;
pub use patches::{Patch, PatchCovariance};
pub use planes::{PatchFootprint, Plane};
pub use predictions::Prediction;
pub use profiles::Profile;
pub use pulses::Pulse;
pub use rejects::Reject;
pub use row::{Row, SchemaError};
pub use scenes::SceneOdds;
pub use searches::JointSearch;
pub use session::Session;
pub use shapes::Shape;
pub use solution::{Ambiguity, Delay, Fit, ONSET_KINDS, Residual, Station, Suspect};
pub use stir::{Impulse, ImpulsePair, Stir};
pub use subtotals::Subtotal;
pub use surface_points::SurfacePoint;
pub use traces::Trace;
pub use truth::{TrueCapture, TrueCentroid, TruePath};
pub use voxels::{Image, VolumeRow, Voxel};

/// Columns that identify one capture; every table of samples, onsets or labels starts with them.
pub const CAPTURE_KEY: [&str; 4] = ["campaign", "sensor", "lit", "seen"];

/// All tables, in the order of the pipeline.
#[must_use]
pub fn all() -> Vec<(&'static str, SchemaRef)> {
    fn of<R: Row>() -> (&'static str, SchemaRef) {
        (R::TABLE, R::schema())
    }
    vec![
        of::<Trace>(),
        of::<Pulse>(),
        of::<Echo>(),
        of::<Subtotal>(),
        of::<Calibration>(),
        of::<Profile>(),
        of::<Session>(),
        of::<Measurement>(),
        of::<Check>(),
        of::<Stir>(),
        of::<Onset>(),
        of::<Label>(),
        of::<Hypothesis>(),
        of::<SceneOdds>(),
        of::<Gap>(),
        of::<Voxel>(),
        of::<Image>(),
        of::<VolumeRow>(),
        of::<JointSearch>(),
        of::<SurfacePoint>(),
        of::<Omission>(),
        of::<Shape>(),
        of::<Mesh>(),
        of::<Vertex>(),
        of::<Distance>(),
        of::<Covariance>(),
        of::<Patch>(),
        of::<PatchCovariance>(),
        of::<Plane>(),
        of::<Prediction>(),
        of::<PatchFootprint>(),
        of::<Delay>(),
        of::<Station>(),
        of::<Residual>(),
        of::<Suspect>(),
        of::<Fit>(),
        of::<Ambiguity>(),
        of::<Decision>(),
        of::<Reject>(),
        of::<TruePath>(),
        of::<TrueCentroid>(),
        of::<TrueCapture>(),
    ]
}

/// Schema of the table of this name.
#[must_use]
pub fn schema_of(table: &str) -> Option<SchemaRef> {
    all().into_iter().find(|(name, _)| *name == table).map(|(_, schema)| schema)
}
