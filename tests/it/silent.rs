//! Nothing is silent: what a run leaves out, rejects or cannot find has an exit code, a count, an example and a fix.

use std::fs;
use std::process::Command;

use crate::lab::{ALL_VISIBLE, Lab};

/// Exit code and messages of a run of the usual pipeline.
fn run(lab: &Lab, args: &[&str]) -> (i32, String) {
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).unwrap();
    let usual = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out", "--progress", "none"];
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(usual)
        .args(args)
        .current_dir(lab.path(""))
        .output()
        .unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
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
    contains(&incomplete(&lab), &[
        "1 pattern of campaign.toml matches no file: [[captures]] number 2: files = \"raw/scenes/",
        "32 files match no rule of campaign.toml and are left out: raw/scene/s1_L1_P1_C1.trc",
        "Add a [[captures]] rule that takes them, or an [[exclude]] with the reason.",
        "`periscope check --campaign campaign` lists all.",
        "`patches`, `paper` came out empty",
    ]);
}

#[test]
fn missing_references_are_exit_code_3() {
    let lab = Lab::tiny();
    for entry in fs::read_dir(lab.campaign().join("raw/scene")).unwrap().flatten() {
        if entry.file_name().to_string_lossy().ends_with("_C2.trc") {
            fs::remove_file(entry.path()).unwrap();
        }
    }
    contains(&incomplete(&lab), &[
        "16 files are left out, since their reference is missing: raw/scene/s1_L1_P1_C1.trc (wanted raw/scene/",
        "Copy the reference files too, or correct `reference` in the [[captures]] rule.",
        "came out empty",
    ]);
}

/// One stray file among good ones: the result is whole, and the exit code says that the file is not in it.
#[test]
fn a_stray_file_is_exit_code_3_and_excluding_it_is_the_fix() {
    let lab = Lab::tiny();
    fs::write(lab.campaign().join("raw/notes.txt"), "shutter was slow").unwrap();
    let text = incomplete(&lab);
    contains(&text, &["1 file matches no rule of campaign.toml and is left out: raw/notes.txt"]);
    assert!(!text.contains("came out empty"), "{text}");
    let path = lab.campaign().join("campaign.toml");
    let exclude = "[[exclude]]\nmatch = { file = \"raw/notes.txt\" }\nreason = \"no recording\"\n";
    fs::write(&path, fs::read_to_string(&path).unwrap() + exclude).unwrap();
    assert_eq!(run(&lab, &["--strict"]), (0, String::new()));
}
