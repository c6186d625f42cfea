//! Least-squares cubic spline through scattered, noisy values: uniform knots, B-spline basis.
//!
//! Minimises `sum (v_n - s(t_n))^2`, plus a second-difference penalty so small that it only decides where no value
//! lies. A spline with knots every `h` carries frequencies below `1 / (2 h)` and averages out those above, so noise
//! falls with the number of values per knot. Source: de Boor, *A Practical Guide to Splines*, chapter XIV; the normal
//! matrix has three sub-diagonals.

use super::banded::Banded;

/// Sub-diagonals of the normal matrix.
const BAND: usize = 3;
/// Weight of the penalty, in values a knot.
const PENALTY: f64 = 1e-6;

/// Sums over the values, from which the spline follows.
pub struct SplineFit {
    start: f64,
    step: f64,
    /// Products of the basis functions with one another.
    normal: Banded<{ BAND + 1 }>,
    /// Products of the basis functions with the values.
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
        let mut normal = Banded::zeros(count);
        normal.add_second_differences(PENALTY);
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
                self.normal.add(i + a, i + b, basis[a] * basis[b]);
            }
        }
    }

    /// The spline's values at places; zero outside. `None` when the values do not determine it.
    #[must_use]
    pub fn values(&self, places: impl Iterator<Item = f64>) -> Option<Vec<f64>> {
        let mut coefficients = self.right.clone();
        self.normal.cholesky()?.solve(&mut coefficients);
        let value = |at: f64| {
            self.basis(at).map_or(0.0, |(i, basis)| basis.iter().zip(&coefficients[i..]).map(|(b, c)| b * c).sum())
        };
        Some(places.map(value).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
