//! Rotations that no path length sees.
//!
//! Patches that share a path form a part. With all stations in one point a part turns freely about it; with stations in
//! line, about that line. A second part, which shares no path with the first, turns on its own. What else is free
//! belongs to single patches that have too few paths.

use faer::Mat;
use nalgebra::Vector3;

use super::groups::Groups;
use super::matrix_free::{self, Matrix};
use super::problem::{Node, Observation, Problem};
use super::rows::{Rows, Values};
use crate::dense;

/// Rounds of weights that separate motions from rotations. A patch is open if what is left of its motion exceeds this
/// size relative to the largest.
const ROUNDS: usize = 40;
const OPEN: f64 = 1e-3;
/// Patches that the search for the largest rigid body begins with.
const STARTS: usize = 64;
/// What is left of a direction of length 1 below this is nothing.
const GONE: f64 = 1e-6;
/// A rotation that changes no path by more than this (squared, relative to the stiffest direction) is free.
const FREE: f64 = 1e-10;

/// Groups of patches that are joined by paths, largest first.
pub fn parts(problem: &Problem) -> Vec<Vec<usize>> {
    let mut groups = Groups::new(problem.start.len());
    for observation in &problem.observations {
        let mut patches = observation.nodes.iter().filter_map(Node::patch);
        let Some(first) = patches.next() else { continue };
        patches.for_each(|patch| groups.join(first, patch));
    }
    let mut parts = groups.sets();
    parts.sort_by_key(|part| (std::cmp::Reverse(part.len()), part[0]));
    parts
}

/// Orthonormal directions of the unknowns that turn a part about the first station of its paths and change no path.
pub fn free_rotations(rows: &Rows, values: &Values, part: &[usize], stiffest: f64) -> Vec<Vec<f64>> {
    let problem = rows.problem;
    let of_part = |node: &Node| matches!(node, Node::Patch(patch) if part.binary_search(patch).is_ok());
    let path = problem.observations.iter().find(|observation| observation.nodes.iter().any(of_part));
    let centre = path.and_then(|observation| match observation.nodes[0] {
        Node::Station(station) => Some(values.stations[station]),
        Node::Patch(_) => None,
    });
    let Some(centre) = centre else {
        return Vec::new();
    };
    let axes: &[Vector3<f64>] = if problem.dimensions == 3 {
        &[Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)]
    } else {
        &[Vector3::new(0.0, 0.0, 1.0)]
    };
    let generator = |axis: &Vector3<f64>| -> Vec<f64> {
        let mut direction = vec![0.0; rows.layout.size];
        for &patch in part {
            let motion = axis.cross(&(values.points[patch] - centre));
            direction[rows.layout.patch(patch)].copy_from_slice(&motion.as_slice()[..problem.dimensions]);
        }
        direction
    };
    let generators: Vec<Vec<f64>> = axes.iter().map(generator).collect();
    // In the span of the generators: how much motion, and how much stiffness.
    let (sizes, turns) = dense::symmetric_eigen(&gram(&generators, &generators));
    let largest = sizes.last().copied().unwrap_or(0.0);
    let basis: Vec<Vec<f64>> = (0..axes.len())
        .filter(|&k| sizes[k] > 1e-12 * largest && largest > 0.0)
        .map(|k| combined(&generators, &turns, k, 1.0 / sizes[k].sqrt()))
        .collect();
    if basis.is_empty() {
        return Vec::new();
    }
    let moved: Vec<Vec<f64>> =
        basis.iter().map(|vector| matrix_free::product(rows, values, Matrix::Normal, vector)).collect();
    let (stiffnesses, vectors) = dense::symmetric_eigen(&gram(&basis, &moved));
    let is_free = |&k: &usize| stiffnesses[k] < FREE * stiffest;
    (0..basis.len()).filter(is_free).map(|k| combined(&basis, &vectors, k, 1.0)).collect()
}

/// Inner products of two sets of vectors.
fn gram(a: &[Vec<f64>], b: &[Vec<f64>]) -> Mat<f64> {
    Mat::from_fn(a.len(), b.len(), |i, k| a[i].iter().zip(&b[k]).map(|(a, b)| a * b).sum::<f64>())
}

/// Sum of vectors by the weights in a column of `matrix`, times `scale`.
fn combined(vectors: &[Vec<f64>], matrix: &Mat<f64>, column: usize, scale: f64) -> Vec<f64> {
    let sum = |i: usize| (0..vectors.len()).map(|k| vectors[k][i] * matrix[(k, column)] * scale).sum();
    (0..vectors[0].len()).map(sum).collect()
}

/// The part of orthonormal directions that does not move the patches `open`, orthonormal again.
pub fn without(directions: &[Vec<f64>], rows: &Rows, open: &[usize]) -> Vec<Vec<f64>> {
    let mut kept: Vec<Vec<f64>> = Vec::new();
    for direction in directions {
        let mut rest = direction.clone();
        open.iter().for_each(|&patch| rest[rows.layout.patch(patch)].fill(0.0));
        for other in &kept {
            let along: f64 = rest.iter().zip(other).map(|(a, b)| a * b).sum();
            rest.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
        }
        let size = rest.iter().map(|x| x * x).sum::<f64>().sqrt();
        if size > GONE {
            rest.iter_mut().for_each(|x| *x /= size);
            kept.push(rest);
        }
    }
    kept
}

/// A covariance without the rotations `nulls` of all patches, without those of the patches instead that laser or sensor
/// sees: the frame turns with them, and errors of hidden patches do not turn it. (An S-transformation, Baarda 1973.)
pub fn about_visible(rows: &Rows, covariance: Mat<f64>, nulls: &Mat<f64>) -> Mat<f64> {
    let mut is_visible = vec![false; rows.problem.start.len()];
    for observation in &rows.problem.observations {
        for ends in observation.nodes.windows(2) {
            if let [Node::Station(_), Node::Patch(patch)] | [Node::Patch(patch), Node::Station(_)] = ends {
                is_visible[*patch] = true;
            }
        }
    }
    if nulls.ncols() == 0 || is_visible.iter().all(|visible| *visible) {
        return covariance;
    }
    let visible: Vec<usize> =
        (0..is_visible.len()).filter(|&patch| is_visible[patch]).flat_map(|patch| rows.layout.patch(patch)).collect();
    let mut shown: Mat<f64> = Mat::zeros(nulls.nrows(), nulls.ncols());
    for (&i, k) in visible.iter().flat_map(|i| (0..nulls.ncols()).map(move |k| (i, k))) {
        shown[(i, k)] = nulls[(i, k)];
    }
    let Some(share) = dense::inverse(&(shown.transpose() * nulls)) else { return covariance };
    let turn = nulls * share * shown.transpose();
    let free = Mat::from_fn(turn.nrows(), turn.ncols(), |i, k| f64::from(u8::from(i == k)) - turn[(i, k)]);
    let left = &free * covariance;
    rows.problem.cancel.check();
    left * free.transpose()
}

/// Patches, of those not `open` yet, that move in any of the directions `free` (columns) otherwise than the largest
/// rigid body of their part. If all move with one, the patch that the fewest paths touch.
pub fn open(
    rows: &Rows,
    values: &Values,
    free: &Mat<f64>,
    turns: &[Vec<f64>],
    parts: &[Vec<usize>],
    open: &[usize],
) -> Vec<usize> {
    let left = |patch: &usize| open.binary_search(patch).is_err();
    let mut new: Vec<usize> = moving(rows, free, turns).into_iter().filter(left).collect();
    let in_place = rows.problem.start.len() - open.len();
    if new.is_empty() || 2 * new.len() > in_place {
        // No body that most patches belong to: the largest.
        new.clear();
        for part in parts {
            let part: Vec<usize> = part.iter().copied().filter(left).collect();
            let body = body(rows, values, free, &part);
            new.extend(part.into_iter().filter(|patch| !body.contains(patch)));
        }
    }
    if new.is_empty() {
        let paths = |patch: usize| {
            let meets = |observation: &&Observation| observation.nodes.contains(&Node::Patch(patch));
            rows.problem.observations.iter().filter(meets).count()
        };
        new.extend((0..rows.problem.start.len()).filter(left).min_by_key(|&patch| paths(patch)));
    }
    new
}

/// The largest set of patches of a part, as far as a greedy search goes, no two of which change their distance, nor
/// that from the first station, in any of the directions `free` (columns).
fn body(rows: &Rows, values: &Values, free: &Mat<f64>, part: &[usize]) -> Vec<usize> {
    let motion = |patch: usize, column: usize| {
        let mut motion = Vector3::zeros();
        rows.layout.patch(patch).enumerate().for_each(|(k, i)| motion[k] = free[(i, column)]);
        motion
    };
    let most = |column: usize| part.iter().map(|&patch| motion(patch, column).norm()).fold(f64::MIN_POSITIVE, f64::max);
    let most: Vec<f64> = (0..free.ncols()).map(most).collect();
    let holds = |arm: Vector3<f64>, moved: &dyn Fn(usize) -> Vector3<f64>| {
        let along = arm.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
        (0..free.ncols()).all(|column| along.dot(&moved(column)).abs() < OPEN * most[column])
    };
    let is_held = |&&patch: &&usize| holds(values.points[patch] - values.stations[0], &|column| motion(patch, column));
    let held: Vec<usize> = part.iter().filter(is_held).copied().collect();
    let is_rigid = |a: usize, b: usize| {
        rows.problem.cancel.check();
        holds(values.points[a] - values.points[b], &|column| motion(a, column) - motion(b, column))
    };
    let rigid: Vec<Vec<bool>> =
        held.iter().map(|&a| held.iter().map(|&b| a == b || is_rigid(a, b)).collect()).collect();
    let degree = |n: usize| rigid[n].iter().filter(|rigid| **rigid).count();
    let mut order: Vec<usize> = (0..held.len()).collect();
    order.sort_by_key(|&n| (std::cmp::Reverse(degree(n)), n));
    let mut largest: Vec<usize> = Vec::new();
    for &first in order.iter().take(STARTS) {
        let mut body = vec![first];
        for &next in &order {
            if next != first && body.iter().all(|&member| rigid[member][next]) {
                body.push(next);
            }
        }
        if body.len() > largest.len() {
            largest = body;
        }
    }
    largest.into_iter().map(|n| held[n]).collect()
}

/// Patches that move in any of the directions `free` (columns) by more than a rotation of all patches: rotations, in
/// the span of `turns`, are fitted by least absolute values, so that the few patches that move on their own do not
/// count.
fn moving(rows: &Rows, free: &Mat<f64>, turns: &[Vec<f64>]) -> Vec<usize> {
    let patches = rows.problem.start.len();
    let mut moves = vec![0.0_f64; patches];
    for column in 0..free.ncols() {
        rows.problem.cancel.check();
        let mut weights = vec![1.0; patches];
        let mut left: Vec<f64> = (0..rows.layout.coordinates).map(|i| free[(i, column)]).collect();
        for _ in 0..ROUNDS {
            let weight = |i: usize| weights[i / rows.layout.dimensions];
            let dot = |a: &dyn Fn(usize) -> f64, b: &[f64]| -> f64 {
                (0..rows.layout.coordinates).map(|i| weight(i) * a(i) * b[i]).sum()
            };
            let gram = Mat::from_fn(turns.len(), turns.len(), |i, k| dot(&|n| turns[i][n], &turns[k]));
            let right: Vec<f64> = turns.iter().map(|turn| dot(&|n| free[(n, column)], turn)).collect();
            let Some(shares) = dense::solve(&gram, &right) else { break };
            for (i, left) in left.iter_mut().enumerate() {
                *left = free[(i, column)] - turns.iter().zip(&shares).map(|(turn, share)| share * turn[i]).sum::<f64>();
            }
            let size = |patch: usize| left[rows.layout.patch(patch)].iter().map(|x| x * x).sum::<f64>().sqrt();
            let largest = (0..patches).map(size).fold(f64::MIN_POSITIVE, f64::max);
            weights = (0..patches).map(|patch| 1.0 / (size(patch) / largest).max(1e-6)).collect();
        }
        for (patch, most) in moves.iter_mut().enumerate() {
            *most = most.max(left[rows.layout.patch(patch)].iter().map(|x| x * x).sum::<f64>().sqrt());
        }
    }
    let largest = moves.iter().copied().fold(0.0, f64::max);
    (0..patches).filter(|&patch| moves[patch] > OPEN * largest).collect()
}
