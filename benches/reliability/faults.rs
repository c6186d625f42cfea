//! Faults of disks, files and permissions: each must end in a message, and leave a folder into which the next run gives
//! the bytes of an undisturbed run.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;

use crate::many_parts::{ManyParts, PIPELINE, errors};
use crate::score::Rate;

/// A raw file in the middle of the campaign.
const RAW_FILE: &str = "campaign/raw/scene/s1_L2_P4_C1.trc";

/// The campaign, and the files of an undisturbed run.
struct Bench {
    lab: ManyParts,
    whole: BTreeMap<PathBuf, blake3::Hash>,
}

/// `faults`.
pub fn study(_: &[usize]) {
    let lab = ManyParts::new();
    let run = lab.run("reference");
    assert_eq!(run.status.code(), Some(0), "{}", errors(&run));
    let whole = lab.files("reference");
    let bench = Bench { lab, whole };
    println!("\n| fault | what is said | exit code | the next run |\n|---|---|---|---|");
    bench.full_disk();
    bench.read_only_disk();
    bench.limited_files();
    bench.no_permission();
    bench.raw_files();
    bench.raw_file_that_goes();
    bench.raw_file_that_grows();
    bench.in_the_way();
}

impl Bench {
    fn out(&self) -> PathBuf {
        let out = self.lab.path("out");
        let _ = fs::remove_dir_all(&out);
        out
    }

    /// A line of the table: the message, and whether all is well once the fault is fixed.
    fn row(&self, fault: &str, code: Option<i32>, said: &str, out: &str) {
        let next = self.lab.run(out);
        let is_same = next.status.code() == Some(0) && shown(self.lab.files(out)) == shown(self.whole.clone());
        let state = match (is_same, self.lab.left_over(out).is_empty()) {
            (true, true) => "same bytes".to_owned(),
            (true, false) => "same bytes, half-written files left".to_owned(),
            _ => format!("NOT THE SAME: {}", errors(&next).lines().last().unwrap_or_default()),
        };
        let code = code.map_or("-".to_owned(), |code| code.to_string());
        let said = said.replace(&format!("{}/", self.lab.path("").display()).replace("//", "/"), "");
        println!("| {fault} | {said} | {code} | {state} |");
    }

    fn row_of(&self, fault: &str, run: &Output, out: &str) {
        self.row(fault, run.status.code(), &last_line(run), out);
    }

    /// Disks too small by more or less.
    fn full_disk(&self) {
        let disk = self.lab.path("disk");
        fs::create_dir_all(&disk).unwrap();
        let need: u64 = self.lab.finished("reference").keys().map(|path| fs::metadata(path).unwrap().len()).sum();
        let (mut explained, mut same, mut of) = (0, 0, 0);
        let mut example = None;
        for percent in [1, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 99] {
            if !mount(&["-t", "tmpfs", "-o", &format!("size={}", need * percent / 100), "tmpfs"], &disk) {
                println!("| full disk | - | - | not tried: this user cannot mount |");
                return;
            }
            let run = self.lab.run("disk/out");
            of += 1;
            let said = last_line(&run);
            let is_explained = said.contains("free some space") || said.contains("the disk is not full");
            explained += usize::from(run.status.code() == Some(1) && is_explained);
            assert!(mount(&["-o", &format!("remount,size={}", 10 * need)], &disk));
            let next = self.lab.run("disk/out");
            same += usize::from(
                next.status.code() == Some(0)
                    && self.lab.files("disk/out") == self.whole
                    && self.lab.left_over("disk/out").is_empty(),
            );
            example.get_or_insert(last_line(&run));
            unmount(&disk);
        }
        let said =
            example.unwrap_or_default().replace(&format!("{}/", self.lab.path("").display()).replace("//", "/"), "");
        println!(
            "| full disk, at {of} sizes | {said} ({explained} of {of}) | 1 | same bytes: {} |",
            Rate { hits: same, of }
        );
    }

    fn read_only_disk(&self) {
        let disk = self.lab.path("disk");
        if !mount(&["-t", "tmpfs", "tmpfs"], &disk) || !mount(&["-o", "remount,ro"], &disk) {
            println!("| read-only disk | - | - | not tried: this user cannot mount |");
            return;
        }
        let run = self.lab.run("disk/out");
        assert!(mount(&["-o", "remount,rw"], &disk));
        self.row_of("read-only disk", &run, "disk/out");
        unmount(&disk);
    }

    /// A limit on the size of a file, as quotas have; the signal that comes with it is ignored.
    fn limited_files(&self) {
        self.out();
        let mut shell = Command::new("sh");
        shell.args(["-c", "trap '' XFSZ; ulimit -f 300; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_periscope")]);
        self.lab.arguments(&mut shell, "out", "100kB");
        self.row_of("no file beyond 150 kB", &shell.output().unwrap(), "out");
    }

    /// Files that the user may not read, and a folder that he may not write. Root may do everything, so the program
    /// runs as user `nobody`.
    fn no_permission(&self) {
        let nobody = |out: &str| {
            let mut command = Command::new("setpriv");
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups", env!("CARGO_BIN_EXE_periscope")]);
            self.lab.arguments(&mut command, out, "100kB");
            command.output()
        };
        let allow = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        allow(&self.lab.path(""), 0o755);
        let (out, raw) = (self.out(), self.lab.path(RAW_FILE));
        fs::create_dir(&out).unwrap();
        match nobody("out") {
            Ok(run) if run.status.code() == Some(1) => self.row_of("result folder may not be written", &run, "out"),
            _ => return println!("| permissions | - | - | not tried: no setpriv, or not root |"),
        }
        let out = self.out();
        fs::create_dir(&out).unwrap();
        allow(&out, 0o777);
        allow(&raw, 0o000);
        let run = nobody("out").unwrap();
        allow(&raw, 0o644);
        self.row_of("raw file may not be read", &run, "out");
    }

    /// Something else where a raw file was.
    fn raw_files(&self) {
        let (raw, aside) = (self.lab.path(RAW_FILE), self.lab.path("aside"));
        let replaced = |fault: &str, replace: &dyn Fn(&Path)| {
            self.out();
            fs::rename(&raw, &aside).unwrap();
            replace(&raw);
            let run = self.lab.run("out");
            if raw.is_dir() { fs::remove_dir(&raw) } else { fs::remove_file(&raw) }.unwrap();
            fs::rename(&aside, &raw).unwrap();
            self.row_of(fault, &run, "out");
        };
        replaced("read error in a raw file", &|path| symlink("/proc/self/mem", path).unwrap());
        replaced("directory in a raw file's place", &|path| fs::create_dir(path).unwrap());
        replaced("pipe in a raw file's place", &|path| {
            assert!(Command::new("mkfifo").arg(path).status().unwrap().success())
        });
    }

    /// In this process, between survey and reading.
    fn raw_file_that_goes(&self) {
        let out = self.out();
        let (raw, aside) = (self.lab.path(RAW_FILE), self.lab.path("aside"));
        let spec = Spec::parse("pipeline.toml", PIPELINE, &[]).unwrap();
        let campaigns = [Campaign::load(&self.lab.path("campaign")).unwrap()];
        let shelf = Shelf::open(&out).unwrap();
        let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
        fs::rename(&raw, &aside).unwrap();
        let error = run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap_err();
        fs::rename(&aside, &raw).unwrap();
        drop(plan);
        drop(shelf);
        self.row(
            "raw file that vanishes after the survey",
            Some(1),
            &format!("error: {:#}", anyhow::Error::from(error)),
            "out",
        );
    }

    fn raw_file_that_grows(&self) {
        self.out();
        let (raw, aside) = (self.lab.path(RAW_FILE), self.lab.path("aside"));
        fs::copy(&raw, &aside).unwrap();
        let is_over = AtomicBool::new(false);
        let run = std::thread::scope(|scope| {
            let mut file = OpenOptions::new().append(true).open(&raw).unwrap();
            let is_over = &is_over;
            scope.spawn(move || {
                while !is_over.load(Ordering::Relaxed) {
                    file.write_all(b"more").unwrap();
                    std::thread::sleep(Duration::from_micros(200));
                }
            });
            // In pieces of 1 kB, so that reading the file takes its time.
            let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
            self.lab.arguments(&mut command, "out", "1kB");
            let run = command.output().unwrap();
            is_over.store(true, Ordering::Relaxed);
            run
        });
        let bytes = fs::metadata(&aside).unwrap().len();
        OpenOptions::new().write(true).open(&raw).unwrap().set_len(bytes).unwrap();
        fs::remove_file(&aside).unwrap();
        self.row_of("raw file that grows while it is read", &run, "out");
    }

    /// Something else where the shelf puts its own.
    fn in_the_way(&self) {
        let part = self
            .whole
            .keys()
            .find(|path| path.starts_with(".shelf") && path.to_string_lossy().contains(".profiles.parquet"));
        let part = part.unwrap().to_str().unwrap();
        for (fault, place) in [
            ("directory where the lock belongs", ".shelf/lock"),
            ("directory where a view belongs", "onsets"),
            ("directory where a part belongs", part),
        ] {
            let out = self.out();
            fs::create_dir_all(out.join(".shelf")).unwrap();
            fs::create_dir_all(out.join(place).join("thesis")).unwrap();
            let run = self.lab.run("out");
            fs::remove_dir_all(out.join(place)).unwrap();
            self.row_of(fault, &run, "out");
        }
        let out = self.out();
        fs::create_dir(&out).unwrap();
        File::create(out.join(".shelf")).unwrap();
        let run = self.lab.run("out");
        fs::remove_file(out.join(".shelf")).unwrap();
        self.row_of("file where the shelf belongs", &run, "out");
    }
}

/// What the views show: the shelf may hold more, of a run that took another campaign for whole.
fn shown(files: BTreeMap<PathBuf, blake3::Hash>) -> BTreeMap<PathBuf, blake3::Hash> {
    files.into_iter().filter(|(path, _)| !path.starts_with(".shelf")).collect()
}

fn last_line(run: &Output) -> String {
    errors(run).lines().last().unwrap_or("nothing").to_owned()
}

fn mount(options: &[&str], folder: &Path) -> bool {
    Command::new("mount").args(options).arg(folder).output().is_ok_and(|output| output.status.success())
}

fn unmount(folder: &Path) {
    assert!(Command::new("umount").arg(folder).status().unwrap().success());
}
