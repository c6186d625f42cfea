//! Where true positions lie in what `run` states of them, for docs/error-bars.md.

use std::fmt::Write;
use std::ops::Range;

use super::ranks::{Flaw, Outcome, outcome, rank};
use super::score::{Estimate, Rate};

/// Parts of equal probability into which ranks are counted.
const PARTS: usize = 10;

/// Rooms and instruments at random; of these cells all or those named, counted from 0.
pub fn print_ranks(seeds: &Range<u64>, only: &[usize]) {
    println!(
        "| instrument | rooms | no solution | reported | doubtful patches | rms / bound | squared error / covariance | ranks outside 95 % | uniform: p | hidden: true, found, made up | hidden, ranks outside 95 % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut counts = String::new();
    for (_, flaw) in Flaw::ALL.into_iter().enumerate().filter(|(n, _)| only.is_empty() || only.contains(n)) {
        let outcomes: Vec<(u64, Outcome)> = seeds.clone().map(|seed| (seed, outcome(flaw, seed))).collect();
        for (seed, one) in &outcomes {
            eprintln!("{}, seed {seed}: {:.2?} {one:.2?}", flaw.name(), one.normalised());
        }
        let rooms: Vec<&Outcome> = outcomes.iter().map(|(_, one)| one).filter(|room| room.refused.is_none()).collect();
        let visible: Vec<f64> = rooms.iter().flat_map(|room| room.visible.iter().map(|z| rank(*z))).collect();
        let hidden: Vec<f64> = rooms.iter().flat_map(|room| room.hidden.iter().map(|z| rank(*z))).collect();
        let sum = |value: fn(&Outcome) -> usize| rooms.iter().map(|room| value(room)).sum::<usize>();
        let square = |value: fn(&Outcome) -> f64| rooms.iter().map(|room| value(room)).sum::<f64>();
        let normalised: Vec<f64> = rooms.iter().filter_map(|room| room.normalised()).collect();
        println!(
            "| {} | {} | {} | {:.2} | {} | {:.2} | {:.2} ± {:.2} | {} | {:.2} | {}, {}, {} | {} |",
            flaw.name(),
            outcomes.len(),
            outcomes.len() - rooms.len(),
            Rate::of(rooms.iter().map(|room| room.is_reported)),
            sum(|room| room.doubtful),
            (square(|room| room.squares_m2) / square(|room| room.bounds_m2)).sqrt(),
            Estimate::mean(&normalised).value,
            Estimate::mean(&normalised).half,
            outside(&visible),
            uniform(&visible),
            sum(|room| room.hidden_true),
            sum(|room| room.hits),
            sum(|room| room.phantoms),
            outside(&hidden),
        );
        for (kind, ranks) in [("visible", &visible), ("hidden", &hidden)] {
            let shares: Vec<String> = parts(ranks).iter().map(usize::to_string).collect();
            let row =
                format!("| {}, {kind} | {} | {} | {} |", flaw.name(), rooms.len(), ranks.len(), shares.join(" | "));
            writeln!(counts, "{row}").expect("a string");
        }
    }
    let numbers: Vec<String> = (1..=PARTS).map(|part| part.to_string()).collect();
    println!("\n| instrument | rooms | ranks | {} |\n|{}\n{counts}", numbers.join(" | "), "---|".repeat(PARTS + 3));
}

fn outside(ranks: &[f64]) -> Rate {
    Rate::of(ranks.iter().map(|rank| !(0.025..0.975).contains(rank)))
}

fn parts(ranks: &[f64]) -> [usize; PARTS] {
    let mut parts = [0; PARTS];
    ranks.iter().for_each(|rank| parts[((rank * PARTS as f64) as usize).min(PARTS - 1)] += 1);
    parts
}

/// Chance of counts that are this far from equal: chi-square of the parts (Wilson and Hilferty's approximation).
fn uniform(ranks: &[f64]) -> f64 {
    let expected = ranks.len() as f64 / PARTS as f64;
    let chi2: f64 = parts(ranks).iter().map(|count| (*count as f64 - expected).powi(2) / expected).sum();
    let freedom = (PARTS - 1) as f64;
    let width = 2.0 / (9.0 * freedom);
    let z = ((chi2 / freedom).cbrt() - (1.0 - width)) / width.sqrt();
    1.0 - rank(z)
}
