//! One pulse of amplitude 1 in a whitened record, and its products with other pulses and with data.

use super::Response;
use super::model::WhitenedRecord;
use super::place::Place;
use std::ops::Range;

/// Whitened samples of a pulse of amplitude 1 from sample `first` on.
pub(super) struct Column {
    first: usize,
    /// Value and derivative by the time.
    samples: Vec<[f64; 2]>,
    /// Derivatives by the variance, by kurtosis or tail, and by the tilt; empty for a point.
    shape: Vec<[f64; 3]>,
}

/// Where products of two columns go: a block of a matrix with rows of `n`, of these `counts` from a `corner` on.
struct Products<'a> {
    matrix: &'a mut [f64],
    n: usize,
    corner: (usize, usize),
    counts: (usize, usize),
}

impl Products<'_> {
    /// Adds what of a part, which begins so far from the corner, lies within the counts.
    fn add<const P: usize, const Q: usize>(&mut self, from: (usize, usize), part: [[f64; Q]; P]) {
        for (row, part) in (from.0..self.counts.0).zip(&part) {
            for (column, product) in (from.1..self.counts.1).zip(part) {
                self.matrix[(self.corner.0 + row) * self.n + self.corner.1 + column] += product;
            }
        }
    }
}

impl Column {
    pub(super) fn new(record: &WhitenedRecord, place: &Place) -> Self {
        if place.shapes() == 0 {
            return Self::of_point(record, place.time_ps, |after_ps| {
                let (value, slope) = record.response.value_and_slope(after_ps);
                [value, -slope]
            });
        }
        let range = place.reach(record.response, record.t0_ps, record.dt_ps, record.len());
        let after_ps = record.t0_ps + range.start as f64 * record.dt_ps - place.time_ps;
        let both = place.samples(record.response, record.width_ps, after_ps, record.dt_ps, range.len());
        let (first, both) = whitened(record, range, both);
        let samples = both.iter().map(|[value, by_time, ..]| [*value, *by_time]).collect();
        let shape = both.iter().map(|[_, _, shape @ ..]| *shape).collect();
        Self { first, samples, shape }
    }

    /// The derivative by the variance of a point, in place of the value; the derivative is left 0.
    pub(super) fn widening(record: &WhitenedRecord, time_ps: f64) -> Self {
        Self::of_point(record, time_ps, |after_ps| [0.5 * record.response.curvature(after_ps), 0.0])
    }

    /// The derivative by the logarithm of the response's width, in place of the value; the derivative is left 0.
    pub(super) fn stretching(record: &WhitenedRecord, time_ps: f64) -> Self {
        Self::of_point(record, time_ps, |after_ps| [-after_ps * record.response.value_and_slope(after_ps).1, 0.0])
    }

    /// Another shape than the response's in the place of a point, in place of the value; the derivative is left 0.
    pub(super) fn of_shape(record: &WhitenedRecord, time_ps: f64, shape: &Response) -> Self {
        let range = shape.reach(time_ps, record.t0_ps, record.dt_ps, record.len());
        let (first, samples) = sample(record, time_ps, range, |after_ps| [shape.value(after_ps), 0.0]);
        Self { first, samples, shape: Vec::new() }
    }

    /// The sum of the values of columns, each with its factor, over a record of `len` samples.
    pub(super) fn sum(columns: impl Iterator<Item = (f64, Self)>, len: usize) -> Self {
        let mut samples = vec![[0.0; 2]; len];
        for (factor, column) in columns {
            for (sum, sample) in samples[column.range()].iter_mut().zip(&column.samples) {
                sum[0] += factor * sample[0];
            }
        }
        Self { first: 0, samples, shape: Vec::new() }
    }

    /// Its values, from the record's start on, for a [`Self::sum`].
    pub(super) fn values(&self) -> Vec<f64> {
        self.samples.iter().map(|sample| sample[0]).collect()
    }

    fn of_point(record: &WhitenedRecord, time_ps: f64, shape: impl Fn(f64) -> [f64; 2]) -> Self {
        let range = record.response.reach(time_ps, record.t0_ps, record.dt_ps, record.len());
        let (first, samples) = sample(record, time_ps, range, shape);
        Self { first, samples, shape: Vec::new() }
    }

    /// Adds products of two columns to the block of `products` (rows of `n`) that starts at `corner`; the rows are this
    /// column's. Each column takes part with the first `counts` of (value, derivatives by time, variance, kurtosis or
    /// tail, tilt).
    pub(super) fn add_products(
        &self,
        other: &Self,
        counts: (usize, usize),
        products: &mut [f64],
        n: usize,
        corner: (usize, usize),
    ) {
        let mut into = Products { matrix: products, n, corner, counts };
        into.add((0, 0), dot(self.first, &self.samples, other.first, &other.samples));
        if !self.shape.is_empty() {
            into.add((2, 0), dot(self.first, &self.shape, other.first, &other.samples));
        }
        if !other.shape.is_empty() {
            into.add((0, 2), dot(self.first, &self.samples, other.first, &other.shape));
            into.add((2, 2), dot(self.first, &self.shape, other.first, &other.shape));
        }
    }

    /// Product of the two columns' values.
    pub(super) fn shared(&self, other: &Self) -> f64 {
        let start = self.first.max(other.first);
        let end = self.range().end.min(other.range().end);
        if start >= end {
            return 0.0;
        }
        let met = |column: &Self| start - column.first..end - column.first;
        self.samples[met(self)].iter().zip(&other.samples[met(other)]).map(|(a, b)| a[0] * b[0]).sum()
    }

    /// Whether both reach a sample.
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        self.first < other.first + other.samples.len() && other.first < self.first + self.samples.len()
    }

    /// Samples of the record that the pulse reaches.
    pub(super) fn range(&self) -> Range<usize> {
        self.first..self.first + self.samples.len()
    }

    /// Products of value and derivatives with a whitened record.
    pub(super) fn dot_record(&self, record: &[f64]) -> [f64; 5] {
        let record = &record[self.range()];
        let mut sums = [0.0; 5];
        for (c, z) in self.samples.iter().zip(record) {
            sums[0] += c[0] * z;
            sums[1] += c[1] * z;
        }
        for (c, z) in self.shape.iter().zip(record) {
            (0..3).for_each(|p| sums[2 + p] += c[p] * z);
        }
        sums
    }

    /// The constant that the pulse of amplitude 1 looks like.
    pub(super) fn mean_v(&self, record: &WhitenedRecord) -> f64 {
        record.nuisance.mean_v(self.first, self.samples.iter().map(|sample| sample[0]))
    }

    /// Value and derivative by the time as whole whitened records.
    pub(super) fn dense(&self, len: usize) -> [Vec<f64>; 2] {
        let mut records = [vec![0.0; len], vec![0.0; len]];
        for (k, record) in records.iter_mut().enumerate() {
            record[self.range()].iter_mut().zip(&self.samples).for_each(|(z, c)| *z = c[k]);
        }
        records
    }

    /// Adds `amplitude` times the pulse to a whitened record.
    pub(super) fn add_to(&self, record: &mut [f64], amplitude: f64) {
        for (c, z) in self.samples.iter().zip(&mut record[self.first..]) {
            *z += amplitude * c[0];
        }
    }
}

/// Whitened samples `range` of `shape`, a function of the time after the arrival.
fn sample<const P: usize>(
    record: &WhitenedRecord,
    time_ps: f64,
    range: Range<usize>,
    shape: impl Fn(f64) -> [f64; P],
) -> (usize, Vec<[f64; P]>) {
    let samples = range.clone().map(|n| shape(record.t0_ps + n as f64 * record.dt_ps - time_ps)).collect();
    whitened(record, range, samples)
}

/// The samples `range` of a record, whitened.
fn whitened<const P: usize>(
    record: &WhitenedRecord,
    range: Range<usize>,
    mut samples: Vec<[f64; P]>,
) -> (usize, Vec<[f64; P]>) {
    let first = range.start;
    // The filter carries each sample on over the next ones.
    let end = if range.is_empty() { range.end } else { (range.end + record.whitener.order()).min(record.len()) };
    samples.resize(end - first, [0.0; P]);
    record.whitener.apply_from(first, &mut samples);
    (first, samples)
}

/// The products of two runs of values that start at their samples `first`; the first index is a's.
#[inline]
fn dot<const P: usize, const Q: usize>(
    first_a: usize,
    a: &[[f64; P]],
    first_b: usize,
    b: &[[f64; Q]],
) -> [[f64; Q]; P] {
    let start = first_a.max(first_b);
    let end = (first_a + a.len()).min(first_b + b.len());
    let mut sums = [[0.0; Q]; P];
    if start < end {
        for (a, b) in a[start - first_a..end - first_a].iter().zip(&b[start - first_b..end - first_b]) {
            for p in 0..P {
                for q in 0..Q {
                    sums[p][q] += a[p] * b[q];
                }
            }
        }
    }
    sums
}
