//! Seeds, fits, and seeds again on what remains.

use super::Problem;
use super::background::{Level, PLAIN};
use super::fit::{Fit, Free, tail};
use super::misfit::{Misfit, wander_m};
use super::model::{Dot, Model};
use super::normal::Shine;
use super::scores::Traces;
use super::volume::{Lattice, Peak};
use crate::Point;

/// Histograms that a first search takes, where there are so many or more.
pub const FIRST: usize = 256;
pub const MANY: usize = 600;
/// Points at most.
pub const MOST: usize = 24;
/// Rounds at most.
const ROUNDS: usize = 8;
/// Peaks above this share of the highest are fitted together, in the first round and later: what is fainter may be
/// their sidelobe.
const BATCH: [f64; 2] = [0.45, 0.6];
/// Share of the threshold above which a peak is worth a fit: the filter has less than the whole information.
const WORTH: f64 = 0.7;
/// Peaks below the threshold that are fitted in a round.
const FAINT: usize = 6;
/// Share of the threshold below which a point is eliminated between rounds.
const LOOSE: f64 = 0.8;

/// Standard deviations of the common delay, shrunk as it is, beyond which its prior was too sure, and is made four
/// times as wide; and the largest factor.
const LATE: f64 = 1.0;
const LEAST_SURE: f64 = 64.0;

/// Estimates of the shifts of single histograms at most, and the relative change that ends them.
const WANDERS: usize = 4;
const SAME: f64 = 0.1;

/// What a search came to.
pub struct Search {
    /// The last fit.
    pub fit: Fit,
    /// How far arrivals lie off it.
    pub misfit: Misfit,
    /// Largest score before any point was fitted.
    pub largest: f64,
    /// The same, less what a wrong model of the wall and of the points could leave.
    pub sure: f64,
    /// Whether there were more points than [`MOST`].
    pub too_many: bool,
}

/// Searches the histograms of a problem for points with a z of `threshold` or more, from the points of a model. Peaks
/// of a score below `clear` may be noise, and only few are tried at once.
pub fn search(problem: &Problem, lattice: &Lattice, [threshold, clear]: [f64; 2], model: Model) -> Search {
    let shape = tail(problem, (&model, &Shine::new(problem, &model, false)));
    let levels: Vec<Level> = vec![PLAIN; problem.histograms.len()];
    let mut fit = Fit::new(problem, shape, model, &levels);
    if !fit.model.dots.is_empty() {
        fit = fit.climb(problem, Free::Law);
    }
    let (mut largest, mut sure, mut too_many) = (0.0, 0.0, false);
    for round in 0..ROUNDS {
        let traces = Traces::new(problem, &fit);
        let peaks = lattice.peaks(problem, &traces, WORTH * threshold);
        if round == 0 {
            largest = peaks.iter().map(|peak| peak.score).fold(0.0, f64::max);
            sure = peaks.iter().map(|peak| peak.sure).fold(0.0, f64::max);
        }
        let mut peaks = batch(peaks, [threshold, clear], if round == 0 { BATCH[0] } else { BATCH[1] });
        let before = fit.model.dots.len();
        // Many peaks at once are a surface; later ones may be ghosts, which vanish when all points are in place.
        too_many = before.max(if round == 0 { peaks.len() } else { 0 }) >= MOST;
        if peaks.is_empty() || too_many {
            break;
        }
        peaks.truncate(MOST - before);
        let next = with(problem, fit.clone(), &peaks).eliminate(problem, LOOSE * threshold, Free::Law);
        let gain = next.normal.log_likelihood - fit.normal.log_likelihood;
        if 2.0 * gain < threshold * threshold {
            break;
        }
        // A wrong response leaves rests that look like faint points.
        fit = steadied(problem, next.reshape(problem).climb(problem, Free::Law).climb(problem, Free::All));
    }
    let (fit, misfit) = last(problem, fit, threshold);
    Search { fit, misfit, largest, sure, too_many }
}

/// The peaks that are fitted together.
fn batch(mut peaks: Vec<Peak>, [threshold, clear]: [f64; 2], share: f64) -> Vec<Peak> {
    let sure = peaks.iter().filter(|peak| peak.sure > clear).count();
    peaks.retain(|peak| peak.sure > WORTH * threshold);
    let highest = peaks.iter().map(|peak| peak.score).fold(0.0, f64::max);
    peaks.retain(|peak| peak.score > share * highest);
    peaks.truncate(sure.max(FAINT));
    peaks
}

/// The fit with free width, and its misfit.
fn last(problem: &Problem, fit: Fit, threshold: f64) -> (Fit, Misfit) {
    if fit.model.dots.is_empty() {
        return (fit, Misfit { factor: 1.0, scatter_m: 0.0, own: 1.0 });
    }
    let mut fit = fit.reshape(problem).climb(problem, Free::All);
    while fit.model.late(&problem.pulse) > LATE && fit.model.unsure < LEAST_SURE {
        fit.model.unsure *= 4.0;
        fit = Fit::new(problem, fit.tail, fit.model, &fit.normal.levels).climb(problem, Free::All);
    }
    settle(problem, fit, threshold)
}

/// The fit with shifts of single histograms as large as its arrivals show them.
fn steadied(problem: &Problem, mut fit: Fit) -> Fit {
    for _ in 0..WANDERS {
        let wander_m = wander_m(&fit);
        if (wander_m - fit.model.wander_m).abs() <= SAME * wander_m {
            break;
        }
        fit.model.wander_m = wander_m;
        fit = Fit::new(problem, fit.tail, fit.model, &fit.normal.levels).climb(problem, Free::All);
    }
    fit
}

/// A fit with shifts of histograms as they show, without points that it does not show, and its misfit.
pub fn settle(problem: &Problem, fit: Fit, threshold: f64) -> (Fit, Misfit) {
    let mut fit = steadied(problem, fit).eliminate(problem, threshold, Free::All);
    loop {
        let misfit = Misfit::new(problem, &fit);
        // Errors of the model that arrivals show count as noise: what they could explain is no point.
        let count = fit.model.dots.len();
        fit = fit.eliminate(problem, threshold * misfit.factor.sqrt(), Free::All);
        if fit.model.dots.len() == count {
            return (fit, misfit);
        }
    }
}

/// A fit with points at peaks: first their photons, then their places, then the law.
fn with(problem: &Problem, fit: Fit, peaks: &[Peak]) -> Fit {
    let mut model = fit.model.clone();
    for peak in peaks {
        let dot = start(problem, &fit, peak.place);
        model.dots.push(dot);
    }
    Fit::new(problem, fit.tail, model, &fit.normal.levels)
        .climb(problem, Free::Photons)
        .climb(problem, Free::Places)
        .climb(problem, Free::Law)
}

/// A point with as many photons as there are above the wall's own light in the bins that its pulse fills best.
fn start(problem: &Problem, fit: &Fit, place: Point) -> Dot {
    let reference_m = (place - problem.wall.middle).norm();
    let dot = Dot { place, log_photons: 0.0, slopes: [0.0; 2], reference_m };
    let half_m = 0.5 * problem.pulse.width_m();
    let (mut light, mut expected, mut tail, mut pulse) = (0.0, 0.0, Vec::new(), Vec::new());
    for (histogram, level) in problem.histograms.iter().zip(&fit.normal.levels) {
        let way = fit.model.way(&dot, histogram);
        fit.tail.fill(histogram, &mut tail);
        let first_m = histogram.first_m + 0.5 * problem.step_m - way.length_m;
        let bins = problem.pulse.bins(first_m, histogram.values.len());
        problem.pulse.fill(0, &bins, way.log_photons.exp(), &mut pulse);
        for (bin, share) in (bins.from..).zip(&pulse) {
            let offset_m = first_m + bin as f64 * problem.step_m;
            if offset_m.abs() < half_m {
                light += f64::from(histogram.values[bin]) - level[0] * tail[bin] - level[1];
                expected += share;
            }
        }
    }
    let photons = if expected > 0.0 { (light / expected).max(1e-3) } else { 1e-3 };
    Dot { log_photons: photons.ln(), ..dot }
}
