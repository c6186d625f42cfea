//! Maximum likelihood on path lengths: patches, stations, delays and the laser's period at once, what photogrammetry
//! calls bundle adjustment.
//!
//! Minimises over patches `z`, stations `w`, delays `t`, the period's error `p` and common errors `c`
//!
//! ```text
//! sum_n rho((l_n - |path_n(z, w)| - t_n + turns_n p - sum_k a_nk c_k) / s_n)
//!   + sum_a |z_a - anchor_a|^2 / s_a^2 + sum_r |direction(z_r - w_r) - ray_r|^2 / s_r^2
//!   + sum_k |w_k - station_k|^2 / s_k^2 + t' C^-1 t + (p / s_p)^2 + |c|^2
//! ```
//!
//! by Levenberg-Marquardt with a robust `rho` ([`super::loss`]; Huber's as a rule). Up to [`DENSE_MAX`] patches the
//! normal matrix is in memory; beyond, its products are passes over the observations (`matrix_free`), with the bending
//! of paths where steps overshoot without it. The covariance is the pseudo-inverse of the Fisher matrix without the
//! rotations that no path length sees: the Cramer-Rao bound at the solution. A matrix-free solution has blocks of it
//! ([`Solution::is_exact`]).
//!
//! Observations may also share errors that are no unknowns ([`shares`]); the squared terms are then those of residuals
//! made independent within each group that shares some.
//!
//! The solution names what nothing determines: parts that share no path, rotations, and patches that can move freely.
//! It does not see a mirror image or another minimum that explains the lengths as well.

mod dense_steps;
mod freedom;
mod groups;
mod matrix_free;
mod outliers;
mod problem;
mod rows;
mod shares;
mod solution;

use faer::Mat;
use matrix_free::Matrix;

use super::loss::{HUBER, Loss};
pub use outliers::outliers;
pub use problem::{Anchor, Node, Observation, Problem, Ray, Station};
use rows::Rows;
pub use rows::Values;
pub use shares::shares;
use solution::Covariance;
pub use solution::Solution;

/// Most patches for which the normal matrix is held in memory: 72 MB for 3,000 coordinates. One factorisation of it is
/// a single call, which a cancel cannot end midway.
pub const DENSE_MAX: usize = 1000;
/// Steps after which a solution that has not settled is given up.
const STEPS: usize = 1000;
/// Steps that lower the objective by less than this share of it lead nowhere; after `IDLE_STEPS` of them a solution has
/// settled too, in a flat valley.
const IDLE: f64 = 1e-12;
const IDLE_STEPS: usize = 10;
/// A step that lowers the objective by less than this share is near the minimum.
const NEAR: f64 = 0.01;
/// A solution has settled when no unknown moves further.
const SETTLED_M: f64 = 1e-11;
/// The same without the normal matrix, whose steps are inexact.
const SETTLED_MATRIX_FREE_M: f64 = 1e-8;

/// The 99.9 % point of a normal distribution.
const BY_CHANCE_SD: f64 = 3.090_232;
/// Where nearly all measurements contradict one another, nothing more can be said of variances.
const INSIDE_MIN: f64 = 0.01;

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsolved {
    /// Too few measurements.
    #[error(
        "the path lengths leave positions undetermined; the patches with the fewest (position among the unknowns, count) are {0:?}"
    )]
    Undetermined(Vec<(usize, usize)>),
    /// No minimum was reached.
    #[error("no minimum was reached in {STEPS} steps from this start")]
    NotSettled,
}

/// How steps are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Means {
    Dense,
    MatrixFree(Matrix),
}

impl Means {
    fn of(problem: &Problem) -> Self {
        if problem.start.len() <= DENSE_MAX { Self::Dense } else { Self::MatrixFree(Matrix::Normal) }
    }

    fn step(self, rows: &Rows, values: &Values, damping: f64) -> Option<Vec<f64>> {
        match self {
            Self::Dense => dense_steps::step(rows, values, damping),
            Self::MatrixFree(matrix) => matrix_free::step(rows, values, matrix, damping),
        }
    }

    fn cost(self, rows: &Rows, values: &Values) -> f64 {
        match self {
            Self::Dense => rows.cost(values, 0..rows.count),
            Self::MatrixFree(_) => matrix_free::cost(rows, values),
        }
    }
}

/// The 99.9 % point of chi-square: a right model stays below it in all but one campaign of a thousand. By the cube root
/// of chi-square, which is nearly normal (Wilson and Hilferty, PNAS 17:684, 1931).
#[must_use]
pub fn by_chance(degrees_of_freedom: f64) -> f64 {
    let freedom = degrees_of_freedom.max(1.0);
    let share = 2.0 / (9.0 * freedom);
    freedom * (1.0 - share + BY_CHANCE_SD * share.sqrt()).powi(3)
}

/// Factor on variances by residuals in standard deviations: that of an M-estimator (Huber, Robust Statistics, 1981,
/// section 7.6),
///
/// ```text
/// (sum psi^2 / degrees of freedom) / (mean psi')^2
/// ```
///
/// if the sum is beyond the 99.9 % point of chi-square; else 1. With the squared loss it is chi-square over its degrees
/// of freedom (Birge's ratio). With others psi ends where Huber's loss becomes linear, so that a few gross errors do
/// not make all others larger.
fn misfit(residuals: &[f64], loss: Loss, degrees_of_freedom: i64) -> f64 {
    if degrees_of_freedom < 1 {
        return 1.0;
    }
    let most = if loss == Loss::Squared { f64::INFINITY } else { HUBER };
    let sum: f64 = residuals.iter().map(|residual| residual.abs().min(most).powi(2)).sum();
    if sum <= by_chance(degrees_of_freedom as f64) {
        return 1.0;
    }
    let inside = residuals.iter().filter(|residual| residual.abs() <= most).count() as f64 / residuals.len() as f64;
    sum / degrees_of_freedom as f64 / (inside * inside).max(INSIDE_MIN)
}

/// Solves the problem.
///
/// # Errors
/// When no minimum is reached; when positions are undetermined and the scene is too large to find out which.
///
/// # Panics
/// When the problem contradicts itself: a path of fewer than two nodes, a standard deviation that is not positive, a
/// station or delay that is not there.
pub fn solve(problem: &Problem) -> Result<Solution, Unsolved> {
    solve_by(problem, Means::of(problem))
}

fn solve_by(problem: &Problem, means: Means) -> Result<Solution, Unsolved> {
    let rows = Rows::new(problem);
    let settled_m = if means == Means::Dense { SETTLED_M } else { SETTLED_MATRIX_FREE_M };
    let (values, loss, settled) = descend(&rows, means, STEPS, settled_m);
    if settled {
        return finish(&rows, means, values, loss);
    }
    if means != Means::Dense {
        return Err(Unsolved::NotSettled);
    }
    // Patches that nothing determines slide on without end: the others are settled without them.
    let open = finish(&rows, means, values.clone(), loss)?.open;
    if open.is_empty() {
        return Err(Unsolved::NotSettled);
    }
    let is_open = |node: &Node| node.patch().is_some_and(|patch| open.contains(&patch));
    let kept = problem.observations.iter().filter(|observation| !observation.nodes.iter().any(is_open));
    let rest = Problem { start: values.points.clone(), observations: kept.cloned().collect(), ..problem.clone() };
    let (others, _, settled) = descend(&Rows::new(&rest), means, STEPS, settled_m);
    if !settled {
        return Err(Unsolved::NotSettled);
    }
    let mut values = Values { stations: others.stations, delays_m: others.delays_m, ..values };
    for (patch, point) in others.points.into_iter().enumerate().filter(|(patch, _)| !open.contains(patch)) {
        values.points[patch] = point;
    }
    let loss = means.cost(&rows, &values);
    finish(&rows, means, values, loss)
}

/// Where at most `steps` steps lead, with the objective there, without covariance: to judge many starts by.
///
/// # Panics
/// As [`solve`].
#[must_use]
pub fn approach(problem: &Problem, steps: usize, settled_m: f64) -> (Values, f64) {
    let (values, cost, _) = descend(&Rows::new(problem), Means::of(problem), steps, settled_m);
    (values, cost)
}

/// Measurements and priors less unknowns; what nothing determines is not given back.
///
/// # Panics
/// As [`solve`].
#[must_use]
pub fn redundancy(problem: &Problem) -> i64 {
    let rows = Rows::new(problem);
    rows.data as i64 - rows.layout.size as i64
}

/// Levenberg-Marquardt: the place reached, the objective there, and whether it has settled.
fn descend(rows: &Rows, mut means: Means, steps: usize, settled_m: f64) -> (Values, f64, bool) {
    let mut values = Values::start(rows.problem);
    let mut now = means.cost(rows, &values);
    let (mut damping, mut idle, mut gained) = (1e-3, 0, f64::INFINITY);
    for _ in 0..steps {
        rows.problem.cancel.check();
        let Some(step) = means.step(rows, &values, damping) else {
            damping *= 10.0;
            continue;
        };
        let trial = values.moved(&step, &rows.layout);
        let then = means.cost(rows, &trial);
        let longest = step.iter().fold(0.0, |most: f64, step| most.max(step.abs()));
        if then <= now {
            idle = if now - then <= IDLE * now { idle + 1 } else { 0 };
            gained = (now - then) / now;
            values = trial;
            now = then;
            damping = (damping * 0.1).max(1e-12);
            if longest < settled_m || idle >= IDLE_STEPS {
                return (values, now, true);
            }
        } else if longest < settled_m || damping > 1e12 {
            return (values, now, true);
        } else {
            damping *= 10.0;
            if gained < NEAR && means == Means::MatrixFree(Matrix::Normal) {
                means = Means::MatrixFree(Matrix::Bent);
            }
        }
    }
    (values, now, false)
}

fn finish(rows: &Rows, means: Means, values: Values, loss: f64) -> Result<Solution, Unsolved> {
    let problem = rows.problem;
    let parts = freedom::parts(problem);
    let stiffest = stiffest(rows, &values);
    let turns: Vec<Vec<Vec<f64>>> =
        parts.iter().map(|part| freedom::free_rotations(rows, &values, part, stiffest)).collect();
    let nulls: Vec<Vec<f64>> = turns.iter().flatten().cloned().collect();
    let (mut open, mut loose) = (Vec::new(), 0);
    let covariance = match means {
        Means::MatrixFree(_) => {
            let (blocks, others) = matrix_free::covariance(rows, &values).ok_or_else(|| undetermined(problem))?;
            Covariance::Blocks(blocks, others)
        }
        Means::Dense => loop {
            problem.cancel.check();
            let nulls = freedom::without(&nulls, rows, &open);
            let columns = Mat::from_fn(rows.layout.size, nulls.len(), |i, k| nulls[k][i]);
            match dense_steps::covariance(rows, &values, &columns, &open) {
                Ok(covariance) => break Covariance::Exact(freedom::about_visible(rows, covariance, &columns)),
                Err(motions) => {
                    let (more, free) = motions.ok_or_else(|| undetermined(problem))?;
                    let new = freedom::open(rows, &values, &free, &nulls, &parts, &open);
                    if open.is_empty() {
                        loose = more;
                    }
                    if new.is_empty() {
                        return Err(undetermined(problem));
                    }
                    open.extend(new);
                    open.sort_unstable();
                }
            }
        },
    };
    let predicted_variance_m2 = match &covariance {
        Covariance::Exact(covariance) => Some(predicted_variances_m2(rows, &values, covariance, &open)),
        Covariance::Blocks(..) => None,
    };
    let residuals: Vec<f64> = (0..rows.count).map(|n| rows.residual(&values, n, None)).collect();
    let degrees_of_freedom = rows.data as i64 - rows.layout.size as i64 + (nulls.len() + loose) as i64;
    Ok(Solution {
        chi2: residuals.iter().map(|residual| residual * residual).sum(),
        misfit: misfit(&residuals, problem.loss, degrees_of_freedom),
        loss,
        predicted_variance_m2,
        residuals_m: (0..problem.observations.len()).map(|n| rows.residual_m(&values, n)).collect(),
        degrees_of_freedom,
        free_rotations: turns.iter().map(Vec::len).collect(),
        parts,
        open,
        points: values.points,
        stations: values.stations,
        delays_m: values.delays_m,
        period_m: values.period_m,
        common: values.common,
        layout: rows.layout.clone(),
        covariance,
    })
}

fn predicted_variances_m2(rows: &Rows, values: &Values, covariance: &Mat<f64>, open: &[usize]) -> Vec<f64> {
    let mut terms = Vec::new();
    let mut variance = |(n, observation): (usize, &Observation)| {
        if observation.nodes.iter().any(|node| matches!(node, Node::Patch(patch) if open.contains(patch))) {
            return f64::INFINITY;
        }
        rows.problem.cancel.check();
        terms.clear();
        rows.path(values, n, 1.0, &mut terms);
        let pairs = terms.iter().flat_map(|a| terms.iter().map(move |b| (a, b)));
        pairs.map(|(&(i, a), &(j, b))| a * covariance[(i, j)] * b).sum()
    };
    rows.problem.observations.iter().enumerate().map(&mut variance).collect()
}

/// About the largest stiffness of a single unknown.
fn stiffest(rows: &Rows, values: &Values) -> f64 {
    let (mut diagonal, mut terms) = (vec![0.0; rows.layout.size], Vec::new());
    for n in 0..rows.count {
        rows.residual(values, n, Some(&mut terms));
        terms.iter().for_each(|&(i, a)| diagonal[i] += a * a);
    }
    diagonal.into_iter().take(rows.layout.coordinates).fold(0.0, f64::max)
}

/// Patches that the fewest paths touch.
fn undetermined(problem: &Problem) -> Unsolved {
    let mut counts: Vec<(usize, usize)> = (0..problem.start.len()).map(|patch| (patch, 0)).collect();
    for observation in &problem.observations {
        let mut patches: Vec<usize> = observation.nodes.iter().filter_map(Node::patch).collect();
        patches.sort_unstable();
        patches.dedup();
        patches.into_iter().for_each(|patch| counts[patch].1 += 1);
    }
    counts.sort_by_key(|&(patch, count)| (count, patch));
    counts.truncate(5);
    Unsolved::Undetermined(counts)
}

#[cfg(test)]
mod tests;
