//! Study: the paper's experiments from scope files, against what the paper prints. Prints the tables of
//! docs/reproduction.md, and draws its figures.
//!
//! `cargo bench --bench reproduction -- hidden-plane 8`, `-- mirror 40`, `-- barcode errors 40`: this number of
//! campaigns of one experiment. The barcode has the parts errors, moved, gap, figure, and these have rows for each
//! response: `-- barcode gap E 300`.

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/barcode.rs"]
mod barcode;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/corner.rs"]
mod corner;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/hidden_plane.rs"]
mod hidden_plane;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/mirror.rs"]
mod mirror;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/missed.rs"]
mod missed;
#[path = "reproduction/mod.rs"]
mod reproduction;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let count: Option<u64> = arguments.iter().find_map(|argument| argument.parse().ok());
    let mut names = arguments.iter().filter(|argument| argument.parse::<u64>().is_err()).map(String::as_str);
    let (name, part, response) = (names.next(), names.next(), names.next());
    let is_selected = |experiment: &str| name.is_none_or(|name| name == experiment);
    if is_selected("hidden-plane") {
        reproduction::hidden_plane::print(count.unwrap_or(8));
    }
    if is_selected("mirror") {
        reproduction::mirror::print(count.unwrap_or(40));
    }
    if is_selected("barcode") {
        reproduction::barcode::study(part, response, count.unwrap_or(40));
    }
}
