//! Hidden strips from bistatic path lengths: source to lit point, to strip, to exit point, to sensor (paper section 6,
//! figure 8 bottom).
//!
//! Every scan lights another diffuser point D_k. The light of one strip P comes back over one diffuser point of its
//! own, its exit E: the measured length less the known legs is `|D_k P| + |P E|`, so P lies on K ellipses (in space:
//! spheroids) with foci D_k and E. Arrivals of all strips stand in one profile, and which is whose is not known: every
//! assignment is a hypothesis.
//!
//! - *Start*: all ellipses share the focus E, which makes their equations linear in P and its distance from E (as in
//!   Bancroft, IEEE Trans. Aerosp. Electron. Syst. 21, 56
//!   (1985)); what is left is a quadratic equation with two roots. Where all foci lie in one line these are mirror
//!   images in it.
//! - *Fit*: maximum likelihood by Gauss and Newton. Anchors (diffuser points, stations) and delays that have a standard
//!   deviation are fitted too; first bounces help to determine them. Onsets of one profile are correlated, as pulses
//!   closer than the response are.
//! - *Labels*: assignments are extended scan by scan, the likeliest first. Another scan never lowers chi-square or the
//!   cost of unexplained onsets. So the first complete assignment is the best of all, and no other within [`CLOSE`] of
//!   it is missed (branch and bound).
//! - *Glints*: over a glossy strip the light's centroid moves with the lit point.
//!
//! With as many scans as dimensions every assignment fits exactly. What then decides is what else is known: on which
//! side of the diffuser strips are, how far apart at most, in which order. What nothing decides comes back as another
//! solution.
//!
//! Onsets that no strip explains may be those of an undeclared object in the middle between two strips. Where that
//! explains more, strips are placed together with such an object.

mod fit;
mod glint;
mod middle;
mod start;

use nalgebra::{DMatrix, Matrix3, Vector3};
use periscope_cancel::Cancel;
use thiserror::Error;

use super::Point;
use fit::{Fit, State, fit};
pub use glint::Surface;

/// Solutions whose chi-square is higher by less are reported too.
pub const CLOSE: f64 = 9.0;
/// Chi-square that an onset costs which nothing explains, if it is as strong as those that something does.
const UNEXPLAINED: f64 = 9.0;
/// Two places whose squared distance in standard deviations is less are one.
const SAME: f64 = 9.0;
/// Fits at most.
const FITS_MAX: usize = 50_000;

/// A point that is known, exactly or to a standard deviation of each coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// Where it is.
    pub at: Point,
    /// Standard deviation of each coordinate, m; 0: exact.
    pub sd_m: f64,
    /// Unit vector towards the side on which strips are, where that is known.
    pub normal: Option<Vector3<f64>>,
}

/// A strip to be placed.
#[derive(Clone, Copy, Debug)]
pub struct Strip {
    /// Anchor over which its light leaves.
    pub exit: usize,
    /// How it reflects.
    pub surface: Surface,
    /// Whether it stands in the middle between the strips before and behind it, about.
    pub is_central: bool,
}

/// Which bounces the onsets of a record are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bounce {
    /// The first, off the lit point: one onset.
    First,
    /// The third, over strips: at least one onset a strip.
    Third,
}

/// Onsets of one profile.
#[derive(Clone, Debug)]
pub struct ProfileOnsets {
    /// Anchor that is lit.
    pub lit: usize,
    /// Anchor where the sensor stands.
    pub station: usize,
    /// The sensor's delay.
    pub delay: usize,
    /// Which bounces they are.
    pub bounce: Bounce,
    /// Path lengths, m.
    pub lengths_m: Vec<f64>,
    /// Their covariance, m^2, delays left out.
    pub covariance_m2: DMatrix<f64>,
    /// Their amplitudes, in any unit.
    pub heights: Vec<f64>,
}

/// What was measured and what is known.
#[derive(Clone, Debug)]
pub struct Problem {
    /// 2 for flatland (z = 0), or 3.
    pub dimensions: usize,
    /// Where light leaves.
    pub source: Point,
    /// Diffuser points and stations.
    pub anchors: Vec<Anchor>,
    /// Standard deviation of each sensor's delay about 0, as a length, m.
    pub delays_sd_m: Vec<f64>,
    /// Strips.
    pub strips: Vec<Strip>,
    /// Profiles.
    pub records: Vec<ProfileOnsets>,
    /// No two strips are farther apart, where that is known.
    pub apart_max_m: Option<f64>,
    /// Direction in which the strips follow one another in their order, where that is known.
    pub along: Option<Vector3<f64>>,
    /// Ends the solution: polled once a step of a fit.
    pub cancel: Cancel,
}

/// Places of all strips.
#[derive(Clone, Debug)]
pub struct Solution {
    /// One a strip.
    pub points: Vec<Point>,
    /// Covariance of all coordinates, strip by strip, x, y and z of each, m^2.
    pub covariance_m2: DMatrix<f64>,
    /// Weighted squares left over, priors included.
    pub chi2: f64,
    /// The same, and what onsets cost that no strip explains: what solutions compare by.
    pub cost: f64,
    /// Their expected number.
    pub degrees_of_freedom: usize,
    /// Of each record of third bounces: its place among the records, and the onset of each strip.
    pub labels: Labels,
    /// The anchors as adjusted, and their covariances, m^2.
    pub anchors: Vec<(Point, Matrix3<f64>)>,
    /// The delays as found, m.
    pub delays_m: Vec<f64>,
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Unsolved {
    /// Too few scans with an onset for every strip.
    #[error("{scans} scans have an onset for every strip, and {needed} are needed")]
    TooFew {
        /// Scans.
        scans: usize,
        /// Needed.
        needed: usize,
    },
    /// In space, all foci in one line.
    #[error("the diffuser points lie in one line, which leaves strips free to turn about it")]
    InLine,
    /// No assignment has a place that agrees with what is known.
    #[error(
        "no assignment of onsets to strips has places on the known side of the diffuser, within the known distance and in the known order"
    )]
    NoPlace,
    /// Too many assignments.
    #[error("more assignments of onsets to strips are about as likely than can be tried")]
    TooMany,
}

impl Solution {
    /// Covariance of strips `a` (rows) and `b` (columns), m^2.
    #[must_use]
    pub fn covariance_of(&self, a: usize, b: usize) -> Matrix3<f64> {
        self.covariance_m2.fixed_view::<3, 3>(3 * a, 3 * b).into_owned()
    }
}

/// Records, and the onset of each strip.
pub type Labels = Vec<(usize, Vec<usize>)>;

/// An assignment of the first scans, and its fit.
struct Node {
    labels: Labels,
    fit: Fit,
    cost: f64,
}

impl Node {
    fn new(problem: &Problem, labels: Labels, start: &State) -> Option<Self> {
        let fit = fit(problem, &labels, start)?;
        let cost = fit.chi2 + problem.unexplained(&labels);
        Some(Self { labels, fit, cost })
    }
}

/// All solutions that are about as likely as the best, the best first.
///
/// # Errors
/// When there is none.
///
/// # Panics
/// When a record or strip names an anchor or delay that is not there.
pub fn solve(problem: &Problem) -> Result<Vec<Solution>, Unsolved> {
    let alone = solve_alone(problem);
    middle::beside_one(problem, alone.as_ref().ok().map(|solutions| &solutions[0])).map_or(alone, Ok)
}

/// Nothing but the strips.
fn solve_alone(problem: &Problem) -> Result<Vec<Solution>, Unsolved> {
    let needed = problem.dimensions;
    let thirds = problem.spread_out();
    if thirds.len() < needed {
        return Err(Unsolved::TooFew { scans: thirds.len(), needed });
    }
    if problem.dimensions == 3 && problem.is_in_line(&thirds) {
        return Err(Unsolved::InLine);
    }
    let choices: Vec<Vec<Vec<usize>>> = thirds
        .iter()
        .map(|record| assignments(problem.records[*record].lengths_m.len(), problem.strips.len()))
        .collect();
    let (mut open, mut fits) = (Vec::new(), 0);
    for labels in combinations(&choices[..needed]) {
        let labels: Labels = thirds.iter().copied().zip(labels).collect();
        for points in start::places(problem, &labels) {
            fits += 1;
            open.extend(Node::new(problem, labels.clone(), &State::new(problem, points)));
        }
        if fits > FITS_MAX {
            return Err(Unsolved::TooMany);
        }
    }
    let mut solutions: Vec<Solution> = Vec::new();
    while let Some(next) = (0..open.len()).min_by(|a, b| open[*a].cost.total_cmp(&open[*b].cost)) {
        let node = open.swap_remove(next);
        if solutions.first().is_some_and(|best| node.cost > best.cost + CLOSE) {
            break;
        }
        let depth = node.labels.len();
        if depth < thirds.len() {
            for choice in &choices[depth] {
                let mut labels = node.labels.clone();
                labels.push((thirds[depth], choice.clone()));
                fits += 1;
                open.extend(Node::new(problem, labels, &node.fit.state));
            }
            if fits > FITS_MAX {
                return Err(Unsolved::TooMany);
            }
        } else if problem.admits(&node.fit.state.strips) {
            let solution = node.fit.solution(problem, node.labels, node.cost);
            if solutions.iter().all(|other| !is_same_place(other, &solution, problem.dimensions)) {
                solutions.push(solution);
            }
        }
    }
    if solutions.is_empty() { Err(Unsolved::NoPlace) } else { Ok(solutions) }
}

impl Problem {
    /// Records of third bounces with an onset for every strip, each lit point as far as possible from those before: the
    /// first few say most.
    fn spread_out(&self) -> Vec<usize> {
        let is_whole =
            |record: &ProfileOnsets| record.bounce == Bounce::Third && record.lengths_m.len() >= self.strips.len();
        let mut left: Vec<usize> = (0..self.records.len()).filter(|n| is_whole(&self.records[*n])).collect();
        let mut taken: Vec<usize> = Vec::new();
        let lit = |record: usize| self.anchors[self.records[record].lit].at;
        while !left.is_empty() {
            let gap_m = |record: usize| {
                let gaps_m = taken.iter().map(|other| (lit(record) - lit(*other)).norm());
                gaps_m.fold(f64::INFINITY, f64::min)
            };
            // The first of equals.
            let next = (0..left.len()).rev().max_by(|a, b| gap_m(left[*a]).total_cmp(&gap_m(left[*b])));
            taken.push(left.remove(next.expect("some are left")));
        }
        taken
    }

    /// Whether the lit points and any strip's exit leave a turn about a line.
    fn is_in_line(&self, thirds: &[usize]) -> bool {
        self.strips.iter().any(|strip| {
            let exit = &self.anchors[strip.exit];
            let arms = thirds.iter().map(|record| {
                let lit = &self.anchors[self.records[*record].lit];
                (lit.at - exit.at, lit.sd_m.max(exit.sd_m))
            });
            let mut spread = Matrix3::zeros();
            let (mut far_m, mut sd_m) = (0.0_f64, 0.0_f64);
            for (arm, arm_sd_m) in arms {
                spread += arm * arm.transpose();
                (far_m, sd_m) = (far_m.max(arm.norm()), sd_m.max(arm_sd_m));
            }
            let mut across: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
            across.sort_by(f64::total_cmp);
            across[1].max(0.0).sqrt() < (3.0 * sd_m).max(1e-6 * far_m)
        })
    }

    /// Cost of the onsets of these records that no strip explains. It grows with their amplitude over that of the
    /// weakest explained onset, as strays are weak.
    fn unexplained(&self, labels: &Labels) -> f64 {
        let of_record = |(record, onsets): &(usize, Vec<usize>)| {
            let heights = &self.records[*record].heights;
            let weakest = onsets.iter().map(|onset| heights[*onset]).fold(f64::INFINITY, f64::min);
            let left = (0..heights.len()).filter(|onset| !onsets.contains(onset));
            left.map(|onset| UNEXPLAINED * (heights[onset] / weakest).min(1.0)).sum::<f64>()
        };
        labels.iter().map(of_record).sum()
    }

    /// Whether places agree with what is known of sides, distances and order.
    fn admits(&self, strips: &[Point]) -> bool {
        let is_near = |limit_m: f64| {
            strips.iter().enumerate().all(|(n, a)| strips[n + 1..].iter().all(|b| (a - b).norm() <= limit_m))
        };
        let follow = |along: Vector3<f64>| strips.windows(2).all(|pair| along.dot(&(pair[1] - pair[0])) > 0.0);
        strips.iter().all(|point| self.is_in_front(point))
            && self.apart_max_m.is_none_or(is_near)
            && self.along.is_none_or(follow)
    }

    /// Whether a place is on the known side of all anchors.
    fn is_in_front(&self, point: &Point) -> bool {
        let is_before = |anchor: &Anchor| anchor.normal.is_none_or(|normal| normal.dot(&(point - anchor.at)) > 0.0);
        self.anchors.iter().all(is_before)
    }
}

/// Whether two solutions place all strips alike.
fn is_same_place(a: &Solution, b: &Solution, dimensions: usize) -> bool {
    let places: Vec<usize> =
        (0..a.points.len()).flat_map(|strip| (0..dimensions).map(move |k| 3 * strip + k)).collect();
    let difference = nalgebra::DVector::from_iterator(
        places.len(),
        places.iter().map(|place| a.points[place / 3][place % 3] - b.points[place / 3][place % 3]),
    );
    let covariance = a.covariance_m2.select_rows(&places).select_columns(&places);
    covariance.cholesky().is_some_and(|cholesky| difference.dot(&cholesky.solve(&difference)) < SAME)
}

/// All ways to give each of `strips` strips another one of `onsets` onsets.
fn assignments(onsets: usize, strips: usize) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new()];
    for _ in 0..strips {
        let longer = |taken: &Vec<usize>| {
            let free = (0..onsets).filter(|onset| !taken.contains(onset));
            free.map(|onset| [taken.as_slice(), &[onset]].concat()).collect::<Vec<_>>()
        };
        all = all.iter().flat_map(longer).collect();
    }
    all
}

/// One of each, in all ways.
fn combinations(choices: &[Vec<Vec<usize>>]) -> Vec<Vec<Vec<usize>>> {
    choices.iter().fold(vec![Vec::new()], |all, choices| {
        let longer = |taken: &Vec<Vec<usize>>| {
            choices.iter().map(|choice| [taken.as_slice(), std::slice::from_ref(choice)].concat()).collect::<Vec<_>>()
        };
        all.iter().flat_map(longer).collect()
    })
}

#[cfg(test)]
mod tests;
