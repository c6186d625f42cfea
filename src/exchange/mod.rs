//! What goes to and comes from other programs: captures of non-line-of-sight imaging to campaigns, results to files that others open.
//!
//! | file | question |
//! |---|---|
//! | `capture` | what is a capture, whatever file it came from? |
//! | `read` | which file is it? |
//! | `y_tal`, `z_nlos`, `confocal_mat` | where does each format keep what? |
//! | `campaign_folder` | as which campaign can it be run? |
//! | `ply` | patches as a point cloud |
//! | `profiles_to_capture`, `y_tal_file` | profiles as a capture of y-tal |
//!
//! Light is in vacuum here: these formats know no medium, and give times as the lengths of path that light goes in them.

mod campaign_folder;
mod capture;
mod confocal_mat;
pub mod ply;
mod profiles_to_capture;
mod read;
mod y_tal;
mod y_tal_file;
mod z_nlos;

use std::path::PathBuf;

pub use campaign_folder::{Told, Written, write as write_campaign};
pub use capture::{Capture, Grid, Pair, Spot};
pub use profiles_to_capture::capture_of;
pub use read::{Unsaid, read};
pub use y_tal_file::write as write_y_tal;

/// Why something was not exchanged.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// The file cannot be read, or contradicts its format.
    #[error("{}", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: crate::formats::FormatError,
    },
    /// What is in it cannot be used.
    #[error("{}: {problem}", path.display())]
    Unfit {
        /// File or folder.
        path: PathBuf,
        /// What, and the mend.
        problem: String,
    },
    /// A file cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
}
