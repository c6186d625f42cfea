//! Ranges of a hidden patch from third bounces: the inverse of the paper's distance transform T3 (section 4.3), for any
//! pattern of onsets.
//!
//! Light that meets a hidden patch `q` comes from a lit patch i and goes on to a seen patch k. With both in known
//! places, the path's length less its legs to laser and sensor is a sum of two ranges `r_i = |q - p_i|`:
//!
//! ```text
//! s_ik = c O_iqk - d_0i - d_0k = r_i + r_k        s_ii = 2 r_i
//! ```
//!
//! The paper solves `s_11` and `s_14` for two ranges and leaves the others unused. Here all sums count, by least
//! squares weighted by their covariance. For sums of all V (V + 1) / 2 pairs, of equal variance,
//! `r = (y - 1 (1' y) / (2 V + 2)) / (V + 2)`, y the transpose of T3 times s (Sherman-Morrison). The right-hand side
//! that the paper prints has three misprints. `O_124^2` and `O_134^23` are third bounces, `O_124^3` and `O_134^3`. The
//! first bounce that goes with `O_131^3` is `O_1^1`, as the hidden patch 3 has none.
//!
//! Known legs are not known exactly, and an error of theirs is common to all sums over that patch. It travels as such:
//! each sum has its own variance, and what each of several independent errors adds to it. So do ranges, and by that the
//! covariance between ranges of different hidden patches follows.
//!
//! Sums determine ranges where they close: patches are nodes, sums edges. A part of that graph has ranges if it has an
//! odd cycle: a sum (i, i), or three patches all in pairs. Disjoint sets of lit and seen patches have none: the ranges
//! of one set may all grow by what those of the other shrink. Such parts are [`Ranges::open`]. Their sums still
//! constrain the place of a patch ([`super::maximum_likelihood`] takes them as they are).

use std::collections::BTreeMap;

use super::t2::Length;
use super::{Matrix, dense};
use crate::units::PatchId;

/// A sum of the ranges from a hidden patch to a lit and a seen one.
#[derive(Clone, Debug, PartialEq)]
pub struct Sum {
    /// Patch that the light came from.
    pub lit: PatchId,
    /// Patch that it went on to; may be the same.
    pub seen: PatchId,
    /// The sum, and the variance of what is its own error.
    pub length: Length,
    /// What independent errors of variance 1, common to several sums, add to it, in metres.
    pub common_m: Vec<f64>,
}

/// What T3 gives of one hidden patch.
#[derive(Clone, Debug)]
pub struct Ranges {
    /// Patches to which the hidden one has a range, ascending.
    pub patches: Vec<PatchId>,
    /// The ranges.
    pub ranges_m: Vec<f64>,
    /// Their covariance, common errors included.
    pub covariance_m2: Matrix,
    /// What the common errors (columns) add to each range (rows), in metres.
    pub common_m: Matrix,
    /// Patches whose ranges the sums leave open, by parts of the graph.
    pub open: Vec<Vec<PatchId>>,
    /// Squared residuals of the sums, by their covariance.
    pub chi2: f64,
    /// Sums less what they determine.
    pub degrees_of_freedom: usize,
}

/// Patches that sums join.
struct Part {
    patches: Vec<PatchId>,
    /// Whether an odd cycle determines its ranges.
    is_closed: bool,
}

/// Inverts T3 for one hidden patch, by generalised least squares over all sums.
///
/// # Panics
/// When a variance is not positive, or sums differ in how many common errors they list.
#[must_use]
pub fn invert(sums: &[Sum]) -> Ranges {
    let errors = sums.first().map_or(0, |sum| sum.common_m.len());
    for sum in sums {
        assert!(sum.length.variance_m2 > 0.0, "the sum ({}, {}) has no variance", sum.lit, sum.seen);
        assert!(sum.common_m.len() == errors, "the sum ({}, {}) lists other common errors", sum.lit, sum.seen);
    }
    let parts = parts(sums);
    let ranges = parts.iter().filter(|part| part.is_closed).flat_map(|part| part.patches.iter().copied());
    let mut patches: Vec<PatchId> = ranges.collect();
    patches.sort_unstable();
    let open: Vec<Vec<PatchId>> = parts.into_iter().filter(|part| !part.is_closed).map(|part| part.patches).collect();
    // Of an open part one range is held, at nothing: the others are then determined, and what its even cycles tell of
    // common errors is used.
    let held = open.iter().flat_map(|part| part[1..].iter().copied());
    let columns: BTreeMap<PatchId, usize> =
        patches.iter().copied().chain(held).enumerate().map(|(column, patch)| (patch, column)).collect();
    let unknowns = columns.len();

    // Rows in standard deviations of their own error: ranges, common errors, right-hand side.
    let weight = |sum: &Sum| sum.length.variance_m2.sqrt().recip();
    let (mut rows, mut right) = (Matrix::zeros(sums.len(), unknowns), Matrix::zeros(sums.len(), 1));
    for (n, sum) in sums.iter().enumerate() {
        for patch in [sum.lit, sum.seen] {
            if let Some(&column) = columns.get(&patch) {
                rows[(n, column)] += weight(sum);
            }
        }
        right[(n, 0)] = weight(sum) * sum.length.length_m;
    }
    let common = Matrix::from_fn(sums.len(), errors, |n, k| weight(&sums[n]) * sums[n].common_m[k]);

    // With B the common errors, the covariance 1 + B B' has the inverse 1 - B (1 + B' B)^-1 B' (Woodbury).
    let product = |left: &Matrix, right: &Matrix| dense::product(left.transpose(), right.as_ref());
    let gram = product(&common, &common);
    let stiffness = Matrix::from_fn(errors, errors, |i, k| gram[(i, k)] + if i == k { 1.0 } else { 0.0 });
    let stiffness = dense::Definite::new(&stiffness).expect("a sum of squares and 1 is definite");
    let (of_rows, of_right) = (product(&common, &rows), product(&common, &right));
    let (mut through, mut through_right) = (of_rows.clone(), of_right.clone());
    stiffness.solve(&mut through);
    stiffness.solve(&mut through_right);
    let normal = product(&rows, &rows) - product(&of_rows, &through);
    let mut solution = product(&rows, &right) - product(&of_rows, &through_right);
    let squares = (product(&right, &right) - product(&of_right, &through_right))[(0, 0)];
    let inverse =
        dense::inverse(&normal).expect("closed parts, and open ones with one range held, determine all others");
    let explained = solution.clone();
    solution = dense::product(inverse.as_ref(), solution.as_ref());
    let levers = dense::product(inverse.as_ref(), through.transpose());
    let count = patches.len();
    Ranges {
        ranges_m: (0..count).map(|i| solution[(i, 0)]).collect(),
        covariance_m2: Matrix::from_fn(count, count, |i, k| inverse[(i, k)]),
        common_m: Matrix::from_fn(count, errors, |i, k| levers[(i, k)]),
        patches,
        open,
        chi2: (squares - product(&explained, &solution)[(0, 0)]).max(0.0),
        degrees_of_freedom: sums.len() - unknowns,
    }
}

/// The connected parts of the graph of sums, by their smallest patch.
fn parts(sums: &[Sum]) -> Vec<Part> {
    let mut neighbours: BTreeMap<PatchId, Vec<PatchId>> = BTreeMap::new();
    for sum in sums {
        neighbours.entry(sum.lit).or_default().push(sum.seen);
        neighbours.entry(sum.seen).or_default().push(sum.lit);
    }
    let mut sides: BTreeMap<PatchId, bool> = BTreeMap::new();
    let mut parts = Vec::new();
    for &first in neighbours.keys() {
        if sides.contains_key(&first) {
            continue;
        }
        sides.insert(first, true);
        let (mut patches, mut is_closed) = (vec![first], false);
        let mut next = 0;
        while let Some(&patch) = patches.get(next) {
            next += 1;
            let side = sides[&patch];
            for &neighbour in &neighbours[&patch] {
                // Two neighbours on one side close an odd cycle.
                if let Some(&other) = sides.get(&neighbour) {
                    is_closed |= other == side;
                } else {
                    sides.insert(neighbour, !side);
                    patches.push(neighbour);
                }
            }
        }
        patches.sort_unstable();
        parts.push(Part { patches, is_closed });
    }
    parts
}

#[cfg(test)]
mod tests;
