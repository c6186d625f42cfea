//! The whitened record and its projection on a set of pulses.
//!
//! All products are taken after division by the samples' sd, over the response's support only, so that a fit's cost follows its pulses and
//! not the record's length. The constant baseline is eliminated from every product in closed form (Schur complement), so that all fits,
//! also those of a few pulses in a long record, are joint fits with it.

use super::linear::{Cholesky, least_squares, non_negative};
use super::{Profile, Response, SparseOptions};
use std::ops::Range;

/// A record, its weights, and the response: everything that stays fixed during a fit.
pub(super) struct Model<'a> {
    pub(super) response: &'a Response,
    pub(super) t0_ps: f64,
    pub(super) dt_ps: f64,
    /// `1 / sd` of each sample; 0 for a sample to be ignored.
    pub(super) weights: Vec<f64>,
    /// Squared norm of the weights, if a baseline is fitted: the constant's own product.
    baseline: Option<f64>,
    /// Whether amplitudes may be negative.
    pub(super) signed: bool,
    /// First and last arrival, ps, whose maximum lies inside the record.
    arrivals_ps: (f64, f64),
}

/// One pulse of amplitude 1: its whitened samples `(value, derivative by the arrival time)` from sample `first` on.
pub(super) struct Column {
    first: usize,
    samples: Vec<[f64; 2]>,
}

/// Best amplitudes for given arrival times, and the products that the next step needs.
pub(super) struct Projection {
    pub(super) times_ps: Vec<f64>,
    pub(super) amplitudes: Vec<f64>,
    pub(super) columns: Vec<Column>,
    /// Drop of chi2 against no pulse.
    pub(super) energy: f64,
    /// Products of the `2K` columns `(value_0, derivative_0, value_1, ..)` with one another, `2K * 2K`.
    products: Vec<f64>,
    /// Products of the `2K` columns with the data.
    with_data: Vec<f64>,
}

impl<'a> Model<'a> {
    pub(super) fn new(profile: &Profile, response: &'a Response, options: &SparseOptions) -> Self {
        let weights: Vec<f64> = profile.sd_v.iter().map(|sd| 1.0 / sd).collect();
        let squared = weights.iter().map(|w| w * w).sum::<f64>();
        let last = (weights.len() - 1) as f64;
        let first_ps = profile.t0_ps - response.peak_ps();
        Self {
            response,
            t0_ps: profile.t0_ps,
            dt_ps: profile.dt_ps,
            weights,
            baseline: (options.baseline && squared > 0.0).then_some(squared),
            signed: options.signed,
            arrivals_ps: (first_ps, first_ps + last * profile.dt_ps),
        }
    }

    pub(super) fn column(&self, time_ps: f64) -> Column {
        self.sample(time_ps, |after_ps| {
            let (value, slope) = self.response.value_and_slope(after_ps);
            (value, -slope)
        })
    }

    fn sample(&self, time_ps: f64, shape: impl Fn(f64) -> (f64, f64)) -> Column {
        let len = self.weights.len();
        let reach = self.response.reach(time_ps, self.t0_ps, self.dt_ps, len);
        Column {
            first: reach.start,
            samples: reach
                .map(|n| {
                    let (p, q) = shape(self.t0_ps + n as f64 * self.dt_ps - time_ps);
                    [self.weights[n] * p, self.weights[n] * q]
                })
                .collect(),
        }
    }

    /// Amplitudes (>= 0, or signed) that fit whitened `data` best with pulses at `times_ps`. `None` if two pulses
    /// coincide, or the maximum of one is outside of the record.
    pub(super) fn project(&self, data: &[f64], times_ps: Vec<f64>) -> Option<Projection> {
        let (first_ps, last_ps) = self.arrivals_ps;
        if times_ps.iter().any(|t| !(first_ps..=last_ps).contains(t)) {
            return None;
        }
        let k = times_ps.len();
        let columns: Vec<Column> = times_ps.iter().map(|t| self.column(*t)).collect();
        let mut products = vec![0.0; 4 * k * k];
        for i in 0..k {
            for j in 0..=i {
                let block = columns[i].dot(&columns[j]);
                for (p, row) in block.iter().enumerate() {
                    for (q, value) in row.iter().enumerate() {
                        products[(2 * i + p) * 2 * k + 2 * j + q] = *value;
                        products[(2 * j + q) * 2 * k + 2 * i + p] = *value;
                    }
                }
            }
        }
        let mut with_data: Vec<f64> = columns.iter().flat_map(|c| c.dot_record(data)).collect();
        self.eliminate_baseline(data, &columns, &mut products, &mut with_data);

        let gram = minor(&products, 2 * k, 0, 0);
        let right: Vec<f64> = with_data.iter().step_by(2).copied().collect();
        let amplitudes = if self.signed { least_squares(&gram, &right)? } else { non_negative(&gram, &right)? };
        let energy = amplitudes.iter().zip(&right).map(|(a, b)| a * b).sum();
        Some(Projection { times_ps, amplitudes, columns, energy, products, with_data })
    }

    fn eliminate_baseline(&self, data: &[f64], columns: &[Column], products: &mut [f64], with_data: &mut [f64]) {
        let Some(squared) = self.baseline else { return };
        let constant: Vec<f64> = columns.iter().flat_map(|c| c.dot_record(&self.weights)).collect();
        let data_sum: f64 = data.iter().zip(&self.weights).map(|(z, w)| z * w).sum();
        let n = constant.len();
        for i in 0..n {
            with_data[i] -= constant[i] * data_sum / squared;
            for j in 0..n {
                products[i * n + j] -= constant[i] * constant[j] / squared;
            }
        }
    }

    /// Best constant for whitened `residual`; 0 if no baseline is fitted.
    pub(super) fn baseline(&self, residual: &[f64]) -> f64 {
        self.baseline.map_or(0.0, |squared| {
            let sum: f64 = residual.iter().zip(&self.weights).map(|(z, w)| z * w).sum();
            sum / squared
        })
    }

    /// Number of parameters besides those of the pulses.
    pub(super) fn offsets(&self) -> usize {
        usize::from(self.baseline.is_some())
    }

    /// Whitened second derivative of a pulse of amplitude 1, in place of the value; the derivative is left 0.
    pub(super) fn second_derivative(&self, time_ps: f64) -> Column {
        self.sample(time_ps, |after_ps| (self.response.curvature(after_ps), 0.0))
    }
}

impl Column {
    /// The four products of two columns; the first index is this column's.
    pub(super) fn dot(&self, other: &Self) -> [[f64; 2]; 2] {
        let start = self.first.max(other.first);
        let end = (self.first + self.samples.len()).min(other.first + other.samples.len());
        let mut sums = [[0.0; 2]; 2];
        if start < end {
            let a = &self.samples[start - self.first..end - self.first];
            let b = &other.samples[start - other.first..end - other.first];
            for (a, b) in a.iter().zip(b) {
                for p in 0..2 {
                    for q in 0..2 {
                        sums[p][q] += a[p] * b[q];
                    }
                }
            }
        }
        sums
    }

    /// Samples of the record that the pulse reaches.
    pub(super) fn range(&self) -> Range<usize> {
        self.first..self.first + self.samples.len()
    }

    /// Products of value and derivative with a whitened record.
    pub(super) fn dot_record(&self, record: &[f64]) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for (c, z) in self.samples.iter().zip(&record[self.first..]) {
            sums[0] += c[0] * z;
            sums[1] += c[1] * z;
        }
        sums
    }

    /// Adds `amplitude` times the pulse to a whitened record.
    pub(super) fn add_to(&self, record: &mut [f64], amplitude: f64) {
        for (c, z) in self.samples.iter().zip(&mut record[self.first..]) {
            *z += amplitude * c[0];
        }
    }
}

impl Projection {
    /// Gauss-Newton step of the times with the amplitudes eliminated (variable projection after Kaufman, BIT 15, 49 (1975)), damped by
    /// Levenberg-Marquardt, and the drop of chi2 that it promises. A pulse of amplitude 0 has no slope and stays.
    pub(super) fn step(&self, damping: f64) -> Option<(Vec<f64>, f64)> {
        let k = self.times_ps.len();
        let (gram, cross, slopes) = (
            Cholesky::new(minor(&self.products, 2 * k, 0, 0), k)?,
            minor(&self.products, 2 * k, 1, 0),
            minor(&self.products, 2 * k, 1, 1),
        );
        // Half[i] = L^-1 (values . derivative_i): its products are what the amplitudes can imitate.
        let half: Vec<Vec<f64>> = (0..k)
            .map(|i| {
                let mut row = cross[i * k..(i + 1) * k].to_vec();
                gram.solve_lower(&mut row);
                row
            })
            .collect();
        let mut normal = vec![0.0; k * k];
        let mut gradient = vec![0.0; k];
        for i in 0..k {
            let a = self.amplitudes[i];
            if a == 0.0 {
                normal[i * k + i] = 1.0;
                continue;
            }
            let imitated: f64 = (0..k).map(|j| cross[i * k + j] * self.amplitudes[j]).sum();
            gradient[i] = a * (self.with_data[2 * i + 1] - imitated);
            for j in 0..k {
                let shared: f64 = half[i].iter().zip(&half[j]).map(|(p, q)| p * q).sum();
                normal[i * k + j] = a * self.amplitudes[j] * (slopes[i * k + j] - shared);
            }
            normal[i * k + i] *= 1.0 + damping;
        }
        let mut step = gradient.clone();
        Cholesky::new(normal, k)?.solve(&mut step);
        let promised = step.iter().zip(&gradient).map(|(d, g)| d * g).sum();
        Some((step, promised))
    }

    /// Factor of the products of all values and derivatives. `None` if two pulses cannot be told apart.
    pub(super) fn factor(&self) -> Option<Cholesky> {
        Cholesky::new(self.products.clone(), self.with_data.len())
    }
}

/// Every second row and column of an `n * n` matrix, from the given ones on.
fn minor(matrix: &[f64], n: usize, row: usize, column: usize) -> Vec<f64> {
    (row..n).step_by(2).flat_map(|i| (column..n).step_by(2).map(move |j| matrix[i * n + j])).collect()
}
