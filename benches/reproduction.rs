//! Study: the paper's experiments again. Prints the tables of docs/reproduction.md.
//!
//! `cargo bench --bench reproduction -- barcode 40` for the 1-0-1 barcode with so many seeds.

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/barcode.rs"]
mod barcode;
#[path = "reproduction/barcode_bound.rs"]
mod barcode_bound;
#[path = "reproduction/barcode_figure.rs"]
mod barcode_figure;
#[path = "reproduction/barcode.rs"]
mod barcode_study;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let seeds: u64 = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(40);
    let part = arguments.get(1).filter(|argument| argument.parse::<u64>().is_err());
    match arguments.first().map(String::as_str) {
        Some("barcode") => barcode_study::study(part.map(String::as_str), seeds),
        asked => eprintln!("there is no experiment `{}`; there is barcode", asked.unwrap_or_default()),
    }
}
