//! Study: how well the kernels of `signal` time and resolve pulses, against bounds from formulas. Prints the tables of
//! docs/time-resolution.md.
//!
//! `cargo bench --bench resolution`, `cargo bench --bench resolution -- quick` for a tenth of the draws; a letter runs
//! one table. With `PERISCOPE_PYTHON`, a Python that has SciPy, its NNLS is timed on the same records
//! (benches/nnls.py). They are written to a temporary folder, or to that of `PERISCOPE_BENCH_FOLDER`.

#[path = "resolution/mod.rs"]
mod resolution;

use resolution::draw::Effort;
use resolution::{counts, coverage, false_pulses, many, methods, mismatch, pairs, single, speed};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with("--")).collect();
    let effort = Effort { one_in: if arguments.iter().any(|arg| arg == "quick") { 10 } else { 1 } };
    let letters: Vec<&String> = arguments.iter().filter(|arg| arg.len() == 1).collect();
    let tables: [(&str, fn(Effort)); 9] = [
        ("a", single::print),
        ("b", pairs::print),
        ("c", false_pulses::print),
        ("d", many::print),
        ("e", coverage::print),
        ("f", mismatch::print),
        ("g", speed::print),
        ("h", counts::print),
        ("i", methods::print),
    ];
    for (letter, print) in tables {
        if letters.is_empty() || letters.iter().any(|argument| *argument == letter) {
            let start = std::time::Instant::now();
            print(effort);
            eprintln!("table {letter}: {:.0} s", start.elapsed().as_secs_f64());
        }
    }
}
