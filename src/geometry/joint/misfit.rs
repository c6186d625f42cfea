//! How far arrivals lie off the model, beyond noise.
//!
//! Each histogram tells by itself when the light of a point arrives. With a right model these scores are independent
//! and have a variance of 1. Relief of the wall, jitter from place to place, a wrong response and things that are no
//! points make it larger. Errors that neighbours share do not show in single histograms, so that scores are also summed
//! over blocks of the wall. The larger factor widens all covariances.

use super::Problem;
use super::fit::Fit;

/// Blocks along each side of the wall.
const BLOCKS: usize = 4;
/// Share of a smooth error's square that scores show, inverted: in simulated relief positions hid two thirds of it.
const HIDING: f64 = 3.0;
/// Standard deviations beyond which a factor counts: 1 in 1000 by chance.
const BEYOND: f64 = 3.09;
/// Degrees of freedom of shifts that positions and the common delay take.
const TAKEN: f64 = 4.0;
/// Largest variance of a shift over that of noise, and halvings of its interval.
const MOST: f64 = 1e6;
const HALVINGS: usize = 40;
/// Least number of degrees of freedom of a factor.
const LEAST: f64 = 4.0;

/// How far arrivals lie off a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Factor on the variances: at least 1.
    pub factor: f64,
    /// Standard deviation of arrivals beyond noise, as path length.
    pub scatter_m: f64,
    /// Mean square of scores that no shift common to all points of a histogram explains.
    pub own: f64,
}

impl Misfit {
    /// Of a fit.
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let scatter_m = scatter_m(&fit.normal.arrivals).hypot(fit.model.wander_m);
        Self { factor: widening(problem, fit), scatter_m, own: own(fit) }
    }
}

/// Standard deviation of the shift that all light of a histogram shares, as path length; 0 where chance explains it.
///
/// A score varies by the information `I`, and by `I^2 wander^2`. The variance of the shifts is that for which the sum
/// of squared scores, each over its variance, is what is expected (Paule and Mandel, J. Res. NBS 87:377, 1982).
pub fn wander_m(fit: &Fit) -> f64 {
    let shifts = || fit.normal.shifts.iter().filter(|[_, information]| *information > 0.0);
    let freedom = shifts().count() as f64 - TAKEN;
    let square = |variance_m2: f64| -> f64 {
        shifts().map(|[score, information]| score * score / (information * (1.0 + information * variance_m2))).sum()
    };
    if beyond_chance(square(0.0), freedom) <= 1.0 {
        return 0.0;
    }
    let mean = shifts().map(|[_, information]| information).sum::<f64>() / (freedom + TAKEN);
    let mut ends = [0.0, 1.0 / mean];
    while square(ends[1]) > freedom && ends[1] * mean < MOST {
        ends[1] *= 4.0;
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (ends[0] + ends[1]);
        ends[usize::from(square(middle) < freedom)] = middle;
    }
    ends[1].sqrt()
}

/// Relief of the wall and jitter from place to place shift all light of a histogram alike, as far as all directions are
/// similar. What is no point has arrivals of its own. 1 where what remains is within noise; where such shifts are in
/// the fit, what is left of the scores sums to nothing in each histogram, and up to half more is within noise too.
fn own(fit: &Fit) -> f64 {
    let points = fit.model.dots.len();
    if points < 2 {
        return 1.0;
    }
    let (mut square, mut freedom) = (0.0, -3.0 * points as f64);
    for arrivals in fit.normal.arrivals.chunks(points) {
        let with_light = || arrivals.iter().filter(|[_, information]| *information > 0.0);
        let [score, information] = with_light().fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
        if information > 0.0 {
            square += with_light().map(|[score, information]| score * score / information).sum::<f64>();
            square -= score * score / information;
            freedom += with_light().count() as f64 - 1.0;
        }
    }
    beyond_chance(square, freedom)
}

/// A score varies by the information, and by its square times the variance of the scatter.
fn scatter_m(arrivals: &[[f64; 2]]) -> f64 {
    let excess: f64 = arrivals.iter().map(|[score, information]| score * score - information).sum();
    let squares: f64 = arrivals.iter().map(|[_, information]| information * information).sum();
    if excess > 0.0 { (excess / squares).sqrt() } else { 0.0 }
}

/// Factor on the variances.
fn widening(problem: &Problem, fit: &Fit) -> f64 {
    let points = fit.model.dots.len();
    if points == 0 {
        return 1.0;
    }
    let mut blocks = vec![[0.0; 2]; BLOCKS * BLOCKS * points];
    for (histogram, arrivals) in problem.histograms.iter().zip(fit.normal.arrivals.chunks(points)) {
        let [lit, seen] = histogram.ends;
        let cell = [0, 1].map(|axis| {
            let middle = 0.25 * (lit[axis] + seen[axis]) + 0.5;
            ((middle * BLOCKS as f64) as usize).min(BLOCKS - 1)
        });
        let block = (cell[1] * BLOCKS + cell[0]) * points;
        for (sum, arrival) in blocks[block..block + points].iter_mut().zip(arrivals) {
            (0..2).for_each(|n| sum[n] += arrival[n]);
        }
    }
    let [single, shared] = [factor(&fit.normal.arrivals, points), factor(&blocks, points)];
    // Positions take up most of an error that is smooth over the wall, and hide it from the scores.
    let shared = if shared > single { single + HIDING * (shared - single) } else { single };
    shared.max(1.0)
}

/// Mean square of scores of unit variance; positions take three degrees of freedom for each point. 1 where what remains
/// is within noise.
fn factor(arrivals: &[[f64; 2]], points: usize) -> f64 {
    let with_light = || arrivals.iter().filter(|[_, information]| *information > 0.0);
    let square: f64 = with_light().map(|[score, information]| score * score / information).sum();
    let freedom = with_light().count() as f64 - 3.0 * points as f64 - 1.0;
    beyond_chance(square, freedom)
}

/// Chi-square over its degrees of freedom; 1 where chance explains it.
fn beyond_chance(square: f64, freedom: f64) -> f64 {
    if freedom < LEAST {
        return 1.0;
    }
    // Wilson and Hilferty's cube root of chi-square over its degrees of freedom is nearly normal.
    let spread = 2.0 / (9.0 * freedom);
    let normal = ((square / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
    if normal > BEYOND { square / freedom } else { 1.0 }
}
