//! Ctrl-C, and the signal that asks a process to end.
//!
//! Commands that leave what they finished (`run`, `demo`, `plan --shards`, `run-shard`, `gather`) cancel a token on
//! these signals. The other commands have no handler: the signal ends them at once, and nothing half-written of them
//! looks whole.

use std::thread;
use std::time::Duration;

use anyhow::{Context, Error, Result};
use periscope::cancel::{Cancel, Cancelled};
use periscope::pipeline::run::RunError;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::INTERRUPTED;
use super::output::note;

/// A command that has not ended so long after the signal is ended by force: some call does not poll, or a disk does not
/// answer. What it leaves is what a killed run leaves; the next run sweeps it away.
const PATIENCE: Duration = Duration::from_millis(1700);

/// From now on the first Ctrl-C or SIGTERM cancels the token. The holder of the token cleans up. A second signal ends
/// the program at once, and so does the end of [`PATIENCE`].
pub fn cancel_on_signals(cancel: &Cancel) -> Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot watch for Ctrl-C")?;
    let cancel = cancel.clone();
    let watch = move || {
        for _ in signals.forever() {
            if cancel.is_cancelled() {
                std::process::exit(i32::from(INTERRUPTED));
            }
            cancel.cancel();
            note!("stopping: what is under way is dropped, what is finished is kept (once more ends at once)");
            let force = thread::Builder::new().spawn(|| {
                thread::sleep(PATIENCE);
                std::process::exit(i32::from(INTERRUPTED));
            });
            if force.is_err() {
                note!("no thread is left that could end it by force");
            }
        }
    };
    thread::Builder::new().spawn(watch).context("cannot start the thread that watches for Ctrl-C")?;
    Ok(())
}

/// Whether a command ended because its token was cancelled.
pub fn is_interruption(error: &Error) -> bool {
    error.is::<Cancelled>() || matches!(error.downcast_ref(), Some(RunError::Interrupted { .. }))
}
