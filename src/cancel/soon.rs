//! A check for tests: whether a kernel ends soon after a cancel.

use std::time::{Duration, Instant};

use super::{Cancel, Cancelled};

/// How long a kernel runs before it is cancelled.
const RUNS: Duration = Duration::from_millis(50);

/// From a cancel to the end of a kernel.
const LATE: Duration = Duration::from_millis(200);

/// One of so many tries is enough: what else runs on the machine only lengthens them.
const TRIES: usize = 10;

/// Cancels a kernel that would run for longer than 50 ms, and sees that it ends within 200 ms.
///
/// # Panics
/// If the kernel ends before the cancel, or in none of ten tries soon after it.
pub fn ends_soon<T>(kernel: impl Fn(&Cancel) -> T) {
    let late = |_| {
        let cancel = Cancel::new();
        let asking = cancel.clone();
        let cancelled_at = std::thread::spawn(move || {
            std::thread::sleep(RUNS);
            asking.cancel();
            Instant::now()
        });
        let ended = Cancel::catch(|| drop(kernel(&cancel)));
        let cancelled_at = cancelled_at.join().expect("it only waits");
        assert_eq!(ended, Err(Cancelled), "the kernel was too quick");
        cancelled_at.elapsed()
    };
    assert!((0..TRIES).map(late).any(|late| late < LATE), "{TRIES} times longer than {LATE:?}");
}
