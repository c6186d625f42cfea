//! Law 6: the same bytes for any thread count, batch size, channel size and memory budget.

use std::fs;

use periscope::pipeline::run::Settings;
use periscope::tables::{Profile, Reject};

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

/// A file that ends within a shot, and one that ends within its head: whatever is read at a time, the same shots count
/// and the same is said.
#[test]
fn files_that_end_early_are_the_same_in_pieces() {
    let lab = Lab::bulk(6);
    let files: Vec<_> = fs::read_dir(lab.campaign().join("raw")).unwrap().map(|file| file.unwrap().path()).collect();
    let sizes = [fs::metadata(&files[0]).unwrap().len() * 2 / 3 + 5, 60];
    for (file, size) in files.iter().zip(sizes) {
        fs::OpenOptions::new().write(true).open(file).unwrap().set_len(size).unwrap();
    }
    let pipeline = "[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\n";
    let run = |name: &str, batch_bytes: usize| {
        lab.run(name, pipeline, &Settings { batch_bytes, ..Settings::default() }).unwrap();
        let rejects = lab.rows::<Reject>(name, "rejects");
        assert!(rejects.len() >= 2, "{rejects:?}");
        (lab.parts(name), rejects)
    };
    let usual = run("usual", Settings::default().batch_bytes);
    for batch_bytes in [1, 3_333, 100_000] {
        assert_eq!(run(&format!("pieces-of-{batch_bytes}"), batch_bytes), usual, "{batch_bytes}");
    }
}
