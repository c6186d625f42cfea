//! What happens when a system call fails: each of a command's calls in turn, from the loader's first to the last, by
//! `strace` and its faults. Each must end in a message, or do without what failed; then the same command on the sound
//! system must leave what an undisturbed one leaves.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use periscope::simulate::{self, Format, Scene};

/// Calls that are made to fail, each with the error that it most likely has. Not `close`, `munmap` and what only tells
/// the time or the process: their failure tells nothing, or cannot happen.
const CALLS: [(&str, &str); 30] = [
    ("open", "EIO"),
    ("openat", "EIO"),
    ("read", "EIO"),
    ("pread64", "EIO"),
    ("write", "ENOSPC"),
    ("writev", "ENOSPC"),
    ("pwrite64", "ENOSPC"),
    ("fsync", "EIO"),
    ("fdatasync", "EIO"),
    ("rename", "EIO"),
    ("renameat2", "EIO"),
    ("unlink", "EIO"),
    ("unlinkat", "EIO"),
    ("mkdir", "ENOSPC"),
    ("rmdir", "EIO"),
    ("link", "EIO"),
    ("linkat", "EIO"),
    ("symlink", "ENOSPC"),
    ("symlinkat", "ENOSPC"),
    ("readlink", "EIO"),
    ("stat", "EIO"),
    ("newfstatat", "EIO"),
    ("fstat", "EIO"),
    ("lstat", "EIO"),
    ("statx", "EIO"),
    ("getdents64", "EIO"),
    ("lseek", "EIO"),
    ("flock", "EIO"),
    ("mmap", "ENOMEM"),
    ("clone3", "EAGAIN"),
];
const PIPELINE: &str = "[calibration_traces]\nstage = 'ingest'\nparams = { roles = ['response'] }\n\
    [calibration]\nstage = 'calibrate'\nfrom = 'calibration_traces'\n\
    [traces]\nstage = 'ingest'\n\
    [profiles]\nstage = 'average'\nfrom = 'traces'\nwith = { calibration = 'calibration' }\n";

/// A command, the folder in which it starts, and what it writes.
struct Case {
    name: &'static str,
    arguments: &'static [&'static str],
    state: &'static str,
    /// What must succeed afterwards.
    check: &'static [&'static str],
}

const RUN: &[&str] = &["run", "test.toml", "--campaign", "campaign", "--out", "out", "--threads", "1"];
const VERIFY: &[&str] = &["verify", "out"];
const SEAL: &[&str] = &["seal", "campaign"];
const SEALED: &[&str] = &["verify", "campaign"];
const CASES: [Case; 7] = [
    Case { name: "run", arguments: RUN, state: "nothing", check: VERIFY },
    Case { name: "run, nothing to do", arguments: RUN, state: "solved", check: VERIFY },
    Case { name: "report", arguments: &["report", "out"], state: "solved", check: VERIFY },
    Case { name: "export", arguments: &["export", "out", "patches.ply"], state: "solved", check: VERIFY },
    Case { name: "verify", arguments: VERIFY, state: "solved", check: VERIFY },
    // The run makes again what the repair took away.
    Case { name: "verify --repair", arguments: &["verify", "--repair", "out"], state: "damaged", check: RUN },
    Case { name: "seal", arguments: SEAL, state: "nothing", check: SEALED },
];

/// How faults of one command ended.
#[derive(Debug, Default)]
struct Row {
    faults: usize,
    /// The command did what it does, and said that it had.
    unharmed: usize,
    /// Exit code 1 with a message.
    errors: usize,
    /// Before the program had begun, with a message of the loader.
    before: usize,
    /// No memory for the program itself, or no thread: ended at once, with a message.
    ended: usize,
    /// The command said that it had done what it does, and had not; or it broke.
    wrong: usize,
    /// The next run left what an undisturbed one leaves.
    same: usize,
}

impl Row {
    fn breaks(&mut self, how: &str) {
        self.wrong += 1;
        eprintln!("{how}");
    }
}

/// A report of which a call failed has all its tables, or ends with an error.
#[test]
fn a_report_is_whole_or_an_error() {
    if !has_strace() {
        return eprintln!("NOT TESTED: there is no strace");
    }
    let report = CASES.iter().find(|case| case.name == "report").expect("it is among them");
    let row = Bench::new().faults(report, 97);
    assert!(row.faults >= 10 && row.wrong == 0 && row.same == row.faults, "{row:?}");
}

fn has_strace() -> bool {
    Command::new("strace").arg("-V").output().is_ok()
}

/// `system-calls N`: each N-th call of each command.
pub fn study(numbers: &[usize]) {
    let step = numbers.first().copied().unwrap_or(1);
    if !has_strace() {
        return println!("system calls: not tried, there is no strace");
    }
    let bench = Bench::new();
    println!(
        "| command | faults | without consequence | ended with an error | out of memory | before the program began | wrong | the next run: the same |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for case in &CASES {
        let row = bench.faults(case, step);
        let Row { faults, unharmed, errors, before, ended, wrong, same } = row;
        println!(
            "| `{}` | {faults} | {unharmed} | {errors} | {ended} | {before} | {wrong} | {same} of {faults} |",
            case.name
        );
    }
}

/// A campaign and its results, and a place to work.
struct Bench {
    folder: tempfile::TempDir,
    /// Calls of `mmap` before the program does anything: of the loader and the allocator.
    first_mmaps: usize,
}

impl Bench {
    fn new() -> Self {
        let mut bench = Self { folder: tempfile::tempdir().expect("a folder for the campaign"), first_mmaps: 0 };
        bench.first_mmaps = bench.calls_of_version("mmap");
        let scene = include_str!("../../pipelines/scenes/tiny.toml");
        let scene = Scene::parse(Path::new("scene.toml"), scene).expect("a scene of the program");
        let nothing = bench.path("nothing");
        fs::create_dir(&nothing).expect("a folder");
        simulate::simulate(&scene, 1, &nothing.join("campaign"), Format::Trc).expect("a campaign");
        fs::write(nothing.join("test.toml"), PIPELINE).expect("a pipeline");
        bench.copy("nothing", "solved");
        assert!(bench.plain("solved", RUN).status.success());
        let scene = ["run", "scene", "--campaign", "campaign", "--out", "out", "--progress", "none"];
        assert!(bench.plain("solved", &scene).status.success());
        assert!(bench.plain("solved", RUN).status.success());
        bench.copy("solved", "damaged");
        let files = bench.files("damaged");
        let part = files.keys().find(|path| path.to_string_lossy().ends_with("profiles.parquet")).expect("a part");
        let part = bench.path("damaged").join(part);
        let mut bytes = fs::read(&part).expect("a part");
        bytes[100] ^= 1;
        fs::write(&part, bytes).expect("a part");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Calls that the program makes to print its version.
    fn calls_of_version(&self, call: &str) -> usize {
        let log = self.path("log");
        let traced = Command::new("strace")
            .args(["-f", "-qq", "-o", &log.to_string_lossy(), "-e", &format!("trace={call}")])
            .args([env!("CARGO_BIN_EXE_periscope"), "--version"])
            .output();
        assert!(traced.expect("strace is there").status.success());
        fs::read_to_string(log).expect("the log").lines().count()
    }

    /// Copies a state with its times; replaces one that is there.
    fn copy(&self, from: &str, to: &str) {
        let _ = fs::remove_dir_all(self.path(to));
        let copied = Command::new("cp").arg("-a").args([self.path(from), self.path(to)]).status();
        assert!(copied.expect("cp is there").success());
    }

    /// The program in a folder.
    fn plain(&self, folder: &str, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
        command.args(arguments).current_dir(self.path(folder)).output().expect("the program was built")
    }

    /// The program with one call that fails, in `work`; `None` if it made fewer calls.
    fn failing(&self, case: &Case, (call, error): (&str, &str), at: usize) -> Option<Output> {
        let log = self.path("log");
        let output = Command::new("strace")
            .args(["-f", "-qq", "-o", &log.to_string_lossy(), "-e", &format!("trace={call}")])
            .args(["-e", &format!("inject={call}:error={error}:when={at}"), env!("CARGO_BIN_EXE_periscope")])
            .args(case.arguments)
            .env("RAYON_NUM_THREADS", "1")
            .current_dir(self.path("work"))
            .output()
            .expect("strace is there");
        fs::read_to_string(log).expect("the log").contains("(INJECTED)").then_some(output)
    }

    /// What a reader finds: tables, the page, the cloud. Names and digests.
    fn files(&self, folder: &str) -> BTreeMap<PathBuf, blake3::Hash> {
        let mut files = BTreeMap::new();
        let mut folders = vec![self.path(folder)];
        while let Some(next) = folders.pop() {
            for entry in fs::read_dir(&next).expect("a folder").flatten() {
                let path = entry.path();
                let is_result = ["parquet", "html", "ply"].iter().any(|end| path.extension() == Some(end.as_ref()));
                if path.is_dir() {
                    folders.push(path);
                } else if is_result {
                    let name = path.strip_prefix(self.path(folder)).expect("below it").to_owned();
                    files.insert(name, blake3::hash(&fs::read(&path).expect("a result")));
                }
            }
        }
        files
    }

    /// The command, undisturbed, and the check of what it left.
    fn again(&self, case: &Case) -> BTreeMap<PathBuf, blake3::Hash> {
        self.plain("work", case.arguments);
        self.checked(case)
    }

    /// What a command left; nothing if its check does not pass.
    fn checked(&self, case: &Case) -> BTreeMap<PathBuf, blake3::Hash> {
        if self.plain("work", case.check).status.success() { self.files("work") } else { BTreeMap::new() }
    }

    fn faults(&self, case: &Case, step: usize) -> Row {
        self.copy(case.state, "work");
        let expected = self.again(case);
        let mut row = Row::default();
        for call in CALLS {
            for at in (1..).step_by(step) {
                self.copy(case.state, "work");
                let Some(output) = self.failing(case, call, at) else { break };
                row.faults += 1;
                let fault = format!("{} {at} of {}", call.0, case.name);
                if output.status.code().is_none() && call.0 == "mmap" && at <= self.first_mmaps {
                    row.before += 1;
                } else {
                    self.judge(case, &fault, &output, &expected, &mut row);
                }
                let is_same = self.again(case) == expected;
                row.same += usize::from(is_same);
                if !is_same {
                    eprintln!("NOT THE SAME AFTER {fault}: {}", String::from_utf8_lossy(&output.stderr));
                }
            }
        }
        row
    }

    fn judge(
        &self,
        case: &Case,
        fault: &str,
        output: &Output,
        expected: &BTreeMap<PathBuf, blake3::Hash>,
        row: &mut Row,
    ) {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().last().unwrap_or_default();
        let finds = case.name.starts_with("verify") && !output.stdout.is_empty();
        match output.status.code() {
            Some(0) if self.checked(case) == *expected => row.unharmed += 1,
            Some(0) => row.breaks(&format!("{fault}: said nothing: {said}")),
            // What `verify` finds stands on standard output.
            Some(1) if said.contains("error: ") || finds => row.errors += 1,
            Some(127) if last.contains("shared librar") => row.before += 1,
            None if said.contains("memory allocation") => row.ended += 1,
            code => row.breaks(&format!("{fault}: ended with {code:?}: {said}")),
        }
    }
}
