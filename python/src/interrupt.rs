//! Ctrl-C in long computations.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use periscope::cancel::Cancel;
use pyo3::prelude::*;

/// Time between two looks at the interpreter's signals.
const LOOK: Duration = Duration::from_millis(50);

/// Runs `compute` without the interpreter's lock, in a thread of its own: only the main thread of Python may look at
/// signals, and it must be free to do so. An exception of a signal's handler, such as `KeyboardInterrupt`, cancels the
/// token; the exception is raised when the computation has ended.
pub fn interruptible<T: Send>(py: Python<'_>, compute: impl FnOnce(&Cancel) -> T + Send) -> PyResult<T> {
    let cancel = Cancel::new();
    let (running, ended) = mpsc::channel::<()>();
    let outcome = py.detach(move || {
        let cancel = &cancel;
        thread::scope(move |scope| {
            let worker = scope.spawn(move || {
                let _running = running; // dropped at the end, also of a panic
                Cancel::catch(|| compute(cancel))
            });
            let mut interruption = None;
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(LOOK) {
                if interruption.is_none() {
                    interruption = Python::attach(|py| py.check_signals().err());
                    interruption.iter().for_each(|_| cancel.cancel());
                }
            }
            let computed = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            interruption.map_or(Ok(computed), Err)
        })
    });
    Ok(outcome?.expect("only an interruption cancels the token"))
}
