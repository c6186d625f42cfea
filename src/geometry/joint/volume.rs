//! Scores summed at places in front of the wall: where one more point may be.

use rayon::prelude::*;

use super::Problem;
use super::scores::{Line, Traces, add_squared};
use crate::Point;

/// Pitch in depth and across, in widths of a pulse as path length.
const PITCH: [f64; 2] = [0.25, 0.5];
/// Places at most.
const PLACES: f64 = 2e6;
/// Share of the wall's half width that is searched beyond its edges.
const MARGIN: f64 = 0.25;
/// Places in a cell of resolution, at the least.
const RESOLUTION: f64 = 4.0;
/// How many times wider the pitch across is where scores are summed: a climb follows.
const ACROSS: f64 = 1.4;
/// Share of a peak's score that the lattice sees at the least.
const COARSE: f32 = 0.75;
/// Depth whose steps are those of the pitch at the least, as a share of the largest.
const NEAREST: f64 = 0.12;
/// Peaks that are looked at more closely.
const PEAKS: usize = 100;
/// Halvings of the step of a climb.
const HALVINGS: usize = 4;

/// A place where a point may be.
#[derive(Clone, Copy, Debug)]
pub struct Peak {
    /// Place.
    pub place: Point,
    /// Score there.
    pub score: f64,
    /// Score over what errors of the model may make of it: `Z / sqrt(1 + Z_wrong^2)`.
    pub sure: f64,
}

/// Places in front of the wall.
#[derive(Clone, Debug)]
pub struct Lattice {
    counts: [usize; 3],
    pitch_m: [f64; 3],
    first_m: [f64; 2],
    cells: usize,
    /// Step of the square of the depth, where all histograms are lit and seen at one point.
    step_m2: f64,
}

impl Lattice {
    /// Of a problem.
    pub fn new(problem: &Problem) -> Self {
        let width_m = problem.pulse.width_m();
        let half_m = problem.wall.half_m.map(|half_m| (1.0 + MARGIN) * half_m);
        let count = |scale: f64| {
            let across = half_m.map(|half_m| 2.0 * half_m / (scale * PITCH[1] * width_m) + 1.0);
            [across[0], across[1], problem.depth_m / (scale * PITCH[0] * width_m)]
        };
        let places: f64 = count(1.0).iter().product();
        // Where there are too many places, all pitches grow.
        let scale = (places / PLACES).cbrt().max(1.0);
        let pitch_m = [PITCH[1], PITCH[1], PITCH[0]].map(|pitch| scale * pitch * width_m);
        let cells = (count(scale).map(f64::floor).iter().product::<f64>() / RESOLUTION).ceil().max(1.0) as usize;
        let counts = [ACROSS, ACROSS, 1.0].map(|wider| scale * wider);
        let counts = [0, 1, 2].map(|axis| count(counts[axis])[axis] as usize);
        let pitch_m = [ACROSS * pitch_m[0], ACROSS * pitch_m[1], pitch_m[2]];
        // Steps are those of the pitch where the first light may come from.
        let first_m = problem.histograms.iter().map(|one| 0.5 * one.first_m).fold(f64::INFINITY, f64::min);
        let step_m2 = 2.0 * pitch_m[2] * first_m.max(NEAREST * problem.depth_m);
        Self { counts, pitch_m, first_m: half_m.map(|half_m| -half_m), cells, step_m2 }
    }

    /// Independent cells.
    pub fn cells(&self) -> usize {
        self.cells
    }

    fn place(&self, problem: &Problem, [x, y]: [usize; 2], depth_m: f64) -> Point {
        let wall = &problem.wall;
        let across_m = [x, y].map(|n| n as f64);
        wall.middle
            + wall.across[0] * (self.first_m[0] + across_m[0] * self.pitch_m[0])
            + wall.across[1] * (self.first_m[1] + across_m[1] * self.pitch_m[1])
            + wall.normal * depth_m
    }

    /// Peaks with a score above `least`, the surest first.
    pub fn peaks(&self, problem: &Problem, traces: &Traces, least: f64) -> Vec<Peak> {
        let [columns, rows, depths] = self.counts;
        let half_m2 = problem.wall.half_m.map(|half_m| ((2.0 + MARGIN) * half_m).powi(2));
        let squares = ((problem.depth_m.powi(2) + half_m2[0] + half_m2[1]) / self.step_m2).ceil() as usize;
        let squared = traces.squared(problem, self.step_m2, squares);
        let depths_m: Vec<f32> = if squared.is_some() {
            let count = (problem.depth_m.powi(2) / self.step_m2) as usize;
            (1..=count).map(|n| (n as f64 * self.step_m2).sqrt() as f32).collect()
        } else {
            (1..=depths).map(|z| (z as f64 * self.pitch_m[2]) as f32).collect()
        };
        let depths = depths_m.len();
        let of_row = |y: usize| {
            let mut scores = vec![0.0_f32; columns * depths];
            let (mut terms, mut places) = (vec![0; depths], vec![0.0; depths]);
            for (x, sums) in scores.chunks_mut(depths).enumerate() {
                problem.cancel.check();
                terms.fill(0);
                let foot = self.place(problem, [x, y], 0.0);
                let along = problem.wall.normal;
                let (terms, places) = (&mut terms, &mut places);
                let mut line = Line { foot, along, depths_m: &depths_m, sums, terms, places };
                match &squared {
                    // The first place is one step from the foot.
                    Some(squared) => add_squared(squared, self.step_m2, &mut line),
                    None => traces.add(&mut line),
                }
                for (sum, terms) in sums.iter_mut().zip(&*terms) {
                    let covered = 2 * *terms as usize >= traces.groups.len();
                    *sum = if covered { *sum / (*terms as f32).sqrt() } else { 0.0 };
                }
            }
            scores
        };
        let volume: Vec<Vec<f32>> = (0..rows).into_par_iter().map(of_row).collect();
        let at = |x: usize, y: usize, z: usize| volume[y][x * depths + z];
        // The lattice may miss a peak by half a pitch on each axis.
        let first = COARSE * least as f32;
        let mut maxima = Vec::new();
        for (y, scores) in volume.iter().enumerate() {
            for (n, score) in scores.iter().enumerate().filter(|(_, score)| **score > first) {
                let (x, z) = (n / depths, n % depths);
                let near = |n: usize, count: usize| n.saturating_sub(1)..(n + 2).min(count);
                let largest =
                    near(y, rows).all(|b| near(x, columns).all(|a| near(z, depths).all(|c| at(a, b, c) <= *score)));
                if largest {
                    maxima.push((*score, [x, y, z]));
                }
            }
        }
        maxima.sort_by(|a, b| b.0.total_cmp(&a.0));
        maxima.truncate(PEAKS);
        let climb = |(_, at): &(f32, [usize; 3])| {
            problem.cancel.check();
            self.climb(problem, traces, self.place(problem, [at[0], at[1]], f64::from(depths_m[at[2]])))
        };
        let mut peaks: Vec<Peak> = maxima.par_iter().map(climb).collect();
        peaks.retain(|peak| peak.score > least);
        peaks.sort_by(|a, b| b.sure.total_cmp(&a.sure));
        self.apart(peaks)
    }

    /// The surest of peaks that climbed to one place.
    fn apart(&self, peaks: Vec<Peak>) -> Vec<Peak> {
        let mut apart: Vec<Peak> = Vec::new();
        for peak in peaks {
            if apart.iter().all(|other| (other.place - peak.place).norm() > self.pitch_m[2]) {
                apart.push(peak);
            }
        }
        apart
    }

    fn climb(&self, problem: &Problem, traces: &Traces, start: Point) -> Peak {
        let wall = &problem.wall;
        let axes = [wall.across[0], wall.across[1], wall.normal];
        let (mut place, mut score) = (start, traces.at(&start));
        let mut scale = 0.5;
        for _ in 0..HALVINGS {
            // A few rounds along the axes; a peak is at most a pitch away.
            for _ in 0..4 {
                let before = score[0];
                for (axis, pitch_m) in axes.iter().zip(self.pitch_m) {
                    for sign in [-1.0, 1.0] {
                        let trial = place + axis * (sign * scale * pitch_m);
                        let value = traces.at(&trial);
                        if value[0] > score[0] {
                            (place, score) = (trial, value);
                        }
                    }
                }
                if score[0] <= before {
                    break;
                }
            }
            scale *= 0.5;
        }
        let sure = score[0] / (1.0 + score[1] * score[1]).sqrt();
        Peak { place, score: score[0], sure }
    }
}
