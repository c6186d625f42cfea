//! Points as small things that send light back, and the law that their light follows over the wall.

use nalgebra::Vector3;

use super::Histogram;
use super::pulse::{Pulse, SHAPES};
use crate::Point;

/// Unknowns of a point: three coordinates, the logarithm of its photons, and how that grows along both directions of
/// the wall.
pub const OF_POINT: usize = 6;
/// Standard deviation of this growth over half the wall's width: points differ in tilt and shape.
const SLOPE_SD: f64 = 0.3;
/// Terms of the law over the wall.
pub const TERMS: usize = 5;
/// Place of the logarithm of the width among the shared unknowns.
pub const WIDTH: usize = 1 + TERMS;
/// Unknowns that all points share: power of the distance, terms over the wall, logarithm of the width, shape of the
/// response.
pub const SHARED: usize = WIDTH + 1 + SHAPES;
/// Mean and standard deviation of the shared unknowns up to the width before there is light. Diffuse points have a
/// power of -4 (two legs, each an inverse square), retroreflective ones about -2; with cosines more.
const PRIORS: [[f64; 2]; WIDTH + 1] =
    [[-4.0, 3.0], [0.0, 0.5], [0.0, 0.5], [0.0, 0.5], [0.0, 0.5], [0.0, 0.5], [0.0, 0.1]];
/// Shared unknowns further than this many standard deviations from their mean stand at the edge of the prior.
pub const EDGE: f64 = 3.0;

/// A point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dot {
    /// Position.
    pub place: Point,
    /// Logarithm of its photons in a histogram whose legs have a geometric mean of `reference_m`.
    pub log_photons: f64,
    /// Growth of this logarithm over half the wall's width, in both directions, beyond the law that all points share.
    pub slopes: [f64; 2],
    /// Scale of its distance.
    pub reference_m: f64,
}

/// Points and what they share.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The points.
    pub dots: Vec<Dot>,
    /// Power of the distance; terms of first and second order over the wall; logarithm of the width of a pulse over
    /// that of the response; shape of the response.
    pub shared: [f64; SHARED],
    /// Factor on the standard deviation of the common delay before there is light.
    pub unsure: f64,
    /// Standard deviation of a shift that all light of one histogram shares, as path length.
    pub wander_m: f64,
}

impl Default for Model {
    fn default() -> Self {
        let mut shared = [0.0; SHARED];
        shared.iter_mut().zip(PRIORS).for_each(|(value, [mean, _])| *value = mean);
        Self { dots: Vec::new(), shared, unsure: 1.0, wander_m: 0.0 }
    }
}

/// How the light of a point reaches a histogram.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    /// Path length from the lit point over the place to the seen point.
    pub length_m: f64,
    /// Gradient of the length over the place.
    pub gradient: Vector3<f64>,
    /// Logarithm of the photons.
    pub log_photons: f64,
    /// Its gradient over the place.
    pub log_gradient: Vector3<f64>,
    /// Its derivative by the power: the logarithm of the distance.
    pub log_distance: f64,
}

impl Way {
    /// The same where all light of the histogram is late by a length.
    pub fn later(self, late_m: f64) -> Self {
        Self { length_m: self.length_m + late_m, ..self }
    }
}

impl Model {
    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        OF_POINT * self.dots.len() + SHARED
    }

    /// Width of a pulse over that of the response.
    pub fn stretch(&self) -> f64 {
        self.shared[WIDTH].exp()
    }

    /// The light of a point in a histogram.
    pub fn way(&self, dot: &Dot, histogram: &Histogram) -> Way {
        let [out, back] = [dot.place - histogram.lit, dot.place - histogram.seen];
        let [out_m, back_m] = [out.norm(), back.norm()];
        let power = self.shared[0];
        let log_distance = 0.5 * (out_m * back_m / (dot.reference_m * dot.reference_m)).ln();
        let terms = terms(histogram);
        let bend: f64 = self.shared[1..WIDTH].iter().zip(terms).map(|(q, term)| q * term).sum();
        let [u, v, ..] = terms;
        Way {
            length_m: out_m + back_m,
            gradient: out / out_m + back / back_m,
            log_photons: dot.log_photons + power * log_distance + bend + dot.slopes[0] * u + dot.slopes[1] * v,
            log_gradient: (out / (out_m * out_m) + back / (back_m * back_m)) * (0.5 * power),
            log_distance,
        }
    }

    /// Shape of the response.
    pub fn shape(&self) -> [f64; SHAPES] {
        std::array::from_fn(|n| self.shared[WIDTH + 1 + n])
    }

    /// Mean and standard deviation of all shared unknowns before there is light.
    fn priors(&self, pulse: &Pulse) -> impl Iterator<Item = [f64; 2]> {
        let mut doubts = pulse.doubts;
        doubts[0] *= self.unsure;
        PRIORS.into_iter().chain(doubts.map(|sd| [0.0, sd]))
    }

    /// Common delay, in standard deviations before there is light.
    pub fn late(&self, pulse: &Pulse) -> f64 {
        self.shape()[0].abs() / (self.unsure * pulse.doubts[0])
    }

    /// Logarithm of the prior's density, with that of the response.
    pub fn log_prior(&self, pulse: &Pulse) -> f64 {
        let shared =
            self.shared.iter().zip(self.priors(pulse)).map(|(value, [mean, sd])| ((value - mean) / sd).powi(2));
        let slopes = self.dots.iter().flat_map(|dot| dot.slopes).map(|slope| (slope / SLOPE_SD).powi(2));
        -0.5 * shared.chain(slopes).sum::<f64>()
    }

    /// Gradient and precision of the prior for each unknown.
    pub fn prior(&self, pulse: &Pulse) -> Vec<[f64; 2]> {
        let normal = |value: f64, [mean, sd]: [f64; 2]| [(mean - value) / (sd * sd), 1.0 / (sd * sd)];
        let of_dot = |dot: &Dot| {
            let [first, second] = dot.slopes.map(|slope| normal(slope, [0.0, SLOPE_SD]));
            [[0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2], first, second]
        };
        let shared = self.shared.iter().zip(self.priors(pulse)).map(|(value, prior)| normal(*value, prior));
        self.dots.iter().flat_map(of_dot).chain(shared).collect()
    }

    /// Standard deviations of their priors by which the power, and a width of pulses so many times that of the
    /// response, lie off the mean.
    pub fn strain(&self, stretch: f64) -> [f64; 2] {
        let off = |value: f64, [mean, sd]: [f64; 2]| (value - mean).abs() / sd;
        [off(self.shared[0], PRIORS[0]), off(stretch.ln(), PRIORS[WIDTH])]
    }

    /// The model moved by a step in all unknowns.
    pub fn moved(&self, step: &[f64]) -> Self {
        let mut moved = self.clone();
        for (dot, step) in moved.dots.iter_mut().zip(step.chunks(OF_POINT)) {
            dot.place += Vector3::new(step[0], step[1], step[2]);
            dot.log_photons += step[3];
            (0..2).for_each(|axis| dot.slopes[axis] += step[4 + axis]);
        }
        moved.shared.iter_mut().zip(&step[OF_POINT * self.dots.len()..]).for_each(|(value, step)| *value += step);
        moved
    }
}

/// Terms of the law over the wall.
pub fn terms(histogram: &Histogram) -> [f64; TERMS] {
    let [lit, seen] = histogram.ends;
    let [u, v] = [0, 1].map(|axis| 0.5 * (lit[axis] + seen[axis]));
    [u, v, u * u, u * v, v * v]
}
