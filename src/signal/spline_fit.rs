//! Least-squares cubic spline through scattered, noisy values: uniform knots, B-spline basis.
//!
//! Minimises `sum (v_n - s(t_n))^2`, plus a second-difference penalty so small that it only decides where no value
//! lies. A spline with knots every `h` carries what lies below `1 / (2 h)` in frequency and averages out what lies
//! above, so noise falls with the values a knot. Source: de Boor, *A Practical Guide to Splines*, chapter XIV; the
//! normal matrix has three sub-diagonals and is solved by Cholesky.

/// Sub-diagonals of the normal matrix.
const BAND: usize = 3;
/// Weight of the penalty, in values a knot.
const PENALTY: f64 = 1e-6;

/// Sums over the values, from which the spline follows.
pub struct SplineFit {
    start: f64,
    step: f64,
    /// Row i: products of basis functions i and i, i + 1, i + 2, i + 3.
    normal: Vec<[f64; BAND + 1]>,
    right: Vec<f64>,
}

impl SplineFit {
    /// A spline over `start..=end` with knots every `step`.
    ///
    /// # Panics
    /// When the step is not positive or the end lies before the start.
    #[must_use]
    pub fn new(start: f64, end: f64, step: f64) -> Self {
        assert!(step > 0.0 && end >= start, "knots from {start} to {end} every {step}");
        let count = ((end - start) / step).ceil().max(1.0) as usize + BAND;
        let mut normal = vec![[0.0; BAND + 1]; count];
        for i in 0..count - 2 {
            // Second difference of coefficients i, i + 1, i + 2: (1, -2, 1), squared.
            let difference = [1.0, -2.0, 1.0];
            for a in 0..3 {
                for b in a..3 {
                    normal[i + a][b - a] += PENALTY * difference[a] * difference[b];
                }
            }
        }
        Self { start, step, normal, right: vec![0.0; count] }
    }

    /// First basis function at a place, and the values there of it and the next three; `None` outside.
    fn basis(&self, at: f64) -> Option<(usize, [f64; 4])> {
        let place = (at - self.start) / self.step;
        let intervals = self.right.len() - BAND;
        if !(0.0..=intervals as f64).contains(&place) {
            return None;
        }
        let i = (place as usize).min(intervals - 1);
        let u = place - i as f64;
        let (v, u2, u3) = (1.0 - u, u * u, u * u * u);
        Some((
            i,
            [
                v * v * v / 6.0,
                (3.0 * u3 - 6.0 * u2 + 4.0) / 6.0,
                (-3.0 * u3 + 3.0 * u2 + 3.0 * u + 1.0) / 6.0,
                u3 / 6.0,
            ],
        ))
    }

    /// Takes a value; those outside do not count.
    pub fn add(&mut self, at: f64, value: f64) {
        let Some((i, basis)) = self.basis(at) else {
            return;
        };
        for a in 0..4 {
            self.right[i + a] += basis[a] * value;
            for b in a..4 {
                self.normal[i + a][b - a] += basis[a] * basis[b];
            }
        }
    }

    /// The spline's values at places; zero outside. `None` when the values do not determine it.
    #[must_use]
    pub fn values(&self, places: impl Iterator<Item = f64>) -> Option<Vec<f64>> {
        let coefficients = self.solve()?;
        let value = |at: f64| {
            self.basis(at).map_or(0.0, |(i, basis)| basis.iter().zip(&coefficients[i..]).map(|(b, c)| b * c).sum())
        };
        Some(places.map(value).collect())
    }

    /// Banded Cholesky factorisation, then forward and backward substitution.
    fn solve(&self) -> Option<Vec<f64>> {
        let count = self.right.len();
        let mut factor = vec![[0.0; BAND + 1]; count];
        let mut solution = self.right.clone();
        for j in 0..count {
            for i in j..count.min(j + BAND + 1) {
                let before = |k: usize| factor[k][j - k] * factor[k][i - k];
                let sum: f64 = (i.saturating_sub(BAND)..j).map(before).sum();
                let rest = self.normal[j][i - j] - sum;
                factor[j][i - j] =
                    if i == j { Some(rest).filter(|rest| *rest > 0.0)?.sqrt() } else { rest / factor[j][0] };
            }
        }
        for i in 0..count {
            let sum: f64 = (i.saturating_sub(BAND)..i).map(|k| factor[k][i - k] * solution[k]).sum();
            solution[i] = (solution[i] - sum) / factor[i][0];
        }
        for i in (0..count).rev() {
            let sum: f64 = (i + 1..count.min(i + BAND + 1)).map(|k| factor[i][k - i] * solution[k]).sum();
            solution[i] = (solution[i] - sum) / factor[i][0];
        }
        Some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_cubic_comes_back_exactly_and_shifts_with_its_values() {
        let cubic = |t: f64| 0.3 * t * t * t - t * t + 2.0;
        for shift in [0.0, 17.3] {
            let mut fit = SplineFit::new(shift, shift + 4.0, 0.5);
            (0..200).map(|k| f64::from(k) * 0.02).for_each(|t| fit.add(t + shift, cubic(t)));
            let places: Vec<f64> = (0..40).map(|k| f64::from(k) * 0.1).collect();
            let values = fit.values(places.iter().map(|t| t + shift)).unwrap();
            for (t, value) in places.iter().zip(values) {
                assert!((value - cubic(*t)).abs() < 1e-4, "{t}: {value}");
            }
        }
    }

    /// The defining least-squares problem by Gaussian elimination on the full matrix.
    #[test]
    fn the_banded_solution_is_that_of_the_full_system() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut fit = SplineFit::new(0.0, 6.0, 1.0);
        (0..60).for_each(|_| fit.add(rng.random_range(0.0..6.0), rng.random_range(-1.0..1.0)));
        let count = fit.right.len();
        let mut full: Vec<Vec<f64>> = (0..count)
            .map(|i| {
                let entry = |j: usize| {
                    let (low, high) = (i.min(j), i.max(j));
                    if high - low <= BAND { fit.normal[low][high - low] } else { 0.0 }
                };
                (0..count).map(entry).chain([fit.right[i]]).collect()
            })
            .collect();
        for i in 0..count {
            let row = full[i].clone();
            for (k, other) in full.iter_mut().enumerate().filter(|(k, _)| *k != i) {
                let factor = other[i] / row[i];
                (0..=count).for_each(|j| other[j] -= factor * row[j]);
                assert!(k < count);
            }
        }
        let expected: Vec<f64> = (0..count).map(|i| full[i][count] / full[i][i]).collect();
        for (a, b) in fit.solve().unwrap().iter().zip(expected) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
    }

    #[test]
    fn places_without_values_are_bridged_and_outside_is_zero() {
        let mut fit = SplineFit::new(0.0, 10.0, 1.0);
        (0..40).map(|k| f64::from(k) * 0.1).chain((60..100).map(|k| f64::from(k) * 0.1)).for_each(|t| fit.add(t, 5.0));
        let values = fit.values([5.0, 2.0, 11.0, -0.1].into_iter()).unwrap();
        assert!(
            (values[0] - 5.0).abs() < 1e-3 && (values[1] - 5.0).abs() < 1e-6 && values[2] == 0.0 && values[3] == 0.0,
            "{values:?}"
        );
    }
}
