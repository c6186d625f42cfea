//! Nothing is silent: what a run leaves out, rejects or cannot find has an exit code, a count, an example and a fix.

use std::fs;
use std::process::Command;

use periscope::tables::Reject;

use crate::lab::{ALL_VISIBLE, Lab};

/// Exit code of a check, and what it prints.
fn check(lab: &Lab, args: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["check", "--campaign", "campaign"])
        .args(args)
        .current_dir(lab.path(""))
        .output()
        .unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stdout).unwrap())
}

/// Changes the codes of a simulated file, shot by shot of 320 samples.
fn edit_codes(lab: &Lab, file: &str, change: impl Fn(usize, &mut [u8])) {
    let path = lab.campaign().join(file);
    let mut bytes = fs::read(&path).unwrap();
    let data = bytes.len() - 24 * 320;
    bytes[data..].chunks_mut(320).enumerate().for_each(|(shot, codes)| change(shot, codes));
    fs::write(&path, bytes).unwrap();
}

/// The reasons that the table of rejects has.
fn reasons(lab: &Lab) -> Vec<String> {
    lab.rows::<Reject>("out", "rejects").into_iter().map(|row| row.reason.to_string()).collect()
}

/// What `run` rejects, `check` names too, in the same words; neither says that all is well.
fn both_say(lab: &Lab, words: &[&str]) {
    let (code, text) = run(lab, &[]);
    assert_eq!(code, 3, "{text}");
    contains(&text, words);
    let (code, text) = check(lab, &["--pipeline", "pipeline.toml"]);
    assert_eq!(code, 3, "{text}");
    contains(&text, words);
    assert!(!text.contains("all is well"), "{text}");
    // `check` prints a few of each kind.
    let reasons = reasons(lab);
    let mut alike = reasons.iter().filter(|reason| reason.contains(words[0])).peekable();
    assert!(alike.peek().is_none() || alike.any(|reason| text.contains(reason.as_str())), "{reasons:#?} in:\n{text}");
}

/// Exit code and messages of a run of the usual pipeline; no message comes twice.
fn run(lab: &Lab, args: &[&str]) -> (i32, String) {
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).unwrap();
    let usual = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out", "--progress", "none"];
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(usual)
        .args(args)
        .current_dir(lab.path(""))
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let mut lines: Vec<&str> = text.lines().filter(|line| line.starts_with("warning: ")).collect();
    lines.sort_unstable();
    assert!(lines.windows(2).all(|pair| pair[0] != pair[1]), "{text}");
    (output.status.code().unwrap(), text)
}

fn edit(lab: &Lab, from: &str, to: &str) {
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from} is not in campaign.toml");
    fs::write(&path, text.replace(from, to)).unwrap();
}

/// Runs twice, since what is reused is reported too, and strictly; returns the messages.
fn incomplete(lab: &Lab) -> String {
    let (code, text) = run(lab, &[]);
    assert_eq!(code, 3, "{text}");
    assert_eq!(run(lab, &[]).0, 3, "{text}");
    assert_eq!(run(lab, &["--strict"]).0, 1, "{text}");
    text
}

fn contains(text: &str, words: &[&str]) {
    words.iter().for_each(|words| assert!(text.contains(words), "`{words}` is not in:\n{text}"));
}

#[test]
fn a_whole_campaign_leaves_nothing_out() {
    let lab = Lab::tiny();
    assert_eq!(run(&lab, &["--strict"]), (0, String::new()));
}

#[test]
fn a_wrong_path_in_files_is_exit_code_3() {
    let lab = Lab::tiny();
    edit(&lab, "raw/scene/{sensor}_L{lit}_P{seen}_C1", "raw/scenes/{sensor}_L{lit}_P{seen}_C1");
    contains(
        &incomplete(&lab),
        &[
            "1 pattern of campaign.toml matches no file: [[captures]] number 2: files = \"raw/scenes/",
            "32 files match no rule of campaign.toml and are left out: raw/scene/s1_L1_P1_C1.trc",
            "Add a [[captures]] rule that takes them, or an [[exclude]] with the reason.",
            "`periscope check --campaign campaign` lists all.",
            "`patches`, `paper` are empty",
        ],
    );
}

#[test]
fn missing_references_are_exit_code_3() {
    let lab = Lab::tiny();
    for entry in fs::read_dir(lab.campaign().join("raw/scene")).unwrap().flatten() {
        if entry.file_name().to_string_lossy().ends_with("_C2.trc") {
            fs::remove_file(entry.path()).unwrap();
        }
    }
    contains(
        &incomplete(&lab),
        &[
            "16 files are left out, since their reference is missing: raw/scene/s1_L1_P1_C1.trc (wanted raw/scene/",
            "Copy the reference files too, or correct `reference` in the [[captures]] rule.",
            "`patches`, `paper` are empty",
        ],
    );
}

/// One stray file among good ones: the result is whole, and the exit code says that the file is not in it.
#[test]
fn a_stray_file_is_exit_code_3_and_excluding_it_is_the_fix() {
    let lab = Lab::tiny();
    fs::write(lab.campaign().join("raw/notes.txt"), "shutter was slow").unwrap();
    let text = incomplete(&lab);
    contains(&text, &["1 file matches no rule of campaign.toml and is left out: raw/notes.txt"]);
    assert!(!text.contains("empty"), "{text}");
    let path = lab.campaign().join("campaign.toml");
    let exclude = "[[exclude]]\nmatch = { file = \"raw/notes.txt\" }\nreason = \"no recording\"\n";
    fs::write(&path, fs::read_to_string(&path).unwrap() + exclude).unwrap();
    assert_eq!(run(&lab, &["--strict"]), (0, String::new()));
}

/// A time between samples in nanoseconds, beside files that say it in seconds: one cause, with both numbers.
#[test]
fn a_wrong_time_base_is_the_cause_that_is_named() {
    let lab = Lab::tiny();
    edit(&lab, "role = \"scene\"", "role = \"scene\"\ndt_ps = 0.05");
    both_say(
        &lab,
        &[
            "0 valid shots of the 16 that it needs; of 24 shots: 24 without a reference pulse in raw/scene/s1_L",
            "`dt_ps` = 0.05 in the [[captures]] rule, but the file says 50 ps: remove `dt_ps`, or give it in picoseconds",
        ],
    );
}

#[test]
fn causes_of_rejected_shots_are_counted_one_by_one() {
    let lab = Lab::tiny();
    // No reference pulse in one capture; disturbances, a hole in the record and noise beside them in another.
    edit_codes(&lab, "raw/scene/s1_L2_P2_C2.trc", |_, codes| codes.fill(7));
    edit_codes(&lab, "raw/scene/s1_L1_P2_C1.trc", |shot, codes| {
        if shot >= 14 {
            codes[200] = 60;
        }
    });
    both_say(
        &lab,
        &["lit 2, seen 2, has 0 valid shots of the 16 that it needs; of 24 shots: 24 without a reference pulse"],
    );
    both_say(
        &lab,
        &[
            "lit 1, seen 2, has 14 valid shots of the 16 that it needs; of 24 shots: 10 outlying",
            "set `reject_outliers = false` if these shots are good",
        ],
    );
}

/// Without a reference channel the trigger's jitter moves shots: they are good, and error bars are large.
#[test]
fn a_reference_that_is_not_named_is_the_cause_that_is_named() {
    let lab = Lab::tiny();
    for role in ["response/s1", "scene/{sensor}_L{lit}_P{seen}"] {
        edit(&lab, &format!("reference = {{ files = \"raw/{role}_C2.trc\" }}\n"), "");
    }
    let (code, text) = check(&lab, &[]);
    assert_eq!(code, 3, "{text}");
    contains(
        &text,
        &["early and late by", "if a channel sees the laser, name it as `reference` in the [[captures]] rule"],
    );
}

/// A capture that is used, but has lost more than a quarter of its shots.
#[test]
fn a_capture_that_loses_many_shots_is_reported() {
    let lab = Lab::tiny();
    edit_codes(&lab, "raw/scene/s1_L1_P2_C1.trc", |shot, codes| {
        if shot >= 17 {
            codes[200] = 60;
        }
    });
    both_say(&lab, &["lit 1, seen 2, is averaged from 17 shots only; of 24 shots: 7 outlying"]);
}

/// `check` takes the rules of the pipeline that will run: by those of another one the same captures pass.
#[test]
fn check_rejects_by_the_rules_of_the_pipeline() {
    let lab = Lab::tiny();
    fs::write(lab.path("strict.toml"), ALL_VISIBLE.replace("shots_min = 16", "shots_min = 100")).unwrap();
    let (code, text) = check(&lab, &["--pipeline", "strict.toml"]);
    assert_eq!(code, 3, "{text}");
    contains(&text, &["16 files or captures are rejected", "has 24 valid shots of the 100 that it needs"]);
    assert_eq!(check(&lab, &[]).0, 0);
}
