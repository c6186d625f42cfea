use std::sync::atomic::AtomicUsize;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::*;

fn endless(cancel: &Cancel) -> u64 {
    let mut turns = 0_u64;
    loop {
        cancel.check();
        turns = turns.wrapping_add(1);
    }
}

#[test]
fn a_loop_ends_when_another_thread_cancels() {
    let cancel = Cancel::new();
    let asking = cancel.clone();
    let asked = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(20));
        asking.cancel();
        Instant::now()
    });
    assert_eq!(Cancel::catch(|| endless(&cancel)), Err(Cancelled));
    assert!(asked.join().unwrap().elapsed() < Duration::from_secs(1));
}

#[test]
fn rayon_carries_it_from_its_workers() {
    let cancel = Cancel::new();
    let turns = AtomicUsize::new(0);
    let sum = Cancel::catch(|| {
        let each = (0..1_000_u64).into_par_iter().map(|i| {
            cancel.check();
            if turns.fetch_add(1, Ordering::Relaxed) == 10 {
                cancel.cancel();
            }
            i
        });
        each.sum::<u64>()
    });
    assert_eq!(sum, Err(Cancelled));
}

#[test]
fn a_result_passes_through_where_nobody_cancels() {
    assert_eq!(Cancel::catch(|| Cancel::new().check()), Ok(()));
    let never = Cancel::never();
    never.cancel();
    never.check();
    assert!(!never.is_cancelled() && !Cancel::default().is_cancelled());
}

#[test]
fn other_panics_pass() {
    let panic = catch_unwind(|| Cancel::catch(|| resume_unwind(Box::new("a defect")))).unwrap_err();
    assert_eq!(panic.downcast_ref::<&str>(), Some(&"a defect"));
}

#[test]
fn no_panic_hook_runs() {
    // The hook belongs to the whole process: other tests of this crate do not run it either.
    static CALLS: AtomicUsize = AtomicUsize::new(0);
    std::panic::set_hook(Box::new(|_| {
        CALLS.fetch_add(1, Ordering::Relaxed);
    }));
    let cancel = Cancel::new();
    cancel.cancel();
    assert_eq!(Cancel::catch(|| cancel.check()), Err(Cancelled));
    drop(std::panic::take_hook());
    assert_eq!(CALLS.load(Ordering::Relaxed), 0);
}
