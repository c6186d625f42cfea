//! Symmetric matrices with few diagonals, as splines have them: Cholesky factor, solutions and determinant.
//!
//! With `n` unknowns and `b` sub-diagonals the factor costs O(n b^2) and a solution O(n b), where a full matrix takes
//! O(n^3) and O(n^2). Source: Golub and Van Loan, *Matrix Computations*, section 4.3.5.

/// Symmetric n x n matrix with `W - 1` sub-diagonals. Only its lower half is stored.
#[derive(Clone, Debug)]
pub struct Banded<const W: usize> {
    /// Row `i`: the elements at columns `i`, `i - 1`, .., `i - (W - 1)`. Those left of column 0 are 0.
    rows: Vec<[f64; W]>,
}

impl<const W: usize> Banded<W> {
    /// The zero matrix with `count` rows.
    #[must_use]
    pub fn zeros(count: usize) -> Self {
        Self { rows: vec![[0.0; W]; count] }
    }

    /// Adds to the element at row `i` and column `j`, and to its mirror image.
    ///
    /// # Panics
    /// When the element lies outside of the band.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.rows[i.max(j)][i.abs_diff(j)] += value;
    }

    /// Adds `weight D^T D`, where D takes second differences of the unknowns: (1, -2, 1).
    ///
    /// # Panics
    /// With fewer than three rows or diagonals.
    pub fn add_second_differences(&mut self, weight: f64) {
        let difference = [1.0, -2.0, 1.0];
        for i in 0..self.rows.len() - 2 {
            for a in 0..3 {
                for b in a..3 {
                    self.add(i + a, i + b, weight * difference[a] * difference[b]);
                }
            }
        }
    }

    /// Cholesky factor; `None` for a matrix that is not positive definite.
    #[must_use]
    pub fn cholesky(&self) -> Option<BandedFactor<W>> {
        let mut rows = self.rows.clone();
        for i in 0..rows.len() {
            for j in i.saturating_sub(W - 1)..=i {
                let before = i.saturating_sub(W - 1)..j;
                let done: f64 = before.map(|k| rows[j][j - k] * rows[i][i - k]).sum();
                let rest = rows[i][i - j] - done;
                rows[i][i - j] = if i == j { Some(rest).filter(|rest| *rest > 0.0)?.sqrt() } else { rest / rows[j][0] };
            }
        }
        Some(BandedFactor { rows })
    }
}

/// Lower triangular factor L of a matrix `L L^T`, stored like the matrix.
#[derive(Clone, Debug)]
pub struct BandedFactor<const W: usize> {
    rows: Vec<[f64; W]>,
}

impl<const W: usize> BandedFactor<W> {
    /// Solves `L L^T x = b` in place.
    ///
    /// # Panics
    /// When `b` has more values than the matrix has rows.
    pub fn solve(&self, b: &mut [f64]) {
        let count = b.len();
        for i in 0..count {
            let done: f64 = (i.saturating_sub(W - 1)..i).map(|k| self.rows[i][i - k] * b[k]).sum();
            b[i] = (b[i] - done) / self.rows[i][0];
        }
        for i in (0..count).rev() {
            let done: f64 = (i + 1..count.min(i + W)).map(|k| self.rows[k][k - i] * b[k]).sum();
            b[i] = (b[i] - done) / self.rows[i][0];
        }
    }

    /// Natural logarithm of the determinant of `L L^T`.
    #[must_use]
    pub fn log_determinant(&self) -> f64 {
        2.0 * self.rows.iter().map(|row| row[0].ln()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A banded matrix, and the same in full.
    fn both<const W: usize>(count: usize, rng: &mut ChaCha8Rng) -> (Banded<W>, DMatrix<f64>) {
        let (mut banded, mut full) = (Banded::<W>::zeros(count), DMatrix::zeros(count, count));
        for i in 0..count {
            for j in i.saturating_sub(W - 1)..=i {
                let value = if i == j { 2.0 * W as f64 } else { rng.random_range(-1.0..1.0) };
                banded.add(j, i, value);
                (full[(i, j)], full[(j, i)]) = (value, value);
            }
        }
        (banded, full)
    }

    fn check<const W: usize>(count: usize, rng: &mut ChaCha8Rng) {
        let (banded, full) = both::<W>(count, rng);
        let factor = banded.cholesky().expect("its diagonal dominates");
        let b: Vec<f64> = (0..count).map(|_| rng.random_range(-3.0..3.0)).collect();
        let mut x = b.clone();
        factor.solve(&mut x);
        let product = &full * DVector::from_vec(x);
        assert!(product.iter().zip(&b).all(|(product, b)| (product - b).abs() < 1e-12), "{count} {W}");
        assert!((factor.log_determinant() - full.determinant().ln()).abs() < 1e-9, "{count} {W}");
    }

    #[test]
    fn solutions_and_determinant_are_those_of_the_full_matrix() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for count in [1, 2, 3, 5, 12] {
            check::<1>(count, &mut rng);
            check::<3>(count, &mut rng);
            check::<4>(count, &mut rng);
        }
    }

    #[test]
    fn second_differences_of_lines_are_zero_and_lines_alone_leave_it_singular() {
        let mut matrix = Banded::<3>::zeros(7);
        matrix.add_second_differences(4.0);
        // Multiplied out for the unit vectors: (1, -4, 6, -4, 1) in the middle.
        assert_eq!(matrix.rows[3], [24.0, -16.0, 4.0]);
        assert_eq!((matrix.rows[0][0], matrix.rows[1][1]), (4.0, -8.0));
        assert!(matrix.cholesky().is_none());
        (0..7).for_each(|i| matrix.add(i, i, 1.3));
        assert!(matrix.cholesky().is_some());
    }
}
