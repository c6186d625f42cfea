//! `pipelines/characterize.toml`: a good instrument passes as often as `level` says, and each fault fails its own
//! check.

use std::collections::BTreeMap;
use std::fs;

use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Check, Measurement, Profile};

use crate::lab::Lab;

const CHARACTERIZE: &str = include_str!("../../pipelines/characterize.toml");
/// An instrument on the bench, and the runs of its check.
pub const INSTRUMENT: &str = include_str!("../../pipelines/scenes/instrument.toml");

/// The instrument with a fault: a key of `[instrument.flaws]`.
pub fn faulty(flaw: &str) -> String {
    INSTRUMENT.replace("[captures]\n", &format!("[instrument.flaws]\n{flaw}\n[captures]\n"))
}

/// Checks of an instrument, by name.
pub fn checks(scene: &str, seed: u64, set: &[&str]) -> (Lab, BTreeMap<String, Check>) {
    let lab = Lab::of(scene, seed, Format::Trc);
    let set: Vec<String> = set.iter().map(|set| format!("checks.{set}")).collect();
    let outcome = lab.run_with("out", CHARACTERIZE, &set, &Settings::default()).unwrap();
    assert_eq!(outcome.rejects, 0);
    let rows = lab.rows::<Check>("out", "checks").into_iter().map(|row| (row.check.to_string(), row)).collect();
    (lab, rows)
}

pub fn failed(checks: &BTreeMap<String, Check>) -> Vec<&str> {
    checks.values().filter(|row| &*row.verdict == "fail").map(|row| &*row.check).collect()
}

/// Every tolerance at 0: the level is then the chance that any check of a good instrument fails.
pub const EXACT: [&str; 9] = [
    "linearity_tolerance=0.0",
    "delay_tolerance_ps=0.0",
    "exponent_tolerance=0.0",
    "shift_tolerance=0.0",
    "drift_tolerance_ps=0.0",
    "power_tolerance=0.0",
    "width_tolerance=0.0",
    "echo_tolerance=0.0",
    "pickup_tolerance_v=0.0",
];

/// Faults, the check that each must fail, what its cause must say, and checks that may fail with it.
pub const FAULTS: [(&str, &str, &str, &[&str]); 5] = [
    ("saturation_v = 5.0", "linearity", "saturation", &["inverse_square", "signal_dependent_delay", "echo"]),
    ("delay_ps_per_h = 1.0", "delay_drift", "warming up", &["delay_scatter"]),
    ("echo = { ratio = 0.02, delay_ps = 4000.0 }", "echo", "ps behind the pulse, as from the far end of a cable", &[]),
    ("slew_ps = 20.0", "signal_dependent_delay", "walk", &["shift_per_path"]),
    (
        "pickup = { volts = 0.004, frequency_ghz = 0.5, decay_ps = 4000.0 }",
        "pickup",
        "synchronous pick-up",
        &["echo", "bounces_2", "bounces_3"],
    ),
];

#[test]
fn a_good_instrument_passes_every_check() {
    let (lab, checks) = checks(INSTRUMENT, 1, &[]);
    assert!(failed(&checks).is_empty(), "{checks:#?}");
    assert!(checks.values().all(|row| &*row.verdict != "missing"), "{checks:#?}");
    let value = |check: &str| checks[check].value.unwrap();
    assert!((value("latency_ps") - 900.0).abs() < 3.0 && (value("inverse_square") + 2.0).abs() < 0.01, "{checks:#?}");
    // 4 mV, and the converter's rounding.
    assert!((value("noise") / 0.00415 - 1.0).abs() < 0.05 && (1.0..1.2).contains(&value("noise_codes")), "{checks:#?}");
    assert!(value("bounces_1") > value("bounces_2") && value("bounces_2") > value("bounces_3"), "{checks:#?}");
    // Every run is a capture of its own, also where they share sensor and role.
    assert_eq!(lab.rows::<Profile>("out", "profiles").len(), 26);
    let measurements = lab.rows::<Measurement>("out", "measurements");
    let runs: Vec<&str> = measurements.iter().map(|row| row.run.as_deref().unwrap()).collect();
    assert!(runs.contains(&"raw/fiducial/12/s1_0003_C1.trc"), "{runs:?}");
    assert!(runs.windows(2).all(|pair| pair[0] != pair[1]), "{runs:?}");
}

/// Short version of `benches/instrument_checks.rs`.
#[test]
fn false_alarms_are_as_rare_as_the_level_says() {
    let set = [&["level=0.2"], EXACT.as_slice()].concat();
    let draws = 16;
    let alarms = (0..draws).filter(|seed| !failed(&checks(INSTRUMENT, 100 + seed, &set).1).is_empty()).count();
    // 3.2 are expected of 16; more than 8 come up once in 400.
    assert!(alarms <= 8, "{alarms} of {draws}");
}

#[test]
fn each_fault_fails_its_own_check_and_names_its_cause() {
    for (flaw, check, cause, also) in FAULTS {
        let (_lab, checks) = checks(&faulty(flaw), 7, &[]);
        let row = &checks[check];
        assert!(&*row.verdict == "fail" && row.cause.contains(cause), "{row:#?}");
        let others: Vec<&str> = failed(&checks).into_iter().filter(|name| *name != check).collect();
        assert!(others.iter().all(|name| also.contains(name)), "{check}: {others:?}");
    }
}

#[test]
fn a_drift_is_measured_in_its_unit() {
    let (_lab, checks) = checks(&faulty("delay_ps_per_h = 1.0"), 8, &[]);
    let row = &checks["delay_drift"];
    assert!((row.value.unwrap() - 1.0).abs() < 5.0 * row.sd.unwrap() && &*row.unit == "ps/h", "{row:#?}");
}

/// The table lists what was not captured as missing, and how to capture it; the rest is checked all the same.
#[test]
fn missing_captures_are_reported() {
    let lab = Lab::tiny();
    lab.run("out", CHARACTERIZE, &Settings::default()).unwrap();
    let checks: Vec<Check> = lab.rows("out", "checks");
    let verdict = |check: &str| checks.iter().find(|row| &*row.check == check).unwrap();
    for (check, fix) in [
        ("linearity", "attenuation_od"),
        ("inverse_square", "path_m"),
        ("delay_drift", "fiducial"),
        ("pickup", "blocked"),
    ] {
        let row = verdict(check);
        assert!(&*row.verdict == "missing" && row.cause.contains(fix) && row.value.is_none(), "{row:#?}");
    }
    assert!(&*verdict("echo").verdict == "pass" && &*verdict("noise_codes").verdict == "pass", "{checks:#?}");
}

/// `noise_v` is the noise of a shot even for records that the oscilloscope averaged: divided by the root of `shots`, it
/// is that of the mean.
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
