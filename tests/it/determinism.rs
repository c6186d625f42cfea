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

/// Captures of one small file, of one that is read in pieces, of two, and of shots larger than a piece, in turn: their
/// rows come in the order of captures, and are those of an archive.
#[test]
fn captures_of_all_sizes_come_in_their_order() {
    let lab = Lab::bulk(4);
    fs::create_dir(lab.campaign().join("raw/other")).unwrap();
    let campaign = lab.campaign().join("campaign.toml");
    let rules = fs::read_to_string(&campaign).unwrap();
    let rule = &rules[rules.find("[[captures]]").unwrap()..];
    let numbered = rule.replace("raw/L{lit}_P{seen}.npy", "raw/other/L{lit}_P{seen}_S{shot}.npy");
    fs::write(&campaign, format!("{rules}{numbered}")).unwrap();
    let write = |name: &str, [shots, samples]: [usize; 2]| {
        let mut codes = vec![0_i16; shots * samples];
        (0..shots).for_each(|shot| codes[shot * samples + samples / 2] = 1000);
        let mut file = fs::File::create(lab.campaign().join("raw/other").join(name)).unwrap();
        periscope::formats::npy::write(&mut file, &[shots as u64, samples as u64], &codes).unwrap();
    };
    for (name, shape) in [
        ("L1_P5_S0.npy", [32, 16_384]),
        ("L2_P6_S0.npy", [200, 16_384]),
        ("L2_P6_S200.npy", [200, 16_384]),
        ("L3_P7_S0.npy", [200, 16_384]),
        ("L3_P8_S0.npy", [200, 16_384]),
        ("L3_P8_S200.npy", [32, 16_384]),
        ("L4_P9_S0.npy", [10, 600_000]),
        ("L5_P10_S0.npy", [200, 16_384]),
    ] {
        write(name, shape);
    }
    let run = |out: &str, params: &str| {
        let average = "[profiles]\nstage = 'average'\nfrom = 'traces'\n";
        lab.run(out, &format!("[traces]\nstage = 'ingest'\n{params}{average}"), &Settings::default()).unwrap();
        lab.rows::<Profile>(out, "profiles")
    };
    let rows = run("in-place", "");
    let pairs: Vec<(i32, i32, i32)> = rows.iter().map(|row| (row.lit, row.seen, row.shots)).collect();
    let of_bulk = |lit, seen| (lit, seen, 512);
    let (first, second) = ([of_bulk(1, 2), of_bulk(2, 1)], [of_bulk(3, 4), of_bulk(4, 3)]);
    assert_eq!(
        pairs,
        [&first[..], &[(1, 5, 32), (2, 6, 400)], &second, &[(3, 7, 200), (3, 8, 232), (4, 9, 10), (5, 10, 200)]]
            .concat()
    );
    assert_eq!(rows, run("archived", "params = { codes = 'none' }\n"));
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
