//! Instructions that each kernel executes, counted by callgrind and held against benches/counts/committed.txt: a guard
//! that other work on the machine cannot blur. `cargo bench --bench counts`; `-- --accept` writes the counts down as
//! the new ones; `-- NAME` counts one kernel. docs/counts.md.
//!
//! Every kernel runs once in a process of its own. Callgrind counts only the instructions inside [`counted`].

#[path = "counts/kernels.rs"]
mod kernels;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// A count that is off by a larger share, up or down, is reported. The same program counts the same; smaller
/// differences come from the compiler, which inlines otherwise where other code changes.
const TOLERANCE: f64 = 0.02;
/// How the program calls itself under callgrind.
const ALONE: &str = "--kernel";

fn main() -> ExitCode {
    let mut arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if let [flag, name] = &arguments[..]
        && flag == ALONE
    {
        // Callgrind counts in one thread: that of the kernel does all work.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
        alone.build_global().expect("no other pool yet");
        let (_, prepare) = kernels::ALL.iter().find(|(listed, _)| listed == name).expect("a kernel of the list");
        let mut kernel = prepare();
        kernel(); // Tables that are made once, and the allocator's first pages, are no part of the kernel.
        counted(&mut kernel);
        return ExitCode::SUCCESS;
    }
    let accept = arguments.iter().any(|argument| argument == "--accept");
    arguments.retain(|argument| argument != "--accept");
    let names = kernels::ALL.iter().map(|(name, _)| *name);
    let selection: Vec<&str> =
        names.filter(|name| arguments.is_empty() || arguments.iter().any(|a| a == name)).collect();
    if Command::new("valgrind").arg("--version").output().is_err() {
        eprintln!("valgrind is not here: NO INSTRUCTION WAS COUNTED (Debian: apt-get install valgrind)");
        return ExitCode::FAILURE;
    }
    let counts: BTreeMap<&str, u64> = selection.iter().map(|name| (*name, instructions(name))).collect();
    let committed = Committed::read();
    println!("| kernel | instructions | committed | change |\n|---|---|---|---|");
    let mut off = Vec::new();
    for (name, count) in &counts {
        let before = committed.counts.get(*name).copied();
        let change = before.map_or(f64::INFINITY, |before| *count as f64 / before as f64 - 1.0);
        println!("| {name} | {count} | {} | {:+.2} % |", before.unwrap_or(0), 100.0 * change);
        if change.abs() > TOLERANCE {
            off.push(format!(
                "{name}: {count} instructions, {} committed: {:+.2} %",
                before.unwrap_or(0),
                100.0 * change
            ));
        }
    }
    if accept {
        committed.with(&counts).write();
        return ExitCode::SUCCESS;
    }
    if off.is_empty() {
        return ExitCode::SUCCESS;
    }
    let here = toolchain();
    if here != committed.toolchain {
        println!(
            "\nCounted with {here}, committed with {}: another compiler counts otherwise, NOTHING WAS GUARDED.",
            committed.toolchain
        );
        return ExitCode::SUCCESS;
    }
    eprintln!("\nMore than {:.0} % off:\n  {}", 100.0 * TOLERANCE, off.join("\n  "));
    eprintln!(
        "Where that is meant, also where it is less: cargo bench --bench counts -- --accept, and commit {}.",
        path().display()
    );
    ExitCode::FAILURE
}

/// Where callgrind counts.
#[inline(never)]
fn counted(kernel: &mut kernels::Kernel) {
    kernel();
    // The call above is not the last thing here, else it would be a jump, which callgrind does not see return.
    std::hint::black_box(());
}

/// Instructions of one kernel.
fn instructions(name: &str) -> u64 {
    let own = std::env::current_exe().expect("the path of this program");
    let output = Command::new("valgrind")
        .args([
            "--tool=callgrind",
            "--callgrind-out-file=/dev/null",
            "--collect-atstart=no",
            "--toggle-collect=*counts*counted*",
        ])
        .arg(own)
        .args([ALONE, name])
        .output()
        .expect("valgrind starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {said}");
    let collected = said.lines().find_map(|line| line.split_once("Collected :")?.1.trim().parse().ok());
    collected.filter(|count| *count > 0).unwrap_or_else(|| panic!("{name}: callgrind counted nothing: {said}"))
}

/// Name and version of the compiler.
fn toolchain() -> String {
    let output = Command::new("rustc").arg("--version").output().expect("rustc says its version");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../counts/committed.txt")
}

/// What was counted before, and with which compiler.
struct Committed {
    toolchain: String,
    counts: BTreeMap<String, u64>,
}

impl Committed {
    fn read() -> Self {
        let text = fs::read_to_string(path()).unwrap_or_default();
        let mut lines = text.lines();
        let toolchain = lines.next().unwrap_or_default().to_owned();
        let count =
            |line: &str| line.split_once(' ').map(|(name, count)| (name.to_owned(), count.parse().expect("a count")));
        Self { toolchain, counts: lines.filter_map(count).collect() }
    }

    fn with(mut self, counts: &BTreeMap<&str, u64>) -> Self {
        self.toolchain = toolchain();
        self.counts.retain(|name, _| kernels::ALL.iter().any(|(listed, _)| listed == name));
        self.counts.extend(counts.iter().map(|(name, count)| ((*name).to_owned(), *count)));
        self
    }

    fn write(&self) {
        let mut text = self.toolchain.clone() + "\n";
        self.counts.iter().for_each(|(name, count)| writeln!(text, "{name} {count}").expect("a String takes all text"));
        fs::write(path(), text).expect("the counts can be written");
    }
}
