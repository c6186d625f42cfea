//! Points that are two: closer together than the response resolves, they are seeded as one, with wider pulses.
//!
//! A score test says which points have pulses wider than the common width; only these are split, along each of three
//! directions, and the fit decides.

use super::background::Level;
use super::fit::{Fit, Free};
use super::model::{Dot, SHARED, WIDTH};
use super::normal::Desk;
use super::rounds::MOST;
use super::{Histogram, Problem};

/// Standard deviations by which a point's width, or the common one, exceeds what is expected.
const WIDE: f64 = 3.5;
/// Points that are split at most where the common width is too large.
const BRIGHTEST: usize = 6;
/// Half the distance of the two points across and in depth, in widths of a pulse.
const HALF: [f64; 3] = [0.3, 0.3, 0.15];

/// The fit with points split in two, where that gains twice the log-likelihood of `threshold` squared; at most twice as
/// many as before.
pub fn split(problem: &Problem, fit: Fit, threshold: f64) -> Fit {
    let mut fit = fit;
    let most = MOST.min(2 * fit.model.dots.len());
    while fit.model.dots.len() < most {
        let tries = candidates(problem, &fit);
        let better = tries.into_iter().find_map(|dot| {
            let best = halves(problem, &fit, dot);
            let gain = best.normal.log_likelihood - fit.normal.log_likelihood;
            (2.0 * gain > threshold * threshold).then_some(best)
        });
        match better {
            Some(better) => fit = better,
            None => break,
        }
    }
    fit
}

/// Points that may be two, the widest first; where the common width is too large, the brightest.
fn candidates(problem: &Problem, fit: &Fit) -> Vec<usize> {
    let points = fit.model.dots.len();
    let widths = widths(problem, fit);
    let mut candidates: Vec<usize> = (0..points).filter(|k| widths[*k] > WIDE).collect();
    candidates.sort_by(|a, b| widths[*b].total_cmp(&widths[*a]));
    let width = fit.model.unknowns() - SHARED + WIDTH;
    let sd = fit.covariance().map_or(f64::INFINITY, |covariance| covariance[(width, width)].sqrt());
    if candidates.is_empty() && fit.model.shared[WIDTH] > WIDE * sd {
        candidates = (0..points).collect();
        candidates.sort_by(|a, b| fit.model.dots[*b].log_photons.total_cmp(&fit.model.dots[*a].log_photons));
        candidates.truncate(BRIGHTEST);
    }
    candidates
}

/// The likeliest fit with a point in two.
fn halves(problem: &Problem, fit: &Fit, dot: usize) -> Fit {
    let wall = &problem.wall;
    let along = |axis: usize| {
        problem.cancel.check();
        let directions = [wall.across[0], wall.across[1], wall.normal];
        let arm = directions[axis] * (HALF[axis] * problem.pulse.width_m());
        let mut model = fit.model.clone();
        let whole = model.dots[dot];
        let half = Dot { log_photons: whole.log_photons - std::f64::consts::LN_2, ..whole };
        model.dots[dot] = Dot { place: whole.place - arm, ..half };
        model.dots.push(Dot { place: whole.place + arm, ..half });
        Fit::new(problem, fit.tail.clone(), model, &fit.normal.levels).climb(problem, Free::All)
    };
    let mut best = along(0);
    for axis in 1..3 {
        let other = along(axis);
        if other.normal.log_likelihood > best.normal.log_likelihood {
            best = other;
        }
    }
    best
}

/// For each point the score of a width of its own, in standard deviations.
fn widths(problem: &Problem, fit: &Fit) -> Vec<f64> {
    let points = fit.model.dots.len();
    let mut sums = vec![[0.0; 2]; points];
    let mut desk = Desk::default();
    for (histogram, level) in problem.histograms.iter().zip(&fit.normal.levels) {
        desk.light(problem, (&fit.model, &fit.shine), (histogram, level[2]));
        fit.tail.fill(histogram, &mut desk.tail);
        for (dot, sum) in fit.model.dots.iter().zip(&mut sums) {
            let [score, information] = own_width(problem, fit, histogram, (dot, *level, &desk));
            sum[0] += score;
            sum[1] += information;
        }
    }
    sums.into_iter()
        .map(|[score, information]| if information > 0.0 { score / information.sqrt() } else { 0.0 })
        .collect()
}

/// Score and information on the width of a point in a histogram, its amplitude there free.
fn own_width(
    problem: &Problem,
    fit: &Fit,
    histogram: &Histogram,
    (dot, [scale, constant, late_m], desk): (&Dot, Level, &Desk),
) -> [f64; 2] {
    let way = fit.model.way(dot, histogram).later(late_m);
    let photons = way.log_photons.min(60.0).exp();
    let bins = fit.shine.bins(problem, histogram, &way);
    let rows = [0, 2].map(|column| {
        let mut row = Vec::new();
        fit.shine.pulse.fill(column, &bins, photons, &mut row);
        row
    });
    let (mut score, mut information) = ([0.0; 2], [0.0; 3]);
    for (bin, (light, width)) in (bins.from..).zip(rows[0].iter().zip(&rows[1])) {
        let rate = scale * desk.tail[bin] + constant + desk.all[bin];
        let weight = problem.noise.weight(rate);
        let rest = (f64::from(histogram.values[bin]) - rate) * weight;
        score[0] += rest * light;
        score[1] += rest * width;
        information[0] += weight * light * light;
        information[1] += weight * light * width;
        information[2] += weight * width * width;
    }
    if information[0] <= 0.0 {
        return [0.0; 2];
    }
    let tilt = information[1] / information[0];
    [score[1] - tilt * score[0], information[2] - tilt * information[1]]
}
