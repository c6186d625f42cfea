//! Collisions of lineages among tables of random pipelines, and whether numbers that are none get in.

use crate::lineage_random::{Counts, count};

/// `numbers`: how many pipelines.
pub fn study(numbers: &[usize]) {
    let draws = numbers.first().copied().unwrap_or(1_000_000) as u64;
    let Counts { tables, different, collisions, splits, refused, taken } = count(draws);
    println!(
        "| pipelines | tables | different | equal lineages of different inputs | different lineages of equal inputs |"
    );
    println!("|---|---|---|---|---|");
    println!("| {draws} | {tables} | {different} | {collisions} | {splits} |");
    println!("\nnan or inf as a parameter: {refused} refused, {taken} taken");
}
