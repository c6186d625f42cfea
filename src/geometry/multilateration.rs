//! A patch from its path lengths to points that are in place: every position that explains them, best first.
//!
//! A path whose other points are known puts a patch `z` on an ellipsoid, `|z - a| + |z - b| = l`; with `a = b` on a
//! sphere. Ellipsoids that share the focus `a` are linear in `x = z - a` and `r = |x|`, as satellite positioning has
//! it:
//!
//! ```text
//! c . x - l r = (|c|^2 - l^2) / 2,    c = b - a;    a sphere: r = l / 2
//! ```
//!
//! Three of them (in flatland two) leave a line in `(x, r)`, and `|x| = r` two points of it: often mirror images. Every
//! three ellipsoids about a focus propose their two points, as do every three spheres. A ray proposes its crossings
//! with them, an anchor itself. A robust loss judges all proposals on all ties. The best are refined by Gauss-Newton,
//! and those that remain apart are kept. A wrong length or a wrongly placed neighbour is thus outvoted. A mirror image
//! that fits the lengths almost as well is returned as a second solution. Source of the closed form: Bancroft, IEEE
//! Trans. AES-21, 56 (1985). Not modelled: the errors of the points that are in place.

mod proposals;

pub use proposals::meet;

use nalgebra::{Matrix3, Vector3};

use super::Point;
use super::loss::Loss;

/// Proposals in closed form that are refined.
const REFINED: usize = 6;
/// Gauss-Newton steps.
const STEPS: usize = 12;
/// Of a place that ties determine, the least stiffness relative to the largest.
const STIFF: f64 = 1e-4;

/// What ties a patch to points that are in place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tie {
    /// A path that comes from one point and goes on to another, or back to the same.
    Path {
        /// Before the patch.
        from: Point,
        /// After it.
        to: Point,
        /// Measured length of both legs together.
        length_m: f64,
        /// Its standard deviation.
        sd_m: f64,
    },
    /// Its position.
    Anchor {
        /// Position.
        position: Point,
        /// Standard deviation of each coordinate.
        sd_m: f64,
    },
    /// Its direction.
    Ray {
        /// Where the ray begins.
        from: Point,
        /// Unit vector.
        direction: Vector3<f64>,
        /// Standard deviation of each of its angles.
        sd_rad: f64,
    },
}

impl Tie {
    /// Residuals in standard deviations, and the derivatives of what is predicted.
    fn rows(&self, z: Point, mut each: impl FnMut(f64, Vector3<f64>)) {
        match *self {
            Self::Path { from, to, length_m, sd_m } => {
                let ((near, out), (far, back)) = (length_and_direction(z - from), length_and_direction(z - to));
                each((length_m - near - far) / sd_m, (out + back) / sd_m);
            }
            Self::Anchor { position, sd_m } => {
                (0..3).for_each(|k| each((position[k] - z[k]) / sd_m, Vector3::ith(k, 1.0 / sd_m)));
            }
            Self::Ray { from, direction, sd_rad } => {
                let (range, along) = length_and_direction(z - from);
                for k in 0..3 {
                    let slope = (Vector3::ith(k, 1.0) - along * along[k]) / (range.max(f64::MIN_POSITIVE) * sd_rad);
                    each((direction[k] - along[k]) / sd_rad, slope);
                }
            }
        }
    }
}

fn length_and_direction(arm: Vector3<f64>) -> (f64, Vector3<f64>) {
    let length = arm.norm();
    (length, if length > 0.0 { arm / length } else { Vector3::zeros() })
}

/// A position with the loss of all its ties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Position.
    pub point: Point,
    /// Loss.
    pub cost: f64,
}

impl Candidate {
    fn new(ties: &[Tie], point: Point, loss: Loss) -> Self {
        Self { point, cost: cost(ties, point, loss) }
    }
}

/// Loss of a patch at `point`.
#[must_use]
pub fn cost(ties: &[Tie], point: Point, loss: Loss) -> f64 {
    let mut sum = 0.0;
    ties.iter().for_each(|tie| tie.rows(point, |residual, _| sum += loss.of(residual).0));
    sum
}

/// Positions that explain a patch's ties, best first, further apart than `apart_m`. Empty where the ties are too few to
/// determine any.
#[must_use]
pub fn candidates(ties: &[Tie], dimensions: usize, apart_m: f64, loss: Loss) -> Vec<Candidate> {
    let proposed =
        proposals::crossings(ties, dimensions).into_iter().map(|point| Candidate::new(ties, point, loss)).collect();
    let mut starts = distinct(proposed, apart_m);
    starts.truncate(REFINED);
    let candidates = refined(ties, &starts, dimensions, apart_m, loss);
    if !candidates.is_empty() || ties.len() < dimensions {
        return candidates;
    }
    let mut candidates = anywhere(ties, dimensions, apart_m, loss);
    candidates.retain(|candidate| is_determined(ties, candidate.point, dimensions, loss));
    candidates
}

/// A position that explains a patch's ties, one of many where they are too few; `None` without a path.
#[must_use]
pub fn somewhere(ties: &[Tie], dimensions: usize, loss: Loss) -> Option<Point> {
    anywhere(ties, dimensions, 0.0, loss).first().map(|candidate| candidate.point)
}

/// Minima found from all directions.
fn anywhere(ties: &[Tie], dimensions: usize, apart_m: f64, loss: Loss) -> Vec<Candidate> {
    let starts: Vec<Candidate> =
        proposals::around(ties, dimensions).into_iter().map(|point| Candidate::new(ties, point, loss)).collect();
    refined(ties, &starts, dimensions, apart_m, loss)
}

/// The minima that some places lead to.
fn refined(ties: &[Tie], starts: &[Candidate], dimensions: usize, apart_m: f64, loss: Loss) -> Vec<Candidate> {
    let refined = starts.iter().map(|start| refine(ties, *start, dimensions, loss)).collect();
    distinct(refined, apart_m)
}

/// Candidates, best first, without those that lie near a better one.
fn distinct(mut candidates: Vec<Candidate>, apart_m: f64) -> Vec<Candidate> {
    candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        if kept.iter().all(|other| (other.point - candidate.point).norm() > apart_m) {
            kept.push(candidate);
        }
    }
    kept
}

/// Normal matrix and right-hand side of a Gauss-Newton step.
fn normal_equations(ties: &[Tie], at: Point, loss: Loss) -> (Matrix3<f64>, Vector3<f64>) {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for tie in ties {
        tie.rows(at, |residual, gradient| {
            let weight = loss.of(residual).1;
            normal += weight * gradient * gradient.transpose();
            right += weight * residual * gradient;
        });
    }
    (normal, right)
}

/// Whether all directions have some stiffness.
fn is_determined(ties: &[Tie], at: Point, dimensions: usize, loss: Loss) -> bool {
    let (mut normal, _) = normal_equations(ties, at, loss);
    if dimensions == 2 {
        normal[(2, 2)] = normal.trace();
    }
    let values = normal.symmetric_eigenvalues();
    values.min() > STIFF * values.max()
}

/// The minimum of the loss nearest to a start, by damped Gauss-Newton.
fn refine(ties: &[Tie], start: Candidate, dimensions: usize, loss: Loss) -> Candidate {
    let mut now = start;
    let mut damping = 1e-6;
    for _ in 0..STEPS {
        let (mut normal, mut right) = normal_equations(ties, now.point, loss);
        normal += Matrix3::identity() * (damping * normal.trace());
        if dimensions == 2 {
            // Nothing moves along z.
            normal[(2, 2)] += 1e6 * normal.trace();
            right.z = 0.0;
        }
        let Some(inverse) = normal.try_inverse() else { break };
        let trial = Candidate::new(ties, now.point + inverse * right, loss);
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
mod tests;
