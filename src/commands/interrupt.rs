//! Ctrl-C, and the signal that asks a process to end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::INTERRUPTED;

/// From now on the first Ctrl-C sets `stop`, and a second one ends the program at once: whoever watches `stop` cleans up, and if that takes too long, the
/// next run does.
pub fn stop_on_signals(stop: &Arc<AtomicBool>) -> Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot watch for Ctrl-C")?;
    let stop = Arc::clone(stop);
    std::thread::spawn(move || {
        for _ in signals.forever() {
            if stop.swap(true, Ordering::Relaxed) {
                std::process::exit(i32::from(INTERRUPTED));
            }
            eprintln!("stopping: what is under way is dropped, what is finished is kept (once more ends at once)");
        }
    });
    Ok(())
}
