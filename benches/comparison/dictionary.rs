//! A record as a sum of pulses on a fine grid of arrival times: the matrix `H` and its products.
//!
//! Column `j` is the response at grid time `j`, each sample times its weight. A column is as long as the response, so
//! the matrix is banded and a product costs grid points times samples of the response. With weights `1 / sd` of the
//! samples, `y - H x` is the whitened residual.

use std::ops::Range;

use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

/// The matrix `H` of a grid of arrivals.
#[derive(Clone, Debug)]
pub struct Dictionary {
    start_ps: f64,
    step_ps: f64,
    samples: usize,
    columns: Vec<Column>,
}

/// One arrival: its weighted samples from sample `first` on.
#[derive(Clone, Debug)]
struct Column {
    first: usize,
    values: Vec<f64>,
    norm: f64,
}

impl Dictionary {
    /// Arrivals every `step_ps` whose maximum lies inside the record; `weights` are factors of the samples, 0 for one
    /// to be ignored.
    ///
    /// # Panics
    /// If the profile is empty, there is not a weight for each sample, or a step is not positive.
    #[must_use]
    pub fn new(profile: &Profile, response: &Response, step_ps: f64, weights: &[f64]) -> Self {
        let samples = profile.mean_v.len();
        assert!(samples > 0 && weights.len() == samples, "a weight for each of the samples");
        assert!(step_ps > 0.0 && profile.dt_ps > 0.0, "steps must be positive");
        let start_ps = profile.t0_ps - response.peak_ps();
        let count = ((samples - 1) as f64 * profile.dt_ps / step_ps).floor() as usize + 1;
        let column = |j: usize| {
            let time_ps = start_ps + j as f64 * step_ps;
            let reach = response.reach(time_ps, profile.t0_ps, profile.dt_ps, samples);
            let value = |n: usize| weights[n] * response.value(profile.t0_ps + n as f64 * profile.dt_ps - time_ps);
            let first = reach.start;
            let values: Vec<f64> = reach.map(value).collect();
            let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
            Column { first, values, norm }
        };
        Self { start_ps, step_ps, samples, columns: (0..count).map(column).collect() }
    }

    /// Number of arrivals.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there is no arrival; there always is one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Time between arrivals, ps.
    #[must_use]
    pub fn step_ps(&self) -> f64 {
        self.step_ps
    }

    /// Arrival time at a place on the grid, which may lie between two points, ps.
    #[must_use]
    pub fn time_ps(&self, place: f64) -> f64 {
        self.start_ps + place * self.step_ps
    }

    /// Norm of column `j`: a pulse of amplitude `a` there has the matched filter's signal-to-noise ratio `a` times
    /// this.
    #[must_use]
    pub fn norm(&self, j: usize) -> f64 {
        self.columns[j].norm
    }

    /// Samples that arrival `j` reaches.
    #[must_use]
    pub fn range(&self, j: usize) -> Range<usize> {
        let column = &self.columns[j];
        column.first..column.first + column.values.len()
    }

    /// `record += factor * H_j`, for one column.
    ///
    /// # Panics
    /// If the record is shorter than the dictionary's.
    pub fn add_to(&self, j: usize, factor: f64, record: &mut [f64]) {
        let column = &self.columns[j];
        for (r, v) in record[column.first..].iter_mut().zip(&column.values) {
            *r += factor * v;
        }
    }

    /// `H_j . record`.
    ///
    /// # Panics
    /// If the record is shorter than the dictionary's.
    #[must_use]
    pub fn dot_record(&self, j: usize, record: &[f64]) -> f64 {
        let column = &self.columns[j];
        column.values.iter().zip(&record[column.first..]).map(|(v, r)| v * r).sum()
    }

    /// `H_i . H_j`.
    #[must_use]
    pub fn dot(&self, i: usize, j: usize) -> f64 {
        let (a, b) = (&self.columns[i], &self.columns[j]);
        let (start, end) = (a.first.max(b.first), self.range(i).end.min(self.range(j).end));
        if start >= end {
            return 0.0;
        }
        a.values[start - a.first..end - a.first].iter().zip(&b.values[start - b.first..]).map(|(p, q)| p * q).sum()
    }

    /// `record = H x`.
    ///
    /// # Panics
    /// If a length is not the dictionary's.
    pub fn apply(&self, x: &[f64], record: &mut [f64]) {
        assert!(x.len() == self.len() && record.len() == self.samples, "lengths are the dictionary's");
        record.fill(0.0);
        for (j, x) in x.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            self.add_to(j, *x, record);
        }
    }

    /// `x = H^T record`.
    ///
    /// # Panics
    /// If a length is not the dictionary's.
    pub fn apply_transposed(&self, record: &[f64], x: &mut [f64]) {
        assert!(x.len() == self.len() && record.len() == self.samples, "lengths are the dictionary's");
        x.iter_mut().enumerate().for_each(|(j, x)| *x = self.dot_record(j, record));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn products_are_those_of_the_dense_matrix() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let response = Response::new(-60.0, 10.0, &[0.0, 1.0, 4.0, 9.0, 7.0, 4.0, 2.0, 1.0, 0.0]);
        let weights: Vec<f64> = (0..30).map(|n| if n == 12 { 0.0 } else { rng.random_range(0.5..2.0) }).collect();
        let profile = Profile {
            mean_v: &[0.0; 30],
            sd_v: &[1.0; 30],
            acf: &[1.0],
            slow_v2: &[],
            jitter: None,
            t0_ps: -7.0,
            dt_ps: 11.0,
        };
        let dictionary = Dictionary::new(&profile, &response, 4.0, &weights);
        let dense = |n: usize, j: usize| {
            weights[n] * response.value(-7.0 + 11.0 * n as f64 - (-7.0 - response.peak_ps() + 4.0 * j as f64))
        };
        let grid = dictionary.len();
        assert_eq!(grid, 80);
        let x: Vec<f64> = (0..grid).map(|_| rng.random_range(0.0..1.0)).collect();
        let (mut record, mut back) = (vec![1.0; 30], vec![1.0; grid]);
        dictionary.apply(&x, &mut record);
        dictionary.apply_transposed(&record, &mut back);
        for n in 0..30 {
            let expected: f64 = (0..grid).map(|j| dense(n, j) * x[j]).sum();
            assert!((record[n] - expected).abs() < 1e-10, "sample {n}");
        }
        for j in 0..grid {
            let expected: f64 = (0..30).map(|n| dense(n, j) * record[n]).sum();
            assert!((back[j] - expected).abs() < 1e-9, "arrival {j}");
            let product: f64 = (0..30).map(|n| dense(n, j) * dense(n, 20)).sum();
            assert!((dictionary.dot(j, 20) - product).abs() < 1e-10);
        }
        assert!((dictionary.norm(20) - dictionary.dot(20, 20).sqrt()).abs() < 1e-12);
        // The maximum of arrival 0 lies on sample 0.
        assert!((dictionary.time_ps(0.0) + response.peak_ps() + 7.0).abs() < 1e-12);
    }
}
