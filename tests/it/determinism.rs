//! Law 6: the same bytes for any thread count, batch size, channel size and memory budget.

use periscope::pipeline::run::Settings;
use periscope::tables::Profile;

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

/// Two stages below a source take each capture where it is read: each makes what it makes alone, and what it makes of
/// rows that come by its channel, since they are archived.
#[test]
fn stages_below_a_source_do_not_depend_on_one_another() {
    let lab = Lab::bulk(16);
    let stage = |heading: &str, params: &str| {
        format!("[{heading}]\nstage = 'average'\nfrom = 'traces'\nparams = {{ {params} }}\n")
    };
    let (traces, plain, odd) = ("[traces]\nstage = 'ingest'\n", stage("profiles", ""), stage("odd", "shots_min = 3"));
    let parts = |out: &str, stages: &[&str]| {
        lab.run(out, &format!("{traces}{}", stages.concat()), &Settings::default()).unwrap();
        lab.parts(out)
    };
    let both = parts("both", &[&plain, &odd]);
    let mut alone = parts("plain", &[&plain]);
    alone.extend(parts("odd", &[&odd]));
    assert_eq!(both, alone);
    let archived = format!("{traces}params = {{ codes = 'none' }}\n{plain}{odd}");
    lab.run("archived", &archived, &Settings::default()).unwrap();
    let profiles = |out: &str, view: &str| lab.rows::<Profile>(out, view);
    assert_eq!(profiles("archived", "profiles"), profiles("both", "profiles"));
    assert_eq!(profiles("archived", "odd"), profiles("both", "odd"));
}
