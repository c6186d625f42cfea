//! Studies: what results survive. Print the tables of docs/reliability.md.
//!
//! `cargo bench --bench reliability` for all, `-- kill 200` or `-- flips 500 200` for one with its numbers.

#[path = "reliability/faults.rs"]
mod faults;
#[path = "reliability/flips.rs"]
mod flips;
#[path = "reliability/kill.rs"]
mod kill;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[path = "../tests/it/many_parts.rs"]
mod many_parts;
#[path = "reliability/memory.rs"]
mod memory;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;
#[path = "reliability/watch.rs"]
mod watch;

/// A study takes the numbers behind its name.
type Study = fn(&[usize]);

const STUDIES: [(&str, Study); 5] = [
    ("kill", kill::study),
    ("faults", faults::study),
    ("flips", flips::study),
    ("memory", memory::study),
    ("watch", watch::study),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let numbers: Vec<usize> = arguments.iter().filter_map(|argument| argument.parse().ok()).collect();
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<usize>().is_err()).collect();
    for (name, study) in STUDIES {
        if names.is_empty() || names.iter().any(|argument| *argument == name) {
            study(&numbers);
        }
    }
}
