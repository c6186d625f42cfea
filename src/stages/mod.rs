//! The stages: one file a verb. Adding one is a file, a line in `parse`, and a table if it makes a new kind of row.

pub mod anchor;
pub mod average;
pub mod calibrate;
pub mod characterize;
pub mod conclude;
pub mod decompose;
pub mod deconvolve;
pub mod detect;
pub mod embed;
pub mod first_returns;
pub mod image;
pub mod import;
pub mod ingest;
pub mod label;
pub mod locate;
pub mod measure;
pub mod mesh;
mod method;
pub mod operator;
pub mod predict;
pub mod range;
pub mod recalibrate;
pub mod refine;
pub mod reflect;
pub mod search;
pub mod shape;
pub mod source;
pub mod stage;
pub mod surface;
pub mod track;
pub mod triangulate;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::campaign::{Campaign, suggest};
use crate::parameter;
use crate::store::finite::NotJson;
use operator::{Operator, WrittenTable};
use source::Source;
use stage::Fold;

/// A stage of either kind.
pub enum Node {
    /// Without streamed input.
    Source(Box<dyn Source>),
    /// With one.
    Operator(Box<dyn Operator>),
}

impl Node {
    /// Main table, then side tables.
    #[must_use]
    pub fn tables(&self) -> Vec<WrittenTable> {
        match self {
            Self::Source(source) => vec![source.table()],
            Self::Operator(operator) => operator.tables(),
        }
    }

    /// Whether a stored table has all rows of the stage with all that these have, so that it stands in for it.
    #[must_use]
    pub fn stands_in(&self) -> bool {
        match self {
            Self::Source(source) => source.stands_in(),
            Self::Operator(_) => true,
        }
    }

    /// Version.
    #[must_use]
    pub fn version(&self) -> u32 {
        match self {
            Self::Source(source) => source.version(),
            Self::Operator(operator) => operator.version(),
        }
    }

    /// Parameters as parsed, defaults included.
    ///
    /// # Errors
    /// When one is not finite.
    pub fn params(&self) -> Result<Value, NotJson> {
        match self {
            Self::Source(source) => source.params(),
            Self::Operator(operator) => operator.params(),
        }
    }

    /// Fields of the campaigns that it reads.
    ///
    /// # Errors
    /// When one is not finite.
    pub fn fields(&self, campaigns: &[Campaign]) -> Result<Value, NotJson> {
        match self {
            Self::Source(source) => source.fields(campaigns),
            Self::Operator(operator) => operator.fields(campaigns),
        }
    }

    /// Kind, as in the pipeline file.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Source(source) => source.kind(),
            Self::Operator(operator) => operator.kind(),
        }
    }
}

/// Kinds that a pipeline file may name.
pub const KINDS: [&str; 28] = [
    "ingest",
    "ingest_pulses",
    "anchor",
    "calibrate",
    "average",
    "track",
    "recalibrate",
    "measure",
    "characterize",
    "deconvolve",
    "detect",
    "decompose",
    "label",
    "range",
    "embed",
    "refine",
    "predict",
    "reflect",
    "search",
    "image",
    "locate",
    "first_returns",
    "shape",
    "mesh",
    "surface",
    "triangulate",
    "conclude",
    "import",
];

/// A source with these parameters.
fn source<S: Source + Serialize + DeserializeOwned + 'static>(params: toml::Table) -> Result<Node, String> {
    Ok(Node::Source(Box::new(parameter::read::<S>(params, &[], |_| None)?)))
}

/// An operator with these parameters.
fn operator<S: Fold + DeserializeOwned>(params: toml::Table) -> Result<Node, String> {
    Ok(Node::Operator(Box::new(parameter::read(params, S::CONDITIONS, S::conflict)?)))
}

/// The stage of this kind with these parameters.
///
/// # Errors
/// When the kind or a parameter is unknown, or a value is refused; the text says what is right.
pub fn parse(kind: &str, params: toml::Table) -> Result<Node, String> {
    match kind {
        "ingest" => source::<ingest::Ingest>(params),
        "ingest_pulses" => source::<ingest::pulses::IngestPulses>(params),
        "anchor" => source::<anchor::AnchorPatches>(params),
        "import" => source::<import::Import>(params),
        "calibrate" => operator::<calibrate::Calibrate>(params),
        "average" => operator::<average::Average>(params),
        "track" => operator::<track::Track>(params),
        "recalibrate" => operator::<recalibrate::Recalibrate>(params),
        "measure" => operator::<measure::Measure>(params),
        "characterize" => operator::<characterize::Characterize>(params),
        "deconvolve" => operator::<deconvolve::Deconvolve>(params),
        "detect" => operator::<detect::Detect>(params),
        "decompose" => operator::<decompose::Decompose>(params),
        "label" => operator::<label::LabelOnsets>(params),
        "range" => operator::<range::Range>(params),
        "embed" => operator::<embed::Embed>(params),
        "refine" => operator::<refine::Refine>(params),
        "predict" => operator::<predict::Predict>(params),
        "reflect" => operator::<reflect::Reflect>(params),
        "search" => operator::<search::Search>(params),
        "image" => operator::<image::MakeImage>(params),
        "locate" => operator::<locate::Locate>(params),
        "first_returns" => operator::<first_returns::FirstReturns>(params),
        "shape" => operator::<shape::FitShapes>(params),
        "mesh" => operator::<mesh::FitMeshes>(params),
        "surface" => operator::<surface::Surface>(params),
        "triangulate" => operator::<triangulate::Triangulate>(params),
        "conclude" => operator::<conclude::Conclude>(params),
        _ => Err(suggest::unknown("stage", kind, &KINDS)),
    }
}
