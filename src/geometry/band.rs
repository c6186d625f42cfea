//! Symmetric matrices whose entries lie in a band about the diagonal, as those of unknowns on a grid do.

use nalgebra::DVectorView;

/// The lower half of a symmetric matrix, a row after another: entries further from the diagonal than `width` are zero.
#[derive(Clone)]
pub struct Band {
    size: usize,
    width: usize,
    rows: Vec<f64>,
}

impl Band {
    /// All zero.
    pub fn new(size: usize, width: usize) -> Self {
        Self { size, width, rows: vec![0.0; size * (width + 1)] }
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.rows[row * (self.width + 1)..][..=self.width]
    }

    /// Adds to an entry of the lower half, and with that to its mirror image.
    ///
    /// # Panics
    /// Outside the band's lower half.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let from_diagonal = row - column;
        assert!(from_diagonal <= self.width, "entries lie within the band");
        self.rows[row * (self.width + 1) + self.width - from_diagonal] += value;
    }

    /// With the diagonal larger by this share.
    pub fn damped(mut self, share: f64) -> Self {
        self.rows.iter_mut().skip(self.width).step_by(self.width + 1).for_each(|value| *value *= 1.0 + share);
        self
    }

    /// Its factor; `None` if it is not positive definite.
    pub fn factor(mut self) -> Option<Factor> {
        let width = self.width;
        for row in 0..self.size {
            let first = row.saturating_sub(width);
            let (before, rest) = self.rows.split_at_mut(row * (width + 1));
            let own = &mut rest[..=width];
            for column in first..row {
                let place = column + width - row;
                // Both rows from the first column that they share.
                let start = first.max(column.saturating_sub(width));
                let other = &before[column * (width + 1)..][..=width];
                let count = column - start;
                let [left, right] = [&own[place - count..place], &other[width - count..width]];
                own[place] = (own[place] - dot(left, right)) / other[width];
            }
            let square = own[width] - dot(&own[..width], &own[..width]);
            if square.is_nan() || square <= 0.0 {
                return None;
            }
            own[width] = square.sqrt();
        }
        Some(Factor { lower: self })
    }
}

/// Sum of products. The library's has several sums side by side; a single one waits for each addition.
fn dot(left: &[f64], right: &[f64]) -> f64 {
    DVectorView::from_slice(left, left.len()).dot(&DVectorView::from_slice(right, right.len()))
}

/// The factor `L` of a positive definite matrix `L L'`.
pub struct Factor {
    lower: Band,
}

impl Factor {
    /// Logarithm of the determinant.
    pub fn log_determinant(&self) -> f64 {
        let width = self.lower.width;
        2.0 * (0..self.lower.size).map(|row| self.lower.row(row)[width].ln()).sum::<f64>()
    }

    /// Solution for a right-hand side, in its place.
    pub fn solve(&self, right: &mut [f64]) {
        let (size, width) = (self.lower.size, self.lower.width);
        for row in 0..size {
            let own = self.lower.row(row);
            let count = row.min(width);
            let sum = dot(&own[width - count..width], &right[row - count..row]);
            right[row] = (right[row] - sum) / own[width];
        }
        for row in (0..size).rev() {
            let own = self.lower.row(row);
            let count = row.min(width);
            let value = right[row] / own[width];
            right[row] = value;
            let above = right[row - count..row].iter_mut().zip(&own[width - count..width]);
            above.for_each(|(above, entry)| *above -= entry * value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dense::Definite;
    use faer::Mat;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solves_as_a_dense_matrix_does(
            size in 1_usize..20, width in 0_usize..6, entries in prop::collection::vec(-1.0..1.0, 200),
        ) {
            let mut band = Band::new(size, width);
            let mut dense = Mat::zeros(size, size);
            for row in 0..size {
                for column in row.saturating_sub(width)..=row {
                    let value = if row == column { 8.0 } else { entries[(row * 7 + column) % 200] };
                    band.add(row, column, value);
                    dense[(row, column)] = value;
                    dense[(column, row)] = value;
                }
            }
            let factor = band.factor().expect("its diagonal is large");
            let definite = Definite::new(&dense).expect("its diagonal is large");
            prop_assert!((factor.log_determinant() - definite.log_determinant()).abs() < 1e-9);
            let mut one: Vec<f64> = entries[..size].to_vec();
            let mut other = Mat::from_fn(size, 1, |row, _| entries[row]);
            factor.solve(&mut one);
            definite.solve(&mut other);
            for (row, value) in one.iter().enumerate() {
                prop_assert!((value - other[(row, 0)]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn what_is_not_positive_has_no_factor() {
        let mut band = Band::new(2, 1);
        [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 1.0)]
            .into_iter()
            .for_each(|(row, column, value)| band.add(row, column, value));
        assert!(band.factor().is_none());
    }
}
