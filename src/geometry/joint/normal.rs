//! Log-likelihood, gradient and Fisher information of a model, each histogram's own light profiled out.
//!
//! In a histogram the unknowns are the logarithm of each point's light, the length of its way and the common width. The
//! information on them, less what scale and constant of the wall's own light take (a Schur complement), is carried to
//! positions, photons and law by the chain rule. Relief of the wall and jitter shift all light of a histogram alike:
//! where arrivals show it, this shift is unknown too, with a prior of its own width, and the log-likelihood is that
//! with the likeliest shift, to second order. Histograms are taken in runs whose sums are added in order, so that
//! threads change no digit.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use rayon::prelude::*;

use super::background::{Level, Tail, level};
use super::model::{Model, OF_POINT, SHARED, TERMS, WIDTH, Way, terms};
use super::pulse::{Bins, COLUMNS, Pulse};
use super::{Histogram, Problem};

/// Histograms in a run.
const RUN: usize = 16;
/// Newton steps for the shift of a histogram, and the square of a step in standard deviations that ends them.
const TURNS: usize = 6;
const SETTLED: f64 = 1e-4;
/// Terms of a sum that are added side by side.
const LANES: usize = 8;

/// What points shine through: their common response, and whether its shape is unknown.
#[derive(Clone, Debug)]
pub struct Shine {
    /// The response with width and shape of the model.
    pub pulse: Pulse,
    /// Whether derivatives by its shape are wanted.
    pub is_free: bool,
}

impl Shine {
    /// That of a model.
    pub fn new(problem: &Problem, model: &Model, is_free: bool) -> Self {
        Self { pulse: problem.pulse.shaped(model.stretch(), &model.shape(), is_free), is_free }
    }

    /// The bins of a histogram that a way's light reaches.
    pub fn bins(&self, problem: &Problem, histogram: &Histogram, way: &Way) -> Bins {
        self.pulse.bins(histogram.first_m + 0.5 * problem.step_m - way.length_m, histogram.values.len())
    }
}

/// Sums over histograms.
#[derive(Clone, Debug)]
pub struct Normal {
    /// With the prior's.
    pub log_likelihood: f64,
    /// By all unknowns, with the prior's.
    pub gradient: DVector<f64>,
    /// Information on all unknowns, with the prior's.
    pub fisher: DMatrix<f64>,
    /// Scale and constant of each histogram.
    pub levels: Vec<Level>,
    /// Score and information on the arrival of each point in each histogram, its amplitude free.
    pub arrivals: Vec<[f64; 2]>,
    /// Score and information on the shift that all light of a histogram shares.
    pub shifts: Vec<[f64; 2]>,
}

impl Normal {
    fn empty(unknowns: usize) -> Self {
        Self {
            log_likelihood: 0.0,
            gradient: DVector::zeros(unknowns),
            fisher: DMatrix::zeros(unknowns, unknowns),
            levels: Vec::new(),
            arrivals: Vec::new(),
            shifts: Vec::new(),
        }
    }

    /// Of a model, with levels to start from.
    pub fn new(problem: &Problem, tail: &Tail, (model, shine): (&Model, &Shine), starts: &[Level]) -> Self {
        let unknowns = model.unknowns();
        let of_run = |(histograms, starts): (&[Histogram], &[Level])| {
            problem.cancel.check();
            let mut sums = Self::empty(unknowns);
            let mut desk = Desk::default();
            for (histogram, start) in histograms.iter().zip(starts) {
                let start = desk.late(problem, tail, (model, shine), (histogram, *start));
                desk.light(problem, (model, shine), (histogram, start[2]));
                desk.add(problem, tail, (histogram, start), model, &mut sums);
            }
            sums
        };
        let runs: Vec<Self> = problem.histograms.par_chunks(RUN).zip(starts.par_chunks(RUN)).map(of_run).collect();
        let mut all = Self::empty(unknowns);
        for run in runs {
            all.log_likelihood += run.log_likelihood;
            all.gradient += run.gradient;
            all.fisher += run.fisher;
            all.levels.extend(run.levels);
            all.arrivals.extend(run.arrivals);
            all.shifts.extend(run.shifts);
        }
        all.log_likelihood += model.log_prior(&problem.pulse);
        for (n, [gradient, precision]) in model.prior(&problem.pulse).into_iter().enumerate() {
            all.gradient[n] += gradient;
            all.fisher[(n, n)] += precision;
        }
        all.fisher.fill_upper_triangle_with_lower_triangle();
        all
    }
}

/// A stretch of bins with values.
#[derive(Clone, Debug, Default)]
struct Row {
    from: usize,
    values: Vec<f64>,
}

impl Row {
    fn to(&self) -> usize {
        self.from + self.values.len()
    }

    fn dot(&self, other: &Self) -> f64 {
        let (from, to) = (self.from.max(other.from), self.to().min(other.to()));
        if from >= to {
            return 0.0;
        }
        let [own, others] = [self, other].map(|row| &row.values[from - row.from..to - row.from]);
        product(own, others)
    }
}

/// Sum of products, in lanes: a sum of one term after the other waits for each.
fn product(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; LANES];
    for (a, b) in a.zip(b) {
        (0..LANES).for_each(|n| sums[n] += a[n] * b[n]);
    }
    rest + sums.iter().sum::<f64>()
}

/// Derivatives of an unknown of a histogram by those of its point, and by those that all points share.
type Slope = ([f64; OF_POINT], [f64; SHARED]);

/// What a histogram needs, kept for the next one.
#[derive(Default)]
pub struct Desk {
    ways: Vec<Way>,
    /// Derivatives by the logarithm of each point's light and by its length, in turn; then by the width, and by the
    /// shape of the response where it is free.
    rows: Vec<Row>,
    weighted: Vec<Row>,
    /// Light of all points.
    pub all: Vec<f64>,
    /// The wall's own light.
    pub tail: Vec<f64>,
    weights: Vec<f64>,
    rests: Vec<f64>,
    cross: Vec<Vector2<f64>>,
    information: Vec<f64>,
    score: Vec<f64>,
    carried: Vec<f64>,
    slopes: Vec<Slope>,
}

impl Desk {
    /// Light of all points in a histogram that is late by a length, and its derivatives.
    pub fn light(
        &mut self,
        problem: &Problem,
        (model, shine): (&Model, &Shine),
        (histogram, late_m): (&Histogram, f64),
    ) {
        let (bins, points) = (histogram.values.len(), model.dots.len());
        let common = if shine.is_free { COLUMNS - 2 } else { 1 };
        self.rows.resize_with(2 * points + common, Row::default);
        self.ways.clear();
        self.all.clear();
        self.all.resize(bins, 0.0);
        let (rows, shared) = self.rows.split_at_mut(2 * points);
        for row in &mut *shared {
            row.from = 0;
            row.values.clear();
            row.values.resize(bins, 0.0);
        }
        for (dot, rows) in model.dots.iter().zip(rows.chunks_mut(2)) {
            let way = model.way(dot, histogram).later(late_m);
            let bins = shine.bins(problem, histogram, &way);
            let photons = way.log_photons.min(60.0).exp();
            for (column, row) in rows.iter_mut().enumerate() {
                row.from = bins.from;
                shine.pulse.fill(column, &bins, photons, &mut row.values);
            }
            self.all[bins.from..bins.from + bins.count]
                .iter_mut()
                .zip(&rows[0].values)
                .for_each(|(sum, value)| *sum += value);
            for (column, row) in shared.iter_mut().enumerate() {
                shine.pulse.add(2 + column, &bins, photons, &mut row.values);
            }
            self.ways.push(way);
        }
    }

    /// Adds what a histogram says.
    fn add(
        &mut self,
        problem: &Problem,
        tail: &Tail,
        (histogram, start): (&Histogram, Level),
        model: &Model,
        sums: &mut Normal,
    ) {
        tail.fill(histogram, &mut self.tail);
        let own = level(problem, histogram, &self.tail, &self.all, start);
        let size = self.rows.len();
        self.weights.clear();
        self.rests.clear();
        let mut wall = Matrix2::zeros();
        for (n, value) in histogram.values.iter().enumerate() {
            let rate = own[0] * self.tail[n] + own[1] + self.all[n];
            let (value, weight) = (f64::from(*value), problem.noise.weight(rate));
            sums.log_likelihood += problem.noise.log_likelihood(value, rate);
            self.weights.push(weight);
            self.rests.push((value - rate) * weight);
            let slope = Vector2::new(self.tail[n], 1.0);
            wall += slope * slope.transpose() * weight;
        }
        self.weighted.resize_with(size, Row::default);
        self.score.clear();
        self.cross.clear();
        for (row, weighted) in self.rows.iter().zip(&mut self.weighted) {
            let bins = row.from..row.to();
            weighted.from = row.from;
            weighted.values.clear();
            weighted.values.extend(row.values.iter().zip(&self.weights[bins.clone()]).map(|(slope, w)| slope * w));
            self.score.push(product(&row.values, &self.rests[bins.clone()]));
            let with_tail = product(&weighted.values, &self.tail[bins]);
            self.cross.push(Vector2::new(with_tail, weighted.values.iter().sum()));
        }
        self.profile(wall);
        let late_m = self.shift(model, own[2], sums);
        sums.levels.push([own[0], own[1], late_m]);
        self.carry(histogram, model, sums);
    }

    /// Information on the unknowns of a histogram, less what the wall's own light takes.
    fn profile(&mut self, wall: Matrix2<f64>) {
        let size = self.rows.len();
        // Without a tail the scale is not there: a ridge keeps the inverse finite.
        let ridge = Matrix2::from_diagonal(&(wall.diagonal() * 1e-9 + Vector2::repeat(1e-12)));
        let inverse = (wall + ridge).try_inverse().unwrap_or_else(Matrix2::zeros);
        self.information.clear();
        self.information.resize(size * size, 0.0);
        for a in 0..size {
            let taken = inverse * self.cross[a];
            for b in 0..=a {
                let value = self.weighted[a].dot(&self.rows[b]) - taken.dot(&self.cross[b]);
                self.information[a * size + b] = value;
                self.information[b * size + a] = value;
            }
        }
    }

    /// The level with the likeliest shift that all light of the histogram shares, at a model as it stands.
    fn late(
        &mut self,
        problem: &Problem,
        tail: &Tail,
        (model, shine): (&Model, &Shine),
        (histogram, start): (&Histogram, Level),
    ) -> Level {
        if model.wander_m <= 0.0 || model.dots.is_empty() {
            return [start[0], start[1], 0.0];
        }
        tail.fill(histogram, &mut self.tail);
        let (precision, mut own, mut slope) = (model.wander_m.powi(-2), start, Vec::new());
        for _ in 0..TURNS {
            self.light(problem, (model, shine), (histogram, own[2]));
            own = level(problem, histogram, &self.tail, &self.all, own);
            slope.clear();
            slope.resize(histogram.values.len(), 0.0);
            for row in self.rows[..2 * model.dots.len()].iter().skip(1).step_by(2) {
                slope[row.from..row.to()].iter_mut().zip(&row.values).for_each(|(sum, value)| *sum += value);
            }
            let (mut score, mut information) = (-own[2] * precision, precision);
            for (n, slope) in slope.iter().enumerate() {
                let rate = own[0] * self.tail[n] + own[1] + self.all[n];
                let weight = problem.noise.weight(rate);
                score += slope * weight * (f64::from(histogram.values[n]) - rate);
                information += slope * slope * weight;
            }
            let step_m = (score / information).clamp(-model.wander_m, model.wander_m);
            own[2] += step_m;
            if step_m * step_m * information < SETTLED {
                break;
            }
        }
        own
    }

    /// Takes out the shift that all light of the histogram shares; returns its likeliest value, to second order.
    fn shift(&mut self, model: &Model, late_m: f64, sums: &mut Normal) -> f64 {
        let (size, points) = (self.rows.len(), model.dots.len());
        let lengths = || (0..points).map(|k| 2 * k + 1);
        let along: Vec<f64> =
            (0..size).map(|a| lengths().map(|length| self.information[a * size + length]).sum()).collect();
        let information: f64 = lengths().map(|length| along[length]).sum();
        let score: f64 = lengths().map(|length| self.score[length]).sum();
        // As it would be without the shift.
        sums.shifts.push([score + information * late_m, information]);
        if model.wander_m <= 0.0 {
            return 0.0;
        }
        let precision = model.wander_m.powi(-2);
        let variance = (information + precision).recip();
        // What the turns before have left.
        let step_m = (score - late_m * precision) * variance;
        sums.log_likelihood += 0.5 * step_m * step_m / variance - 0.5 * late_m * late_m * precision;
        for a in 0..size {
            self.score[a] -= along[a] * step_m;
            for b in 0..size {
                self.information[a * size + b] -= along[a] * along[b] * variance;
            }
        }
        late_m + step_m
    }

    /// How the unknown of a row depends on those of its point, and on those that all points share.
    fn slope(&self, row: usize, terms: [f64; TERMS]) -> Slope {
        let mut shared = [0.0; SHARED];
        if row >= 2 * self.ways.len() {
            shared[WIDTH + row - 2 * self.ways.len()] = 1.0;
            return ([0.0; OF_POINT], shared);
        }
        let way = &self.ways[row / 2];
        if row % 2 == 1 {
            let along = way.gradient;
            return ([along.x, along.y, along.z, 0.0, 0.0, 0.0], shared);
        }
        shared[0] = way.log_distance;
        shared[1..=TERMS].copy_from_slice(&terms);
        let log = way.log_gradient;
        ([log.x, log.y, log.z, 1.0, terms[0], terms[1]], shared)
    }

    /// Carries score and information to the unknowns of the model.
    fn carry(&mut self, histogram: &Histogram, model: &Model, sums: &mut Normal) {
        let (size, unknowns) = (self.rows.len(), model.unknowns());
        let points = model.dots.len();
        let first = unknowns - SHARED;
        let terms = terms(histogram);
        let mut slopes = std::mem::take(&mut self.slopes);
        slopes.clear();
        slopes.extend((0..size).map(|row| self.slope(row, terms)));
        self.carried.clear();
        self.carried.resize(size * unknowns, 0.0);
        for a in 0..size {
            let carried = &mut self.carried[a * unknowns..][..unknowns];
            for (b, (own, shared)) in slopes.iter().enumerate() {
                let value = self.information[a * size + b];
                if b < 2 * points {
                    let place = b / 2 * OF_POINT;
                    carried[place..place + OF_POINT].iter_mut().zip(own).for_each(|(sum, slope)| *sum += value * slope);
                }
                if b >= 2 * points {
                    carried[first + WIDTH + b - 2 * points] += value;
                } else if b % 2 == 0 {
                    carried[first..].iter_mut().zip(&shared[..=TERMS]).for_each(|(sum, slope)| *sum += value * slope);
                }
            }
        }
        for (a, (own, shared)) in slopes.iter().enumerate() {
            let carried = &self.carried[a * unknowns..][..unknowns];
            let own = own.iter().enumerate().filter(|_| a < 2 * points).map(|(n, slope)| (a / 2 * OF_POINT + n, slope));
            for (row, slope) in own.chain(shared.iter().enumerate().map(|(n, slope)| (first + n, slope))) {
                if *slope != 0.0 {
                    sums.gradient[row] += slope * self.score[a];
                    for (column, value) in carried[..=row].iter().enumerate() {
                        sums.fisher[(row, column)] += slope * value;
                    }
                }
            }
        }
        self.slopes = slopes;
        for k in 0..points {
            let at = |a: usize, b: usize| self.information[(2 * k + a) * size + 2 * k + b];
            let tilt = if at(0, 0) > 0.0 { at(0, 1) / at(0, 0) } else { 0.0 };
            sums.arrivals.push([self.score[2 * k + 1] - tilt * self.score[2 * k], at(1, 1) - tilt * at(0, 1)]);
        }
    }
}
