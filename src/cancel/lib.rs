//! Cancellation: one thread asks, long loops in other threads poll a token and end.
//!
//! Every loop that can run longer than 0.1 s calls [`Cancel::check`] once a turn, at a level where a turn takes
//! microseconds to milliseconds. Innermost loops do not poll. After a cancel, the check unwinds the stack.
//! [`Cancel::catch`] stands where the computation was started and turns that unwinding into the error [`Cancelled`].
//!
//! Single calls into rustfft and faer do not poll: a transform of one record, a factor of 3,000 unknowns, eigenvectors
//! of 1,500. Callers poll between them.
//!
//! # Why unwinding and not `Result`
//!
//! A kernel does not fail because its user presses Ctrl-C. With `Result`, every kernel, every helper and every closure
//! that one hands to rayon or to a sort would return an error which no caller between loop and boundary can act on.
//! Unwinding keeps the return types of kernels, drops what they hold, and rayon carries it from its workers to the
//! caller. The payload is private to this crate, and starts with [`std::panic::resume_unwind`]: no panic hook runs, and
//! nothing is printed. Other panics pass through [`Cancel::catch`] unchanged. The program must not be built with `panic
//! = "abort"`.
//!
//! ```
//! use periscope_cancel::{Cancel, Cancelled};
//!
//! fn kernel(cancel: &Cancel) -> f64 {
//!     (0..).map(|i| { cancel.check(); f64::from(i) }).sum()
//! }
//!
//! let cancel = Cancel::new();
//! cancel.cancel(); // usually from another thread
//! assert_eq!(Cancel::catch(|| kernel(&cancel)), Err(Cancelled));
//! ```

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use thiserror::Error;

pub use soon::ends_soon;

mod soon;

/// Asks computations to end. Clones are one token: a cancel through any of them reaches all. The default is
/// [`Cancel::never`].
#[derive(Clone, Debug, Default)]
pub struct Cancel(Option<Arc<AtomicBool>>);

/// A computation ended because its token was cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("cancelled")]
pub struct Cancelled;

/// What [`Cancel::check`] unwinds with.
struct Payload;

impl Cancel {
    /// A token that is not cancelled yet.
    #[must_use]
    pub fn new() -> Self {
        Self(Some(Arc::default()))
    }

    /// A token for callers who do not cancel. It allocates nothing, and [`Cancel::cancel`] has no effect on it.
    #[must_use]
    pub const fn never() -> Self {
        Self(None)
    }

    /// Asks all who hold this token to end.
    pub fn cancel(&self) {
        if let Some(flag) = &self.0 {
            flag.store(true, Ordering::Relaxed);
        }
    }

    /// Whether somebody cancelled the token: one relaxed load.
    #[must_use]
    #[inline]
    pub fn is_cancelled(&self) -> bool {
        self.0.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// Unwinds to the next [`Cancel::catch`] if somebody cancelled the token, else returns at once.
    ///
    /// # Panics
    /// When cancelled; not with a message, but with a payload that [`Cancel::catch`] takes.
    #[inline]
    pub fn check(&self) {
        if self.is_cancelled() {
            unwind();
        }
    }

    /// Runs `body`, which may call [`Cancel::check`] of any token, in this thread or in rayon's.
    ///
    /// What `body` changed through references may be half changed afterwards: drop it with the error.
    ///
    /// # Errors
    /// When a check ended `body`.
    ///
    /// # Panics
    /// When `body` panics: such a panic passes.
    pub fn catch<T>(body: impl FnOnce() -> T) -> Result<T, Cancelled> {
        catch_unwind(AssertUnwindSafe(body)).map_err(|payload| match payload.downcast::<Payload>() {
            Ok(_) => Cancelled,
            Err(other) => resume_unwind(other),
        })
    }
}

#[cold]
fn unwind() -> ! {
    resume_unwind(Box::new(Payload))
}

#[cfg(test)]
mod tests;
