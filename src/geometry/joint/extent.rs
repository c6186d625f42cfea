//! How large the points are.
//!
//! A thing of some size spreads the ways of its light. With `S` the second moments of its light about its middle and
//! `g` the gradient of the length of the way, the variance of the lengths is `g' S g`: pulses are wider where the wall
//! sees the thing at an angle. A score test at size 0, with brightness and arrival of each histogram free, tells the
//! moments across the wall. What widens all pulses alike is the response.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use rayon::prelude::*;

use super::background::Level;
use super::fit::Fit;
use super::normal::Desk;
use super::{Histogram, Problem};

/// Standard deviation of the logarithm of the response's width.
const WIDTH_SD: f64 = 0.1;
/// Histograms in a run.
const RUN: usize = 64;
/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;

/// Mean square of the distances across the wall of a point's light from its middle, by the score at size 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// The estimate; negative where pulses are narrower than the response.
    pub square_m2: f64,
    /// Its standard deviation.
    pub sd_m2: f64,
}

/// Of all points of a fit.
pub fn extents(problem: &Problem, fit: &Fit) -> Vec<Extent> {
    let points = fit.model.dots.len();
    let of_run = |(histograms, levels): (&[Histogram], &[Level])| {
        problem.cancel.check();
        let mut sums = vec![(Matrix4::zeros(), Vector4::zeros()); points];
        let mut desk = Desk::default();
        let mut pulse = Vec::new();
        for (histogram, level) in histograms.iter().zip(levels) {
            desk.light(problem, (&fit.model, &fit.shine), (histogram, level[2]));
            fit.tail.fill(histogram, &mut desk.tail);
            for (k, sum) in sums.iter_mut().enumerate() {
                let way = fit.model.way(&fit.model.dots[k], histogram).later(level[2]);
                let bins = fit.shine.bins(problem, histogram, &way);
                fit.shine.pulse.fill(0, &bins, way.log_photons.min(60.0).exp(), &mut pulse);
                let [score, information] = spread(problem, histogram, (bins.from, &pulse), (*level, &desk));
                let [u, v] = problem.wall.across.map(|across| across.dot(&way.gradient));
                let terms = Vector4::new(u * u, 2.0 * u * v, v * v, 1.0);
                sum.0 += terms * terms.transpose() * information;
                sum.1 += terms * score;
            }
        }
        sums
    };
    let runs: Vec<_> = problem.histograms.par_chunks(RUN).zip(fit.normal.levels.par_chunks(RUN)).map(of_run).collect();
    let square_m2 = (problem.pulse.width_m() / FWHM).powi(2);
    let log = fit.shine.pulse.stretch().ln();
    (0..points)
        .map(|k| {
            let mut system = Matrix4::zeros();
            let mut goal = Vector4::zeros();
            for run in &runs {
                system += run[k].0;
                goal += run[k].1;
            }
            // The width that all pulses share may stand for size: its prior is that of the response.
            let precision = (2.0 * WIDTH_SD * square_m2).powi(-2);
            system[(3, 3)] += precision;
            goal[3] -= precision * 2.0 * log * square_m2;
            extent(system, goal)
        })
        .collect()
}

fn extent(system: Matrix4<f64>, goal: Vector4<f64>) -> Extent {
    let unknown = Extent { square_m2: 0.0, sd_m2: f64::INFINITY };
    let Some(covariance) = system.try_inverse() else { return unknown };
    let moments = covariance * goal;
    let variance = covariance[(0, 0)] + covariance[(2, 2)] + 2.0 * covariance[(0, 2)];
    if variance > 0.0 { Extent { square_m2: moments[0] + moments[2], sd_m2: variance.sqrt() } } else { unknown }
}

/// Score and information on the variance of the lengths of a point's ways in a histogram, its brightness and arrival
/// there free.
fn spread(
    problem: &Problem,
    histogram: &Histogram,
    (from, pulse): (usize, &[f64]),
    ([scale, constant, _], desk): (Level, &Desk),
) -> [f64; 2] {
    let (mut information, mut score) = (Matrix3::zeros(), Vector3::zeros());
    let step_m = problem.step_m;
    for (n, light) in pulse.windows(3).enumerate() {
        let bin = from + n + 1;
        let rate = scale * desk.tail[bin] + constant + desk.all[bin];
        let weight = problem.noise.weight(rate);
        let slopes = Vector3::new(
            light[1],
            (light[2] - light[0]) / (2.0 * step_m),
            // Half the second derivative: what a Gaussian of little variance adds.
            0.5 * (light[2] - 2.0 * light[1] + light[0]) / (step_m * step_m),
        );
        score += slopes * ((f64::from(histogram.values[bin]) - rate) * weight);
        information += slopes * slopes.transpose() * weight;
    }
    let free = information.fixed_view::<2, 2>(0, 0).into_owned();
    let Some(inverse) = free.try_inverse() else { return [0.0; 2] };
    let taken = inverse * information.fixed_view::<2, 1>(0, 2);
    let own = score[2] - taken.dot(&score.fixed_view::<2, 1>(0, 0).into_owned());
    let left = information[(2, 2)] - taken.dot(&information.fixed_view::<2, 1>(0, 2).into_owned());
    [own, left.max(0.0)]
}
