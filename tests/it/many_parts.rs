//! A small campaign of many parts, and the program itself run over it: what the tests and studies of kills and faults
//! share.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use periscope::simulate::{self, Format, Scene};

/// All stages, twice over labels, ranges, places and fits.
pub const PIPELINE: &str = include_str!("../../pipelines/scene.toml");
const SCENE: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
/// Four visible patches and a hidden one.
const PATCHES: [i32; 5] = [1, 2, 3, 4, 9];
/// Mean bytes of raw files in a part: some ten parts.
const PART_BYTES: u64 = 150_000;

/// A campaign in a folder of its own, with room for results next to it.
pub struct ManyParts {
    folder: tempfile::TempDir,
}

/// A run that was killed.
pub struct Killed {
    /// Tables that were being made.
    pub under_way: String,
    /// Files of finished parts: what they are and when they were written.
    pub finished: BTreeMap<PathBuf, (u64, i64)>,
}

impl ManyParts {
    /// The scene of `periscope demo`, with fewer patches and a fifth of its shots.
    pub fn new() -> Self {
        Self::of(&PATCHES, PART_BYTES)
    }

    /// The same with these patches, and parts of this mean size in bytes of raw files.
    pub fn of(patches: &[i32], part_bytes: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text =
            SCENE.replace("shots = 200\n", "shots = 40\n").replace("response_shots = 2000", "response_shots = 200");
        let mut scene = Scene::parse(Path::new("scene.toml"), &text).unwrap();
        scene.patches.retain(|patch, _| patches.contains(patch));
        let campaign = folder.path().join("campaign");
        simulate::simulate(&scene, 1, &campaign, Format::Trc).unwrap();
        let keys = fs::read_to_string(campaign.join("campaign.toml")).unwrap();
        let keys = keys.replacen("[campaign]\n", &format!("[campaign]\npart_bytes = {part_bytes}\n"), 1);
        fs::write(campaign.join("campaign.toml"), keys).unwrap();
        fs::write(folder.path().join("pipeline.toml"), PIPELINE).unwrap();
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `periscope run` with small batches, its progress as JSON.
    pub fn command(&self, out: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
        self.arguments(&mut command, out, "100kB");
        command
    }

    /// Gives a command the arguments of such a run.
    pub fn arguments(&self, command: &mut Command, out: &str, batch: &str) {
        command.args([
            "run",
            "pipeline.toml",
            "--campaign",
            "campaign",
            "--progress",
            "json",
            "--batch",
            batch,
            "--out",
            out,
        ]);
        command.current_dir(self.folder.path()).stdout(Stdio::null()).stderr(Stdio::piped());
    }

    pub fn start(&self, out: &str) -> Child {
        self.command(out).spawn().unwrap()
    }

    pub fn run(&self, out: &str) -> Output {
        self.command(out).output().unwrap()
    }

    /// Starts a run and kills it after a while (SIGKILL); `None` if it had ended by then.
    pub fn kill(&self, out: &str, after: Duration) -> Option<Killed> {
        let mut child = self.start(out);
        std::thread::sleep(after);
        if child.try_wait().unwrap().is_some() {
            return None;
        }
        child.kill().unwrap();
        let text = errors(&child.wait_with_output().unwrap());
        let mut events = text.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        let last = events.rfind(|event| event["event"] != "read");
        let under_way = match last {
            Some(event) if event["event"] == "pass" => {
                let tables = event["tables"].as_array().unwrap();
                tables.iter().map(|table| table.as_str().unwrap()).collect::<Vec<_>>().join(", ")
            }
            Some(_) => "between two".to_owned(),
            None => "before the first".to_owned(),
        };
        Some(Killed { under_way, finished: self.finished(out) })
    }

    /// Every Parquet file of a result folder, as the views show it and as it lies on the shelf, with its digest.
    pub fn files(&self, out: &str) -> BTreeMap<PathBuf, blake3::Hash> {
        let out = self.path(out);
        let paths =
            walk(&out, true).into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "parquet"));
        paths
            .map(|path| (path.strip_prefix(&out).unwrap().to_owned(), blake3::hash(&fs::read(&path).unwrap())))
            .collect()
    }

    /// Files of finished parts: those that have a record. Number of the file and time of its last change.
    pub fn finished(&self, out: &str) -> BTreeMap<PathBuf, (u64, i64)> {
        let files = walk(&self.path(out), false);
        let of_part = |path: &PathBuf| {
            let name = path.file_name()?.to_str()?;
            let (part, _) = name.strip_suffix(".parquet")?.split_once('.')?;
            path.with_file_name(format!("{part}.json")).exists().then(|| {
                let metadata = fs::metadata(path).unwrap();
                (path.clone(), (metadata.ino(), metadata.mtime() * 1_000_000_000 + metadata.mtime_nsec()))
            })
        };
        files.iter().filter_map(of_part).collect()
    }

    /// How many of these files were written again since.
    pub fn written_again(&self, finished: &BTreeMap<PathBuf, (u64, i64)>, out: &str) -> usize {
        let now = self.finished(out);
        finished.iter().filter(|(path, was)| now.get(*path) != Some(was)).count()
    }

    /// Half-written files that are still there.
    pub fn left_over(&self, out: &str) -> Vec<PathBuf> {
        let is_half = |path: &PathBuf| {
            path.iter().any(|name| name.as_encoded_bytes().starts_with(b"tmp-"))
                || path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
        };
        let mut files = walk(&self.path(out), false);
        files.extend(walk(&self.path("campaign"), false));
        files.into_iter().filter(is_half).collect()
    }
}

/// What a program said on standard error.
pub fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// All files below a folder, through links to folders or not.
fn walk(folder: &Path, through_links: bool) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_link = entry.file_type().unwrap().is_symlink();
        if path.is_dir() && (through_links || !is_link) {
            files.extend(walk(&path, through_links));
        } else if !path.is_dir() {
            files.push(path);
        }
    }
    files
}
