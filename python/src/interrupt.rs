//! Ctrl-C in long computations.
//!
//! Only the main thread of Python may look at signals, so it must be free to do so: it waits, others compute.

use std::process;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use periscope::cancel::{Cancel, Cancelled};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Time between two looks at the interpreter's signals.
const LOOK: Duration = Duration::from_millis(50);

/// Most samples whose pulses are fitted briefly, and most that are looked at once.
pub const FEW: usize = 4096;
pub const ONCE: usize = 1 << 20;

/// The threads of kernels, with the process that they belong to: a forked process has none of them.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// The pool of this process.
fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((process, pool)) = &*pool
        && *process == process::id()
    {
        return Ok(Arc::clone(pool));
    }
    let own = ThreadPoolBuilder::new().build();
    let own = Arc::new(own.map_err(|error| PyRuntimeError::new_err(format!("cannot start threads: {error}")))?);
    // To end the threads of another process would be to wait for them.
    std::mem::forget(pool.replace((process::id(), Arc::clone(&own))));
    Ok(own)
}

/// Runs a kernel without the interpreter's lock. An exception of a signal's handler, such as `KeyboardInterrupt`,
/// cancels the token; it is raised when the kernel has ended.
///
/// Threads of a pool take the kernel: to start one costs more than many kernels do.
pub fn interruptible<T: Send>(py: Python<'_>, compute: impl FnOnce(&Cancel) -> T + Send) -> PyResult<T> {
    let pool = pool()?;
    waiting(py, |cancel, running, wait| {
        let mut computed = None;
        let interruption = pool.in_place_scope(|scope| {
            scope.spawn(|_| {
                let _running = running; // dropped at the end, also of a panic
                computed = Some(Cancel::catch(|| compute(cancel)));
            });
            wait()
        });
        (computed.expect("the scope ends when the kernel has"), interruption)
    })
}

/// The same for kernels that start no threads of their own. One that is brief, some tens of milliseconds at most, runs
/// in the caller's thread: to hand it over costs more than many take, and Ctrl-C waits for its end.
pub fn interruptible_unless<T: Send>(
    is_brief: bool,
    py: Python<'_>,
    compute: impl FnOnce(&Cancel) -> T + Send,
) -> PyResult<T> {
    if is_brief { Ok(py.detach(|| compute(&Cancel::never()))) } else { interruptible(py, compute) }
}

/// The same for runs of pipelines, which must not start in a pool: they wait for its workers.
pub fn interruptible_run<T: Send>(py: Python<'_>, compute: impl FnOnce(&Cancel) -> T + Send) -> PyResult<T> {
    waiting(py, |cancel, running, wait| {
        thread::scope(|scope| {
            let worker = scope.spawn(move || {
                let _running = running;
                Cancel::catch(|| compute(cancel))
            });
            let interruption = wait();
            (worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), interruption)
        })
    })
}

/// Without the interpreter's lock: lets `start` compute elsewhere, until the sender that it gets is dropped, and wait
/// for that or for an exception.
fn waiting<T: Send>(
    py: Python<'_>,
    start: impl FnOnce(&Cancel, Sender<()>, &dyn Fn() -> Option<PyErr>) -> (Result<T, Cancelled>, Option<PyErr>) + Send,
) -> PyResult<T> {
    let cancel = Cancel::new();
    let (computed, interruption) = py.detach(move || {
        let (running, ended) = mpsc::channel();
        start(&cancel, running, &|| exception(&ended, &cancel))
    });
    match (interruption, computed) {
        (Some(exception), _) => Err(exception),
        (None, Ok(value)) => Ok(value),
        (None, Err(Cancelled)) => Err(PyRuntimeError::new_err("the computation was cancelled, by no exception")),
    }
}

/// Waits for the end. The first exception cancels the token, and is returned at the end.
fn exception(ended: &Receiver<()>, cancel: &Cancel) -> Option<PyErr> {
    let mut exception = None;
    while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(LOOK) {
        if exception.is_none() {
            exception = Python::attach(|py| py.check_signals().err());
            exception.iter().for_each(|_| cancel.cancel());
        }
    }
    exception
}
