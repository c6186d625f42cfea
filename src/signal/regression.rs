//! Linear least squares with few unknowns: the normal equations, and what noise makes of the solution.
//!
//! Source: Press et al., *Numerical Recipes*, section 15.4. Columns are scaled to length 1 before the normal matrix is
//! inverted, so that units do not matter. Not modelled: correlated errors; a caller that has them propagates them
//! through [`Regression::influence`].

/// A fit of `right = sum_k values[k] columns[k]`, each row with its own standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// The coefficients.
    pub values: Vec<f64>,
    /// Their covariance, for rows with the standard deviations given.
    pub covariance: Vec<Vec<f64>>,
    /// Sum of squared residuals, each over its standard deviation.
    pub chi2: f64,
    /// Rows less coefficients.
    pub dof: usize,
}

impl Regression {
    /// Standard deviation of a coefficient.
    #[must_use]
    pub fn sd(&self, k: usize) -> f64 {
        self.covariance[k][k].sqrt()
    }

    /// How much each row's value moves coefficient `k`, for equal standard deviations `sd`.
    #[must_use]
    pub fn influence(&self, columns: &[Vec<f64>], sd: f64, k: usize) -> Vec<f64> {
        let weight = |n: usize| columns.iter().zip(&self.covariance[k]).map(|(column, c)| column[n] * c).sum::<f64>();
        (0..columns[0].len()).map(|n| weight(n) / (sd * sd)).collect()
    }
}

/// The least-squares fit; `None` when the columns do not determine the coefficients, or there are fewer rows than
/// columns.
///
/// # Panics
/// When lengths differ, there are no columns, or a standard deviation is not positive.
#[must_use]
pub fn least_squares(columns: &[Vec<f64>], right: &[f64], sd: &[f64]) -> Option<Regression> {
    let rows = right.len();
    assert!(!columns.is_empty() && sd.len() == rows, "a fit has columns, and a standard deviation for each row");
    assert!(columns.iter().all(|column| column.len() == rows), "columns have as many rows as the right side");
    assert!(sd.iter().all(|sd| *sd > 0.0), "standard deviations are positive");
    if rows < columns.len() {
        return None;
    }
    let dot = |a: &[f64], b: &[f64]| (0..rows).map(|n| a[n] * b[n] / (sd[n] * sd[n])).sum::<f64>();
    let scale: Vec<f64> = columns.iter().map(|column| dot(column, column).sqrt()).collect();
    if scale.iter().any(|scale| *scale == 0.0 || !scale.is_finite()) {
        return None;
    }
    let size = columns.len();
    let pairs = || (0..size).flat_map(|i| (0..size).map(move |j| (i, j)));
    let mut normal: Vec<f64> = pairs().map(|(i, j)| dot(&columns[i], &columns[j]) / (scale[i] * scale[j])).collect();
    let mut inverse = vec![0.0; size * size];
    invert(&mut normal, &mut inverse)?;
    let scaled: Vec<f64> = pairs().zip(&inverse).map(|((i, j), value)| value / (scale[i] * scale[j])).collect();
    let covariance: Vec<Vec<f64>> = scaled.chunks(size).map(<[f64]>::to_vec).collect();
    let products: Vec<f64> = columns.iter().map(|column| dot(column, right)).collect();
    let values: Vec<f64> =
        covariance.iter().map(|row| row.iter().zip(&products).map(|(c, product)| c * product).sum()).collect();
    let residual =
        |n: usize| right[n] - values.iter().zip(columns).map(|(value, column)| value * column[n]).sum::<f64>();
    let chi2 = (0..rows).map(|n| (residual(n) / sd[n]).powi(2)).sum();
    Some(Regression { values, covariance, chi2, dof: rows - size })
}

/// Inverse of a positive definite matrix of unit diagonal, row by row, by elimination; what the matrix held is lost.
/// `None` if it is singular to rounding.
#[allow(clippy::inline_always, reason = "where its size is known, its loops need not be loops")]
#[inline(always)]
pub(super) fn invert(matrix: &mut [f64], inverse: &mut [f64]) -> Option<()> {
    /// A pivot is the share of its column that the columns before it leave unexplained; less than this is rounding.
    const SINGULAR: f64 = 1e-12;
    let size = matrix.len().isqrt();
    inverse.iter_mut().enumerate().for_each(|(at, value)| *value = f64::from(u8::from(at % (size + 1) == 0)));
    for k in 0..size {
        let pivot = matrix[k * size + k];
        if pivot <= SINGULAR {
            return None;
        }
        for j in 0..size {
            matrix[k * size + j] /= pivot;
            inverse[k * size + j] /= pivot;
        }
        for i in (0..size).filter(|&i| i != k) {
            let factor = matrix[i * size + k];
            for j in 0..size {
                matrix[i * size + j] -= factor * matrix[k * size + j];
                inverse[i * size + j] -= factor * inverse[k * size + j];
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> (Vec<Vec<f64>>, Vec<f64>, Vec<f64>) {
        let x: Vec<f64> = vec![0.0, 1.0, 2.0, 5.0, 7.0];
        let sd = vec![0.1, 0.2, 0.1, 0.3, 0.2];
        (vec![vec![1.0; 5], x], vec![1.1, 2.9, 5.2, 10.8, 15.1], sd)
    }

    #[test]
    fn it_is_the_textbook_line() {
        let (columns, y, sd) = line();
        let fit = least_squares(&columns, &y, &sd).unwrap();
        let sum = |f: &dyn Fn(usize) -> f64| (0..5).map(|n| f(n) / (sd[n] * sd[n])).sum::<f64>();
        let x = &columns[1];
        let (s, sx, sxx) = (sum(&|_| 1.0), sum(&|n| x[n]), sum(&|n| x[n] * x[n]));
        let (sy, sxy) = (sum(&|n| y[n]), sum(&|n| x[n] * y[n]));
        let delta = s * sxx - sx * sx;
        assert!((fit.values[1] - (s * sxy - sx * sy) / delta).abs() < 1e-12);
        assert!((fit.sd(1) - (s / delta).sqrt()).abs() < 1e-12 && (fit.sd(0) - (sxx / delta).sqrt()).abs() < 1e-12);
        assert!(fit.dof == 3 && fit.chi2 > 0.0);
    }

    #[test]
    fn units_do_not_matter_and_influences_make_the_solution() {
        let (columns, y, _) = line();
        let fit = least_squares(&columns, &y, &[0.5; 5]).unwrap();
        let tiny = vec![columns[0].clone(), columns[1].iter().map(|x| x * 1e-12).collect()];
        let other = least_squares(&tiny, &y, &[0.5; 5]).unwrap();
        assert!((other.values[1] * 1e-12 / fit.values[1] - 1.0).abs() < 1e-9);
        let slope: f64 = fit.influence(&columns, 0.5, 1).iter().zip(&y).map(|(m, y)| m * y).sum();
        assert!((slope - fit.values[1]).abs() < 1e-12);
    }

    #[test]
    fn columns_that_depend_on_one_another_are_not_solved() {
        let column = vec![1.0, 2.0, 3.0];
        assert!(least_squares(&[column.clone(), column.clone()], &column, &[1.0; 3]).is_none());
        assert!(least_squares(&[vec![1.0], vec![2.0]], &[1.0], &[1.0]).is_none());
        assert!(least_squares(&[vec![0.0; 3]], &column, &[1.0; 3]).is_none());
    }
}
