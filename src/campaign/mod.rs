//! A campaign folder: what was captured, how, and in which files.
//!
//! | file | question |
//! |---|---|
//! | `keys` | what can stand in campaign.toml? |
//! | `load`, `check_setup`, `check_captures`, `fault` | is what stands there possible? |
//! | `toml_text`, `suggest` | if not: in which line, and what was meant? |
//! | `survey`, `pattern`, `walk`, `captures_table`, `references`, `companions`, `exclusions`, `exposure`, `claims` | which file is which exposure? |
//! | `manifest`, `seal`, `tree_hash` | is it still the file that was read before? |
//! | `parts` | where does a run of captures end that is stored and computed as one? |
//!
//! Nothing here reads a waveform: what is in a file is the matter of `formats`.

pub mod captures_table;
pub mod check_captures;
pub mod check_setup;
mod claims;
pub mod exclusions;
pub mod exposure;
pub mod fault;
pub mod keys;
pub mod load;
pub mod manifest;
pub mod parts;
pub mod pattern;
pub mod references;
pub mod seal;
pub mod suggest;
pub mod survey;
pub mod toml_text;
pub mod tree_hash;
pub mod walk;

pub use exclusions::Exclusions;
pub use exposure::{Exposure, ReferenceSource};
pub use fault::Fault;
pub use keys::{Axis, Campaign, CaptureRule, RecordKeys, Role};
pub use load::CampaignError;
pub use manifest::{FileState, Manifest, ManifestError, hash_file, modified_ns};
pub use parts::closes_part;
pub use seal::{SealReport, seal};
pub use survey::{Survey, SurveyError};
