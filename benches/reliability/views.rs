//! Manipulations of views, copies and archives, counted: how many `verify` passes.

use std::fs;
use std::path::Path;
use std::process::Command;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::lab::{ALL_VISIBLE, Lab};
use crate::manipulations::{MANIPULATIONS, copy};
use crate::score::Rate;

/// Ways to copy a result folder `out` to `copied`, in a shell.
const COPIES: [(&str, &str); 5] = [
    ("cp -r", "cp -rP out copied"),
    ("cp -rL", "cp -rL out copied"),
    ("tar", "mkdir copied && tar -C out -cf - . | tar -C copied -xf -"),
    ("tar -h", "mkdir copied && tar -C out -chf - . | tar -C copied -xf -"),
    ("zip", "(cd out && python3 -m zipfile -c ../a.zip .shelf *) && python3 -m zipfile -e a.zip copied && rm a.zip"),
];

/// `numbers`: how many manipulations of each kind, and copies of each kind.
pub fn study(numbers: &[usize]) {
    let each = numbers.first().copied().unwrap_or(20);
    let lab = Lab::tiny();
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).expect("the pipeline");
    let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
    assert_eq!(periscope(&lab, &run), Some(0));
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    println!("| manipulation | draws | found by `verify` [95 %] |\n|---|---|---|");
    let mut all = Vec::new();
    for (name, is_followed, change) in MANIPULATIONS {
        let found: Vec<bool> = (0..each)
            .map(|_| {
                clear(&lab);
                copy(&lab.path("out"), &lab.path("copied"), is_followed);
                change(&lab.path("copied"), &mut rng);
                periscope(&lab, &["verify", "copied"]) == Some(1)
            })
            .collect();
        let rate = Rate::of(found.iter().copied());
        println!("| {name} | {each} | {} = {rate} |", rate.hits);
        all.extend(found);
    }
    let rate = Rate::of(all.iter().copied());
    println!("| all | {} | {} = {rate} |", all.len(), rate.hits);
    println!("\n| copied with | copies | `verify` finds nothing | `run` computes nothing |\n|---|---|---|---|");
    for (name, script) in COPIES {
        let outcomes: Vec<(bool, bool)> = (0..each.min(10))
            .map(|_| {
                clear(&lab);
                let copied = Command::new("sh").args(["-ec", script]).current_dir(lab.path("")).status();
                assert!(copied.expect("a shell").success(), "{name}");
                let is_clean = periscope(&lab, &["verify", "copied"]) == Some(0);
                let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "copied", "--format", "json"];
                let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(run).current_dir(lab.path("")).output();
                let output = output.expect("the program was built");
                let is_reused =
                    output.status.success() && !String::from_utf8_lossy(&output.stdout).contains("computed");
                (is_clean, is_reused)
            })
            .collect();
        let [clean, reused] = [Rate::of(outcomes.iter().map(|o| o.0)), Rate::of(outcomes.iter().map(|o| o.1))];
        println!("| {name} | {} | {} | {} |", outcomes.len(), clean.hits, reused.hits);
    }
}

/// Removes what the last draw left beside the result folder.
fn clear(lab: &Lab) {
    for name in ["copied", "elsewhere", "aside"] {
        let path = lab.path(name);
        if path.exists() {
            remove(&path);
        }
    }
}

fn remove(path: &Path) {
    fs::remove_dir_all(path).expect("a folder of this study");
}

/// Exit code of the program.
fn periscope(lab: &Lab, args: &[&str]) -> Option<i32> {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(lab.path("")).output();
    output.expect("the program was built").status.code()
}
