//! Cholesky factor of a covariance whose correlation has a short reach.
//!
//! Not that of `signal::banded`: the bound shares no code with the estimators, and whitens where these solve.

/// Lower factor of a symmetric positive definite matrix with few diagonals (Golub and Van Loan, *Matrix Computations*,
/// section 4.3.5).
pub struct Banded {
    reach: usize,
    /// Row by row, `reach + 1` values up to the diagonal.
    rows: Vec<f64>,
}

impl Banded {
    /// Factors the covariance of noise: `acf[lag]` for the correlated part, plus the variances `extra[i]` on the
    /// diagonal.
    ///
    /// # Panics
    /// When the covariance is not positive definite.
    pub fn new(acf: &[f64], extra: &[f64]) -> Self {
        Self::factored(acf, extra).expect("a covariance is positive definite")
    }

    /// The same; `None` when the covariance is not positive definite.
    pub fn factored(acf: &[f64], extra: &[f64]) -> Option<Self> {
        let reach = acf.len() - 1;
        let width = reach + 1;
        let mut rows = vec![0.0; extra.len() * width];
        for i in 0..extra.len() {
            for j in i.saturating_sub(reach)..=i {
                let mut value = acf[i - j] + if i == j { extra[i] } else { 0.0 };
                for k in i.saturating_sub(reach)..j {
                    if j - k <= reach {
                        value -= rows[i * width + reach + k - i] * rows[j * width + reach + k - j];
                    }
                }
                rows[i * width + reach + j - i] = if i == j {
                    if value.is_nan() || value <= 0.0 {
                        return None;
                    }
                    value.sqrt()
                } else {
                    value / rows[j * width + reach]
                };
            }
        }
        Some(Self { reach, rows })
    }

    /// Solves `L x = b` in place: turns noise of this covariance into white noise of variance 1.
    pub fn whiten(&self, b: &mut [f64]) {
        let width = self.reach + 1;
        for i in 0..b.len() {
            let start = i.saturating_sub(self.reach);
            let row = &self.rows[i * width..(i + 1) * width];
            let done: f64 = (start..i).map(|k| row[self.reach + k - i] * b[k]).sum();
            b[i] = (b[i] - done) / row[self.reach];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn whitening_is_the_dense_factors() {
        let (acf, extra) = ([2.0, 0.9, -0.3], [0.1, 0.4, 0.2, 0.3, 0.7, 0.1, 0.5]);
        let dense = DMatrix::from_fn(7, 7, |i, j| {
            acf.get(i.abs_diff(j)).copied().unwrap_or(0.0) + if i == j { extra[i] } else { 0.0 }
        });
        let factor = dense.cholesky().unwrap();
        let mut values = [1.0, -2.0, 0.5, 3.0, 0.0, 1.5, -1.0];
        let expected = factor.l().solve_lower_triangular(&DMatrix::from_column_slice(7, 1, &values)).unwrap();
        Banded::new(&acf, &extra).whiten(&mut values);
        assert!(values.iter().zip(expected.iter()).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
