//! Which neighbours show light of the same thing.

use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;
use crate::neighbours::Cells;

/// Places of the wall that are asked, the place itself among them.
const NEAREST: usize = 49;
/// Lengths of one thing differ by no more than this share of the most that is possible, and so many standard deviations
/// of the response. A thing may lie at a steeper slope; then fewer neighbours are asked.
const GENTLE: f64 = 0.25;
const OFF: f64 = 2.0;

/// For each place with a length those of its nearest places, itself first, whose lengths are nearly its own. Lengths
/// change over the wall by `steepest` at most: 2 where light goes back where it came from, else 1. `sigma_m` is the
/// standard deviation of the response, as a length. Places without a length have no neighbours.
#[must_use]
pub fn alike(places: &[(Point, Option<f64>)], steepest: f64, sigma_m: f64, cancel: &Cancel) -> Vec<Vec<usize>> {
    let near = Cells::new(places.iter().map(|(place, _)| *place).collect()).all_nearest(NEAREST, cancel);
    let of_place = |(near, (here, own_m)): (Vec<u32>, &(Point, Option<f64>))| {
        let is_alike = |n: &usize| {
            let (place, length_m) = places[*n];
            let most_m = GENTLE * steepest * (place - here).norm() + OFF * sigma_m;
            own_m.zip(length_m).is_some_and(|(own_m, length_m)| (length_m - own_m).abs() <= most_m)
        };
        near.iter().map(|n| *n as usize).filter(is_alike).collect()
    };
    near.into_par_iter().zip(places).map(of_place).collect()
}
