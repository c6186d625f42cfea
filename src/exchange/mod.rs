//! Exchange with other programs: captures of non-line-of-sight imaging become campaigns, results become files for
//! others.
//!
//! | file | question |
//! |---|---|
//! | `capture` | what is a capture, whatever its format? |
//! | `read` | which format has a file? |
//! | `y_tal`, `z_nlos`, `confocal_mat`, `point_lists` | where does each format store what? |
//! | `campaign_folder` | which campaign does it become? |
//! | `ply`, `las` | patches as a point cloud, echoes of a lidar as one |
//! | `profiles_to_capture`, `y_tal_file` | profiles as a capture of y-tal |
//! | `volume` | the volume of an image as a file that y-tal reads |
//!
//! Light is in vacuum here: these formats have no medium, and give times as path lengths.

mod campaign_folder;
mod capture;
mod confocal_mat;
pub mod las;
pub mod ply;
mod point_lists;
mod profiles_to_capture;
mod read;
mod volume;
mod y_tal;
mod y_tal_file;
mod z_nlos;

use std::path::PathBuf;

pub use campaign_folder::{CampaignOptions, Summary, write as write_campaign};
pub use capture::{Capture, Grid, Pair, Spot};
pub use profiles_to_capture::capture_of;
pub use read::{Defaults, read};
pub use volume::write as write_volume;
pub use y_tal_file::write as write_y_tal;

/// Why an exchange failed.
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
    /// Its content cannot be used.
    #[error("{}: {problem}", path.display())]
    Unfit {
        /// File or folder.
        path: PathBuf,
        /// What is wrong, and how to fix it.
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
