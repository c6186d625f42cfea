//! Study: how often a good instrument fails `characterize`, and how often a faulty one is detected. Prints the tables
//! of docs/instrument-checks.md.
//!
//! `cargo bench --bench instrument_checks` (300 seeds), `cargo bench --bench instrument_checks -- 20` for fewer.

#[allow(dead_code, unused_imports, reason = "the tests use more of it")]
#[path = "../tests/it/characterize.rs"]
mod characterize;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;

use std::collections::BTreeMap;

use characterize::{EXACT, FAULTS, INSTRUMENT, checks, failed, faulty};

/// Wilson's interval of a rate, 95 %.
fn interval(hits: usize, draws: usize) -> (f64, f64) {
    let (hits, n, z) = (hits as f64, draws as f64, 1.959_964_f64);
    let centre = (hits + 0.5 * z * z) / (n + z * z);
    let half = z / (n + z * z) * (hits * (n - hits) / n + 0.25 * z * z).sqrt();
    (100.0 * (centre - half), 100.0 * (centre + half))
}

/// A campaign at a time on each core. Not in rayon's own threads, which the runs need.
fn draws<T: Send>(seeds: u64, draw: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, |count| count.get() as u64);
    let share =
        |thread: u64| (0..seeds).filter(|seed| seed % threads == thread).map(|seed| draw(1000 + seed)).collect();
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|thread| scope.spawn(move || -> Vec<T> { share(thread) })).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a draw does not panic")).collect()
    })
}

fn main() {
    let seeds = std::env::args().skip(1).find_map(|arg| arg.parse().ok()).unwrap_or(300_u64);
    println!("| good instrument | seeds | passed | 95 % | alarms |\n|---|---|---|---|---|");
    let exact = [&["level=0.05"], EXACT.as_slice()].concat();
    for (name, set) in [("tolerances as they are", vec!["level=0.05"]), ("all tolerances 0", exact)] {
        let runs: Vec<Vec<String>> =
            draws(seeds, |seed| failed(&checks(INSTRUMENT, seed, &set).1).into_iter().map(str::to_owned).collect());
        let passed = runs.iter().filter(|failed| failed.is_empty()).count();
        let mut alarms: BTreeMap<&str, usize> = BTreeMap::new();
        runs.iter().flatten().for_each(|check| *alarms.entry(check).or_default() += 1);
        let (low, high) = interval(passed, runs.len());
        let rate = 100.0 * passed as f64 / runs.len() as f64;
        println!("| {name}, level 5 % | {seeds} | {rate:.1} % | {low:.1} to {high:.1} | {alarms:?} |");
    }
    println!("\n| fault | seeds | found, cause named | 95 % | other checks that failed |\n|---|---|---|---|---|");
    for (flaw, check, cause, _) in FAULTS {
        let scene = faulty(flaw);
        let runs: Vec<(bool, Vec<String>)> = draws(seeds / 3, |seed| {
            let (_lab, checks) = checks(&scene, seed, &[]);
            let is_named = &*checks[check].verdict == "fail" && checks[check].cause.contains(cause);
            let others = failed(&checks).into_iter().filter(|other| *other != check).map(str::to_owned).collect();
            (is_named, others)
        });
        let hits = runs.iter().filter(|(is_named, _)| *is_named).count();
        let mut others: BTreeMap<&str, usize> = BTreeMap::new();
        runs.iter().flat_map(|(_, others)| others).for_each(|check| *others.entry(check).or_default() += 1);
        let (low, high) = interval(hits, runs.len());
        let rate = 100.0 * hits as f64 / runs.len() as f64;
        println!("| `{flaw}` | {} | {rate:.1} % ({check}) | {low:.1} to {high:.1} | {others:?} |", runs.len());
    }
}
