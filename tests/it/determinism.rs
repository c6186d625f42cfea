//! Law 6: the same bytes for any thread count, batch size, channel size and memory budget.

use periscope::pipeline::run::Settings;

use crate::lab::{ALL_VISIBLE, Lab, with_threads};

#[test]
fn every_part_is_the_same_however_the_run_uses_the_machine() {
    let lab = Lab::tiny();
    let usual = Settings::default();
    let variants = [
        ("usual", 2, usual.clone()),
        ("one-thread", 1, usual.clone()),
        ("small-batches", 2, Settings { batch_bytes: 10_000, ..usual.clone() }),
        ("odd-batches", 1, Settings { batch_bytes: 3_333, replay_rows: 7, ..usual.clone() }),
        ("one-batch-channels", 2, Settings { channel_batches: 1, ..usual.clone() }),
        ("wide-channels", 2, Settings { channel_batches: 32, memory_bytes: 256 << 20, ..usual.clone() }),
        ("much-memory", 2, Settings { memory_bytes: 512 << 20, ..usual.clone() }),
        ("little-memory", 2, Settings { memory_bytes: 30 << 20, batch_bytes: 100_000, channel_batches: 1, ..usual }),
    ];
    let mut reference = None;
    for (name, threads, settings) in variants {
        with_threads(threads, || lab.run(name, ALL_VISIBLE, &settings)).unwrap();
        let parts = lab.parts(name);
        assert!(parts.len() > 10, "{parts:?}");
        let reference = reference.get_or_insert_with(|| parts.clone());
        assert_eq!(&parts, reference, "{name} differs");
    }
}
