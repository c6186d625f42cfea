//! The commands, a file each: arguments, what they print, and their exit codes.

mod aftermath;
pub mod check;
pub mod convert;
pub mod demo;
pub mod design;
pub mod diff;
pub mod explain;
pub mod export;
pub mod gather;
mod inert;
pub mod inspect;
mod interrupt;
mod machine;
pub mod man;
pub mod output;
pub mod pipelines;
pub mod plan;
pub mod query;
pub mod report;
pub mod run;
pub mod run_shard;
pub mod schema;
pub mod seal;
pub mod simulate;
pub mod tables;
pub mod verify;
mod watch;
mod whole_file;

pub use interrupt::is_interruption;
pub use machine::{Machine, start_threads};

/// Done, but some input was rejected, or something needs to be fixed.
pub const SOME_REJECTED: u8 = 3;

/// Ended by Ctrl-C or SIGTERM.
pub const INTERRUPTED: u8 = 130;

/// Standard output was closed before all was printed: the code that a shell shows for a tool that SIGPIPE ends.
pub const CLOSED: u8 = 141;
