//! What is measured and what is known beforehand.

use faer::Mat;
use nalgebra::Vector3;
use periscope_cancel::Cancel;

use crate::Point;
use crate::loss::Loss;

/// A point of a path, by its position among the stations or the patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Node {
    /// A station.
    Station(usize),
    /// A patch.
    Patch(usize),
}

impl Node {
    /// The patch, if it is one.
    pub(super) fn patch(&self) -> Option<usize> {
        match *self {
            Self::Patch(patch) => Some(patch),
            Self::Station(_) => None,
        }
    }
}

/// A measured path length.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Source, patches in the order light meets them, sensor.
    pub nodes: Vec<Node>,
    /// Measured length, laser periods added at their nominal length.
    pub length_m: f64,
    /// Its standard deviation, with all errors but the common ones.
    pub sd_m: f64,
    /// Delay that adds to it, by its position.
    pub delay: Option<usize>,
    /// Laser periods that were added.
    pub turns: i32,
    /// Errors that it has in common with others, by their numbers: what one standard deviation of each adds, m.
    pub common: Vec<(usize, f64)>,
    /// The part of `sd_m` that it shares with others, by the numbers of independent errors: what one standard deviation
    /// of each adds, m. Two observations have the sum of the products of their shares as covariance
    /// ([`super::shares`]). Unlike common errors these are no unknowns.
    pub shared: Vec<(usize, f64)>,
}

impl Observation {
    /// Without a delay and laser periods, and with an error that no other has.
    #[must_use]
    pub fn new(nodes: Vec<Node>, length_m: f64, sd_m: f64) -> Self {
        Self { nodes, length_m, sd_m, delay: None, turns: 0, common: Vec::new(), shared: Vec::new() }
    }

    /// What common errors add to it, these in standard deviations; those that are missing are 0.
    #[must_use]
    pub fn common_m(&self, errors: &[f64]) -> f64 {
        let value = |error: usize| errors.get(error).copied().unwrap_or_default();
        self.common.iter().map(|(error, each_m)| value(*error) * each_m).sum()
    }
}

/// Where light leaves or arrives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Where it is, as far as is known beforehand.
    pub position: Point,
    /// Standard deviation of each coordinate; 0: exact.
    pub sd_m: f64,
}

/// A patch whose position is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Patch, by its position among the unknowns.
    pub patch: usize,
    /// Where it is.
    pub position: Point,
    /// Standard deviation of each coordinate.
    pub sd_m: f64,
}

/// A patch whose direction is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Patch, by its position among the unknowns.
    pub patch: usize,
    /// Station where the ray begins.
    pub from: usize,
    /// Unit vector.
    pub direction: Vector3<f64>,
    /// Standard deviation of each of its angles.
    pub sd_rad: f64,
}

/// What is to be solved.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Where each patch is searched from.
    pub start: Vec<Point>,
    /// 3, or 2 for flatland, where z stays.
    pub dimensions: usize,
    /// Stations.
    pub stations: Vec<Station>,
    /// Measurements.
    pub observations: Vec<Observation>,
    /// Patches of known position.
    pub anchors: Vec<Anchor>,
    /// Patches of known direction.
    pub rays: Vec<Ray>,
    /// Prior covariance of the delays, as lengths; their means are 0.
    pub delay_covariance_m2: Mat<f64>,
    /// Prior standard deviation of the laser's period, as a length; 0: exact.
    pub period_sd_m: f64,
    /// Loss of the observations' residuals; priors always cost their squares.
    pub loss: Loss,
    /// Ends the solution: polled once a step, once a direction of conjugate gradients, and once a chunk of rows.
    pub cancel: Cancel,
}

impl Problem {
    /// Without priors: exact stations, no delays.
    #[must_use]
    pub fn new(start: Vec<Point>, dimensions: usize, stations: &[Point], observations: Vec<Observation>) -> Self {
        Self {
            start,
            dimensions,
            stations: stations.iter().map(|&position| Station { position, sd_m: 0.0 }).collect(),
            observations,
            anchors: Vec::new(),
            rays: Vec::new(),
            delay_covariance_m2: Mat::zeros(0, 0),
            period_sd_m: 0.0,
            loss: Loss::Huber,
            cancel: Cancel::never(),
        }
    }

    /// The same with one delay, known to a standard deviation, that adds to all lengths.
    #[must_use]
    pub fn with_common_delay(mut self, sd_m: f64) -> Self {
        self.delay_covariance_m2 = Mat::from_fn(1, 1, |_, _| sd_m * sd_m);
        self.observations.iter_mut().for_each(|observation| observation.delay = Some(0));
        self
    }

    /// Number of common errors.
    pub(super) fn common(&self) -> usize {
        let errors = self.observations.iter().flat_map(|observation| &observation.common);
        errors.map(|(error, _)| error + 1).max().unwrap_or(0)
    }

    /// Number of delays.
    #[must_use]
    pub fn delays(&self) -> usize {
        self.delay_covariance_m2.nrows()
    }

    pub(super) fn check(&self) {
        assert!(self.dimensions == 2 || self.dimensions == 3, "space has 2 or 3 dimensions");
        let is_there = |node: &Node| match node {
            Node::Station(station) => *station < self.stations.len(),
            Node::Patch(patch) => *patch < self.start.len(),
        };
        for observation in &self.observations {
            assert!(
                observation.nodes.len() >= 2 && observation.sd_m > 0.0,
                "a path has two ends and a standard deviation"
            );
            assert!(observation.nodes.iter().all(is_there), "stations and patches of a path are there");
            let shared_m2: f64 = observation.shared.iter().map(|(_, each_m)| each_m * each_m).sum();
            assert!(shared_m2 < observation.sd_m.powi(2), "an observation has errors of its own");
            assert!(observation.delay.is_none_or(|delay| delay < self.delays()), "a delay has a prior");
        }
        let priors = self.anchors.iter().map(|anchor| anchor.sd_m).chain(self.rays.iter().map(|ray| ray.sd_rad));
        assert!(priors.into_iter().all(|sd| sd > 0.0), "what is known beforehand has a standard deviation");
    }
}
