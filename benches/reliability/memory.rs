//! How much memory a run takes, for campaigns of any size under one budget.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Budget that the runs are given.
const BUDGET_MIB: usize = 128;
/// One capture of 4 MiB: number of shots, and of 16 bit samples in each.
const SHOTS: usize = 256;
const SAMPLES: usize = 8192;

/// Averages, deconvolution and onsets, all tables kept, the raw traces archived.
const PIPELINE: &str =
    "[traces]\nstage = 'ingest'\nparams = { codes = 'zstd' }\n[profiles]\nstage = 'average'\nfrom = 'traces'\n";

/// `numbers`: sizes of the campaigns in MB.
pub fn study(numbers: &[usize]) {
    let sizes_mb = if numbers.is_empty() { &[100, 1000, 10_000] } else { numbers };
    println!(
        "| campaign (MB) | captures | --memory (MiB) | --threads | peak of the process (MiB) | above the budget (MiB) | time (s) |"
    );
    println!("|---|---|---|---|---|---|---|");
    for &size_mb in sizes_mb {
        let folder = tempfile::tempdir().expect("a folder for the campaign");
        let captures = (size_mb * 1_000_000).div_ceil(2 * SHOTS * SAMPLES);
        record(folder.path(), captures);
        std::fs::write(folder.path().join("average.toml"), PIPELINE).expect("the pipeline");
        for threads in [1, 2] {
            let start = Instant::now();
            let mut child = Command::new(env!("CARGO_BIN_EXE_periscope"))
                .args(["run", "average.toml", "--campaign", "campaign", "--progress", "none"])
                .args(["--out", &format!("out{threads}"), "--memory", &format!("{BUDGET_MIB}MiB")])
                .args(["--threads", &threads.to_string()])
                .current_dir(folder.path())
                .stdout(Stdio::null())
                .spawn()
                .expect("the program was built");
            let peak_mib = peak_mib(&mut child);
            println!(
                "| {size_mb} | {captures} | {BUDGET_MIB} | {threads} | {peak_mib:.0} | {:.0} | {:.1} |",
                peak_mib - BUDGET_MIB as f64,
                start.elapsed().as_secs_f64()
            );
            std::fs::remove_dir_all(folder.path().join(format!("out{threads}"))).expect("results can be removed");
        }
    }
}

/// A campaign of noise of some codes with a pulse in each shot.
fn record(folder: &Path, captures: usize) {
    let raw = folder.join("campaign/raw");
    std::fs::create_dir_all(&raw).expect("a folder for the raw files");
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";
    std::fs::write(folder.join("campaign/campaign.toml"), format!("[campaign]\nname = 'bulk'\n[sensors.s1]\n{rule}"))
        .expect("the campaign file");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for capture in 0..captures {
        let mut codes: Vec<i16> = (0..SHOTS * SAMPLES).map(|_| rng.random_range(-30..30)).collect();
        (0..SHOTS).for_each(|shot| codes[shot * SAMPLES + SAMPLES / 2] += 1000);
        let path = raw.join(format!("L{}_P{}.npy", capture / 100 + 1, capture % 100 + 1));
        let mut file = BufWriter::new(File::create(path).expect("a raw file"));
        periscope::formats::npy::write(&mut file, &[SHOTS as u64, SAMPLES as u64], &codes).expect("a raw file");
        file.flush().expect("a raw file");
    }
}

/// Largest resident memory of a process, which is looked at until it ends.
fn peak_mib(child: &mut Child) -> f64 {
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kib = 0.0_f64;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
        peak_kib = peak_kib.max(kib.unwrap_or(0.0));
        if let Some(status) = child.try_wait().expect("it was started") {
            assert!(status.success(), "the run failed: {status}");
            return peak_kib / 1024.0;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// What each command takes of a campaign of many small files, and of one with a large text file. `numbers`: how many
/// files, and how many MB of text.
pub fn commands(numbers: &[usize]) {
    let files = numbers.first().copied().unwrap_or(100_000);
    let text_mb = numbers.get(1).copied().unwrap_or(300);
    println!("| campaign | command | peak of the process (MiB) | time (s) |\n|---|---|---|---|");
    let folder = tempfile::tempdir().expect("a folder for the campaign");
    many_files(folder.path(), files);
    std::fs::write(folder.path().join("average.toml"), PIPELINE).expect("the pipeline");
    let campaign = format!("{files} files");
    let run = ["run", "average.toml", "--campaign", "campaign", "--out", "out", "--memory", "64MiB", "--threads", "1"];
    measure(folder.path(), &campaign, &["plan", "average.toml", "--campaign", "campaign", "--out", "out"]);
    measure(folder.path(), &campaign, &[&run[..], &["--progress", "none"]].concat());
    measure(folder.path(), &campaign, &[&run[..], &["--progress", "none"]].concat());
    for command in ["verify", "tables", "report"] {
        measure(folder.path(), &campaign, &[command, "out"]);
    }
    measure(folder.path(), &campaign, &["seal", "campaign"]);
    measure(folder.path(), &campaign, &["verify", "campaign"]);
    let folder = tempfile::tempdir().expect("a folder for the campaign");
    large_text(folder.path(), text_mb);
    std::fs::write(folder.path().join("average.toml"), PIPELINE).expect("the pipeline");
    let campaign = format!("one CSV of {text_mb} MB");
    measure(folder.path(), &campaign, &["inspect", "campaign/raw/L1_P2.csv"]);
    measure(folder.path(), &campaign, &[&run[..], &["--progress", "none"]].concat());
}

/// Runs a command and prints a row.
fn measure(folder: &Path, campaign: &str, command: &[&str]) {
    let start = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(command)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program was built");
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kib = 0.0_f64;
    let code = loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
        peak_kib = peak_kib.max(kib.unwrap_or(0.0));
        if let Some(status) = child.try_wait().expect("it was started") {
            break status.code();
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let (seconds, peak_mib) = (start.elapsed().as_secs_f64(), peak_kib / 1024.0);
    let failed = if code == Some(0) { String::new() } else { format!(", ended with {code:?}") };
    println!("| {campaign} | `{}`{failed} | {peak_mib:.0} | {seconds:.1} |", command.join(" "));
}

/// A campaign of many files of two shots.
fn many_files(folder: &Path, files: usize) {
    const SEEN: usize = 300;
    let raw = folder.join("campaign/raw");
    std::fs::create_dir_all(&raw).expect("a folder for the raw files");
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";
    let text = format!("[campaign]\nname = 'many'\n[sensors.s1]\n{rule}");
    std::fs::write(folder.join("campaign/campaign.toml"), text).expect("the campaign file");
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for n in 0..files {
        let codes: Vec<i16> = (0..2 * 64).map(|_| rng.random_range(-30..30)).collect();
        let path = raw.join(format!("L{}_P{}.npy", n / SEEN + 1, n % SEEN + 1));
        let mut file = BufWriter::new(File::create(path).expect("a raw file"));
        periscope::formats::npy::write(&mut file, &[2, 64], &codes).expect("a raw file");
        file.flush().expect("a raw file");
    }
}

/// A campaign of one text file of times and volts.
fn large_text(folder: &Path, size_mb: usize) {
    let raw = folder.join("campaign/raw");
    std::fs::create_dir_all(&raw).expect("a folder for the raw files");
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.csv'\n";
    let text = format!("[campaign]\nname = 'text'\n[sensors.s1]\n{rule}");
    std::fs::write(folder.join("campaign/campaign.toml"), text).expect("the campaign file");
    let mut file = BufWriter::new(File::create(raw.join("L1_P2.csv")).expect("a raw file"));
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    writeln!(file, "time (s),signal (V)").expect("a raw file");
    for n in 0..size_mb * 1_000_000 / 24 {
        writeln!(file, "{:.10e},{:.3}", n as f64 * 5e-11, rng.random_range(-0.1..0.1)).expect("a raw file");
    }
    file.flush().expect("a raw file");
}
