//! What a run costs that follows a capture of many files, and whether its tables are those of one run at the end.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Averages, deconvolved by nothing; all tables kept.
const PIPELINE: &str = "[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\n";
/// Files that arrive in a second.
const FILES_PER_S: usize = 400;
/// Patches lit, and seen by each.
const SEEN: usize = 150;
const SHOTS: usize = 2;
const SAMPLES: usize = 512;

/// What a process holds at a moment.
struct Held {
    files: usize,
    resident_mib: f64,
    threads: usize,
    handles: usize,
}

/// `numbers`: how many files arrive.
pub fn study(numbers: &[usize]) {
    let count = numbers.first().copied().unwrap_or(20_000);
    let folder = tempfile::tempdir().expect("a folder for the campaign");
    let raw = folder.path().join("campaign/raw");
    fs::create_dir_all(&raw).expect("a folder for the raw files");
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";
    let campaign = format!("[campaign]\nname = 'arriving'\npart_bytes = 1000000\n[sensors.s1]\n{rule}");
    fs::write(folder.path().join("campaign/campaign.toml"), campaign).expect("the campaign file");
    fs::write(folder.path().join("averages.toml"), PIPELINE).expect("the pipeline");

    let mut following = run(folder.path(), "followed", &["--watch", "--idle", "5"]);
    let stderr = following.stderr.take().expect("it is piped");
    let lines = thread::spawn(move || BufReader::new(stderr).lines().map_while(Result::ok).collect::<Vec<String>>());
    let start = Instant::now();
    let mut held = Vec::new();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for n in 0..count {
        arrive(&raw, n, &mut rng);
        if n % FILES_PER_S == FILES_PER_S - 1 {
            held.extend(look(&following, n + 1));
            let due = Duration::from_secs_f64((n + 1) as f64 / FILES_PER_S as f64);
            thread::sleep(due.saturating_sub(start.elapsed()));
        }
    }
    loop {
        if let Some(status) = following.try_wait().expect("it was started") {
            assert!(status.success(), "{status}");
            break;
        }
        held.extend(look(&following, count));
        thread::sleep(Duration::from_millis(200));
    }
    let lines = lines.join().expect("the reader does not panic");
    let passes = lines.iter().filter(|line| line.contains("pass ")).count();

    println!("| files so far | resident (MiB) | threads | open handles |\n|---|---|---|---|");
    let tenth = held.len().div_ceil(12).max(1);
    let last = held.len().saturating_sub(1);
    for (_, Held { files, resident_mib, threads, handles }) in
        held.iter().enumerate().filter(|(n, _)| n % tenth == 0 || *n == last)
    {
        println!("| {files} | {resident_mib:.0} | {threads} | {handles} |");
    }

    let mut once = run(folder.path(), "once", &[]);
    assert!(once.wait().expect("it was started").success());
    let (followed, once) = (tables(&folder.path().join("followed")), tables(&folder.path().join("once")));
    let same = followed.iter().filter(|(name, digest)| once.get(*name) == Some(digest)).count();
    println!(
        "\n{count} files in {passes} passes; {same} of {} table files are those of one run at the end ({} there); {} MiB of results, {} of one run.",
        followed.len(),
        once.len(),
        megabytes(&folder.path().join("followed")),
        megabytes(&folder.path().join("once")),
    );
}

fn run(folder: &Path, out: &str, more: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "averages.toml", "--campaign", "campaign", "--out", out, "--progress", "none"])
        .args(more)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program was built")
}

/// A file of two shots, written under a hidden name and renamed, as a careful recorder does.
fn arrive(raw: &Path, n: usize, rng: &mut ChaCha8Rng) {
    let codes: Vec<i16> = (0..SHOTS * SAMPLES).map(|_| rng.random_range(-30..30)).collect();
    let half = raw.join(".half");
    let mut file = fs::File::create(&half).expect("a raw file");
    periscope::formats::npy::write(&mut file, &[SHOTS as u64, SAMPLES as u64], &codes).expect("a raw file");
    fs::rename(half, raw.join(format!("L{}_P{}.npy", n / SEEN + 1, n % SEEN + 1))).expect("a raw file");
}

/// `None` once it has ended.
fn look(child: &Child, files: usize) -> Option<Held> {
    let place = PathBuf::from(format!("/proc/{}", child.id()));
    let status = fs::read_to_string(place.join("status")).ok()?;
    let value = |key: &str| -> Option<usize> {
        let line = status.lines().find_map(|line| line.strip_prefix(key))?;
        line.trim().trim_end_matches(" kB").parse().ok()
    };
    let handles = fs::read_dir(place.join("fd")).ok()?.count();
    Some(Held { files, resident_mib: value("VmRSS:")? as f64 / 1024.0, threads: value("Threads:")?, handles })
}

/// Digests of all files of all views, by view and name.
fn tables(out: &Path) -> BTreeMap<String, blake3::Hash> {
    let mut digests = BTreeMap::new();
    for view in ["traces", "profiles", "rejects"] {
        for entry in fs::read_dir(out.join(view)).expect("a view").flatten() {
            let bytes = fs::read(entry.path()).expect("a table file");
            digests.insert(format!("{view}/{}", entry.file_name().display()), blake3::hash(&bytes));
        }
    }
    digests
}

/// Size of all files on the shelf; a file with several names counts once.
fn megabytes(out: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    let (mut files, mut folders) = (BTreeMap::new(), vec![out.join(".shelf")]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder of results").flatten() {
            let metadata = entry.metadata().expect("a file of results");
            if metadata.is_dir() {
                folders.push(entry.path());
            } else {
                files.insert(metadata.ino(), metadata.len());
            }
        }
    }
    files.values().sum::<u64>() >> 20
}
