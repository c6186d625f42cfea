//! Other solutions that the onsets do not rule out.

use std::cmp::Ordering;

use super::context::Rival;
use super::model::Model;
use super::readings::Reading;
use crate::geometry::Point;
use crate::geometry::maximum_likelihood::{self, DENSE_MAX, Node, Observation, Problem, Solution};
use crate::geometry::placement::{self, Kind};
use crate::geometry::procrustes;

/// Other solutions whose loss is higher by less than this (a likelihood ratio of 3,000) are alternatives.
const LIKELY: f64 = 16.0;
/// Largest number of alternatives that are reported.
const ALTERNATIVES: usize = 32;
/// A loss that is lower by less is the same.
const LOWER: f64 = 1e-3;
/// Rounds in which a better solution replaces the best one.
const ROUNDS: usize = 6;
/// Places nearer than this many standard deviations are one.
const SAME: f64 = 3.0;
/// Bounces from which labels depend on which places were taken.
const LATER: usize = 3;

/// What makes another solution.
#[derive(Clone, Copy, PartialEq)]
pub enum OtherKind {
    /// The mirror image of the whole.
    Mirror,
    /// Other places of some patches.
    Flip,
    /// An onset read another way.
    Label,
}

/// Another solution that the onsets do not rule out.
pub struct Other {
    /// Positions of the patches that it moves, by their places.
    pub patches: Vec<usize>,
    pub kind: OtherKind,
    /// Log-likelihood less that of the best solution.
    pub log_likelihood: f64,
    pub solution: Solution,
}

impl Other {
    /// Whether both move the same patches to the same places.
    fn is_same(&self, other: &Self) -> bool {
        let is_near = |&place: &usize| {
            let sd_m = self.solution.patch_covariance_m2(place, place).trace().max(0.0).sqrt();
            (self.solution.points[place] - other.solution.points[place]).norm() <= SAME * sd_m
        };
        self.patches == other.patches && self.patches.iter().all(is_near)
    }
}

/// The likeliest solution, and others that are about as likely. Among these, one with hidden patches in front of the
/// wall that shows them comes before one with them behind.
pub fn alternatives(model: &Model, problem: &Problem, mut best: Solution) -> (Solution, Vec<Other>) {
    if problem.start.len() > DENSE_MAX {
        return (best, Vec::new());
    }
    // A turn or mirror image of a scene that nothing turns is no other solution.
    let is_turned = |kind: &Kind, best: &Solution| *kind == Kind::Mirror && best.free_rotations.first() != Some(&0);
    let mut others: Vec<Other> = Vec::new();
    for _ in 0..ROUNDS {
        // What the model does not explain makes likelihoods look more certain than they are.
        let misfit = best.misfit;
        // Other places may be this one, once errors that onsets have in common are solved for too.
        let compared = Best::new(&best);
        let is_elsewhere = |other: &Solution| {
            other.loss < best.loss - LOWER || !compared.moved(&compared.turned(&other.points)).is_empty()
        };
        let starts = placement::alternatives(problem, &best.points, &best.unplaced()).into_iter();
        let solved = starts.filter(|start| !is_turned(&start.kind, &best)).filter_map(|start| {
            let solution = maximum_likelihood::solve(&Problem { start: start.points, ..problem.clone() }).ok()?;
            let log_likelihood = -0.5 * (solution.loss - best.loss) / misfit;
            let kind = if start.kind == Kind::Mirror { OtherKind::Mirror } else { OtherKind::Flip };
            Some(Other { patches: start.patches, kind, log_likelihood, solution })
        });
        others.clear();
        let counts = |other: &Other| other.kind == OtherKind::Mirror || is_elsewhere(&other.solution);
        for other in solved.filter(|other| -2.0 * other.log_likelihood < LIKELY && counts(other)) {
            if others.len() < ALTERNATIVES && !others.iter().any(|old| old.is_same(&other)) {
                others.push(other);
            }
        }
        let is_better = |other: &Other| {
            let behind = |solution: &Solution| model.behind(problem, solution, &other.patches);
            match behind(&other.solution).cmp(&behind(&best)) {
                Ordering::Less => true,
                Ordering::Equal => other.solution.loss < best.loss - LOWER,
                Ordering::Greater => false,
            }
        };
        let Some(better) = others.iter().position(is_better) else { break };
        best = others.swap_remove(better).solution;
        others.clear();
    }
    for rival in &model.context.rivals {
        add_rival(model, problem, &best, rival, &mut others);
    }
    others.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    others.truncate(ALTERNATIVES);
    (best, others)
}

/// Adds places that were not taken when the onsets were labelled, if they are about as likely. Labels of later bounces
/// over these patches hold for the places that were taken alone; so the other places are solved for without them.
fn add_rival(model: &Model, problem: &Problem, best: &Solution, rival: &Rival, others: &mut Vec<Other>) {
    let at = |(patch, point): (&_, &Point)| Some((model.patches.binary_search(patch).ok()?, *point));
    let places: Vec<(usize, Point)> = rival.places.iter().filter_map(at).collect();
    let is_at = |solution: &Solution| {
        let sd_m = |place: usize| solution.patch_covariance_m2(place, place).trace().max(0.0).sqrt();
        places.iter().all(|(place, point)| (solution.points[*place] - point).norm() < SAME * sd_m(*place))
    };
    let log_likelihood = rival.log_likelihood / best.misfit;
    if -2.0 * log_likelihood > LIKELY || is_at(best) {
        return;
    }
    let patches: Vec<usize> = places.iter().map(|(place, _)| *place).collect();
    if let Some(other) = others.iter_mut().find(|other| other.patches == patches && is_at(&other.solution)) {
        other.log_likelihood = other.log_likelihood.max(log_likelihood);
        return;
    }
    let meets = |observation: &Observation| {
        observation.nodes.iter().any(|node| matches!(node, Node::Patch(patch) if patches.contains(patch)))
    };
    // Nodes are the bounces and both stations.
    let holds = |observation: &&Observation| observation.nodes.len() < LATER + 2 || !meets(observation);
    let observations = problem.observations.iter().filter(holds).cloned().collect();
    let mut start = best.points.clone();
    places.iter().for_each(|(place, point)| start[*place] = *point);
    let solved = maximum_likelihood::solve(&Problem { start: start.clone(), observations, ..problem.clone() });
    // Where first light now draws them to the places that were taken, they stay where it had them at first.
    let solution = solved.ok().filter(is_at).unwrap_or_else(|| {
        let mut solution = best.clone();
        solution.points = start;
        solution
    });
    let kind = if patches.len() == model.patches.len() { OtherKind::Mirror } else { OtherKind::Flip };
    others.push(Other { patches, kind, log_likelihood, solution });
}

/// The best solution, as others are compared with it.
struct Best<'a> {
    solution: &'a Solution,
    /// Standard deviations of its patches.
    sds_m: Vec<f64>,
}

impl<'a> Best<'a> {
    fn new(solution: &'a Solution) -> Self {
        let sd_m = |place: usize| solution.patch_covariance_m2(place, place).trace().max(0.0).sqrt();
        Self { solution, sds_m: (0..solution.points.len()).map(sd_m).collect() }
    }

    /// Places turned onto the best ones, if nothing fixes the frame, by the half of the patches that fit best: others
    /// may be elsewhere.
    fn turned(&self, points: &[Point]) -> Vec<Point> {
        let (best, mut points) = (self.solution, points.to_vec());
        if best.free_rotations.first().is_none_or(|free| *free == 0) {
            return points;
        }
        let centre = best.stations[0];
        let mut kept: Vec<usize> = (0..points.len()).filter(|place| !best.open.contains(place)).collect();
        for share in [2, 1] {
            let of = |points: &[Point]| -> Vec<Point> { kept.iter().map(|place| points[*place]).collect() };
            let fit = procrustes::rotation(&of(&points), &of(&best.points), centre, false);
            points.iter_mut().for_each(|point| *point = procrustes::turn(&fit.matrix, centre, *point));
            let off = |place: &usize| (points[*place] - best.points[*place]).norm() / self.sds_m[*place];
            kept.sort_by(|a, b| off(a).total_cmp(&off(b)));
            kept.truncate(kept.len().div_ceil(share));
        }
        points
    }

    /// Patches that turned places move by more than their errors say.
    fn moved(&self, turned: &[Point]) -> Vec<usize> {
        let best = self.solution;
        let is_moved = |&place: &usize| {
            !best.open.contains(&place) && (turned[place] - best.points[place]).norm() > SAME * self.sds_m[place]
        };
        (0..turned.len()).filter(is_moved).collect()
    }
}

/// Adds what other readings of onsets make of the solution, if they are about as likely and move a patch by more than
/// its error says. `used` are the positions of labels among the observations.
pub fn add_readings(
    problem: &Problem,
    best: &Solution,
    (readings, used): (Vec<Reading>, &[Option<usize>]),
    others: &mut Vec<Other>,
) {
    let compared = Best::new(best);
    for reading in readings {
        problem.cancel.check();
        if others.len() >= ALTERNATIVES {
            return;
        }
        let out: Vec<usize> = reading.replaced.iter().filter_map(|n| used[*n]).collect();
        let kept = problem.observations.iter().enumerate().filter(|(at, _)| !out.contains(at));
        let mut observations: Vec<Observation> = kept.map(|(_, kept)| kept.clone()).collect();
        observations.extend(reading.observations);
        let start = best.points.clone();
        let Ok(mut solution) = maximum_likelihood::solve(&Problem { start, observations, ..problem.clone() }) else {
            continue;
        };
        solution.points = compared.turned(&solution.points);
        // The same number of onsets, or what `label` says of one pulse against two.
        let by_loss = -0.5 * (solution.loss - best.loss) / best.misfit;
        let log_likelihood = reading.log_likelihood.unwrap_or(by_loss).min(0.0);
        let patches = compared.moved(&solution.points);
        let other = Other { patches, kind: OtherKind::Label, log_likelihood, solution };
        if -2.0 * log_likelihood < LIKELY && !other.patches.is_empty() && !others.iter().any(|old| old.is_same(&other))
        {
            others.push(other);
        }
    }
    others.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
}
