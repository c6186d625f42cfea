//! Maximum likelihood of thousands of patches from first and second bounces, matrix-free: the memory is that of the
//! input.
//!
//! Minimises, with p0 at the origin, over positions `z` and one delay `t`
//!
//! ```text
//! sum_i rho((l_i - 2 |z_i| - t) / s_i) + sum_ij rho((l_ij - |z_i| - |z_i - z_j| - |z_j| - t) / s_ij) + (t / s_t)^2
//! ```
//!
//! with Huber's `rho` (3 standard deviations), from a start by landmark scaling, by Gauss-Newton. Each step solves its
//! normal equations by conjugate gradients, preconditioned with the 3x3 blocks of the patches; a product of the normal
//! matrix with a vector is one pass over all pairs, whose directions are computed anew. With all pairs measured these
//! systems are well conditioned: some 20 passes in all, whatever the number of patches, and some 50 with a delay, which
//! is eliminated first. Positions settle to 1 % of their standard deviation. Sources: Dembo, Eisenstat and Steihaug,
//! SIAM J. Numer. Anal. 19, 400 (1982) for inexact Newton steps; de Silva and Tenenbaum ([`landmark`]).
//!
//! Rows of pairs are cut into chunks by their number alone, and the chunks' sums are added in order: the same bits for
//! any number of threads.
//!
//! Covariances are 3x3 blocks without rotations: the inverse of a patch's block of the normal matrix, as if all other
//! patches were fixed, plus the share of the delay. That share is exact. With all pairs measured the block is within 2
//! % of the exact standard deviation for 300 patches, and nearer for more. Where many are missing it is too small.
//!
//! Not modelled: several delays, separate source and sensor, anchors, patches without first bounce; for those and for
//! exact covariances there is [`periscope_geometry::maximum_likelihood`].

mod passes;

use nalgebra::{Matrix3, Vector3};

use crate::{Point, landmark};

/// Standard deviations beyond which a residual counts linearly.
const HUBER: f64 = 3.0;
/// Landmarks of the start, p0 among them.
const LANDMARKS: usize = 120;
/// Settled when the last step, in standard deviations (root of the mean square over unknowns), was smaller.
const SETTLED: f64 = 0.01;
/// A larger step leaves the delay as it is.
const NEAR: f64 = 1.0;
/// Most Gauss-Newton steps, and most conjugate directions in one.
const STEPS: usize = 30;
const DIRECTIONS: usize = 100;
/// A step's equations are solved to this share of their right-hand side.
const SOLVED: f64 = 0.02;
/// The same of the delay's: moving all patches outwards nearly makes up for a delay, and what remains of its stiffness
/// is a small difference.
const SOLVED_DELAY: f64 = 1e-5;
/// Chunks that the rows are cut into: a number that does not depend on the threads, so neither do the bytes of the
/// sums.
const CHUNKS: usize = 32;
/// Pairs that are worked on at once.
const LANES: usize = 8;

/// Standard deviations of second bounces.
#[derive(Clone, Copy, Debug)]
pub enum Sds<'a> {
    /// The same for all.
    Common(f32),
    /// One each, packed as the lengths; infinite for what is not measured.
    Each(&'a [f32]),
}

/// Measured path lengths.
#[derive(Clone, Copy, Debug)]
pub struct Lengths<'a> {
    /// First bounce of each patch.
    pub first_m: &'a [f64],
    /// Their standard deviation.
    pub first_sd_m: f64,
    /// Second bounce over patches i and j < i at `i (i - 1) / 2 + j`; finite also where it is not measured.
    pub second_m: &'a [f32],
    /// Standard deviations of the second bounces.
    pub second_sd_m: Sds<'a>,
    /// Prior standard deviation of the delay that adds to all lengths; 0 where it is known to be none.
    pub delay_sd_m: f64,
    /// 3, or 2 for flatland, where z = 0.
    pub dimensions: usize,
}

/// The solution.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Positions; frame and mirror image are arbitrary.
    pub points: Vec<Point>,
    /// Covariance of each, approximately; see the head of this file.
    pub covariances_m2: Vec<Matrix3<f64>>,
    /// Delay, as a length.
    pub delay_m: f64,
    /// Its variance.
    pub delay_variance_m2: f64,
    /// Huber's loss of all lengths and of the delay.
    pub loss: f64,
    /// Measurements and priors less unknowns, free rotations given back.
    pub degrees_of_freedom: i64,
    /// Passes over all pairs.
    pub passes: usize,
}

/// Positions of all patches; `None` if no minimum is reached.
///
/// # Panics
/// When the lengths are not those of all patches and pairs, or a standard deviation is not positive. When there are
/// fewer than three patches, or `dimensions` is neither 2 nor 3.
#[must_use]
pub fn solve(lengths: &Lengths) -> Option<Solution> {
    let measurements = Measurements::new(lengths);
    let mut values = measurements.values(&measurements.start(), 0.0);
    let mut slope = measurements.slope(&values);
    let mut answer = vec![0.0; slope.right.len()];
    let mut passes = 1;
    for _ in 0..STEPS {
        let (step, size) = measurements.newton_step(&values, &slope, &mut answer, &mut passes);
        let mut share = 1.0;
        let next = loop {
            let next = measurements.moved(&values, &step, share);
            let next_slope = measurements.slope(&next);
            passes += 1;
            if next_slope.loss <= slope.loss || size < SETTLED {
                break (next, next_slope);
            }
            share *= 0.5;
            if share < 1e-3 {
                return None;
            }
        };
        (values, slope) = next;
        if size < SETTLED {
            return Some(measurements.finish(&values, &slope, answer, passes));
        }
    }
    None
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// What was measured. Vectors over unknowns hold x of all patches, then y, z, and the delay; each of the three is
/// padded by `LANES`.
struct Measurements<'a> {
    lengths: &'a Lengths<'a>,
    count: usize,
    stride: usize,
}

/// A place of all unknowns, with range and direction of each patch from p0.
struct Values {
    x: Vec<f64>,
    range: Vec<f64>,
    out: Vec<f64>,
}

/// The objective at a place, its downhill direction, and the preconditioner.
struct Slope {
    loss: f64,
    right: Vec<f64>,
    /// Inverses of the patches' blocks of the normal matrix.
    inverses: Vec<Matrix3<f64>>,
    /// Each patch's row of the normal matrix in the column of the delay.
    coupling: Vec<Vector3<f64>>,
    /// Stiffness of the delay.
    delay: f64,
}

impl<'a> Measurements<'a> {
    fn new(lengths: &'a Lengths<'a>) -> Self {
        let count = lengths.first_m.len();
        let pairs = count * count.saturating_sub(1) / 2;
        assert!(lengths.dimensions == 2 || lengths.dimensions == 3, "space has 2 or 3 dimensions");
        assert!(count >= 3 && lengths.second_m.len() == pairs, "{count} patches have {pairs} pairs");
        let positive = match lengths.second_sd_m {
            Sds::Common(sd_m) => sd_m > 0.0,
            Sds::Each(sds_m) => sds_m.len() == pairs && sds_m.iter().all(|sd_m| *sd_m > 0.0),
        };
        assert!(positive && lengths.first_sd_m > 0.0 && lengths.delay_sd_m >= 0.0, "standard deviations are positive");
        Self { lengths, count, stride: count + LANES }
    }

    fn sd_m(&self, pair: usize) -> f32 {
        match self.lengths.second_sd_m {
            Sds::Common(sd_m) => sd_m,
            Sds::Each(sds_m) => sds_m[pair],
        }
    }

    /// Landmark scaling of the distances; one that is missing is the shortest detour over another landmark.
    fn start(&self) -> Vec<Point> {
        let over_p0 = |a: usize, b: usize| {
            self.distance_m(a, b).unwrap_or_else(|| 0.5 * (self.lengths.first_m[a - 1] + self.lengths.first_m[b - 1]))
        };
        let landmarks = landmark::spread(self.count + 1, LANDMARKS.min(self.count + 1), over_p0);
        let detour = |a: usize, b: usize| {
            let over = |&via: &usize| Some(self.distance_m(a, via)? + self.distance_m(via, b)?);
            landmarks.iter().filter_map(over).fold(f64::INFINITY, f64::min)
        };
        let filled = |a: usize, b: usize| self.distance_m(a, b).unwrap_or_else(|| detour(a, b));
        landmark::embed(self.count + 1, &landmarks, filled, self.lengths.dimensions)
    }

    /// Distance of two patches, 0 for p0, by their bounces alone; `None` if that of the pair is missing.
    fn distance_m(&self, a: usize, b: usize) -> Option<f64> {
        let range_m = |i: usize| 0.5 * self.lengths.first_m[i - 1];
        match (a.max(b), a.min(b)) {
            (i, j) if i == j => Some(0.0),
            (i, 0) => Some(range_m(i)),
            (i, j) => {
                let pair = (i - 1) * (i - 2) / 2 + j - 1;
                let across_m = || (f64::from(self.lengths.second_m[pair]) - range_m(i) - range_m(j)).max(0.0);
                self.sd_m(pair).is_finite().then(across_m)
            }
        }
    }

    fn values(&self, points: &[Point], delay_m: f64) -> Values {
        let mut x = vec![0.0; 3 * self.stride + 1];
        for (i, k) in (0..self.count).flat_map(|i| (0..3).map(move |k| (i, k))) {
            x[k * self.stride + i] = points[i][k];
        }
        x[3 * self.stride] = delay_m;
        self.seen_from_p0(x)
    }

    fn moved(&self, from: &Values, step: &[f64], share: f64) -> Values {
        self.seen_from_p0(from.x.iter().zip(step).map(|(x, step)| x + share * step).collect())
    }

    fn seen_from_p0(&self, x: Vec<f64>) -> Values {
        let (mut range, mut out) = (vec![0.0; self.stride], vec![0.0; 3 * self.stride]);
        for i in 0..self.count {
            let arm = self.patch(&x, i);
            range[i] = arm.norm();
            let direction = arm.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
            (0..3).for_each(|k| out[k * self.stride + i] = direction[k]);
        }
        Values { x, range, out }
    }

    /// Part of a vector that belongs to a patch.
    fn patch(&self, vector: &[f64], i: usize) -> Vector3<f64> {
        Vector3::from_fn(|k, _| vector[k * self.stride + i])
    }

    /// Solves the positions' part of the normal equations for a right-hand side, from a guess, by preconditioned
    /// conjugate gradients. Rotations, which the equations leave open, stay as they are in the guess. Gives what is
    /// left of the right-hand side.
    fn solve_positions(
        &self,
        values: &Values,
        slope: &Slope,
        right: &[f64],
        solved: f64,
        guess: &mut [f64],
        passes: &mut usize,
    ) -> Vec<f64> {
        let product = |vector: &[f64]| {
            let mut product = self.product(values, vector);
            product[3 * self.stride] = 0.0;
            product
        };
        let precondition = |vector: &[f64]| {
            let part = |i: usize| slope.inverses[i] * self.patch(vector, i);
            self.gather(part)
        };
        let target = dot(right, &precondition(right)) * solved * solved;
        let mut left = right.to_vec();
        if guess.iter().any(|guess| *guess != 0.0) {
            left.iter_mut().zip(product(guess)).for_each(|(left, product)| *left -= product);
            *passes += 1;
        }
        let mut towards = precondition(&left);
        let mut size = dot(&left, &towards);
        let mut direction = towards.clone();
        for _ in 0..DIRECTIONS {
            if size <= target {
                break;
            }
            let product = product(&direction);
            *passes += 1;
            let share = size / dot(&direction, &product);
            guess.iter_mut().zip(&direction).for_each(|(guess, direction)| *guess += share * direction);
            left.iter_mut().zip(&product).for_each(|(left, product)| *left -= share * product);
            towards = precondition(&left);
            let before = std::mem::replace(&mut size, dot(&left, &towards));
            direction.iter_mut().zip(&towards).for_each(|(d, towards)| *d = towards + size / before * *d);
        }
        left
    }

    /// A vector over unknowns from its parts; nothing for the delay.
    fn gather(&self, part: impl Fn(usize) -> Vector3<f64>) -> Vec<f64> {
        let mut vector = vec![0.0; 3 * self.stride + 1];
        for i in 0..self.count {
            let part = part(i);
            (0..3).for_each(|k| vector[k * self.stride + i] = part[k]);
        }
        vector
    }

    /// How positions answer to the delay: the solution for its column, improved from a guess, and what stiffness of the
    /// delay that leaves.
    fn answer(&self, values: &Values, slope: &Slope, answer: &mut [f64], passes: &mut usize) -> f64 {
        let column = self.gather(|i| slope.coupling[i]);
        let left = self.solve_positions(values, slope, &column, SOLVED_DELAY, answer, passes);
        // To second order in the error of the answer.
        slope.delay - dot(&column, answer) - dot(&left, answer)
    }

    /// The step, with the delay eliminated, which would spoil the condition; and its size in standard deviations.
    fn newton_step(&self, values: &Values, slope: &Slope, answer: &mut [f64], passes: &mut usize) -> (Vec<f64>, f64) {
        let delay = 3 * self.stride;
        let mut right = slope.right.clone();
        right[delay] = 0.0;
        let mut step = vec![0.0; right.len()];
        self.solve_positions(values, slope, &right, SOLVED, &mut step, passes);
        let size = (dot(&step, &right) / (self.count * self.lengths.dimensions) as f64).max(0.0).sqrt();
        // Far from the solution the delay would cost many passes and tell little.
        if self.delay_weight().is_none() || size > NEAR {
            return (step, size);
        }
        let stiffness = self.answer(values, slope, answer, passes);
        let change = (slope.right[delay] - dot(answer, &right)) / stiffness;
        step.iter_mut().zip(answer).for_each(|(step, answer)| *step -= change * *answer);
        step[delay] = change;
        (step, size.max(change.abs() * stiffness.sqrt()))
    }

    /// The rotation about p0 in a motion of all patches.
    fn rotation(&self, values: &Values, motion: &[f64]) -> Vector3<f64> {
        let (mut inertia, mut momentum) = (Matrix3::zeros(), Vector3::zeros());
        for i in 0..self.count {
            let arm = self.patch(&values.x, i);
            inertia += Matrix3::identity() * arm.norm_squared() - arm * arm.transpose();
            momentum += arm.cross(&self.patch(motion, i));
        }
        definite_inverse(&inertia) * momentum
    }

    fn finish(&self, values: &Values, slope: &Slope, mut answer: Vec<f64>, mut passes: usize) -> Solution {
        let mut covariances_m2 = slope.inverses.clone();
        let mut delay_variance_m2 = 0.0;
        if self.delay_weight().is_some() {
            delay_variance_m2 = 1.0 / self.answer(values, slope, &mut answer, &mut passes);
            let turn = self.rotation(values, &answer);
            for (i, covariance) in covariances_m2.iter_mut().enumerate() {
                let answer = self.patch(&answer, i) - turn.cross(&self.patch(&values.x, i));
                *covariance += delay_variance_m2 * answer * answer.transpose();
            }
        }
        let missing = match self.lengths.second_sd_m {
            Sds::Common(_) => 0,
            Sds::Each(sds_m) => sds_m.iter().filter(|sd_m| !sd_m.is_finite()).count(),
        };
        let rotations = if self.lengths.dimensions == 3 { 3 } else { 1 };
        let delays = usize::from(self.delay_weight().is_some());
        let data = self.count + self.lengths.second_m.len() - missing + delays;
        let unknowns = self.count * self.lengths.dimensions + delays;
        Solution {
            points: (0..self.count).map(|i| Point::from(self.patch(&values.x, i))).collect(),
            covariances_m2,
            delay_m: values.x[3 * self.stride],
            delay_variance_m2,
            loss: slope.loss,
            degrees_of_freedom: (data + rotations) as i64 - unknowns as i64,
            passes,
        }
    }
}

/// Inverse of a block; in flatland, which has no stiffness along z, and of a patch without pairs, in what directions it
/// has.
fn definite_inverse(block: &Matrix3<f64>) -> Matrix3<f64> {
    let eigen = block.symmetric_eigen();
    let floor = 1e-12 * eigen.eigenvalues.max();
    let inverse = eigen.eigenvalues.map(|value| if value > floor { 1.0 / value } else { 0.0 });
    eigen.eigenvectors * Matrix3::from_diagonal(&inverse) * eigen.eigenvectors.transpose()
}

#[cfg(test)]
mod tests;
