//! The two small dense solvers of the fit: Cholesky, and least squares with non-negative unknowns.
//!
//! A fit solves thousands of systems of one to ten unknowns; a call into a blocked library costs more than such a
//! system. Matrices are row-major slices of `n * n`. Sources: Golub and Van Loan, *Matrix Computations*, section 4.2;
//! Lawson and Hanson, *Solving Least Squares Problems*, chapter 23.

/// Pivots below this part of their diagonal element count as singular.
const SINGULAR: f64 = 1e-13;

/// Factor `A = L L^T` of a symmetric positive definite matrix.
pub(super) struct Cholesky {
    n: usize,
    lower: Vec<f64>,
}

impl Cholesky {
    /// `None` if `matrix` (`n * n`) is not positive definite to working precision.
    pub(super) fn new(mut matrix: Vec<f64>, n: usize) -> Option<Self> {
        for j in 0..n {
            let diagonal = matrix[j * n + j];
            for i in j..n {
                let (row_j, row_i) = (&matrix[j * n..j * n + j], &matrix[i * n..i * n + j]);
                let done: f64 = row_i.iter().zip(row_j).map(|(a, b)| a * b).sum();
                let rest = matrix[i * n + j] - done;
                if i > j {
                    matrix[i * n + j] = rest / matrix[j * n + j];
                } else if rest > SINGULAR * diagonal && diagonal > 0.0 {
                    matrix[j * n + j] = rest.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { n, lower: matrix })
    }

    /// Solves `A x = b` in place.
    pub(super) fn solve(&self, b: &mut [f64]) {
        self.solve_lower(b);
        self.solve_upper(b);
    }

    /// Solves `L^T x = b` in place.
    pub(super) fn solve_upper(&self, b: &mut [f64]) {
        for i in (0..self.n).rev() {
            let rest: f64 = (i + 1..self.n).map(|k| self.lower[k * self.n + i] * b[k]).sum();
            b[i] = (b[i] - rest) / self.lower[i * self.n + i];
        }
    }

    /// Solves `L x = b` in place: then `x . x = b^T A^-1 b`.
    pub(super) fn solve_lower(&self, b: &mut [f64]) {
        for i in 0..self.n {
            let row = &self.lower[i * self.n..i * self.n + i];
            let done: f64 = row.iter().zip(b.iter()).map(|(l, x)| l * x).sum();
            b[i] = (b[i] - done) / self.lower[i * self.n + i];
        }
    }

    /// Half the logarithm of the determinant of A.
    pub(super) fn half_log_determinant(&self) -> f64 {
        (0..self.n).map(|i| self.lower[i * self.n + i].ln()).sum()
    }

    /// Inverse of A, row-major.
    pub(super) fn inverse(&self) -> Vec<f64> {
        let n = self.n;
        let mut inverse = vec![0.0; n * n];
        for i in 0..n {
            let row = &mut inverse[i * n..(i + 1) * n];
            row[i] = 1.0;
            self.solve(row); // column i, and the inverse is symmetric
        }
        inverse
    }
}

/// Minimises `x^T G x - 2 b^T x` for `gram` G (`n * n`). `None` if G is singular.
pub(super) fn least_squares(gram: &[f64], b: &[f64]) -> Option<Vec<f64>> {
    solve_on(gram, b, &(0..b.len()).collect::<Vec<_>>())
}

/// Minimises `x^T G x - 2 b^T x` over `x >= 0` for `gram` G (`n * n`). `None` if G is singular.
pub(super) fn non_negative(gram: &[f64], b: &[f64]) -> Option<Vec<f64>> {
    let n = b.len();
    let x = least_squares(gram, b)?;
    if x.iter().all(|v| *v > 0.0) {
        return Some(x);
    }
    let mut x = vec![0.0; n];
    let mut free: Vec<usize> = Vec::new();
    // Each round adds one unknown and strictly lowers the objective; the bound only guards against rounding.
    for _ in 0..3 * n {
        let descent = |i: usize| b[i] - (0..n).map(|j| gram[i * n + j] * x[j]).sum::<f64>();
        let tolerance = |i: usize| 1e-10 * (gram[i * n + i].sqrt() + b[i].abs());
        let best = (0..n)
            .filter(|i| !free.contains(i) && descent(*i) > tolerance(*i))
            .max_by(|i, j| descent(*i).total_cmp(&descent(*j)));
        let Some(best) = best else { break };
        free.push(best);
        loop {
            let trial = solve_on(gram, b, &free)?;
            // The longest step towards the trial that keeps all free unknowns non-negative.
            let blocked = free
                .iter()
                .zip(&trial)
                .filter(|(_, t)| **t <= 0.0)
                .map(|(&i, t)| (i, x[i] / (x[i] - t)))
                .min_by(|p, q| p.1.total_cmp(&q.1));
            let length = blocked.map_or(1.0, |(_, l)| l);
            for (&i, t) in free.iter().zip(&trial) {
                x[i] += length * (t - x[i]);
            }
            let Some((out, _)) = blocked else { break };
            x[out] = 0.0;
            free.retain(|i| *i != out);
        }
    }
    Some(x)
}

fn solve_on(gram: &[f64], b: &[f64], free: &[usize]) -> Option<Vec<f64>> {
    let n = b.len();
    let part = free.iter().flat_map(|i| free.iter().map(move |j| gram[i * n + j])).collect();
    let mut x: Vec<f64> = free.iter().map(|i| b[*i]).collect();
    Cholesky::new(part, free.len())?.solve(&mut x);
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// `B^T B` of a random `2n * n` matrix.
    fn random_gram(n: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let b: Vec<f64> = (0..2 * n * n).map(|_| rng.random_range(-1.0..1.0)).collect();
        (0..n * n).map(|e| (0..2 * n).map(|r| b[r * n + e / n] * b[r * n + e % n]).sum()).collect()
    }

    fn times(matrix: &[f64], x: &[f64]) -> Vec<f64> {
        matrix.chunks_exact(x.len()).map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum()).collect()
    }

    #[test]
    fn cholesky_solves_and_inverts_and_refuses_the_singular() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for n in 1..9 {
            let matrix = random_gram(n, &mut rng);
            let b: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
            let factor = Cholesky::new(matrix.clone(), n).expect("definite");
            let (mut x, mut half) = (b.clone(), b.clone());
            factor.solve(&mut x);
            factor.solve_lower(&mut half);
            for (left, right) in times(&matrix, &x).iter().zip(&b) {
                assert!((left - right).abs() < 1e-9);
            }
            let quadratic: f64 = b.iter().zip(&x).map(|(b, x)| b * x).sum();
            assert!((half.iter().map(|v| v * v).sum::<f64>() - quadratic).abs() < 1e-9);
            for (left, right) in times(&factor.inverse(), &b).iter().zip(&x) {
                assert!((left - right).abs() < 1e-9);
            }
        }
        assert!(Cholesky::new(vec![1.0, 1.0, 1.0, 1.0], 2).is_none());
    }

    #[test]
    fn non_negative_is_the_best_of_all_active_sets() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..300 {
            let n = 4;
            let gram = random_gram(n, &mut rng);
            let b: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
            let energy = |x: &[f64]| -> f64 {
                let gx = times(&gram, x);
                (0..n).map(|i| x[i] * (2.0 * b[i] - gx[i])).sum()
            };
            // The optimum is the unconstrained solution on some set of unknowns.
            let mut best = 0.0_f64;
            for set in 1..1_usize << n {
                let free: Vec<usize> = (0..n).filter(|i| set >> i & 1 == 1).collect();
                let part = solve_on(&gram, &b, &free).expect("definite");
                if part.iter().all(|v| *v >= 0.0) {
                    let mut x = vec![0.0; n];
                    free.iter().zip(&part).for_each(|(i, v)| x[*i] = *v);
                    best = best.max(energy(&x));
                }
            }
            let x = non_negative(&gram, &b).expect("definite");
            assert!(x.iter().all(|v| *v >= 0.0));
            assert!((energy(&x) - best).abs() < 1e-9);
        }
    }
}
