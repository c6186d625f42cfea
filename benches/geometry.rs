//! Study: coordinates from path lengths, every method against the Cramer-Rao bound. Prints the tables of
//! docs/geometry.md.
//!
//! `cargo bench --bench geometry` for all, `cargo bench --bench geometry -- methods` for one of methods, missing,
//! separate, thirds, scale, chi-square; a number sets the scenes. PERISCOPE_PYTHON names a python with scikit-learn for
//! its row.

#[path = "geometry/mod.rs"]
mod geometry;

use geometry::{chi_square, methods, missing, scale, separate, thirds};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let scenes: Option<u64> = arguments.iter().find_map(|argument| argument.parse().ok());
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<u64>().is_err()).collect();
    let is_selected = |name: &str| names.is_empty() || names.iter().any(|given| *given == name);
    if is_selected("methods") {
        methods::print(scenes.unwrap_or(200));
    }
    if is_selected("missing") {
        missing::print(scenes.unwrap_or(300));
    }
    if is_selected("separate") {
        separate::print(scenes.unwrap_or(100));
    }
    if is_selected("thirds") {
        thirds::print(scenes.unwrap_or(100));
    }
    if is_selected("scale") {
        scale::print();
    }
    if is_selected("chi-square") {
        chi_square::print(scenes.unwrap_or(300));
    }
}
