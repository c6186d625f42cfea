//! Onsets that scatter more than their standard deviations say: which kind of them does, and by how much.
//!
//! Onsets of one kind share their causes of error: the shape of a patch's light, other light in the same pulse, a pulse
//! that is read as two. The scatter of a kind is the median of its studentised residuals (over 0.674, that of a normal
//! distribution): wrong labels, up to half of them, say nothing of the others. Beyond what chance makes of the median
//! (its 99.9 % point) its square is the factor on the variances of that kind, and all is solved again, so that the
//! other kinds count the more.

use crate::geometry::maximum_likelihood::{Problem, Solution};
use crate::tables::{Label, ONSET_KINDS};

/// Median of the size of a normal variable.
const MEDIAN: f64 = 0.674_490;
/// Standard deviation of the squared median of n sizes, over that square, times the root of n: the median knows a scale
/// with 0.37 of the information that squares have.
const MEDIAN_SD: f64 = 2.33;
/// The 99.9 % point of a normal distribution.
const BY_CHANCE_SD: f64 = 3.09;
/// Onsets of a kind, counted by their redundancy (the share of their information that others check), that tell a
/// scatter.
const LEAST: f64 = 8.0;
/// An onset that others check no more than this does not tell.
const UNCHECKED: f64 = 0.01;

/// Position of an onset's kind in [`ONSET_KINDS`].
pub const fn kind(label: &Label) -> usize {
    match (label.part, label.bounces) {
        (1.., _) => 3,
        (_, ..=1) => 0,
        (_, 2) => 1,
        (_, _) => 2,
    }
}

/// Factors on the variances of all kinds, 1 where chance explains their residuals; `kinds` are those of the problem's
/// observations. All 1 of solutions without predicted variances.
pub fn factors(problem: &Problem, solution: &Solution, kinds: &[usize]) -> [f64; ONSET_KINDS.len()] {
    let Some(predicted_m2) = &solution.predicted_variance_m2 else { return [1.0; ONSET_KINDS.len()] };
    let mut sizes: [Vec<f64>; ONSET_KINDS.len()] = Default::default();
    let mut redundancies = [0.0; ONSET_KINDS.len()];
    for (n, (observation, kind)) in problem.observations.iter().zip(kinds).enumerate() {
        let redundancy = 1.0 - predicted_m2[n] / (observation.sd_m * observation.sd_m);
        if redundancy > UNCHECKED {
            sizes[*kind].push((solution.residuals_m[n] / observation.sd_m).abs() / redundancy.sqrt());
            redundancies[*kind] += redundancy;
        }
    }
    // What too few of a kind tell, all onsets do.
    let of_all = factor(sizes.concat(), redundancies.iter().sum()).unwrap_or(1.0);
    let mut own = sizes.into_iter().zip(redundancies).map(|(sizes, redundancy)| factor(sizes, redundancy));
    std::array::from_fn(|kind| {
        let own = own.next().flatten();
        if kinds.contains(&kind) { own.unwrap_or(of_all) } else { 1.0 }
    })
}

/// By the sizes of studentised residuals and the sum of their redundancies; `None` of too few.
fn factor(mut sizes: Vec<f64>, redundancy: f64) -> Option<f64> {
    sizes.sort_by(f64::total_cmp);
    let square = (sizes.get(sizes.len() / 2).filter(|_| redundancy >= LEAST)? / MEDIAN).powi(2);
    Some(if square > 1.0 + BY_CHANCE_SD * MEDIAN_SD / redundancy.sqrt() { square } else { 1.0 })
}
