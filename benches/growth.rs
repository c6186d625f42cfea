//! Study: how the time of the larger estimations grows with their size. Prints the tables of docs/growth.md.
//!
//! `cargo bench --bench growth` for all, `cargo bench --bench growth -- sparse` for one of sparse, label, search, near,
//! scattered, all-pairs; numbers replace its sizes. One thread; each time is processor time, the median of three
//! rounds.

#[path = "growth/mod.rs"]
mod growth;

use growth::refine::Pairs;
use growth::{label, refine, sparse};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let given_sizes: Vec<usize> = arguments.iter().filter_map(|argument| argument.parse().ok()).collect();
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<usize>().is_err()).collect();
    let is_selected = |name: &str| names.is_empty() || names.iter().any(|given| *given == name);
    let sizes = |usual: &[usize]| if given_sizes.is_empty() { usual.to_vec() } else { given_sizes.clone() };
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
    one_thread.install(|| {
        if is_selected("sparse") {
            sparse::print(&sizes(&[100, 1000, 10_000]));
        }
        if is_selected("label") {
            label::print_labelling(&sizes(&[8, 16, 32, 64]));
        }
        if is_selected("search") {
            label::print_search(&sizes(&[8, 16, 32, 64]));
        }
        if is_selected("near") {
            refine::print(Pairs::Near, &sizes(&[100, 300, 1000, 3000, 10_000, 20_000]));
        }
        if is_selected("scattered") {
            refine::print(Pairs::Scattered, &sizes(&[100, 300, 1000, 3000, 10_000, 20_000]));
        }
        if is_selected("all-pairs") {
            refine::print(Pairs::All, &sizes(&[100, 300, 1000]));
        }
    });
}
