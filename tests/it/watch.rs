//! `run --watch`: files that come while it runs join later passes, and in the end its tables are those of one run.

use std::fs;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use periscope::pipeline::run::Settings;

use crate::lab::{ALL_VISIBLE, Lab};

#[test]
fn what_comes_later_joins_and_nothing_else_is_left_in_the_end() {
    let lab = Lab::tiny();
    let raw = lab.campaign().join("raw/scene");
    let later = lab.path("later");
    fs::create_dir(&later).unwrap();
    let mut files: Vec<_> = fs::read_dir(&raw).unwrap().flatten().map(|entry| entry.file_name()).collect();
    files.sort();
    let late = &files[files.len() / 2..];
    late.iter().for_each(|file| fs::rename(raw.join(file), later.join(file)).unwrap());
    fs::write(lab.path("all-visible.toml"), ALL_VISIBLE).unwrap();

    let following = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "all-visible.toml", "--campaign", "campaign", "--out", "followed", "--watch", "--idle", "4"])
        .current_dir(lab.path(""))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first pass begins when the campaign's files are two seconds old.
    thread::sleep(Duration::from_secs(4));
    late.iter().for_each(|file| fs::rename(later.join(file), raw.join(file)).unwrap());
    // Half of a file, which is not read before it is whole.
    let half = raw.join(files[0].to_str().unwrap().replace("L1_P1", "L1_P5"));
    let whole = fs::read(raw.join(&files[0])).unwrap();
    fs::write(&half, &whole[..whole.len() / 2]).unwrap();
    thread::sleep(Duration::from_secs(1));
    fs::remove_file(&half).unwrap();

    let done = following.wait_with_output().unwrap();
    let (out, said) = (String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
    assert!(done.status.success(), "{said}");
    assert!(said.contains("pass 2: "), "{said}");
    assert!(out.contains("patches"), "{out}");
    lab.run("once", ALL_VISIBLE, &Settings::default()).unwrap();
    assert_eq!(lab.parts("followed"), lab.parts("once"), "{said}");
}
