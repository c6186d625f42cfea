//! Errors of a result folder, and how to fix them.

use std::io;
use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;
use thiserror::Error;

use super::damage::Damage;
use super::finite::NotJson;
use super::lock::{Hold, Holder};

/// What a user can do about damage.
pub const MEND: &str = "delete it, and the next `run` makes anew what is missing (`periscope verify --repair` deletes all that is damaged)";

/// What can go wrong with a result folder.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another run or shards hold the folder.
    #[error("{}", busy(out, *hold, holder.as_ref()))]
    Busy {
        /// Result folder.
        out: PathBuf,
        /// Whether a run holds it, or shards.
        hold: Hold,
        /// Who holds it, if that can be read.
        holder: Option<Holder>,
    },
    /// A folder that is not a result folder.
    #[error("{0} holds other files and no .shelf: it is no result folder of periscope; choose another --out")]
    Foreign(PathBuf),
    /// The shelf is a link to another folder.
    #[error(
        "{0} is a link: periscope writes and clears only a shelf that it made; put a folder in its place, or make all of \
         the result folder a link"
    )]
    Linked(PathBuf),
    /// The folder has nothing to read.
    #[error("{}", absent(.0))]
    Absent(PathBuf),
    /// Something else has a name that the views need.
    #[error("{0} is in the way: it is not a view made by periscope; move it away, or choose another --out")]
    InTheWay(PathBuf),
    /// No such table.
    #[error("{out} has no table `{heading}`; `periscope tables {out}` lists what there is")]
    NoTable {
        /// Result folder.
        out: PathBuf,
        /// Requested name.
        heading: String,
    },
    /// A file could not be read or written.
    #[error("cannot {what} {path}{}", advice(source))]
    Io {
        /// Attempted operation.
        what: &'static str,
        /// File.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// A table file could not be read or written.
    #[error("cannot {what} {path}")]
    Parquet {
        /// Attempted operation.
        what: &'static str,
        /// File.
        path: PathBuf,
        /// Cause.
        source: ParquetError,
    },
    /// A table file differs from its record.
    #[error("{} is damaged ({}); {MEND}", .0.file.display(), .0.place)]
    Damaged(Box<Damage>),
    /// A parameter or a campaign field cannot stand in a recipe.
    #[error(transparent)]
    Recipe(#[from] NotJson),
    /// A record of the shelf differs from what was written.
    #[error("{path} is damaged; {MEND}")]
    Record {
        /// File.
        path: PathBuf,
        /// Cause.
        source: serde_json::Error,
    },
}

/// Message for a folder without a shelf; it names neighbours that have one.
fn absent(out: &Path) -> String {
    let folder = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut results: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    results.retain(|neighbour| neighbour.join(".shelf").is_dir());
    results.sort();
    let names: Vec<String> =
        results.iter().map(|path| path.strip_prefix("./").unwrap_or(path).display().to_string()).collect();
    let hint =
        if names.is_empty() { String::new() } else { format!("; next to it are results in {}", names.join(", ")) };
    let what = if out.exists() { "is no result folder: it has no .shelf" } else { "does not exist" };
    format!("{} {what}; `periscope run ... --out DIR` makes a result folder{hint}", out.display())
}

fn busy(out: &Path, hold: Hold, holder: Option<&Holder>) -> String {
    let out = out.display();
    let holder_text = |before: &str| holder.map_or(String::new(), |holder| format!(" ({before}{holder})"));
    let (who, them) = match hold {
        Hold::Alone => (format!("another run is writing to {out}{}", holder_text("")), "it"),
        // The text names only the shard that began last; which ones still run is unknown.
        Hold::Together => {
            (format!("shards are being computed into {out}{}", holder_text("the last began as ")), "them")
        }
    };
    format!("{who}; wait for {them} (--wait), or choose another --out")
}

/// What a user can do about a failed write.
fn advice(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            "; free some space and run again: finished parts are kept"
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "; choose a folder that can be written with --out"
        }
        io::ErrorKind::IsADirectory | io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
            "; what stands there was not made by periscope: move it away"
        }
        _ => "",
    }
}

/// Adds the operation and the path to an error.
pub(super) trait At<T> {
    fn at(self, what: &'static str, path: &Path) -> Result<T, StoreError>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, what: &'static str, path: &Path) -> Result<T, StoreError> {
        self.map_err(|source| StoreError::Io { what, path: path.to_owned(), source })
    }
}

impl<T> At<T> for Result<T, ParquetError> {
    fn at(self, what: &'static str, path: &Path) -> Result<T, StoreError> {
        self.map_err(|source| match source {
            ParquetError::External(cause) => match cause.downcast::<io::Error>() {
                Ok(source) => StoreError::Io { what, path: path.to_owned(), source: *source },
                Err(cause) => {
                    StoreError::Parquet { what, path: path.to_owned(), source: ParquetError::External(cause) }
                }
            },
            source => StoreError::Parquet { what, path: path.to_owned(), source },
        })
    }
}
