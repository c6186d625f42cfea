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
#[path = "reliability/lineage.rs"]
mod lineage;
#[allow(dead_code, reason = "the test uses more of it")]
#[path = "../tests/it/lineage_random.rs"]
mod lineage_random;
#[path = "../tests/it/manipulations.rs"]
mod manipulations;
#[path = "../tests/it/many_parts.rs"]
mod many_parts;
#[path = "reliability/memory.rs"]
mod memory;
#[path = "reliability/parts.rs"]
mod parts;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;
#[path = "../tests/it/system_calls.rs"]
mod system_calls;
#[path = "reliability/views.rs"]
mod views;
#[path = "reliability/watch.rs"]
mod watch;

/// A study takes the numbers behind its name.
type Study = fn(&[usize]);

const STUDIES: [(&str, Study); 11] = [
    ("kill", kill::study),
    ("faults", faults::study),
    ("system-calls", system_calls::study),
    ("flips", flips::study),
    ("settings", flips::settings),
    ("views", views::study),
    ("lineage", lineage::study),
    ("parts", parts::study),
    ("memory", memory::study),
    ("commands", memory::commands),
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
