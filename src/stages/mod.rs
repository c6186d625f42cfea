//! The stages: one file a verb. Adding one is a file, a line in `parse`, and a table if it makes a new kind of row.

pub mod anchor;
pub mod average;
pub mod calibrate;
pub mod characterize;
pub mod deconvolve;
pub mod detect;
pub mod embed;
pub mod import;
pub mod ingest;
pub mod label;
pub mod measure;
mod method;
pub mod operator;
pub mod range;
pub mod refine;
pub mod reflect;
pub mod search;
pub mod source;
pub mod stage;
pub mod surface;
pub mod track;
pub mod triangulate;

use serde::de::DeserializeOwned;

use crate::campaign::suggest;
use operator::{Operator, WrittenTable};
use source::Source;

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
pub const KINDS: [&str; 18] = [
    "ingest",
    "anchor",
    "calibrate",
    "average",
    "track",
    "measure",
    "characterize",
    "deconvolve",
    "detect",
    "label",
    "range",
    "embed",
    "refine",
    "reflect",
    "search",
    "surface",
    "triangulate",
    "import",
];

/// The key that an error is about, as `.threshold_sigma`, where the message has not named it.
fn key_of(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let key = text.lines().find_map(|line| line.strip_prefix("in `")?.strip_suffix('`'));
    key.filter(|_| !error.message().starts_with("unknown field")).map_or(String::new(), |key| format!(".{key}"))
}

/// The stage of this kind with these parameters.
///
/// # Errors
/// When the kind or a parameter is unknown, or a value is refused; the text names the mend.
pub fn parse(kind: &str, params: toml::Table) -> Result<Node, String> {
    fn params_of<S: DeserializeOwned>(params: toml::Table) -> Result<Box<S>, String> {
        params.try_into().map(Box::new).map_err(|error: toml::de::Error| {
            format!("params{}: {}", key_of(&error), suggest::explain(error.message()))
        })
    }
    Ok(match kind {
        "ingest" => Node::Source(params_of::<ingest::Ingest>(params)?),
        "anchor" => Node::Source(params_of::<anchor::AnchorPatches>(params)?),
        "import" => Node::Source(params_of::<import::Import>(params)?),
        "calibrate" => Node::Operator(params_of::<calibrate::Calibrate>(params)?),
        "average" => Node::Operator(params_of::<average::Average>(params)?),
        "track" => Node::Operator(params_of::<track::Track>(params)?),
        "measure" => Node::Operator(params_of::<measure::Measure>(params)?),
        "characterize" => Node::Operator(params_of::<characterize::Characterize>(params)?),
        "deconvolve" => Node::Operator(params_of::<deconvolve::Deconvolve>(params)?),
        "detect" => Node::Operator(params_of::<detect::Detect>(params)?),
        "label" => Node::Operator(params_of::<label::LabelOnsets>(params)?),
        "range" => Node::Operator(params_of::<range::Range>(params)?),
        "embed" => Node::Operator(params_of::<embed::Embed>(params)?),
        "refine" => Node::Operator(params_of::<refine::Refine>(params)?),
        "reflect" => Node::Operator(params_of::<reflect::Reflect>(params)?),
        "search" => Node::Operator(params_of::<search::Search>(params)?),
        "surface" => Node::Operator(params_of::<surface::Surface>(params)?),
        "triangulate" => Node::Operator(params_of::<triangulate::Triangulate>(params)?),
        _ => return Err(suggest::unknown("stage", kind, &KINDS)),
    })
}
