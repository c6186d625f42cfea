//! `periscope check`: what it finds in campaigns that are whole, growing, broken, or measured by a faulty instrument.

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;

use periscope::simulate::Format;

use crate::characterize::faulty;
use crate::lab::Lab;

fn check(lab: &Lab, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
    command.args(["check", "--campaign", "campaign"]).args(args).current_dir(lab.path("")).output().unwrap()
}

fn json(lab: &Lab, args: &[&str]) -> (Option<i32>, Value) {
    let output = check(lab, &[&["--format", "json"], args].concat());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), serde_json::from_slice(&output.stdout).expect(&text))
}

/// Whether one of the things to fix says so.
fn fix(report: &Value, text: &str) -> bool {
    report["fix"].as_array().unwrap().iter().any(|fix| fix.as_str().unwrap().contains(text))
}

#[test]
fn a_whole_campaign_is_well_in_text_and_json() {
    let lab = Lab::tiny();
    let output = check(&lab, &[]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for line in ["scene     s1           16 captures in 16 files", "24 / 24 / 24", "echo", "not checked", "all is well"]
    {
        assert!(text.contains(line), "{line} is not in:\n{text}");
    }
    let (code, report) = json(&lab, &[]);
    let sensor = &report["sensors"][0];
    assert_eq!((code, sensor["faintest"].as_array().unwrap().len()), (Some(0), 5), "{report:#}");
    // One shot has a signal-to-noise ratio of 20, a fit of it about 26; 24 shots are averaged.
    assert!((100.0..160.0).contains(&sensor["snr_median"].as_f64().unwrap()), "{report:#}");
    assert!(!lab.path("out").exists());
}

#[test]
fn what_is_missing_or_unknown_is_a_line_and_the_rest_is_checked() {
    let lab = Lab::tiny();
    let scene = lab.campaign().join("raw/scene");
    for channel in ["C1", "C2"] {
        fs::remove_file(scene.join(format!("s1_L3_P4_{channel}.trc"))).unwrap();
    }
    fs::remove_file(scene.join("s1_L1_P1_C2.trc")).unwrap();
    fs::write(lab.campaign().join("raw/notes.txt"), "shutter was slow").unwrap();
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap() + "[[captures]]\nrole = \"dark\"\nfiles = \"raw/dark/*.trc\"\n";
    fs::write(&path, &text).unwrap();
    let (code, report) = json(&lab, &[]);
    assert_eq!(code, Some(3));
    assert!(fix(&report, "2 pairs (lit, seen) are missing: capture (1, 1) (3, 4)"), "{report:#}");
    assert!(
        fix(&report, "1 file matches no rule") && fix(&report, "1 pattern of campaign.toml matches no file"),
        "{report:#}"
    );
    assert_eq!(report["unmatched"][0], "raw/notes.txt");
    assert!(report["missing_references"][0].as_str().unwrap().contains("s1_L1_P1_C1.trc"), "{report:#}");
    assert_eq!(report["captures"][0]["count"], 14);
    // What is excluded is not missing.
    let exclude = "[[exclude]]\nmatch = { lit = 3, seen = 4 }\nreason = \"in the way\"\n";
    fs::write(&path, text + exclude).unwrap();
    assert!(fix(&json(&lab, &[]).1, "1 pair (lit, seen) is missing: capture (1, 1)"));
}

#[test]
fn a_file_that_is_still_being_written_is_a_line_and_read_again_when_it_is_whole() {
    let lab = Lab::tiny();
    let file = lab.campaign().join("raw/scene/s1_L2_P3_C1.trc");
    let whole = fs::read(&file).unwrap();
    fs::write(&file, &whole[..whole.len() / 3]).unwrap();
    for _ in 0..2 {
        let (code, report) = json(&lab, &["--out", "out"]);
        assert_eq!(code, Some(3));
        assert!(report["rejected"][0]["file"].as_str().unwrap().contains("s1_L2_P3_C1.trc"), "{report:#}");
        assert!(report["sensors"][0]["missing_pairs"].as_array().unwrap().is_empty(), "{report:#}");
    }
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(json(&lab, &["--out", "out"]).0, Some(3));
    fs::write(&file, &whole).unwrap();
    let (code, report) = json(&lab, &["--out", "out"]);
    assert_eq!(code, Some(0), "{report:#}");
    let again = check(&lab, &["--out", "out"]);
    let progress = String::from_utf8_lossy(&again.stderr);
    assert!(again.status.code() == Some(0) && !progress.contains("computing"), "nothing is new, but: {progress}");
}

#[test]
fn a_campaign_that_has_only_begun_can_be_checked() {
    let lab = Lab::tiny();
    fs::remove_dir_all(lab.campaign().join("raw/response")).unwrap();
    let (code, report) = json(&lab, &[]);
    assert_eq!(code, Some(3));
    assert!(fix(&report, "sensor s1 is not calibrated") && fix(&report, "capture its response"), "{report:#}");
    assert!(
        fix(&report, "no file shows the impulse response of sensor `s1`, which [draft_stir] (`deconvolve`) needs"),
        "{report:#}"
    );
    fs::remove_dir_all(lab.campaign().join("raw")).unwrap();
    let (code, report) = json(&lab, &[]);
    assert_eq!((code, report["captures"].as_array().unwrap().len()), (Some(3), 0), "{report:#}");
    fs::remove_file(lab.campaign().join("campaign.toml")).unwrap();
    let failed = check(&lab, &[]);
    assert_eq!(failed.status.code(), Some(1), "{}", String::from_utf8_lossy(&failed.stderr));
}

#[test]
fn verdicts_of_the_instrument_are_reported_with_their_cause() {
    let lab = Lab::of(&faulty("saturation_v = 5.0"), 3, Format::Trc);
    let (code, report) = json(&lab, &[]);
    assert_eq!(code, Some(3));
    assert!(fix(&report, "sensor s1: linearity fails: saturation"), "{report:#}");
    let checks = report["sensors"][0]["checks"].as_array().unwrap();
    assert!(checks.iter().any(|row| row["check"] == "delay_drift" && row["verdict"] == "pass"), "{report:#}");
    let text = String::from_utf8(check(&lab, &[]).stdout).unwrap();
    assert!(text.contains("linearity                fail  0.1"), "{text}");
}
