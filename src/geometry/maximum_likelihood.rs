//! Maximum likelihood on path lengths: all patches and delays at once, what photogrammetry calls bundle adjustment.
//!
//! Minimises over patch positions `z` and delays `t`
//!
//! ```text
//! sum_n rho((l_n - |path_n(z)| - t_n) / s_n) + sum_d (t_d / s_d)^2 + sum_a |z_a - anchor_a|^2 / s_a^2
//! ```
//!
//! by Levenberg-Marquardt with Huber's `rho` (quadratic to 3 standard deviations, then linear). The covariance is the pseudo-inverse of the Fisher
//! matrix without the rotations that no path length sees, so it is the Cramer-Rao bound at the solution. Delays have priors because first and
//! second bounces alone hardly determine a common delay. Not modelled: uncertainty of station positions, errors that onsets of one profile share.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::{Point, dense};

/// Steps after which a solution that has not settled is given up.
const STEPS: usize = 200;
/// A solution has settled when no coordinate moves further.
const SETTLED_M: f64 = 1e-11;
/// Standard deviations beyond which a residual counts linearly.
const HUBER: f64 = 3.0;
/// A rotation that changes no path by more than this (squared, relative to the stiffest direction) is free.
const FREE: f64 = 1e-10;

/// A point of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Node {
    /// A station: known.
    Station(Point),
    /// A patch, by its position among the unknowns.
    Patch(usize),
}

/// A measured path length.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Source, patches in the order light meets them, sensor.
    pub nodes: Vec<Node>,
    /// Measured length.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
    /// Delay that adds to it, by its position.
    pub delay: Option<usize>,
}

/// A patch whose position is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Patch, by its position among the unknowns.
    pub patch: usize,
    /// Where it is.
    pub position: Point,
    /// Standard deviation of each coordinate.
    pub sd_m: f64,
}

/// What is to be solved.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Where each patch is searched from.
    pub start: Vec<Point>,
    /// 3, or 2 for flatland, where z stays.
    pub dimensions: usize,
    /// Measurements.
    pub observations: Vec<Observation>,
    /// Known patches.
    pub anchors: Vec<Anchor>,
    /// Prior standard deviation of each delay, as a length; its mean is 0.
    pub delay_sd_m: Vec<f64>,
    /// Whether large residuals count linearly.
    pub robust: bool,
}

/// The solution.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Positions of the patches.
    pub points: Vec<Point>,
    /// Delays, as lengths.
    pub delays_m: Vec<f64>,
    /// Covariance of all coordinates (`dimensions` a patch, in order), then of the delays.
    pub covariance: Mat<f64>,
    /// Residual of each observation: measured minus predicted length.
    pub residuals_m: Vec<f64>,
    /// Sum of squared standardised residuals, priors included.
    pub chi2: f64,
    /// Measurements and priors less unknowns, free rotations given back.
    pub degrees_of_freedom: i64,
    /// Rotations that no measurement determines.
    pub free_rotations: usize,
    /// Dimensions of space.
    pub dimensions: usize,
}

impl Solution {
    /// Covariance of the coordinates of two patches; in flatland z has none.
    #[must_use]
    pub fn patch_covariance_m2(&self, a: usize, b: usize) -> Matrix3<f64> {
        let dimensions = self.dimensions;
        Matrix3::from_fn(|i, k| {
            if i < dimensions && k < dimensions {
                self.covariance[(a * dimensions + i, b * dimensions + k)]
            } else {
                0.0
            }
        })
    }

    /// Variance of a delay.
    #[must_use]
    pub fn delay_variance_m2(&self, delay: usize) -> f64 {
        let at = self.points.len() * self.dimensions + delay;
        self.covariance[(at, at)]
    }
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsolved {
    /// Too few measurements.
    #[error(
        "the path lengths leave more than rotations undetermined; the patches with the fewest (position among the unknowns, count) are {0:?}"
    )]
    Undetermined(Vec<(usize, usize)>),
    /// No minimum was reached.
    #[error("no minimum was reached in {STEPS} steps from this start")]
    NotSettled,
}

impl Problem {
    fn coordinates(&self) -> usize {
        self.start.len() * self.dimensions
    }

    fn unknowns(&self) -> usize {
        self.coordinates() + self.delay_sd_m.len()
    }

    fn check(&self) {
        assert!(self.dimensions == 2 || self.dimensions == 3, "space has 2 or 3 dimensions");
        for observation in &self.observations {
            assert!(
                observation.nodes.len() >= 2 && observation.sd_m > 0.0,
                "a path has two ends and a standard deviation"
            );
            assert!(observation.delay.is_none_or(|delay| delay < self.delay_sd_m.len()), "a delay has a prior");
        }
    }
}

/// Unknowns at one place.
#[derive(Clone)]
struct Place {
    points: Vec<Point>,
    delays_m: Vec<f64>,
}

impl Place {
    fn position(&self, node: Node) -> Point {
        match node {
            Node::Station(point) => point,
            Node::Patch(patch) => self.points[patch],
        }
    }

    fn moved(&self, step: &[f64], dimensions: usize) -> Self {
        let mut place = self.clone();
        for (patch, point) in place.points.iter_mut().enumerate() {
            for k in 0..dimensions {
                point[k] += step[patch * dimensions + k];
            }
        }
        let first = self.points.len() * dimensions;
        place.delays_m.iter_mut().zip(&step[first..]).for_each(|(delay, step)| *delay += step);
        place
    }
}

/// Predicted length of an observation.
fn predicted_m(observation: &Observation, place: &Place) -> f64 {
    let lengths = observation.nodes.windows(2).map(|ends| (place.position(ends[1]) - place.position(ends[0])).norm());
    lengths.sum::<f64>() + observation.delay.map_or(0.0, |delay| place.delays_m[delay])
}

/// Derivative of an observation's length: unknown, value; an unknown may come twice.
fn gradient(observation: &Observation, place: &Place, problem: &Problem, out: &mut Vec<(usize, f64)>) {
    out.clear();
    for ends in observation.nodes.windows(2) {
        let arm: Vector3<f64> = place.position(ends[1]) - place.position(ends[0]);
        // Ends that coincide pull nowhere.
        let direction = arm.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
        for (node, sign) in [(ends[0], -1.0), (ends[1], 1.0)] {
            if let Node::Patch(patch) = node {
                out.extend((0..problem.dimensions).map(|k| (patch * problem.dimensions + k, sign * direction[k])));
            }
        }
    }
    out.extend(observation.delay.map(|delay| (problem.coordinates() + delay, 1.0)));
}

/// Huber's loss of a standardised residual, and the weight of its square.
fn loss(residual: f64, robust: bool) -> (f64, f64) {
    let size = residual.abs();
    if robust && size > HUBER { (HUBER * (2.0 * size - HUBER), HUBER / size) } else { (size * size, 1.0) }
}

/// Objective, and where asked for the normal matrix and its right-hand side.
fn cost(problem: &Problem, place: &Place) -> f64 {
    let measured = problem
        .observations
        .iter()
        .map(|o| loss((o.length_m - predicted_m(o, place)) / o.sd_m, problem.robust).0)
        .sum::<f64>();
    measured + prior_cost(problem, place)
}

fn prior_cost(problem: &Problem, place: &Place) -> f64 {
    let delays: f64 = place.delays_m.iter().zip(&problem.delay_sd_m).map(|(delay, sd)| (delay / sd).powi(2)).sum();
    let anchors: f64 = problem
        .anchors
        .iter()
        .map(|anchor| {
            (0..problem.dimensions)
                .map(|k| ((place.points[anchor.patch][k] - anchor.position[k]) / anchor.sd_m).powi(2))
                .sum::<f64>()
        })
        .sum();
    delays + anchors
}

fn normal_equations(problem: &Problem, place: &Place) -> (Mat<f64>, Vec<f64>) {
    let size = problem.unknowns();
    let (mut normal, mut right) = (Mat::zeros(size, size), vec![0.0; size]);
    let mut terms = Vec::new();
    for observation in &problem.observations {
        let residual = (observation.length_m - predicted_m(observation, place)) / observation.sd_m;
        let weight = loss(residual, problem.robust).1 / (observation.sd_m * observation.sd_m);
        gradient(observation, place, problem, &mut terms);
        for &(i, a) in &terms {
            right[i] += weight * a * residual * observation.sd_m;
            for &(j, b) in &terms {
                normal[(i, j)] += weight * a * b;
            }
        }
    }
    for (d, sd_m) in problem.delay_sd_m.iter().enumerate() {
        let i = problem.coordinates() + d;
        normal[(i, i)] += 1.0 / (sd_m * sd_m);
        right[i] -= place.delays_m[d] / (sd_m * sd_m);
    }
    for anchor in &problem.anchors {
        for k in 0..problem.dimensions {
            let i = anchor.patch * problem.dimensions + k;
            normal[(i, i)] += 1.0 / (anchor.sd_m * anchor.sd_m);
            right[i] += (anchor.position[k] - place.points[anchor.patch][k]) / (anchor.sd_m * anchor.sd_m);
        }
    }
    (normal, right)
}

/// Solves the problem.
///
/// # Errors
/// When the measurements leave more than rotations open, or no minimum is reached.
///
/// # Panics
/// When an observation has fewer than two nodes or no standard deviation, or names a delay without prior.
pub fn solve(problem: &Problem) -> Result<Solution, Unsolved> {
    problem.check();
    let (place, _, settled) = descend(problem, STEPS, SETTLED_M);
    if settled { finish(problem, place) } else { Err(Unsolved::NotSettled) }
}

/// Where at most `steps` steps lead, with the objective there, without covariance: to judge many starts by.
///
/// # Panics
/// As [`solve`].
#[must_use]
pub fn approach(problem: &Problem, steps: usize, settled_m: f64) -> (Vec<Point>, f64) {
    problem.check();
    let (place, cost, _) = descend(problem, steps, settled_m);
    (place.points, cost)
}

/// Levenberg-Marquardt: the place reached, the objective there, and whether it has settled.
fn descend(problem: &Problem, steps: usize, settled_m: f64) -> (Place, f64, bool) {
    let mut place = Place { points: problem.start.clone(), delays_m: vec![0.0; problem.delay_sd_m.len()] };
    let mut now = cost(problem, &place);
    let mut damping = 1e-3;
    for _ in 0..steps {
        let (normal, right) = normal_equations(problem, &place);
        let scale = (0..normal.nrows()).map(|i| normal[(i, i)]).fold(0.0, f64::max);
        let damped = Mat::from_fn(normal.nrows(), normal.nrows(), |i, j| {
            // The floor keeps rotations, which have no stiffness of their own, from blowing up.
            normal[(i, j)] + if i == j { damping * normal[(i, i)] + 1e-9 * damping.max(1e-3) * scale } else { 0.0 }
        });
        let Some(step) = dense::solve(&damped, &right) else {
            damping *= 10.0;
            continue;
        };
        let trial = place.moved(&step, problem.dimensions);
        let then = cost(problem, &trial);
        let longest = step.iter().fold(0.0, |most: f64, step| most.max(step.abs()));
        if then <= now {
            place = trial;
            now = then;
            damping = (damping * 0.1).max(1e-12);
            if longest < settled_m {
                return (place, now, true);
            }
        } else if longest < settled_m || damping > 1e12 {
            return (place, now, true);
        } else {
            damping *= 10.0;
        }
    }
    (place, now, false)
}

fn finish(problem: &Problem, place: Place) -> Result<Solution, Unsolved> {
    let (fisher, _) = normal_equations(problem, &place);
    let nulls = free_rotations(problem, &place, &fisher);
    let covariance = dense::pseudo_inverse(&fisher, &nulls)
        .filter(|covariance| (0..covariance.nrows()).all(|i| covariance[(i, i)].is_finite()));
    let covariance = covariance.ok_or_else(|| undetermined(problem))?;
    let residuals_m: Vec<f64> = problem.observations.iter().map(|o| o.length_m - predicted_m(o, &place)).collect();
    let measured: f64 =
        residuals_m.iter().zip(&problem.observations).map(|(residual, o)| (residual / o.sd_m).powi(2)).sum();
    let data = problem.observations.len() + problem.delay_sd_m.len() + problem.dimensions * problem.anchors.len();
    Ok(Solution {
        chi2: measured + prior_cost(problem, &place),
        degrees_of_freedom: data as i64 - problem.unknowns() as i64 + nulls.ncols() as i64,
        free_rotations: nulls.ncols(),
        dimensions: problem.dimensions,
        points: place.points,
        delays_m: place.delays_m,
        covariance,
        residuals_m,
    })
}

/// Patches that the fewest paths touch.
fn undetermined(problem: &Problem) -> Unsolved {
    let touches = |patch: usize| problem.observations.iter().filter(|o| o.nodes.contains(&Node::Patch(patch))).count();
    let mut counts: Vec<(usize, usize)> = (0..problem.start.len()).map(|patch| (patch, touches(patch))).collect();
    counts.sort_by_key(|&(patch, count)| (count, patch));
    counts.truncate(5);
    Unsolved::Undetermined(counts)
}

/// Orthonormal directions of the unknowns that rotate all patches about the first station and change no path: three for stations in one point, one about
/// their line, none otherwise.
fn free_rotations(problem: &Problem, place: &Place, fisher: &Mat<f64>) -> Mat<f64> {
    let stations = problem.observations.iter().flat_map(|o| &o.nodes).find_map(|node| match node {
        Node::Station(point) => Some(*point),
        Node::Patch(_) => None,
    });
    let Some(centre) = stations else {
        return Mat::zeros(fisher.nrows(), 0);
    };
    let axes: &[Vector3<f64>] = if problem.dimensions == 3 {
        &[Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)]
    } else {
        &[Vector3::new(0.0, 0.0, 1.0)]
    };
    let generator = |axis: &Vector3<f64>| -> Vec<f64> {
        let mut direction = vec![0.0; fisher.nrows()];
        for (patch, point) in place.points.iter().enumerate() {
            let motion = axis.cross(&(point - centre));
            direction[patch * problem.dimensions..(patch + 1) * problem.dimensions]
                .copy_from_slice(&motion.as_slice()[..problem.dimensions]);
        }
        direction
    };
    let generators: Vec<Vec<f64>> = axes.iter().map(generator).collect();
    let columns = Mat::from_fn(fisher.nrows(), axes.len(), |i, k| generators[k][i]);
    // In the span of the generators: how much motion, and how much stiffness.
    let motion = dense::product(columns.transpose(), columns.as_ref());
    let (sizes, turns) = dense::symmetric_eigen(&motion);
    let largest = sizes.last().copied().unwrap_or(0.0);
    let kept: Vec<usize> = (0..axes.len()).filter(|&k| sizes[k] > 1e-12 * largest && largest > 0.0).collect();
    let basis = Mat::from_fn(fisher.nrows(), kept.len(), |i, k| {
        (0..axes.len()).map(|a| columns[(i, a)] * turns[(a, kept[k])]).sum::<f64>() / sizes[kept[k]].sqrt()
    });
    let stiffness = dense::product(basis.transpose(), dense::product(fisher.as_ref(), basis.as_ref()).as_ref());
    if kept.is_empty() {
        return Mat::zeros(fisher.nrows(), 0);
    }
    let (values, vectors) = dense::symmetric_eigen(&stiffness);
    let scale = (0..fisher.nrows()).map(|i| fisher[(i, i)]).fold(0.0, f64::max);
    let free: Vec<usize> = (0..kept.len()).filter(|&k| values[k] < FREE * scale).collect();
    Mat::from_fn(fisher.nrows(), free.len(), |i, k| {
        (0..kept.len()).map(|b| basis[(i, b)] * vectors[(b, free[k])]).sum()
    })
}

#[cfg(test)]
mod tests;
