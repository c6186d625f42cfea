//! Shards: many processes make parts of one result folder, some die, and its bytes are those of a single run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;
use std::time::Duration;

use periscope::store::Shelf;
use serde_json::Value;

use crate::many_parts::{ManyParts, errors};

/// Seven visible patches and a hidden one: 28 pairs, each a part of its own.
const PATCHES: [i32; 8] = [1, 2, 3, 4, 5, 6, 7, 9];

fn lab() -> ManyParts {
    ManyParts::of(&PATCHES, 1)
}

/// The program in the folder of a campaign.
fn periscope(lab: &ManyParts, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
    command.args(args).current_dir(lab.path("")).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn output(lab: &ManyParts, args: &[&str]) -> Output {
    periscope(lab, args).output().unwrap()
}

/// What it prints; it must end well.
fn printed(lab: &ManyParts, args: &[&str]) -> String {
    let output = output(lab, args);
    assert!(output.status.success(), "{args:?}: {}", errors(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn refused(lab: &ManyParts, args: &[&str]) -> String {
    let output = output(lab, args);
    assert_eq!(output.status.code(), Some(1), "{args:?}");
    errors(&output)
}

/// Plans shards into a result folder: their lines by key.
fn plan(lab: &ManyParts, out: &str, count: &str, more: &[&str]) -> BTreeMap<String, Value> {
    let args = ["plan", "pipeline.toml", "--campaign", "campaign", "--out", out, "--shards", count, "--format", "json"];
    let lines: Vec<Value> = serde_json::from_str(&printed(lab, &[&args[..], more].concat())).unwrap();
    lines.into_iter().map(|line| (line["key"].as_str().unwrap().to_owned(), line)).collect()
}

fn shard<'a>(key: &'a str, out: &'a str) -> [&'a str; 6] {
    ["run-shard", key, "--out", out, "--threads", "1"]
}

/// Runs these shards one after the other, each from another folder than that of the plan: their lines.
fn run_all<'a>(lab: &ManyParts, keys: impl IntoIterator<Item = &'a String>, out: &str) -> Vec<Value> {
    let out = lab.path(out).display().to_string();
    let line = |key: &String| {
        let output = periscope(lab, &shard(key, &out)).current_dir("/").output().unwrap();
        assert!(output.status.success(), "{}", errors(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    keys.into_iter().map(line).collect()
}

#[test]
fn three_workers_one_killed_at_a_third_leave_the_bytes_of_a_single_run() {
    let lab = lab();
    assert!(lab.run("single").status.success());
    let lines = plan(&lab, "out", "28", &[]);
    assert_eq!(lines.len(), 28);
    let is_stir = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().contains(".stir."));
    assert!(!lab.finished("out").keys().any(is_stir), "who plans averages nothing of the scene");
    let captures: u64 = lines.values().map(|line| line["captures"].as_u64().unwrap()).sum();
    let inputs: BTreeSet<&str> =
        lines.values().flat_map(|line| line["inputs"].as_array().unwrap()).map(|file| file.as_str().unwrap()).collect();
    assert_eq!((captures, inputs.len()), (49, 98), "each capture once, with the file of its reference");
    let queue: Mutex<Vec<&String>> = Mutex::new(lines.keys().collect());
    let killed = Mutex::new(Vec::new());
    let work = || {
        while let Some(key) = { queue.lock().unwrap().pop() } {
            let mut child = periscope(&lab, &shard(key, "out")).spawn().unwrap();
            let is_victim = queue.lock().unwrap().len() < 19 && killed.lock().unwrap().is_empty();
            if is_victim {
                killed.lock().unwrap().push(key);
                std::thread::sleep(Duration::from_millis(20));
                child.kill().unwrap();
            }
            let ended = child.wait_with_output().unwrap();
            if !ended.status.success() {
                // What an engine does: the task is run again.
                queue.lock().unwrap().push(key);
            }
        }
    };
    std::thread::scope(|scope| (0..3).for_each(|_| drop(scope.spawn(work))));
    assert_eq!(killed.lock().unwrap().len(), 1);
    assert!(!lab.path("out/onsets").exists(), "nothing is shown before it is gathered");
    let text = printed(&lab, &["gather", "--out", "out"]);
    assert!(text.contains("patches") && text.contains("out/patches"), "{text}");
    assert_eq!(lab.files("out"), lab.files("single"));
    assert!(lab.left_over("out").is_empty(), "{:?}", lab.left_over("out"));
    printed(&lab, &["verify", "out"]);
    // The run that was planned is the run that ended; what it ran is known, and nothing is left to do.
    let runs = Shelf::look(&lab.path("out")).unwrap().runs().unwrap();
    assert!(runs.len() == 1 && runs[0].ended.is_some() && runs[0].tables.contains_key("onsets"), "{runs:?}");
    // An engine that asks again for what is done is not refused, and nothing is done.
    let (files, again) = (lab.files("out"), output(&lab, &["gather", "--out", "out"]));
    assert!(again.status.success() && errors(&again).contains("nothing to do"), "{}", errors(&again));
    for key in lines.keys() {
        let again = output(&lab, &shard(key, "out"));
        assert!(again.status.success() && errors(&again).contains("nothing to do"), "{}", errors(&again));
    }
    assert_eq!((lab.files("out"), lab.path("out/.shelf/shards/job.json").exists()), (files, false));
    assert!(!printed(&lab, &["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"]).contains("computed"));
}

#[test]
fn what_is_finished_is_not_made_again_and_two_may_make_the_same_shard() {
    let lab = lab();
    let first = plan(&lab, "out", "7", &[]);
    let done: Vec<&String> = first.keys().take(3).collect();
    let made = run_all(&lab, done.clone(), "out");
    assert!(made.iter().all(|line| line["computed"] == line["parts"] && line["rejects"] == 0), "{made:?}");
    let finished = lab.finished("out");
    let again = run_all(&lab, done, "out");
    for (made, again) in made.iter().zip(&again) {
        let mut expected = made.clone();
        expected["computed"] = 0.into();
        assert_eq!(*again, expected);
    }
    // The engine is gone, and the job is submitted again.
    let second = plan(&lab, "out", "7", &[]);
    let inputs = |lines: &BTreeMap<String, Value>| {
        lines.values().map(|line| line["inputs"].as_array().unwrap().len()).sum::<usize>()
    };
    assert!(inputs(&second) < inputs(&first), "{second:?}");
    assert!(refused(&lab, &shard(first.keys().next().unwrap(), "out")).contains("planned anew"));
    std::thread::scope(|scope| {
        (0..2).for_each(|_| drop(scope.spawn(|| run_all(&lab, second.keys(), "out"))));
    });
    printed(&lab, &["gather", "--out", "out"]);
    assert_eq!(lab.written_again(&finished, "out"), 0);
    assert!(lab.run("single").status.success());
    assert_eq!(lab.files("out"), lab.files("single"));
    assert_eq!(plan(&lab, "out", "7", &[]).len(), 0, "nothing is left to deal out");
}

#[test]
fn raw_traces_that_are_not_kept_other_parameters_seals_and_rejects() {
    let lab = lab();
    let broken = lab.path("campaign/raw/scene/s1_L2_P3_C1.trc");
    let bytes = fs::read(&broken).unwrap();
    fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    printed(&lab, &["seal", "campaign"]);
    let set = ["--set", "traces.keep=false"];
    let other = ["--set", "traces.keep=false", "--set", "profiles.outlier_sigma=7"];
    for (more, parts) in [(&set[..], 28), (&other[..], 28)] {
        let lines = plan(&lab, "out", "5", more);
        let made = run_all(&lab, lines.keys(), "out");
        assert!(lines.len() == 5 && made.len() == 5);
        assert!(made.iter().map(|line| line["parts"].as_u64().unwrap()).sum::<u64>() >= parts);
        let gathered = output(&lab, &["gather", "--out", "out", "--progress", "none"]);
        assert_eq!(gathered.status.code(), Some(3), "{}", errors(&gathered));
        assert!(errors(&gathered).contains("1 record was rejected"), "{}", errors(&gathered));
        let run = [&["run", "pipeline.toml", "--campaign", "campaign", "--out", "single"], more].concat();
        assert_eq!(output(&lab, &run).status.code(), Some(3));
        assert_eq!(lab.files("out"), lab.files("single"));
    }
}

#[test]
fn faults_are_reported_with_their_fix() {
    let lab = lab();
    assert!(refused(&lab, &["gather", "--out", "none"]).contains("does not exist"));
    assert!(refused(&lab, &shard("0123456789abcdef", "none")).contains("does not exist"));
    let lines = plan(&lab, "out", "4", &["--until", "onsets"]);
    for key in ["0123456789abcdef", "../job", "job"] {
        let text = refused(&lab, &shard(key, "out"));
        assert!(text.contains(&format!("out has no shard {key}")) && text.contains("--shards N"), "{text}");
    }
    let keys: Vec<&String> = lines.keys().collect();
    run_all(&lab, keys[..3].iter().copied(), "out");
    let text = refused(&lab, &["gather", "--out", "out"]);
    assert!(text.contains("parts of traces are missing: 1 shards are not finished"), "{text}");
    assert!(text.contains(&format!("run-shard {} --out", keys[3])), "{text}");
    // Another campaign.toml makes other parts.
    let file = lab.path("campaign/campaign.toml");
    let keys_of_campaign = fs::read_to_string(&file).unwrap();
    fs::write(&file, keys_of_campaign.replacen("[campaign]\n", "[campaign]\nrepetition_ps = 1e6\n", 1)).unwrap();
    let text = refused(&lab, &shard(keys[3], "out"));
    assert!(text.contains("planned and made here differ") && text.contains("repetition_ps"), "{text}");
    fs::write(&file, keys_of_campaign).unwrap();
    // A raw file that changed since.
    let raw = lines[keys[3]]["inputs"][0].as_str().unwrap();
    run_all(&lab, keys[3..].iter().copied(), "out");
    let mut bytes = fs::read(raw).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(raw, bytes).unwrap();
    let text = refused(&lab, &shard(keys[3], "out"));
    assert!(text.contains("changed since they were first read") && text.contains(raw), "{text}");
}

#[test]
fn a_run_and_shards_do_not_write_at_the_same_time() {
    let lab = lab();
    let lines = plan(&lab, "out", "2", &[]);
    let key = lines.keys().next().unwrap();
    {
        let _run = Shelf::open(&lab.path("out")).unwrap();
        let text = refused(&lab, &shard(key, "out"));
        assert!(text.contains("another run is writing to out (process"), "{text}");
    }
    let _shard = Shelf::join(&lab.path("out")).unwrap();
    let text = refused(&lab, &["gather", "--out", "out"]);
    assert!(text.contains("shards are being computed into out (the last began as process"), "{text}");
    run_all(&lab, [key], "out");
}
