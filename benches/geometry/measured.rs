//! Path lengths with source and camera in one point.

use faer::Mat;
use periscope::cancel::Cancel;
use periscope::geometry::maximum_likelihood::{Node, Observation, Problem};
use periscope::geometry::placement::{self, Alternative};
use periscope::geometry::t2::Length;
use periscope::geometry::{Point, completion, procrustes};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::room;

/// Path lengths of a scene with noise, a delay, and missing pairs. A second bounce is the mean of both directions, with
/// lit and seen patch exchanged.
pub struct Measured {
    pub pairs: Vec<(usize, usize)>,
    first: Vec<Length>,
    second: Vec<(usize, usize, Length)>,
}

/// Standard deviations of first and second bounces, of that of an onset.
pub fn sds_m(onset_sd_m: f64) -> [f64; 2] {
    [onset_sd_m, onset_sd_m / 2_f64.sqrt()]
}

pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

impl Measured {
    pub fn new(truth: &[Point], missing: f64, sd_m: f64, delay_sd_m: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut pairs = room::all_pairs(truth.len());
        pairs.retain(|_| !rng.random_bool(missing));
        let delay_m = delay_sd_m * normal(&mut rng);
        let mut noisy = |length_m: f64, sd_m: f64| {
            let error_m = delay_m + sd_m * normal(&mut rng);
            Length { length_m: length_m + error_m, variance_m2: sd_m * sd_m }
        };
        let [first_sd_m, second_sd_m] = sds_m(sd_m);
        let first = (0..truth.len()).map(|patch| noisy(room::first_m(truth, patch), first_sd_m)).collect();
        let second = pairs.iter().map(|&(a, b)| (a, b, noisy(room::second_m(truth, a, b), second_sd_m))).collect();
        Self { pairs, first, second }
    }

    /// Distances over p0 and all patches, missing ones by shortest paths, and weights.
    pub fn distances(&self) -> (Mat<f64>, Mat<f64>) {
        let size = self.first.len() + 1;
        let (mut distances, mut weights) = (Mat::full(size, size, f64::NAN), Mat::zeros(size, size));
        let mut set = |i: usize, j: usize, distance_m: f64, weight: f64| {
            (distances[(i, j)], distances[(j, i)]) = (distance_m, distance_m);
            (weights[(i, j)], weights[(j, i)]) = (weight, weight);
        };
        // The range of a patch is half its first bounce, with half the error that a pair's distance has.
        (0..size - 1).for_each(|i| set(0, i + 1, 0.5 * self.first[i].length_m, 4.0));
        for (a, b, length) in &self.second {
            let across = length.length_m - 0.5 * (self.first[*a].length_m + self.first[*b].length_m);
            set(a + 1, b + 1, across.max(0.0), 1.0);
        }
        let distance = |i: usize, j: usize| Some(distances[(i, j)]).filter(|distance: &f64| !distance.is_nan());
        (completion::complete(size, distance, &Cancel::never()).expect("all patches have a range"), weights)
    }

    pub fn problem(&self, start: Vec<Point>, delay_sd_m: f64) -> Problem {
        let origin = Node::Station(0);
        let observation = |patches: &[usize], length: &Length| {
            Observation::new(
                std::iter::once(origin).chain(patches.iter().map(|&p| Node::Patch(p))).chain([origin]).collect(),
                length.length_m,
                length.variance_m2.sqrt(),
            )
        };
        let first = self.first.iter().enumerate().map(|(i, length)| observation(&[i], length));
        let second = self.second.iter().map(|(a, b, length)| observation(&[*a, *b], length));
        let problem = Problem::new(start, 3, &[Point::origin()], first.chain(second).collect());
        if delay_sd_m > 0.0 { problem.with_common_delay(delay_sd_m) } else { problem }
    }

    /// Positions from nothing, and others that the lengths do not tell from them.
    pub fn placed(&self) -> (Vec<Point>, Vec<Alternative>) {
        let problem = self.problem(vec![Point::origin(); self.first.len()], 0.0);
        let points = placement::place(&problem).points;
        let alternatives = placement::alternatives(&problem, &points, &[]);
        (points, alternatives)
    }
}

pub fn rms_m(points: &[Point], truth: &[Point]) -> f64 {
    procrustes::rotation(points, truth, Point::origin(), true).rms_m
}
