//! Embedding by semidefinite programming: convex, without a start, to be compared with.
//!
//! Over Gram matrices G about p0 it minimises
//!
//! ```text
//! sum_ij w_ij (G_ii - 2 G_ij + G_jj - d_ij^2)^2 / 2        G positive semidefinite
//! ```
//!
//! with G_00 = 0 and `w` the weights of the distances carried over to their squares, and takes the directions of the
//! largest eigenvalues. The rank, which should be that of space, is let go; that makes it convex. Sources: the paper's
//! reference 22; Alfakih, Khandani and Wolkowicz, Comput. Optim. Appl. 12, 13 (1999) for the completion of distance
//! matrices. Solved by projected gradients with momentum that restarts when it overshoots (Beck and Teboulle, SIAM J.
//! Imaging Sci. 2, 183 (2009); O'Donoghue and Candes, Found. Comput. Math. 15, 715 (2015)): an eigenproblem a round,
//! hence for up to 60 patches.
//!
//! Measured with all pairs (docs/geometry.md): more than 100 times slower than SMACOF from classical scaling and no
//! more exact, since noise fills the directions that space does not have.

use faer::Mat;

use crate::{Point, dense};

/// Most rounds.
const ROUNDS: usize = 2000;
/// Settled when a round changes the matrix by no more than this share.
const SETTLED: f64 = 1e-7;
/// Squared distances below this share of their mean weigh as if they were it.
const SHORT: f64 = 0.01;

/// Points of patches 1..M, p0 at the origin, from distances and weights (0: not measured) over p0..pM; the frame is
/// arbitrary.
///
/// # Panics
/// When the matrices are not square and of one size, or `dimensions` is neither 2 nor 3.
#[must_use]
pub fn embed(distances_m: &Mat<f64>, weights: &Mat<f64>, dimensions: usize) -> Vec<Point> {
    assert!(dimensions == 2 || dimensions == 3, "space has 2 or 3 dimensions");
    let problem = Problem::new(distances_m, weights);
    let step = 1.0 / problem.stiffness();
    let size = problem.size;
    let mut gram = Mat::zeros(size, size);
    let (mut ahead, mut momentum): (Mat<f64>, f64) = (Mat::zeros(size, size), 1.0);
    for _ in 0..ROUNDS {
        let slope = problem.slope(&ahead);
        let (next, values, vectors) =
            semidefinite(&Mat::from_fn(size, size, |i, j| ahead[(i, j)] - step * slope[(i, j)]));
        let change = &next - &gram;
        let overshot = entries(size).map(|at| (ahead[at] - next[at]) * change[at]).sum::<f64>() > 0.0;
        let following = if overshot { 1.0 } else { 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt()) };
        let share = if overshot { 0.0 } else { (momentum - 1.0) / following };
        ahead = Mat::from_fn(size, size, |i, j| next[(i, j)] + share * change[(i, j)]);
        momentum = following;
        let squares = |matrix: &Mat<f64>| entries(size).map(|at| matrix[at] * matrix[at]).sum::<f64>();
        let settled = squares(&change) <= SETTLED * SETTLED * squares(&next);
        gram = next;
        if settled {
            return points(&values, &vectors, dimensions);
        }
    }
    let (_, values, vectors) = semidefinite(&gram);
    points(&values, &vectors, dimensions)
}

fn entries(size: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..size).flat_map(move |j| (0..size).map(move |i| (i, j)))
}

/// The nearest semidefinite matrix, with its eigenvalues and vectors.
fn semidefinite(matrix: &Mat<f64>) -> (Mat<f64>, Vec<f64>, Mat<f64>) {
    let (values, vectors) = dense::symmetric_eigen(matrix);
    let scaled = Mat::from_fn(values.len(), values.len(), |i, k| vectors[(i, k)] * values[k].max(0.0));
    (dense::product(scaled.as_ref(), vectors.transpose()), values, vectors)
}

/// Coordinates along the largest eigenvalues.
fn points(values: &[f64], vectors: &Mat<f64>, dimensions: usize) -> Vec<Point> {
    let count = values.len();
    let coordinate = |i: usize, k: usize| {
        if k < dimensions.min(count) {
            values[count - 1 - k].max(0.0).sqrt() * vectors[(i, count - 1 - k)]
        } else {
            0.0
        }
    };
    (0..count).map(|i| Point::new(coordinate(i, 0), coordinate(i, 1), coordinate(i, 2))).collect()
}

/// Squared distances over p0..pM with their weights; `size` is M.
struct Problem {
    size: usize,
    squares: Mat<f64>,
    weights: Mat<f64>,
}

impl Problem {
    fn new(distances_m: &Mat<f64>, weights: &Mat<f64>) -> Self {
        let count = distances_m.nrows();
        assert!(
            [distances_m, weights].iter().all(|matrix| matrix.nrows() == count && matrix.ncols() == count),
            "distances and weights are square matrices of one size"
        );
        let measured = |(i, j): &(usize, usize)| i != j && weights[(*i, *j)] > 0.0;
        let squares = Mat::from_fn(count, count, |i, j| distances_m[(i, j)] * distances_m[(i, j)]);
        let distances = entries(count).filter(measured);
        let (sum, number) = distances.fold((0.0, 0.0), |(sum, number), at| (sum + squares[at], number + 1.0));
        let floor = SHORT * sum / number;
        let weights = Mat::from_fn(count, count, |i, j| {
            if measured(&(i, j)) { weights[(i, j)] / (4.0 * squares[(i, j)].max(floor)) } else { 0.0 }
        });
        Self { size: count - 1, squares, weights }
    }

    /// Derivative of the objective by the Gram matrix.
    fn slope(&self, gram: &Mat<f64>) -> Mat<f64> {
        self.weighted(gram, |at| self.squares[at])
    }

    /// Weighted misfits of a Gram matrix to targets, taken back to Gram matrices.
    fn weighted(&self, gram: &Mat<f64>, target: impl Fn((usize, usize)) -> f64) -> Mat<f64> {
        let mut back = Mat::zeros(self.size, self.size);
        for i in 0..self.size {
            // p0 first: its distance is the diagonal alone.
            back[(i, i)] += self.weights[(0, i + 1)] * (gram[(i, i)] - target((0, i + 1)));
            for j in 0..i {
                let square = gram[(i, i)] - 2.0 * gram[(i, j)] + gram[(j, j)];
                let pull = self.weights[(i + 1, j + 1)] * (square - target((i + 1, j + 1)));
                back[(i, i)] += pull;
                back[(j, j)] += pull;
                back[(i, j)] -= pull;
                back[(j, i)] -= pull;
            }
        }
        back
    }

    /// Largest eigenvalue of the objective's second derivative, from above, by power iteration.
    fn stiffness(&self) -> f64 {
        let mut gram = Mat::from_fn(self.size, self.size, |i, j| if i == j { 1.0 } else { 0.0 });
        let mut largest = 0.0;
        for _ in 0..50 {
            let next = self.weighted(&gram, |_| 0.0);
            largest = entries(self.size).map(|at| next[at] * next[at]).sum::<f64>().sqrt();
            gram = Mat::from_fn(self.size, self.size, |i, j| next[(i, j)] / largest);
        }
        1.05 * largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room;
    use periscope_geometry::procrustes;

    #[test]
    fn exact_distances_give_the_points_back_though_some_are_missing() {
        let truth: Vec<Point> = room::rectangles().into_iter().step_by(3).collect();
        let all: Vec<Point> = std::iter::once(Point::origin()).chain(truth.iter().copied()).collect();
        let count = all.len();
        let distances = Mat::from_fn(count, count, |i, j| (all[i] - all[j]).norm());
        let weights = Mat::from_fn(count, count, |i, j| if i * j % 5 == 2 { 0.0 } else { 1.0 });
        let solution = embed(&distances, &weights, 3);
        let fit = procrustes::rotation(&solution, &truth, Point::origin(), true);
        assert!(fit.rms_m < 0.01, "{}", fit.rms_m);
    }

    #[test]
    fn slopes_are_derivatives() {
        let distances = Mat::from_fn(5, 5, |i, j| if i == j { 0.0 } else { 1.0 + 0.1 * (i * j) as f64 });
        let problem = Problem::new(&distances, &Mat::from_fn(5, 5, |i, j| 1.0 + (i + j) as f64));
        let objective = |gram: &Mat<f64>| {
            let mut sum = 0.0;
            for i in 0..4 {
                sum += 0.5 * problem.weights[(0, i + 1)] * (gram[(i, i)] - problem.squares[(0, i + 1)]).powi(2);
                for j in 0..i {
                    let square = gram[(i, i)] - 2.0 * gram[(i, j)] + gram[(j, j)];
                    sum += 0.5 * problem.weights[(i + 1, j + 1)] * (square - problem.squares[(i + 1, j + 1)]).powi(2);
                }
            }
            sum
        };
        let gram = Mat::from_fn(4, 4, |i, j| 0.3 + 0.2 * (i as f64) * (j as f64));
        let slope = problem.slope(&gram);
        for (i, j) in [(0, 0), (2, 1), (3, 3)] {
            let moved = |by: f64| {
                let mut moved = gram.clone();
                moved[(i, j)] += by;
                moved[(j, i)] = moved[(i, j)];
                objective(&moved)
            };
            let both = if i == j { 1.0 } else { 2.0 };
            assert!(((moved(1e-6) - moved(-1e-6)) / 2e-6 - both * slope[(i, j)]).abs() < 1e-6);
        }
    }
}
