//! A campaign folder: what was captured, how, and in which files.
//!
//! | file | question |
//! |---|---|
//! | `keys` | which keys may campaign.toml have? |
//! | `load`, `check_setup`, `check_captures`, `fault` | are their values possible? |
//! | `toml_text`, `suggest` | if not: which line is wrong, and what was meant? |
//! | `survey`, `pattern`, `walk`, `captures_table`, `references`, `companions`, `exclusions`, `exposure`, `claims` | which file is which exposure? |
//! | `left_out` | what does a run not use, and what is to be done? |
//! | `counted` | one file, two files? |
//! | `stamp`, `manifest`, `seal`, `settings`, `tree_hash` | is it still the same file as before? |
//! | `parts` | where does a part end, the unit of storage and computation? |
//!
//! No file here reads a waveform; `formats` does.

pub mod captures_table;
pub mod check_captures;
pub mod check_setup;
mod claims;
mod counted;
pub mod exclusions;
pub mod exposure;
pub mod fault;
pub mod keys;
pub mod left_out;
pub mod load;
pub mod manifest;
pub mod parts;
pub mod pattern;
pub mod references;
pub mod seal;
pub mod settings;
pub mod stamp;
pub mod suggest;
pub mod survey;
pub mod toml_text;
pub mod tree_hash;
pub mod walk;

pub use counted::count;
pub use exclusions::Exclusions;
pub use exposure::{Exposure, ReferenceSource};
pub use fault::Fault;
pub use keys::{Axis, Campaign, CaptureRule, RecordKeys, Role};
pub use left_out::{Cause, LeftOut};
pub use load::CampaignError;
pub use manifest::{FileState, Manifest, ManifestError, hash_file};
pub use parts::closes_part;
pub use seal::{SealReport, seal};
pub use stamp::Stamp;
pub use survey::{Survey, SurveyError};
