//! Pulses of several paths that make one arrival.

use std::ops::RangeInclusive;

use super::superposition::Pair;
use super::{Arrival, Path};

/// Chance that two pulses at the same time make one arrival; it falls to none over the length that the response
/// resolves.
const MERGED: f64 = 0.95;
/// Paths less likely than this to be seen are too faint to pull an arrival.
const BRIGHT: f64 = 0.3;

fn chance(off_m: f64, blend_m: f64) -> f64 {
    MERGED * (1.0 - off_m.abs() / blend_m).max(0.0)
}

/// Probability that light over `length_m` has no arrival of its own because it is in one that other paths claim.
pub fn hidden(arrivals: &[Arrival], left: &[f64], length_m: f64, blend_m: f64) -> f64 {
    if blend_m == 0.0 {
        return 0.0;
    }
    let from = arrivals.partition_point(|arrival| arrival.length_m < length_m - blend_m);
    let near = arrivals.iter().zip(left).skip(from).take_while(|(arrival, _)| arrival.length_m < length_m + blend_m);
    near.map(|(arrival, left)| (1.0 - left) * chance(arrival.length_m - length_m, blend_m)).fold(0.0, f64::max)
}

/// The same for each bin of a curve over lengths: bin `k` stands for `offset_m + k * step_m`.
pub fn hidden_along(
    arrivals: &[Arrival],
    left: &[f64],
    offset_m: f64,
    step_m: f64,
    bins: RangeInclusive<usize>,
    blend_m: f64,
) -> Vec<f64> {
    let (first, last) = (*bins.start(), *bins.end());
    let mut hidden = vec![0.0_f64; last + 1 - first];
    for (arrival, left) in arrivals.iter().zip(left) {
        let at = |length_m: f64| ((length_m - offset_m) / step_m).max(0.0);
        let from = (at(arrival.length_m - blend_m) as usize).max(first);
        let to = (at(arrival.length_m + blend_m) as usize + 1).min(last);
        for k in from..=to {
            let length_m = offset_m + k as f64 * step_m;
            let claimed = (1.0 - left) * chance(arrival.length_m - length_m, blend_m);
            hidden[k - first] = hidden[k - first].max(claimed);
        }
    }
    hidden
}

/// The same for lengths that are surely claimed, in order.
pub fn hidden_by(claimed_m: &[f64], length_m: f64, blend_m: f64) -> f64 {
    let next = claimed_m.partition_point(|other_m| *other_m < length_m);
    let near = &claimed_m[next.saturating_sub(1)..(next + 1).min(claimed_m.len())];
    if blend_m == 0.0 {
        0.0
    } else {
        near.iter().map(|other_m| chance(other_m - length_m, blend_m)).fold(0.0, f64::max)
    }
}

/// Standard deviations of a profile's arrivals, larger where an arrival of one path may be that of two: near a path
/// that is bright and has no arrival of its own. Unresolved pulses make an arrival at the centroid of their light, half
/// of their distance off where both are as strong.
pub fn widened(arrivals: &[Arrival], paths: &[Path], pairs: &[Pair], blend_m: f64) -> Vec<f64> {
    let mut whole = vec![1.0; paths.len()];
    pairs.iter().for_each(|pair| whole[pair.path] += pair.odds * pair.left);
    let mut owners: Vec<Option<(f64, usize)>> = vec![None; arrivals.len()];
    for pair in pairs {
        let share = pair.odds * pair.left / whole[pair.path];
        if owners[pair.arrival].is_none_or(|(most, _)| share > most) {
            owners[pair.arrival] = Some((share, pair.path));
        }
    }
    let mut bright: Vec<usize> = (0..paths.len()).filter(|&k| paths[k].seen >= BRIGHT).collect();
    bright.sort_by(|&a, &b| paths[a].length_m.total_cmp(&paths[b].length_m));
    let widened = |(arrival, owner): (&Arrival, Option<(f64, usize)>)| {
        let from_m = owner.map_or(arrival.length_m, |(_, own)| paths[own].length_m);
        let lone = |k: usize| {
            // 1 / whole: none of the arrivals is its own.
            let error_m = 0.5 * (paths[k].length_m - from_m);
            chance(2.0 * error_m, blend_m) * error_m * error_m / whole[k]
        };
        let from = bright.partition_point(|&k| paths[k].length_m < from_m - blend_m);
        let near = bright[from..].iter().copied().take_while(|&k| paths[k].length_m < from_m + blend_m);
        let others = near.filter(|&k| owner.is_none_or(|(_, own)| own != k));
        arrival.sd_m.hypot(others.map(lone).fold(0.0, f64::max).sqrt())
    };
    arrivals.iter().zip(owners).map(widened).collect()
}
