//! A level and a sum of widened pulses, fitted by least squares (Levenberg-Marquardt).

use super::outgoing::Outgoing;
use crate::fft::{Complex, RealFft, fast_length};
use crate::regression::{Regression, least_squares};

/// Steps of a fit at the most.
const STEPS: usize = 40;
/// A fit has settled when a step makes the sum of squares smaller by less than this share.
const SETTLED: f64 = 1e-7;
/// Damping at the start, how it falls and grows, and where a fit gives up.
const DAMPING: f64 = 1e-3;
const FALL: f64 = 5.0;
const GROWTH: f64 = 4.0;
const GIVE_UP: f64 = 1e6;
/// Largest standard deviation of the widening, as a share of the record's length.
const WIDEST: f64 = 0.25;
/// Widened pulses end after so many standard deviations of the widening.
const REACH: f64 = 4.0;

/// One echo of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Height that the echo would have if it were not widened.
    pub strength: f64,
    /// Place of the pulse's maximum before it is widened, in samples.
    pub place: f64,
    /// Variance of the widening, in samples squared.
    pub variance: f64,
}

/// A fit.
#[derive(Clone, Debug)]
pub struct Fit {
    pub level: f64,
    pub parts: Vec<Part>,
    /// Curve of each part at every sample.
    pub curves: Vec<Vec<f64>>,
    /// Samples less model; 0 where a sample does not count.
    pub residuals: Vec<f64>,
    pub sum_of_squares: f64,
    /// Derivatives by level, then by strength, place and variance of each part; 0 where a sample does not count.
    pub columns: Vec<Vec<f64>>,
}

/// Makes curves of widened pulses, and fits them.
pub struct Model<'a> {
    samples: &'a [f64],
    spectrum: Vec<Complex<f64>>,
    length: usize,
    fft: &'a mut RealFft,
}

impl<'a> Model<'a> {
    pub fn new(samples: &'a [f64], outgoing: &Outgoing, fft: &'a mut RealFft) -> Self {
        let widest = (REACH * WIDEST * samples.len() as f64).ceil() as usize;
        // A pulse at one end must not come in at the other.
        let length = fast_length(samples.len() + 2 * (outgoing.len() + widest));
        let spectrum = outgoing.spectrum(length, fft);
        Self { samples, spectrum, length, fft }
    }

    /// Number of samples that count.
    pub fn count(&self) -> usize {
        self.samples.iter().filter(|sample| sample.is_finite()).count()
    }

    /// A part's curve for strength 1, and its derivatives by place and by variance.
    fn curve(&mut self, part: &Part) -> [Vec<f64>; 3] {
        let mut bins = [const { Vec::new() }; 3];
        for (k, bin) in self.spectrum.iter().enumerate() {
            let omega = std::f64::consts::TAU * k as f64 / self.length as f64;
            let turn = Complex::from_polar((-0.5 * part.variance * omega * omega).exp(), -omega * part.place);
            let value = bin * turn;
            bins[0].push(value);
            bins[1].push(value * Complex::new(0.0, -omega));
            bins[2].push(value * (-0.5 * omega * omega));
        }
        bins.map(|bins| {
            let mut curve = vec![0.0; self.length];
            self.fft.inverse(&bins, &mut curve);
            curve.truncate(self.samples.len());
            curve
        })
    }

    /// Model, residuals and derivatives at these parameters.
    fn at(&mut self, level: f64, parts: Vec<Part>) -> Fit {
        let counts: Vec<bool> = self.samples.iter().map(|sample| sample.is_finite()).collect();
        let column = |values: Vec<f64>, factor: f64| -> Vec<f64> {
            values.iter().zip(&counts).map(|(value, counts)| if *counts { factor * value } else { 0.0 }).collect()
        };
        let mut columns = vec![column(vec![1.0; counts.len()], 1.0)];
        let (mut curves, mut sum) = (Vec::new(), vec![level; counts.len()]);
        for part in &parts {
            let [value, by_place, by_variance] = self.curve(part);
            let curve: Vec<f64> = value.iter().map(|value| part.strength * value).collect();
            sum.iter_mut().zip(&curve).for_each(|(sum, curve)| *sum += curve);
            curves.push(curve);
            columns.push(column(value, 1.0));
            columns.push(column(by_place, part.strength));
            columns.push(column(by_variance, part.strength));
        }
        let residual = |(sample, sum): (&f64, &f64)| if sample.is_finite() { sample - sum } else { 0.0 };
        let residuals: Vec<f64> = self.samples.iter().zip(&sum).map(residual).collect();
        let sum_of_squares = residuals.iter().map(|residual| residual * residual).sum();
        Fit { level, parts, curves, residuals, sum_of_squares, columns }
    }

    /// The best fit from here on.
    pub fn fit(&mut self, level: f64, parts: Vec<Part>) -> Fit {
        let mut fit = self.at(level, parts);
        let mut damping = DAMPING;
        for _ in 0..STEPS {
            let before = fit.sum_of_squares;
            loop {
                let Some(step) = damped_step(&fit, damping) else { return fit };
                let next = self.at(fit.level + step[0], self.stepped(&fit.parts, &step[1..]));
                if next.sum_of_squares <= before {
                    fit = next;
                    damping /= FALL;
                    break;
                }
                damping *= GROWTH;
                if damping > GIVE_UP {
                    return fit;
                }
            }
            if before - fit.sum_of_squares <= SETTLED * before {
                break;
            }
        }
        fit
    }

    /// Parts after a step: strengths and variances are not negative, places lie within the record.
    fn stepped(&self, parts: &[Part], step: &[f64]) -> Vec<Part> {
        let end = self.samples.len() as f64;
        let widest = (WIDEST * end).powi(2);
        let moved = |(part, step): (&Part, &[f64])| Part {
            strength: (part.strength + step[0]).max(0.01 * part.strength),
            place: (part.place + step[1]).clamp(-0.5, end - 0.5),
            variance: (part.variance + step[2]).clamp(0.0, widest),
        };
        parts.iter().zip(step.chunks_exact(3)).map(moved).collect()
    }
}

/// The step of Levenberg and Marquardt: each column has a row of its own that keeps its coefficient small.
fn damped_step(fit: &Fit, damping: f64) -> Option<Vec<f64>> {
    let size = fit.columns.len();
    let mut columns = fit.columns.clone();
    for (k, column) in columns.iter_mut().enumerate() {
        let length = column.iter().map(|value| value * value).sum::<f64>();
        let own = column.len() + k;
        column.resize(fit.residuals.len() + size, 0.0);
        column[own] = (damping * length).sqrt();
    }
    let mut right = fit.residuals.clone();
    right.resize(right.len() + size, 0.0);
    least_squares(&columns, &right, &vec![1.0; right.len()]).map(|solved| solved.values)
}

/// The regression at a fit, for standard deviations 1.
pub fn regression(fit: &Fit) -> Option<Regression> {
    least_squares(&fit.columns, &fit.residuals, &vec![1.0; fit.residuals.len()])
}
