//! `pipelines/characterize.toml`: a good instrument passes as often as `level` says, and each fault fails its own check.

use std::collections::BTreeMap;
use std::fs;

use periscope::pipeline::run::Settings;
use periscope::tables::{Check, Measurement, Profile};

use crate::bench::{self, Faults};
use crate::lab::Lab;

const CHARACTERIZE: &str = include_str!("../../pipelines/characterize.toml");
const SHOTS: usize = 64;

/// Checks of an instrument, by name.
fn checks(faults: &Faults, seed: u64, set: &[&str]) -> (Lab, BTreeMap<String, Check>) {
    let lab = Lab::empty();
    fs::create_dir_all(lab.campaign()).unwrap();
    bench::write(&lab.campaign(), faults, SHOTS, seed);
    let set: Vec<String> = set.iter().map(|set| format!("checks.{set}")).collect();
    let outcome = lab.run_with("out", CHARACTERIZE, &set, &Settings::default()).unwrap();
    assert_eq!(outcome.rejects, 0);
    let rows = lab.rows::<Check>("out", "checks").into_iter().map(|row| (row.check.to_string(), row)).collect();
    (lab, rows)
}

fn failed(checks: &BTreeMap<String, Check>) -> Vec<&str> {
    checks.values().filter(|row| &*row.verdict == "fail").map(|row| &*row.check).collect()
}

#[test]
fn a_good_instrument_passes_every_check() {
    let (lab, checks) = checks(&Faults::default(), 1, &[]);
    assert!(failed(&checks).is_empty(), "{checks:#?}");
    assert!(checks.values().all(|row| &*row.verdict != "missing"), "{checks:#?}");
    let value = |check: &str| checks[check].value.unwrap();
    assert!((value("latency_ps") - 900.0).abs() < 5.0 && (value("inverse_square") + 2.0).abs() < 0.05, "{checks:#?}");
    assert!((value("noise") / 0.02 - 1.0).abs() < 0.05 && value("noise_codes") > 100.0, "{checks:#?}");
    assert!(value("bounces_1") > value("bounces_2") && value("bounces_2") > value("bounces_3"), "{checks:#?}");
    // Every run is a capture of its own, also where they share sensor and role.
    assert_eq!(lab.rows::<Profile>("out", "profiles").len(), 25);
    let measurements = lab.rows::<Measurement>("out", "measurements");
    let runs: Vec<&str> = measurements.iter().map(|row| row.run.as_deref().unwrap()).collect();
    assert!(runs.contains(&"raw/fiducial/od_3_C1.npy") && runs.windows(2).all(|pair| pair[0] != pair[1]), "{runs:?}");
}

/// At tolerance 0 the level is the chance that any check fails. `PERISCOPE_DRAWS=500` looks closer.
#[test]
fn false_alarms_are_as_rare_as_the_level_says() {
    let tolerances = [
        "linearity_tolerance",
        "delay_tolerance_ps",
        "exponent_tolerance",
        "shift_tolerance",
        "drift_tolerance_ps",
        "power_tolerance",
        "width_tolerance",
        "echo_tolerance",
        "pickup_tolerance_v",
    ];
    let mut set: Vec<String> = tolerances.iter().map(|name| format!("{name}=0.0")).collect();
    set.push("level=0.2".to_owned());
    let set: Vec<&str> = set.iter().map(String::as_str).collect();
    let draws: u64 = std::env::var("PERISCOPE_DRAWS").map_or(24, |draws| draws.parse().unwrap());
    let mut alarms: BTreeMap<String, u32> = BTreeMap::new();
    let mut bad = 0;
    let mut squares: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for seed in 0..draws {
        let (_lab, checks) = checks(&Faults::default(), 100 + seed, &set);
        let failed = failed(&checks);
        bad += u32::from(!failed.is_empty());
        failed.iter().for_each(|check| *alarms.entry((*check).to_owned()).or_default() += 1);
        for (name, row) in &checks {
            if let (Some(sd), Some(expected)) = (row.sd, row.expected) {
                squares.entry(name.clone()).or_default().push((row.value.unwrap() - expected) / sd);
            }
        }
    }
    for (name, zs) in &squares {
        let rms = (zs.iter().map(|z| z * z).sum::<f64>() / zs.len() as f64).sqrt();
        let mean = zs.iter().sum::<f64>() / zs.len() as f64;
        eprintln!("{name:26} z mean {mean:+.2} rms {rms:.2}");
    }
    eprintln!("{bad} of {draws} with an alarm at level 0.2: {alarms:?}");
    assert!(f64::from(bad) < 0.2 * draws as f64 + 3.0 * (0.16 * draws as f64).sqrt(), "{bad} of {draws}: {alarms:?}");
}

/// Each fault fails its own check, with a cause that names it, and no others than may follow from it.
#[test]
fn each_fault_fails_its_own_check() {
    let good = Faults::default();
    for (faults, check, cause, also) in [
        (Faults { compression: 0.1, ..good }, "linearity", "saturation", vec!["inverse_square"]),
        (Faults { drift_ps: 1.0, ..good }, "delay_drift", "warming up", vec![]),
        (Faults { echo: 0.02, ..good }, "echo", "ps behind the pulse, as from the far end of a cable of 0.4", vec![]),
        (Faults { walk_ps: 15.0, ..good }, "signal_dependent_delay", "walk", vec!["shift_per_path"]),
        (Faults { pickup_v: 0.02, ..good }, "pickup", "synchronous pick-up", vec![]),
    ] {
        let (_lab, checks) = checks(&faults, 7, &[]);
        let row = &checks[check];
        assert!(&*row.verdict == "fail" && row.cause.contains(cause), "{row:#?}");
        let others: Vec<&str> = failed(&checks).into_iter().filter(|name| *name != check).collect();
        assert!(others.iter().all(|name| also.contains(name)), "{check}: {others:?}");
    }
    let (_lab, checks) = checks(&Faults { compression: 0.1, drift_ps: 1.0, ..good }, 8, &[]);
    assert!((checks["linearity"].value.unwrap() - 0.1).abs() < 0.02, "{:#?}", checks["linearity"]);
    assert!((checks["delay_drift"].value.unwrap() - 1.0).abs() < 0.3, "{:#?}", checks["delay_drift"]);
    assert_eq!(&*checks["delay_drift"].unit, "ps/run");
}

/// What was not captured is said to be missing, and how to capture it; the rest is checked all the same.
#[test]
fn missing_captures_are_told() {
    let lab = Lab::tiny();
    lab.run("out", CHARACTERIZE, &Settings::default()).unwrap();
    let checks: Vec<Check> = lab.rows("out", "checks");
    let verdict = |check: &str| checks.iter().find(|row| &*row.check == check).unwrap();
    for (check, mend) in [
        ("linearity", "attenuation_od"),
        ("inverse_square", "path_m"),
        ("delay_drift", "fiducial"),
        ("pickup", "blocked"),
    ] {
        let row = verdict(check);
        assert!(&*row.verdict == "missing" && row.cause.contains(mend) && row.value.is_none(), "{row:#?}");
    }
    assert!(&*verdict("echo").verdict == "pass" && &*verdict("noise_codes").verdict == "pass", "{checks:#?}");
}

/// Records that the oscilloscope averaged are quieter than shots: `noise_v` is that of a shot, so that it over the root of `shots` is that of the mean.
#[test]
fn the_noise_of_one_shot_is_known_also_where_records_are_averages() {
    let noise = |averaged: &str| {
        let lab = Lab::tiny();
        let path = lab.campaign().join("campaign.toml");
        let text = fs::read_to_string(&path).unwrap().replace("segments = \"shot\"", averaged);
        fs::write(&path, text).unwrap();
        lab.run("out", CHARACTERIZE, &Settings::default()).unwrap();
        let profile = lab.rows::<Profile>("out", "profiles").remove(0);
        (profile.shots, profile.noise_v)
    };
    let (single, averaged) = (noise("segments = \"shot\""), noise("segments = \"shot\"\naveraged_shots = 4"));
    assert!(averaged.0 == 4 * single.0 && (averaged.1 / single.1 - 2.0).abs() < 1e-9, "{single:?} {averaged:?}");
}
