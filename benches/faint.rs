//! Study: hidden patches too weak for an onset in any single profile. Prints the tables of docs/accuracy.md, "Too weak
//! for an onset".
//!
//! `cargo bench --bench faint` for all, `cargo bench --bench faint -- power 100` or `-- none 300` for that number of
//! scenes of one, `-- power 100 1.5` for one signal-to-noise ratio.

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/faint.rs"]
mod faint;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

use faint::{Placed, Seen, draw, run};
use periscope::geometry::Point;
use score::{Estimate, Rate};

/// Signal-to-noise ratios of the study.
const SNRS: [f64; 6] = [0.5, 0.75, 1.0, 1.25, 1.5, 2.0];
/// A patch counts as found within this many of its standard deviations.
const NEAR: f64 = 5.0;
/// 95 % of chi-square of three degrees of freedom.
const CHI_95: f64 = 7.815;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let scenes: Option<u64> = arguments.iter().find_map(|argument| argument.parse().ok());
    let is_selected = |name: &str| {
        let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<f64>().is_err()).collect();
        names.is_empty() || names.iter().any(|given| *given == name)
    };
    if is_selected("power") {
        let snrs: Vec<f64> =
            arguments.iter().filter(|argument| argument.contains('.')).flat_map(|snr| snr.parse()).collect();
        power(if snrs.is_empty() { &SNRS } else { &snrs }, scenes.unwrap_or(100));
    }
    if is_selected("none") {
        none(scenes.unwrap_or(300));
    }
}

/// A campaign at a time on each core. Not in rayon's own threads, which the runs need.
fn draws<T: Send>(scenes: u64, draw: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, |count| count.get() as u64);
    let share =
        |thread: u64| (0..scenes).filter(|scene| scene % threads == thread).map(|scene| draw(1000 + scene)).collect();
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|thread| scope.spawn(move || -> Vec<T> { share(thread) })).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a draw does not panic")).collect()
    })
}

/// One hidden patch, by the signal-to-noise ratio of its light in a profile.
fn power(snrs: &[f64], scenes: u64) {
    println!(
        "| SNR, rms over profiles | largest | scenes | found [95 %] | found among onsets | false | evidence | rms error (mm) | error^2 / covariance (3) | within 95 % [95 %] | shots needed / taken where declined |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for &snr in snrs {
        let runs: Vec<(Seen, Point, f64)> = draws(scenes, |seed| {
            let drawn = draw(snr, seed);
            (run(&drawn.scene, seed), drawn.hidden, drawn.largest_snr)
        });
        let (mut patches, mut wrong, mut evidence) = (Vec::new(), 0, 0.0);
        for (seen, hidden, _) in &runs {
            let near = |patch: &&Placed| patch.squares(hidden).0 < NEAR * NEAR;
            patches.extend(seen.patches.iter().find(near).map(|patch| patch.squares(hidden)));
            wrong += seen.patches.iter().filter(|patch| !near(patch)).count();
            evidence += seen.hypotheses.first().map_or(0.0, |row| row.evidence) / runs.len() as f64;
        }
        let by_label = runs.iter().filter(|(seen, ..)| seen.by_label > 0).count();
        let largest = runs.iter().map(|(.., largest)| largest).sum::<f64>() / runs.len() as f64;
        let declined = |(seen, ..): &(Seen, _, _)| {
            seen.hypotheses.iter().find_map(|row| row.shots_needed).filter(|_| seen.patches.is_empty())
        };
        let mut shots: Vec<f64> = runs.iter().filter_map(declined).map(|shots| shots / 50.0).collect();
        shots.sort_by(f64::total_cmp);
        let mean_m2 = patches.iter().map(|(_, square_m2)| square_m2).sum::<f64>() / patches.len() as f64;
        println!(
            "| {snr} | {largest:.1} | {} | {} | {by_label} | {wrong} | {evidence:.1} | {} | {} | {} | {} |",
            runs.len(),
            Rate { hits: patches.len(), of: runs.len() },
            number((!patches.is_empty()).then_some(1e3 * mean_m2.sqrt())),
            Estimate::mean(&patches.iter().map(|(normalised, _)| *normalised).collect::<Vec<_>>()),
            Rate::of(patches.iter().map(|(normalised, _)| *normalised < CHI_95)),
            number(shots.get(shots.len() / 2).copied()),
        );
    }
}

/// A number of a table, where there is one.
fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"))
}

/// No hidden patch.
fn none(scenes: u64) {
    let runs: Vec<Seen> = draws(scenes, |seed| run(&draw(0.0, seed).scene, seed));
    let alarms = Rate::of(runs.iter().map(|seen| !seen.patches.is_empty()));
    let messages = Rate::of(runs.iter().map(Seen::is_declined));
    println!(
        "\n| none hidden: scenes | found | told as not sure |\n|---|---|---|\n| {} | {alarms} | {messages} |",
        runs.len()
    );
}
