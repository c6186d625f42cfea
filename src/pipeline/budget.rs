//! The memory budget: a source takes credit in bytes before it reads; the credit returns when the last stage has
//! dropped the rows.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use crate::stages::source::Credit;
use crate::stages::stage::StageError;

/// Bytes that may be in flight between sources and the stages that reduce them.
pub struct Budget {
    state: Mutex<State>,
    freed: Condvar,
}

struct State {
    free: usize,
    stopped: bool,
}

/// Returns its bytes when dropped.
struct Hold {
    budget: Arc<Budget>,
    bytes: usize,
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.budget.state.lock().unwrap_or_else(PoisonError::into_inner).free += self.bytes;
        self.budget.freed.notify_all();
    }
}

impl Budget {
    /// A budget of `bytes`.
    #[must_use]
    pub fn new(bytes: usize) -> Arc<Self> {
        Arc::new(Self { state: Mutex::new(State { free: bytes, stopped: false }), freed: Condvar::new() })
    }

    /// Waits until `bytes` are available.
    ///
    /// # Errors
    /// When the run is being stopped.
    pub fn reserve(self: &Arc<Self>, bytes: usize) -> Result<Credit, StageError> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        while state.free < bytes && !state.stopped {
            state = self.freed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.stopped {
            return Err(StageError::Stopped);
        }
        state.free -= bytes;
        Ok(Credit::new(Hold { budget: Arc::clone(self), bytes }))
    }

    /// Wakes all waiting sources: the run has failed.
    pub fn stop(&self) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).stopped = true;
        self.freed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn never_more_than_the_budget_is_out() {
        let budget = Budget::new(100);
        let (out, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for bytes in [40, 60, 30, 70] {
                let (budget, out, most) = (&budget, &out, &most);
                scope.spawn(move || {
                    for _ in 0..500 {
                        let credit = budget.reserve(bytes).unwrap();
                        let now = out.fetch_add(bytes, Ordering::SeqCst) + bytes;
                        most.fetch_max(now, Ordering::SeqCst);
                        out.fetch_sub(bytes, Ordering::SeqCst);
                        drop(credit);
                    }
                });
            }
        });
        assert!(most.load(Ordering::SeqCst) <= 100, "{most:?}");
    }

    #[test]
    fn stopping_wakes_who_waits() {
        let budget = Budget::new(10);
        let all = budget.reserve(10).unwrap();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| budget.reserve(1).is_err());
            std::thread::sleep(std::time::Duration::from_millis(20));
            budget.stop();
            assert!(waiting.join().unwrap());
        });
        drop(all);
    }
}
