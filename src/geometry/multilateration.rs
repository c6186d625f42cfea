//! A patch from its path lengths to patches that are in place: every position that explains them, best first.
//!
//! With p0 at the origin, the first bounce gives the range `r = |z|`, and a second bounce over a patch at `a` the projection onto it:
//! `z . a = (r^2 + |a|^2 - d^2) / 2`. Two such projections and the range leave two points, mirror images in the plane of p0 and the two patches.
//! Each pair of patches proposes its two; the best of all proposals, judged on all lengths by Huber's loss, are refined by Gauss-Newton, and those that
//! remain apart are kept. In flatland a single patch proposes two. A wrongly placed neighbour is thus outvoted, and a mirror image that the lengths can
//! hardly tell from the patch comes out beside it. Source of the projections: the p0-centred Gram matrix of the paper's Algorithm 1.
//! Not modelled: the errors of the patches that are in place.

use nalgebra::{Matrix3, Vector3};

use super::Point;

/// Standard deviations beyond which a residual counts linearly.
const HUBER: f64 = 3.0;
/// Proposals that are refined.
const REFINED: usize = 6;
/// Gauss-Newton steps.
const STEPS: usize = 12;
/// Proposals are taken from the pairs of at most this many neighbours.
const PROPOSERS: usize = 12;

/// A measured length of a path: its value and standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tie {
    /// Where the other patch of the path is; `None` for the first bounce.
    pub over: Option<Point>,
    /// Measured length.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
}

impl Tie {
    /// Residual in standard deviations, and its gradient in the patch's position times the standard deviation.
    fn residual(&self, z: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (range, out) = length_and_direction(z);
        let Some(over) = self.over else {
            return ((self.length_m - 2.0 * range) / self.sd_m, 2.0 * out);
        };
        let (across, along) = length_and_direction(&(z - over.coords));
        ((self.length_m - range - across - over.coords.norm()) / self.sd_m, out + along)
    }
}

fn length_and_direction(arm: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let length = arm.norm();
    (length, if length > 0.0 { arm / length } else { Vector3::zeros() })
}

/// A position with Huber's loss of all its lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Position.
    pub point: Point,
    /// Loss.
    pub cost: f64,
}

/// Huber's loss of a patch at `point`.
#[must_use]
pub fn cost(ties: &[Tie], point: Point) -> f64 {
    ties.iter().map(|tie| loss(tie.residual(&point.coords).0)).sum()
}

fn loss(residual: f64) -> f64 {
    let size = residual.abs();
    if size > HUBER { HUBER * (2.0 * size - HUBER) } else { size * size }
}

/// Positions that explain a patch's lengths, best first, further apart than `apart_m`. Empty without a first bounce or with too few neighbours: two,
/// in flatland one.
#[must_use]
pub fn candidates(ties: &[Tie], dimensions: usize, apart_m: f64) -> Vec<Candidate> {
    let judged = |z: Vector3<f64>| Candidate { point: Point::from(z), cost: cost(ties, Point::from(z)) };
    let mut proposals: Vec<Candidate> = proposals(ties, dimensions).into_iter().map(judged).collect();
    proposals.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut apart: Vec<Candidate> = Vec::new();
    for proposal in proposals {
        if apart.len() < REFINED && apart.iter().all(|kept| (kept.point - proposal.point).norm() > apart_m) {
            apart.push(proposal);
        }
    }
    let mut refined: Vec<Candidate> = apart.iter().map(|start| refine(ties, *start, dimensions)).collect();
    refined.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut distinct: Vec<Candidate> = Vec::new();
    for candidate in refined {
        if distinct.iter().all(|kept| (kept.point - candidate.point).norm() > apart_m) {
            distinct.push(candidate);
        }
    }
    distinct
}

/// Both points of each pair of neighbours (in flatland, of each neighbour).
fn proposals(ties: &[Tie], dimensions: usize) -> Vec<Vector3<f64>> {
    let Some(range) = ties.iter().find(|tie| tie.over.is_none()).map(|tie| 0.5 * tie.length_m) else {
        return Vec::new();
    };
    // Direction of each neighbour, and the patch's projection onto it.
    let projection = |tie: &Tie| {
        let over = tie.over?.coords;
        let (away, direction) = length_and_direction(&over);
        let across = tie.length_m - range - away;
        (away > 0.0).then(|| (direction, (range * range + away * away - across * across) / (2.0 * away)))
    };
    let neighbours: Vec<(Vector3<f64>, f64)> = ties.iter().filter_map(projection).take(PROPOSERS).collect();
    let mut proposals = Vec::new();
    let mut mirrored = |foot: Vector3<f64>, normal: Vector3<f64>| {
        let height = (range * range - foot.norm_squared()).max(0.0).sqrt();
        proposals.extend([foot + height * normal, foot - height * normal]);
    };
    for (i, (a, along_a)) in neighbours.iter().enumerate() {
        if dimensions == 2 {
            mirrored(a * *along_a, Vector3::new(-a.y, a.x, 0.0));
            continue;
        }
        for (b, along_b) in &neighbours[..i] {
            let cosine = a.dot(b);
            let Some(normal) = a.cross(b).try_normalize(1e-3) else { continue };
            let sine2 = 1.0 - cosine * cosine;
            let foot = a * ((along_a - cosine * along_b) / sine2) + b * ((along_b - cosine * along_a) / sine2);
            mirrored(foot, normal);
        }
    }
    proposals
}

/// The minimum of Huber's loss nearest to a start, by damped Gauss-Newton.
fn refine(ties: &[Tie], start: Candidate, dimensions: usize) -> Candidate {
    let mut now = start;
    let mut damping = 1e-6;
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for tie in ties {
            let (residual, gradient) = tie.residual(&now.point.coords);
            let weight = if residual.abs() > HUBER { HUBER / residual.abs() } else { 1.0 };
            let gradient = gradient / tie.sd_m;
            normal += weight * gradient * gradient.transpose();
            right += weight * residual * gradient;
        }
        normal += Matrix3::identity() * (damping * normal.trace());
        if dimensions == 2 {
            // Nothing moves along z.
            normal[(2, 2)] += 1e6 * normal.trace();
            right.z = 0.0;
        }
        let Some(inverse) = normal.try_inverse() else { break };
        let step = inverse * right;
        let point = now.point + step;
        let trial = Candidate { point, cost: cost(ties, point) };
        if trial.cost < now.cost {
            let settled = now.cost - trial.cost < 1e-6 * now.cost;
            now = trial;
            damping *= 0.1;
            if settled {
                break;
            }
        } else {
            damping = damping.max(1e-9) * 100.0;
        }
    }
    now
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::room;

    /// Exact lengths of the last patch over the others.
    fn ties(points: &[Point], over: &[usize]) -> Vec<Tie> {
        let patch = points.len() - 1;
        let first = Tie { over: None, length_m: room::first_m(points, patch), sd_m: 0.003 };
        let second =
            |&a: &usize| Tie { over: Some(points[a]), length_m: room::second_m(points, patch, a), sd_m: 0.003 };
        std::iter::once(first).chain(over.iter().map(second)).collect()
    }

    #[test]
    fn three_neighbours_place_a_patch_and_two_leave_its_mirror_image() {
        let points = room::rectangles();
        let truth = points[48];
        let three = candidates(&ties(&points, &[0, 27, 44]), 3, 0.05);
        assert!((three[0].point - truth).norm() < 1e-6 && three[0].cost < 1e-9);
        assert!(three[1..].iter().all(|other| other.cost > 10.0));
        let two = candidates(&ties(&points, &[0, 27]), 3, 0.05);
        assert!(two.len() == 2 && two.iter().all(|candidate| candidate.cost < 1e-9));
        let mirrored = {
            let normal = points[0].coords.cross(&points[27].coords).normalize();
            truth - 2.0 * normal * normal.dot(&truth.coords)
        };
        assert!(two.iter().any(|candidate| (candidate.point - truth).norm() < 1e-6));
        assert!(two.iter().any(|candidate| (candidate.point - mirrored).norm() < 1e-6));
        assert!(candidates(&ties(&points, &[0]), 3, 0.05).is_empty());
        assert!(candidates(&ties(&points, &[0, 27, 44])[1..], 3, 0.05).is_empty());
    }

    #[test]
    fn a_neighbour_in_a_wrong_place_is_outvoted() {
        let points = room::rectangles();
        let mut ties = ties(&points, &[3, 11, 20, 27, 33, 44]);
        ties[4].over = Some(Point::new(0.0, 1.0, 1.0));
        let found = candidates(&ties, 3, 0.05);
        assert!((found[0].point - points[48]).norm() < 0.01, "{:?}", found[0]);
    }

    #[test]
    fn in_flatland_one_neighbour_leaves_two_points_and_two_one() {
        let points: Vec<Point> =
            room::rectangles().iter().map(|p| Point::new(p.x + 0.3 * p.z, p.y + 0.2 * p.z, 0.0)).collect();
        let (one, two) = (candidates(&ties(&points, &[0]), 2, 0.05), candidates(&ties(&points, &[0, 27]), 2, 0.05));
        assert!(one.len() == 2 && one.iter().all(|candidate| candidate.cost < 1e-9 && candidate.point.z == 0.0));
        assert!((two[0].point - points[48]).norm() < 1e-6 && two[1..].iter().all(|other| other.cost > 10.0));
    }
}
