//! Steps without the normal matrix: for thousands of patches.
//!
//! A product of the normal matrix with a vector is one pass over all observations. Coordinates of the patches are
//! solved for by conjugate gradients, preconditioned with the blocks of the patches; the few other unknowns (stations,
//! delays, period) are eliminated first, a right-hand side each. Observations are cut into chunks by their number
//! alone, and the chunks' sums are added in order: the same bits for any number of threads.
//!
//! Covariances are blocks: the inverse of a patch's block of the normal matrix, as if all other patches were fixed,
//! plus the share of the other unknowns. That share is exact. With nearly all pairs measured the block is within some
//! per cent of the exact one; where many are missing it is too small.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::rows::{Rows, Values};
use crate::dense;

/// Chunks that the observations are cut into: a number that does not depend on the threads, so neither do the bytes of
/// the sums.
const CHUNKS: usize = 32;
/// Most conjugate directions in a step.
const DIRECTIONS: usize = 200;
/// A step's equations are solved to this share of their right-hand side.
const SOLVED: f64 = 1e-3;
/// The same of the other unknowns': moving all patches outwards nearly makes up for a delay, and what remains of its
/// stiffness is a small difference.
const SOLVED_OTHERS: f64 = 1e-6;

/// Right-hand side, blocks of the patches, and what couples to the other unknowns.
struct Slope {
    right: Vec<f64>,
    blocks: Vec<Matrix3<f64>>,
    /// Columns of the normal matrix of the other unknowns.
    others: Mat<f64>,
}

/// Sums on the way to a slope: right-hand side, blocks, others, and room for a row's terms.
type Sums = (Vec<f64>, Vec<f64>, Vec<f64>, Vec<(usize, f64)>);

/// Sum over all rows, in chunks.
fn summed<T: Send>(
    rows: &Rows,
    zero: impl Fn() -> T + Sync,
    add_row: impl Fn(&mut T, usize) + Sync,
    add: impl Fn(&mut T, T),
) -> T {
    let size = rows.count.div_ceil(CHUNKS).max(1);
    let chunk = |c: usize| {
        rows.problem.cancel.check();
        let mut sum = zero();
        (c * size..rows.count.min((c + 1) * size)).for_each(|n| add_row(&mut sum, n));
        sum
    };
    let chunks: Vec<T> = (0..CHUNKS).into_par_iter().map(chunk).collect();
    let mut total = zero();
    chunks.into_iter().for_each(|sum| add(&mut total, sum));
    total
}

fn add_to(sum: &mut [f64], other: &[f64]) {
    sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
}

fn add_sums(sums: &mut Sums, others: Sums) {
    add_to(&mut sums.0, &others.0);
    add_to(&mut sums.1, &others.1);
    add_to(&mut sums.2, &others.2);
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Objective.
pub fn cost(rows: &Rows, values: &Values) -> f64 {
    summed(rows, || 0.0, |sum, n| *sum += rows.cost(values, n..n + 1), |sum, other| *sum += other)
}

/// Which second derivatives of the objective.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matrix {
    /// The normal matrix, for lengths that change in proportion: the Fisher matrix.
    Normal,
    /// The whole, given the residuals. Where only near patches are paired, a scene is so soft that noise times the
    /// bending of short legs counts: near the minimum steps without it overshoot, and hundreds are needed. Far from
    /// there it need not be definite.
    Bent,
}

/// Product of a matrix with a vector.
pub fn product(rows: &Rows, values: &Values, matrix: Matrix, vector: &[f64]) -> Vec<f64> {
    let zero = || (vec![0.0; rows.layout.size], Vec::new());
    let add_row = |(sum, terms): &mut (Vec<f64>, Vec<(usize, f64)>), n: usize| {
        let residual = rows.residual(values, n, Some(terms));
        let weight = rows.loss(n, residual).1;
        let along: f64 = weight * terms.iter().map(|&(i, a)| a * vector[i]).sum::<f64>();
        terms.iter().for_each(|&(i, a)| sum[i] += a * along);
        if matrix == Matrix::Bent {
            rows.bend(values, n, (residual, weight), vector, sum);
        }
    };
    summed(rows, zero, add_row, |(sum, _), (other, _)| add_to(sum, &other)).0
}

impl Slope {
    fn new(rows: &Rows, values: &Values) -> Self {
        let layout = &rows.layout;
        let (size, dimensions, coordinates) = (layout.size, layout.dimensions, layout.coordinates);
        let patches = rows.problem.start.len();
        let zero = || {
            let others = vec![0.0; size * (size - coordinates)];
            (vec![0.0; size], vec![0.0; 9 * patches], others, Vec::new())
        };
        let add_row = |(right, blocks, others, terms): &mut Sums, n: usize| {
            let residual = rows.residual(values, n, Some(terms));
            let weight = rows.loss(n, residual).1;
            for &(i, a) in terms.iter() {
                right[i] += weight * a * residual;
                for &(j, b) in terms.iter() {
                    if j >= coordinates {
                        others[(j - coordinates) * size + i] += weight * a * b;
                    } else if i / dimensions == j / dimensions {
                        blocks[9 * (i / dimensions) + 3 * (i % dimensions) + j % dimensions] += weight * a * b;
                    }
                }
            }
        };
        let (right, blocks, others, _) = summed(rows, zero, add_row, add_sums);
        let block = |patch: usize| Matrix3::from_fn(|i, k| blocks[9 * patch + 3 * i + k]);
        Self {
            right,
            blocks: (0..patches).map(block).collect(),
            others: Mat::from_fn(size, size - coordinates, |i, k| others[k * size + i]),
        }
    }
}

/// A matrix of the patches' coordinates, damped.
struct Patches<'a> {
    rows: &'a Rows<'a>,
    values: &'a Values,
    matrix: Matrix,
    extra: Vec<f64>,
    inverses: Vec<Matrix3<f64>>,
}

impl<'a> Patches<'a> {
    /// `None` if a block is not definite.
    fn new(rows: &'a Rows<'a>, values: &'a Values, matrix: Matrix, slope: &Slope, damping: f64) -> Option<Self> {
        let dimensions = rows.layout.dimensions;
        let diagonal = |i: usize| slope.blocks[i / dimensions][(i % dimensions, i % dimensions)];
        let scale = (0..rows.layout.coordinates).map(diagonal).fold(0.0, f64::max);
        // The floor keeps rotations, which have no stiffness of their own, from blowing up.
        let floor = 1e-9 * damping.max(1e-3) * scale;
        let extra: Vec<f64> = (0..rows.layout.coordinates).map(|i| damping * diagonal(i) + floor).collect();
        let inverse = |(patch, block): (usize, &Matrix3<f64>)| {
            let at = |i: usize| if i < dimensions { extra[patch * dimensions + i] } else { 1.0 };
            (block + Matrix3::from_diagonal(&Vector3::from_fn(|i, _| at(i)))).try_inverse()
        };
        let inverses: Option<Vec<_>> = slope.blocks.iter().enumerate().map(inverse).collect();
        Some(Self { rows, values, matrix, inverses: inverses?, extra })
    }

    fn times(&self, vector: &[f64]) -> Vec<f64> {
        let mut all = vector.to_vec();
        all.resize(self.rows.layout.size, 0.0);
        let mut product = product(self.rows, self.values, self.matrix, &all);
        product.truncate(vector.len());
        product.iter_mut().zip(&self.extra).zip(vector).for_each(|((sum, extra), value)| *sum += extra * value);
        product
    }

    fn preconditioned(&self, vector: &[f64]) -> Vec<f64> {
        let dimensions = self.rows.layout.dimensions;
        let block = |(inverse, part): (&Matrix3<f64>, &[f64])| {
            let full = Vector3::from_fn(|i, _| part.get(i).copied().unwrap_or(0.0));
            let solved = inverse * full;
            (0..dimensions).map(|k| solved[k]).collect::<Vec<f64>>()
        };
        self.inverses.iter().zip(vector.chunks(dimensions)).flat_map(block).collect()
    }

    /// Conjugate gradients.
    fn solve(&self, right: &[f64], solved: f64) -> Vec<f64> {
        let (mut answer, mut residual) = (vec![0.0; right.len()], right.to_vec());
        let mut ahead = self.preconditioned(&residual);
        let mut direction = ahead.clone();
        let mut size = dot(&residual, &ahead);
        let enough = size * solved * solved;
        for _ in 0..DIRECTIONS {
            self.rows.problem.cancel.check();
            if size <= enough || size <= 0.0 {
                break;
            }
            let turned = self.times(&direction);
            let stiffness = dot(&direction, &turned);
            if stiffness <= 0.0 {
                // Paths bend more than they hold: what is found so far leads down, and so does the first direction.
                return if answer.iter().all(|value| *value == 0.0) { direction } else { answer };
            }
            let length = size / stiffness;
            answer.iter_mut().zip(&direction).for_each(|(sum, d)| *sum += length * d);
            residual.iter_mut().zip(&turned).for_each(|(sum, t)| *sum -= length * t);
            ahead = self.preconditioned(&residual);
            let next = dot(&residual, &ahead);
            direction.iter_mut().zip(&ahead).for_each(|(d, a)| *d = a + next / size * *d);
            size = next;
        }
        answer
    }

    /// What the patches do as each of the other unknowns moves by one, negated; and what is left of the others' normal
    /// matrix.
    fn eliminate(&self, others: &Mat<f64>) -> (Vec<Vec<f64>>, Mat<f64>) {
        let coordinates = self.rows.layout.coordinates;
        let column = |k: usize| -> Vec<f64> { (0..coordinates).map(|i| others[(i, k)]).collect() };
        let columns: Vec<Vec<f64>> = (0..others.ncols()).map(column).collect();
        let follow: Vec<Vec<f64>> = columns.iter().map(|column| self.solve(column, SOLVED_OTHERS)).collect();
        let left = Mat::from_fn(others.ncols(), others.ncols(), |i, k| {
            let (i, k) = (i.max(k), i.min(k));
            others[(coordinates + i, k)] - dot(&columns[i], &follow[k])
        });
        (follow, left)
    }
}

/// A damped Gauss-Newton step, or Newton step; `None` if a block is not definite.
pub fn step(rows: &Rows, values: &Values, matrix: Matrix, damping: f64) -> Option<Vec<f64>> {
    let slope = Slope::new(rows, values);
    let patches = Patches::new(rows, values, matrix, &slope, damping)?;
    let coordinates = rows.layout.coordinates;
    let mut step = patches.solve(&slope.right[..coordinates], SOLVED);
    if slope.others.ncols() == 0 {
        return Some(step);
    }
    let (follow, mut left) = patches.eliminate(&slope.others);
    (0..left.nrows()).for_each(|k| left[(k, k)] *= 1.0 + damping);
    let right: Vec<f64> = (0..left.nrows())
        .map(|k| slope.right[coordinates + k] - dot(&follow[k], &slope.right[..coordinates]))
        .collect();
    let others = dense::solve(&left, &right)?;
    for (follow, other) in follow.iter().zip(&others) {
        step.iter_mut().zip(follow).for_each(|(sum, follow)| *sum -= other * follow);
    }
    step.extend(others);
    Some(step)
}

/// Blocks of the patches (infinite where nothing determines one), and covariance of the other unknowns.
pub fn covariance(rows: &Rows, values: &Values) -> Option<(Vec<Matrix3<f64>>, Mat<f64>)> {
    let slope = Slope::new(rows, values);
    let patches = Patches::new(rows, values, Matrix::Normal, &slope, 0.0)?;
    let (follow, left) = patches.eliminate(&slope.others);
    let others = dense::inverse(&left)?;
    let dimensions = rows.layout.dimensions;
    let block = |(patch, own): (usize, &Matrix3<f64>)| {
        let lever = |k: usize, i: usize| if i < dimensions { follow[k][patch * dimensions + i] } else { 0.0 };
        let shared = Matrix3::from_fn(|i, j| {
            let pairs = (0..follow.len()).flat_map(|k| (0..follow.len()).map(move |l| (k, l)));
            pairs.map(|(k, l)| lever(k, i) * others[(k, l)] * lever(l, j)).sum::<f64>()
        });
        let own = Matrix3::from_fn(|i, j| if i < dimensions && j < dimensions { own[(i, j)] } else { 0.0 });
        own + shared
    };
    Some((patches.inverses.iter().enumerate().map(block).collect(), others))
}
