//! Something undeclared in the middle between two strips, whose light has onsets of its own.

use nalgebra::DMatrix;

use super::{Bounce, Problem, Solution, Strip, Surface, solve_alone};

/// Chi-square that an onset costs which nothing explains.
const UNEXPLAINED: f64 = 9.0;

/// Places of the strips beside something in the middle between two of them, over the exit of either: the likeliest such, where it explains more than `alone` does.
pub(super) fn beside_one(problem: &Problem, alone: Option<&Solution>) -> Option<Vec<Solution>> {
    let cost = |solution: &Solution| solution.chi2 - UNEXPLAINED * explained(solution);
    if problem
        .records
        .iter()
        .all(|record| record.bounce == Bounce::First || record.lengths_m.len() <= problem.strips.len())
    {
        return None;
    }
    let mut best = None;
    let mut least = alone.map_or(f64::INFINITY, cost);
    for behind in 1..problem.strips.len() {
        for neighbour in [behind - 1, behind] {
            let mut crowded = problem.clone();
            let exit = problem.strips[neighbour].exit;
            crowded.strips.insert(behind, Strip { exit, surface: Surface::Diffuse, is_central: true });
            let Ok(found) = solve_alone(&crowded) else { continue };
            if cost(&found[0]) < least {
                least = cost(&found[0]);
                best = Some(found.iter().map(|solution| solution.without(behind)).collect());
            }
        }
    }
    best
}

/// How many onsets it explains.
fn explained(solution: &Solution) -> f64 {
    solution.labels.iter().map(|(_, onsets)| onsets.len() as f64).sum()
}

impl Solution {
    /// The same without one of the strips.
    fn without(&self, strip: usize) -> Self {
        let place = |k: usize| if k < 3 * strip { k } else { k + 3 };
        let size = self.covariance_m2.nrows() - 3;
        let mut left = self.clone();
        left.points.remove(strip);
        left.covariance_m2 = DMatrix::from_fn(size, size, |r, c| self.covariance_m2[(place(r), place(c))]);
        left.labels.iter_mut().for_each(|(_, onsets)| {
            onsets.remove(strip);
        });
        left
    }
}
