//! Allocations on the hot path, counted: whole runs of pipelines/average.toml over campaigns that differ in one thing.
//! The difference in exposures alone is the cost of an exposure, that in captures alone the cost of a capture. `cargo
//! test --release --test allocations -- --nocapture` prints the counts; docs/counts.md says how to find who allocates.
//! A binary of its own: the counting allocator sees all threads of its process.

use std::alloc::System;
use std::fs;
use std::path::Path;

use periscope::campaign::Campaign;
use periscope::formats::npy;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::{Shelf, TableWriter};
use periscope::tables::{Calibration, Row};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static COUNTED: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Most allocations, reallocations included, per additional exposure of a capture that is averaged where it is read.
const EXPOSURE_MAX: f64 = 0.05;
/// The same of a file that is read in pieces of 2 MiB: those of a piece, which five hundred exposures share.
const EXPOSURE_IN_PIECES_MAX: f64 = 1.2;
/// The same of one capture more.
const CAPTURE_MAX: f64 = 1000.0;

const SAMPLES: usize = 2048;

const CAMPAIGN: &str = "[campaign]\nname = 'counted'\n[sensors.s1]\n[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\nsegments = 'shot'\n\
    dt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";

/// Codes of one shot: a pulse and some noise. Shots repeat, so that any number of them has the same mean and spread,
/// and takes the same path through the stages.
fn shot(n: u32) -> impl Iterator<Item = i16> {
    let mut state = n % 50 + 1;
    (0..SAMPLES).map(move |i| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let pulse = 3000.0 * (-0.5 * ((i as f64 - 900.0) / 30.0).powi(2)).exp();
        pulse as i16 + (state >> 26) as i16
    })
}

fn campaign(folder: &Path, captures: u32, shots: u32) {
    fs::create_dir_all(folder.join("raw")).unwrap();
    fs::write(folder.join("campaign.toml"), CAMPAIGN).unwrap();
    let codes: Vec<i16> = (0..shots).flat_map(shot).collect();
    for lit in 0..captures {
        let file = fs::File::create(folder.join(format!("raw/L{}_P1.npy", lit + 1))).unwrap();
        npy::write(&mut std::io::BufWriter::new(file), &[u64::from(shots), SAMPLES as u64], &codes).unwrap();
    }
}

fn calibration(path: &Path) {
    let row = Calibration {
        campaign: "counted".into(),
        sensor: "s1".into(),
        shots: 1,
        step_ps: 50.0,
        response_t0_ps: -2000.0,
        response: (0..80).map(|i| (-0.5 * ((f64::from(i) - 40.0) / 3.0).powi(2)).exp()).collect(),
        width_ps: 350.0,
        ..Calibration::default()
    };
    let mut writer = TableWriter::create(path, &Calibration::schema()).unwrap();
    writer.write(&Calibration::to_batch(&[row])).unwrap();
    writer.finish(&[]).unwrap();
}

/// Allocations of one run, from loading the campaign to the last table on the shelf.
fn allocations(captures: u32, shots: u32) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    campaign(&folder.path().join("campaign"), captures, shots);
    let response = folder.path().join("calibration.parquet");
    calibration(&response);
    let set = [format!("calibration.path='{}'", response.display())];
    let counted = Region::new(COUNTED);
    let spec = Spec::parse("average", include_str!("../pipelines/average.toml"), &set).unwrap();
    let campaigns = [Campaign::load(&folder.path().join("campaign")).unwrap()];
    let shelf = Shelf::open(&folder.path().join("out")).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    let outcome = run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
    let counts = counted.change();
    assert_eq!(outcome.tables["onsets"].rows("onsets"), u64::from(captures));
    let all = counts.allocations + counts.reallocations;
    println!("{captures} captures of {shots} shots: {all} allocations, {:.1} MB", counts.bytes_allocated as f64 / 1e6);
    all as f64
}

#[test]
fn exposures_do_not_allocate() {
    // The same pool on any machine: workers allocate too.
    rayon::ThreadPoolBuilder::new().num_threads(2).build_global().unwrap();
    let _ = allocations(4, 400); // what is made once a process
    // Files up to a batch of 4 MiB are averaged where they are read, larger ones are read in pieces.
    for (shots, most) in [(200, EXPOSURE_MAX), (1600, EXPOSURE_IN_PIECES_MAX)] {
        let exposure = (allocations(4, 4 * shots) - allocations(4, shots)) / f64::from(4 * 3 * shots);
        println!("{exposure:.3} an exposure more than {shots}");
        assert!(exposure < most, "{exposure} allocations an exposure more than {shots}");
    }
    let capture = (allocations(16, 400) - allocations(4, 400)) / 12.0;
    println!("{capture:.0} a capture of 400 shots");
    assert!(capture < CAPTURE_MAX, "{capture} allocations a capture");
}
