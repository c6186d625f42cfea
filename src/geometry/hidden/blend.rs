//! Pulses of several paths that make one arrival.

use super::superposition::Pair;
use super::{Arrival, Path, Profile};

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

/// A profile with larger errors where an arrival of one path may be that of two: near one that is bright and has none
/// of its own. Unresolved pulses make an arrival at the centroid of their light, half of their distance off where both
/// are as strong.
pub fn widened(profile: &Profile, paths: &[Path], pairs: &[Pair], blend_m: f64) -> Profile {
    let mut whole = vec![1.0; paths.len()];
    pairs.iter().for_each(|pair| whole[pair.path] += pair.odds * pair.left);
    let mut owners: Vec<Option<(f64, usize)>> = vec![None; profile.arrivals.len()];
    for pair in pairs {
        let share = pair.odds * pair.left / whole[pair.path];
        if owners[pair.arrival].is_none_or(|(most, _)| share > most) {
            owners[pair.arrival] = Some((share, pair.path));
        }
    }
    let mut arrivals = profile.arrivals.clone();
    for (arrival, owner) in arrivals.iter_mut().zip(owners) {
        let lone = |(k, other): (usize, &Path)| {
            if other.seen < BRIGHT || owner.is_some_and(|(_, own)| own == k) {
                return 0.0;
            }
            let from_m = owner.map_or(arrival.length_m, |(_, own)| paths[own].length_m);
            // 1 / whole: none of the arrivals is its own.
            let error_m = 0.5 * (other.length_m - from_m);
            chance(2.0 * error_m, blend_m) * error_m * error_m / whole[k]
        };
        let variance_m2 = paths.iter().enumerate().map(lone).fold(0.0, f64::max);
        arrival.sd_m = arrival.sd_m.hypot(variance_m2.sqrt());
    }
    profile.with(arrivals)
}
