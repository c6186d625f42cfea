//! Mistakes of newcomers. The answer to each names the place and the fix. The snapshot has the whole texts.

mod list;

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use periscope::simulate::Format;

use crate::lab::{ALL_VISIBLE, Lab, TINY};
use list::{Edit, MISTAKES, Mistake};

impl Edit {
    fn apply(&self, folder: &Path) {
        match *self {
            Self::Replace(file, from, to) => {
                let text = fs::read_to_string(folder.join(file)).unwrap();
                assert!(text.contains(from), "{from} is not in {file}");
                fs::write(folder.join(file), text.replacen(from, to, 1)).unwrap();
            }
            Self::Append(file, text) => {
                let before = fs::read_to_string(folder.join(file)).unwrap();
                fs::write(folder.join(file), before + text).unwrap();
            }
            Self::Empty(of) => {
                fs::read_dir(folder.join(of)).unwrap().flatten().for_each(|file| fs::remove_file(file.path()).unwrap());
            }
            Self::Write(file, bytes) => fs::write(folder.join(file), bytes).unwrap(),
            Self::Cut(file, length) => {
                fs::File::options().write(true).open(folder.join(file)).unwrap().set_len(length).unwrap();
            }
            Self::Copy(from, to) => copy(&folder.join(from), &folder.join(to)),
            Self::Transpose(of) => {
                for file in fs::read_dir(folder.join(of)).unwrap().flatten() {
                    let codes = codes_of(&file.path());
                    let turned: Vec<i8> = (0..320).flat_map(|i| codes.chunks(320).map(move |shot| shot[i])).collect();
                    write_array(&file.path(), [320, codes.len() as u64 / 320], &turned);
                }
            }
            Self::Spoil(file) => {
                let mut volts: Vec<f32> = codes_of(&folder.join(file)).into_iter().map(f32::from).collect();
                volts.chunks_mut(320).for_each(|shot| shot[100] = f32::NAN);
                write_array(&folder.join(file), [volts.len() as u64 / 320, 320], &volts);
            }
        }
    }
}

/// The codes at the end of a simulated array of shots of 320 samples.
fn codes_of(file: &Path) -> Vec<i8> {
    let bytes = fs::read(file).unwrap();
    // The head's length stands in bytes 8 and 9.
    let head = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[head..].iter().map(|byte| *byte as i8).collect()
}

fn write_array<T: periscope::formats::npy::Number>(file: &Path, shape: [u64; 2], values: &[T]) {
    periscope::formats::npy::write(&mut fs::File::create(file).unwrap(), &shape, values).unwrap();
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Two campaigns of one scene, in scope files and in arrays; a pipeline and the scene.
fn lab() -> Lab {
    let lab = Lab::tiny();
    copy(&Lab::of(TINY, 1, Format::Npy).campaign(), &lab.path("arrays"));
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).unwrap();
    fs::write(lab.path("barcode.toml"), include_str!("../../pipelines/barcode.toml")).unwrap();
    fs::write(lab.path("scene.toml"), TINY).unwrap();
    lab
}

/// What the command prints to standard error, but for what it is doing.
fn answer(folder: &Path, command: &str) -> String {
    let periscope = env!("CARGO_BIN_EXE_periscope");
    let mut called = Command::new(periscope);
    called.args(command.split(' ')).current_dir(folder);
    if command.starts_with("run ") {
        called.args(["--progress", "none"]);
    }
    let output = called.output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let lines = text.lines().filter(|line| !line.is_empty());
    let code = output.status.code().unwrap();
    format!("[exit code {code}]\n{}", lines.collect::<Vec<_>>().join("\n"))
}

#[test]
fn every_mistake_is_reported_with_its_place_and_its_fix() {
    let lab = lab();
    lab.rows_of_patches("results");
    let mut all = String::new();
    for Mistake(edits, command, place, fix) in MISTAKES {
        let edited = tempfile::tempdir().unwrap();
        // What only reads, or is refused at once, needs no folder of its own.
        let folder = if edits.is_empty() && !command.contains("--out new") {
            lab.path("")
        } else {
            for part in ["campaign", "arrays"].iter().filter(|part| command.contains(**part)) {
                copy(&lab.path(part), &edited.path().join(part));
            }
            for file in ["pipeline.toml", "barcode.toml", "scene.toml"] {
                fs::copy(lab.path(file), edited.path().join(file)).unwrap();
            }
            edits.iter().for_each(|edit| edit.apply(edited.path()));
            edited.path().to_owned()
        };
        let answer = answer(&folder, command);
        assert!(
            answer.contains(place) && answer.contains(fix),
            "{command}: {place} and {fix} were expected in\n{answer}"
        );
        assert!(!answer.contains("panicked") && !answer.contains("defect"), "{answer}");
        edits.iter().for_each(|edit| writeln!(all, "# {edit:?}").unwrap());
        writeln!(all, "$ periscope {command}\n{answer}\n").unwrap();
    }
    assert!(MISTAKES.len() >= 40, "{}", MISTAKES.len());
    insta::assert_snapshot!("mistakes", all);
}

/// Results within the campaign are no raw files of it.
#[test]
fn results_may_lie_in_the_campaign_folder() {
    let lab = lab();
    let command = "run pipeline.toml --campaign campaign --out campaign/results";
    for _ in 0..2 {
        assert_eq!(answer(&lab.path(""), command), "[exit code 0]\n");
    }
}
