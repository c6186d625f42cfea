//! Something undeclared in the middle between two strips, whose light has onsets of its own.

use nalgebra::DMatrix;

use super::{Bounce, Problem, Solution, Strip, Surface, UNEXPLAINED, solve_alone};

/// Places of the strips, fitted together with an object in the middle between two of them, seen over the exit of
/// either. The likeliest such places, if they explain more than `alone` does.
pub(super) fn beside_one(problem: &Problem, alone: Option<&Solution>) -> Option<Vec<Solution>> {
    let strips = problem.strips.len();
    let thirds = || problem.records.iter().enumerate().filter(|(_, record)| record.bounce == Bounce::Third);
    if thirds().all(|(_, record)| record.lengths_m.len() <= strips) {
        return None;
    }
    // Records without an onset for everything are left out, which explains nothing of them.
    let cost = |solution: &Solution| {
        let is_left_out = |record: usize| solution.labels.iter().all(|(other, _)| *other != record);
        let left_out = thirds().filter(|(n, _)| is_left_out(*n)).map(|(_, record)| record.lengths_m.len());
        solution.cost + UNEXPLAINED * left_out.sum::<usize>() as f64
    };
    let (mut best, mut least) = (None, alone.map_or(f64::INFINITY, cost));
    for behind in 1..strips {
        for neighbour in [behind - 1, behind] {
            let mut crowded = problem.clone();
            let exit = problem.strips[neighbour].exit;
            crowded.strips.insert(behind, Strip { exit, surface: Surface::Diffuse, is_central: true });
            let Ok(solutions) = solve_alone(&crowded) else { continue };
            if cost(&solutions[0]) < least {
                least = cost(&solutions[0]);
                best = Some(solutions.iter().map(|solution| solution.without(behind)).collect());
            }
        }
    }
    best
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
