//! What a model leaves of each histogram, filtered so that smooth light vanishes, over its standard deviation.
//!
//! The filter is the negative second derivative of a Gaussian. It separates points that blend in one histogram, where a
//! matched filter would take the middle of the blend, and it is blind to whatever is smooth. Where many histograms lie
//! close together their scores are added, since a volume takes a time proportional to their number.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::fit::Fit;
use super::normal::Desk;
use super::{Histogram, Problem};
use crate::Point;

/// Standard deviation of the filter's Gaussian, in widths of a pulse.
const WIDTH: f64 = 0.65;
/// Reach of the filter, in standard deviations.
const REACH: f64 = 3.5;
/// Groups of histograms at most.
const GROUPS: usize = 1100;
/// Distance of lit and seen point, and of both from the wall's plane, that changes no sum, in widths of a pulse.
const APART: f64 = 0.1;
/// Shares of the points' light and of the wall's own that a model may be wrong by.
const WRONG: [f64; 2] = [0.1, 0.03];

/// Scores of neighbouring histograms.
#[derive(Clone, Debug)]
pub struct Trace {
    lit: Point,
    seen: Point,
    first_m: f64,
    /// Scores of variance 1, and what errors of the model may make of them.
    scores: Vec<[f32; 2]>,
    /// The scores alone, with 0 at both ends where the filter does not fit.
    nearest: Vec<f32>,
    /// Bins between which it fits.
    whole: [usize; 2],
}

/// Scores of all histograms.
#[derive(Clone, Debug)]
pub struct Traces {
    /// By groups of neighbours.
    pub groups: Vec<Trace>,
    step_m: f64,
}

impl Traces {
    /// Of what a fit leaves.
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let filter = filter(WIDTH * problem.pulse.width_m() / problem.step_m);
        let groups = groups(&problem.histograms);
        let of_group = |members: &Vec<usize>| {
            problem.cancel.check();
            trace(problem, fit, &filter, members)
        };
        Self { groups: groups.par_iter().map(of_group).collect(), step_m: problem.step_m }
    }

    /// Score at a place, and what errors of the model may make of it. 0 where fewer than half of the groups have one.
    pub fn at(&self, place: &Point) -> [f64; 2] {
        let (mut sum, mut wrong, mut terms) = (0.0, 0.0, 0_usize);
        for trace in &self.groups {
            let length_m = (place - trace.lit).norm() + (place - trace.seen).norm();
            let at = (length_m - trace.first_m) / self.step_m - 0.5;
            let left = at.max(0.0) as usize;
            let Some([here, next]) = trace.scores.get(left..left + 2).and_then(|pair| pair.first_chunk()) else {
                continue;
            };
            if at < 0.0 || here[0].is_nan() || next[0].is_nan() {
                continue;
            }
            let share = at - left as f64;
            let between = |n: usize| f64::from(here[n]) * (1.0 - share) + f64::from(next[n]) * share;
            sum += between(0);
            wrong += between(1);
            terms += 1;
        }
        if 2 * terms < self.groups.len() {
            return [0.0; 2];
        }
        [sum, wrong].map(|sum| sum / (terms as f64).sqrt())
    }

    /// The same on a grid of squared distances where each group is lit and seen at one point of the wall; `None`
    /// where some are not.
    pub fn squared(&self, problem: &Problem, step_m2: f64, count: usize) -> Option<Vec<Squared>> {
        let wall = &problem.wall;
        let near_m = APART * problem.pulse.width_m();
        let is_confocal = |trace: &Trace| {
            (trace.lit - trace.seen).norm() < near_m && wall.normal.dot(&(trace.lit - wall.middle)).abs() < near_m
        };
        if !self.groups.iter().all(is_confocal) {
            return None;
        }
        let squared = |trace: &Trace| {
            let middle = Point::from(0.5 * (trace.lit.coords + trace.seen.coords));
            let bin = |n: usize| (2.0 * (n as f64 * step_m2).sqrt() - trace.first_m) / self.step_m;
            let is_whole = |n: &usize| bin(*n) >= trace.whole[0] as f64 && bin(*n) < trace.whole[1] as f64;
            let first = (0..count).find(is_whole).unwrap_or(count);
            let scores: Vec<f32> =
                (first..count).take_while(is_whole).map(|n| trace.nearest[bin(n) as usize]).collect();
            Squared { middle, first, scores }
        };
        Some(self.groups.par_iter().map(squared).collect())
    }

    /// Adds the scores of nearest bins at places along a line, and counts them.
    pub fn add(&self, line: &mut Line<'_>) {
        for trace in &self.groups {
            let arms = [trace.lit, trace.seen].map(|end| line.foot - end);
            let [out, back] = arms.map(|arm| [arm.norm_squared() as f32, 2.0 * line.along.dot(&arm) as f32]);
            let (first, per_step) = ((trace.first_m / self.step_m) as f32, (1.0 / self.step_m) as f32);
            for (place, depth) in line.places.iter_mut().zip(line.depths_m) {
                let leg = |[square, tilt]: [f32; 2]| (square + depth * (tilt + depth)).sqrt();
                *place = (leg(out) + leg(back)) * per_step - first;
            }
            let [from, to] = trace.whole.map(|bin| bin as f32);
            for ((place, sum), terms) in line.places.iter().zip(&mut *line.sums).zip(&mut *line.terms) {
                let is_whole = *place >= from && *place < to;
                let bin = if is_whole { *place as usize } else { 0 };
                *sum += trace.nearest[bin];
                *terms += i32::from(is_whole);
            }
        }
    }
}

/// Scores of a group by the square of the distance from its point.
pub struct Squared {
    middle: Point,
    first: usize,
    scores: Vec<f32>,
}

/// Adds scores to a line at right angles to the wall, whose places are equal steps in the square of the depth: the
/// squared distance from a point of the wall is that of the foot, and the square of the depth. Counts them too.
pub fn add_squared(groups: &[Squared], step_m2: f64, line: &mut Line<'_>) {
    let places = line.sums.len();
    for group in groups {
        // The first place lies one step behind the foot.
        let shift = 1 + ((line.foot - group.middle).norm_squared() / step_m2).round() as usize;
        let (from, to) = (group.first.saturating_sub(shift), (group.first + group.scores.len()).saturating_sub(shift));
        let (from, to) = (from.min(places), to.min(places));
        if from < to {
            let scores = &group.scores[from + shift - group.first..to + shift - group.first];
            line.sums[from..to].iter_mut().zip(scores).for_each(|(sum, score)| *sum += score);
            // Here differences: they become counts below.
            line.terms[from] += 1;
            if to < places {
                line.terms[to] -= 1;
            }
        }
    }
    let mut count = 0;
    for terms in &mut *line.terms {
        count += *terms;
        *terms = count;
    }
}

/// Places along a line from a foot, with sums of scores there.
pub struct Line<'a> {
    /// Where it begins.
    pub foot: Point,
    /// Unit vector along it.
    pub along: nalgebra::Vector3<f64>,
    /// Distances from the foot.
    pub depths_m: &'a [f32],
    /// Sums of scores.
    pub sums: &'a mut [f32],
    /// Their numbers; zeros at the start.
    pub terms: &'a mut [i32],
    /// Bins, for one trace after another.
    pub places: &'a mut [f32],
}

/// Scores of a group on the bins of its middle.
fn trace(problem: &Problem, fit: &Fit, filter: &[f64], members: &[usize]) -> Trace {
    let count = members.len() as f64;
    let middle = |of: fn(&Histogram) -> Point| {
        let sum = members.iter().map(|n| of(&problem.histograms[*n]).coords).sum::<nalgebra::Vector3<f64>>();
        Point::from(sum / count)
    };
    let first_m = members.iter().map(|n| problem.histograms[*n].first_m).fold(f64::INFINITY, f64::min);
    let bins = members.iter().map(|n| problem.histograms[*n].values.len()).max().unwrap_or(0);
    let mut scores = vec![[0.0_f64; 2]; bins];
    let mut desk = Desk::default();
    let (mut rests, mut rates, mut wrong) = (Vec::new(), Vec::new(), Vec::new());
    for n in members {
        let histogram = &problem.histograms[*n];
        let [scale, constant, late_m] = fit.normal.levels[*n];
        desk.light(problem, (&fit.model, &fit.shine), (histogram, late_m));
        fit.tail.fill(histogram, &mut desk.tail);
        rests.clear();
        rates.clear();
        wrong.clear();
        for (bin, value) in histogram.values.iter().enumerate() {
            let own = scale * desk.tail[bin];
            let rate = own + constant + desk.all[bin];
            rests.push(f64::from(*value) - rate);
            rates.push(rate);
            wrong.push(WRONG[0] * desk.all[bin] + WRONG[1] * own);
        }
        let shift = ((histogram.first_m - first_m) / problem.step_m).round() as usize;
        let light: Vec<f64> = histogram.values.iter().map(|value| f64::from(*value)).collect();
        let reach = filter.len() / 2;
        let smooth = rolling(&light, reach / 2);
        for (bin, rate) in rates.iter_mut().enumerate() {
            // Light that the model lacks varies too.
            let rate_here = rate.max(smooth[bin]);
            *rate = 1.0 / problem.noise.weight(rate_here);
        }
        let windows = rests.windows(filter.len()).zip(rates.windows(filter.len())).zip(wrong.windows(filter.len()));
        for (at, ((rests, variances), wrong)) in windows.enumerate() {
            let (mut sum, mut variance, mut off) = (0.0, 0.0, 0.0);
            for (k, weight) in filter.iter().enumerate() {
                sum += weight * rests[k];
                variance += weight * weight * variances[k];
                off += weight * wrong[k];
            }
            let sd = variance.sqrt();
            if let Some(score) = scores.get_mut(at + reach + shift) {
                score[0] += sum / sd;
                score[1] += off.abs() / sd;
            }
        }
    }
    let reach = filter.len() / 2;
    let whole = |n: usize| n >= reach && n + reach < bins;
    let score =
        |(n, score): (usize, [f64; 2])| score.map(|sum| if whole(n) { (sum / count.sqrt()) as f32 } else { f32::NAN });
    let scores: Vec<[f32; 2]> = scores.into_iter().enumerate().map(score).collect();
    let nearest = scores.iter().map(|score| if score[0].is_nan() { 0.0 } else { score[0] }).collect();
    let whole = [reach, bins.saturating_sub(reach)];
    Trace { lit: middle(|one| one.lit), seen: middle(|one| one.seen), first_m, scores, nearest, whole }
}

/// Means over up to `half` bins to either side.
fn rolling(values: &[f64], half: usize) -> Vec<f64> {
    let mut sums = vec![0.0];
    for value in values {
        sums.push(sums[sums.len() - 1] + value);
    }
    let mean = |at: usize| {
        let (from, to) = (at.saturating_sub(half), (at + half + 1).min(values.len()));
        (sums[to] - sums[from]) / (to - from) as f64
    };
    (0..values.len()).map(mean).collect()
}

/// Negative second derivative of a Gaussian, without what a straight line leaves in it.
fn filter(width: f64) -> Vec<f64> {
    let reach = (REACH * width).ceil().max(2.0) as i32;
    let at = |n: i32| f64::from(n) / width;
    let filter: Vec<f64> = (-reach..=reach).map(|n| (1.0 - at(n).powi(2)) * (-0.5 * at(n).powi(2)).exp()).collect();
    let mean = filter.iter().sum::<f64>() / filter.len() as f64;
    filter.into_iter().map(|weight| weight - mean).collect()
}

/// Histograms whose points lie in the same cells of the wall, so many cells that there are [`GROUPS`] groups at most.
fn groups(histograms: &[Histogram]) -> Vec<Vec<usize>> {
    let mut cells = 64.0;
    loop {
        let mut groups: BTreeMap<[i32; 4], Vec<usize>> = BTreeMap::new();
        for (n, histogram) in histograms.iter().enumerate() {
            let cell = |value: f64| (0.5 * (value + 1.0) * cells) as i32;
            let [lit, seen] = [histogram.ends[0], histogram.ends[1]];
            groups.entry([cell(lit[0]), cell(lit[1]), cell(seen[0]), cell(seen[1])]).or_default().push(n);
        }
        if groups.len() <= GROUPS || histograms.len() <= GROUPS || cells < 2.0 {
            return groups.into_values().collect();
        }
        cells *= 0.9;
    }
}
