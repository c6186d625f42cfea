//! How the whole lies about stations, anchors and rays.
//!
//! Lengths determine a scene's shape much better than how it is turned about stations that are close together, and fit
//! its mirror image hardly worse. Stations are found from the patches as patches are from stations (resection); the
//! whole is then turned so that they come to lie where they are.

use nalgebra::{Matrix3, Vector3};

use super::{Measurements, SETTLED_M, STEPS, State};
use crate::maximum_likelihood::{self, Node, Observation, Problem, Values};
use crate::{Point, procrustes};

/// What spans less than this share of the longest path spans nothing.
const FLAT: f64 = 1e-5;
/// Of the longest path, how far out a ray's direction counts as a point.
const OUT: f64 = 0.25;

/// What fixes the frame: stations, anchors and rays.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Mean of the stations.
    pub centre: Point,
    /// Root of their mean squared distance from there.
    reach_m: f64,
    /// The longest path.
    pub longest_m: f64,
    /// Mean of all that fixes the frame, and the direction in which that is flattest.
    middle: Point,
    normal: Vector3<f64>,
    /// Dimensions that it spans.
    rank: usize,
    dimensions: usize,
}

impl Frame {
    pub fn new(problem: &Problem) -> Self {
        let Problem { observations, stations, anchors, rays, dimensions, .. } = problem;
        let longest_m = observations.iter().fold(0.0, |most: f64, observation| most.max(observation.length_m));
        let is_used = |station: usize| {
            let node = Node::Station(station);
            observations.iter().any(|observation| observation.nodes.contains(&node))
        };
        let used = (0..stations.len()).filter(|&station| is_used(station));
        let mut points: Vec<Point> = used.map(|station| stations[station].position).collect();
        let centre = mean(&points);
        let reach_m = (points.iter().map(|point| (point - centre).norm_squared()).sum::<f64>()
            / points.len().max(1) as f64)
            .sqrt();
        points.extend(anchors.iter().map(|anchor| anchor.position));
        points.extend(rays.iter().map(|ray| stations[ray.from].position + OUT * longest_m * ray.direction));
        let middle = mean(&points);
        let spread: Matrix3<f64> = points.iter().map(|point| (point - middle) * (point - middle).transpose()).sum();
        let axes = spread.symmetric_eigen();
        let spans = |k: &usize| axes.eigenvalues[*k] > (FLAT * longest_m).powi(2);
        let along_z = |k: usize| axes.eigenvectors[(2, k)].abs();
        // In flatland the axis across is out of play.
        let across = (*dimensions == 2).then(|| (0..3).max_by(|&a, &b| along_z(a).total_cmp(&along_z(b)))).flatten();
        let in_play = (0..3).filter(|&k| Some(k) != across);
        let flattest = in_play.min_by(|&a, &b| axes.eigenvalues[a].total_cmp(&axes.eigenvalues[b]));
        let normal = axes.eigenvectors.column(flattest.expect("space has two dimensions at least")).into_owned();
        Self { centre, reach_m, longest_m, middle, normal, rank: (0..3).filter(spans).count(), dimensions: *dimensions }
    }

    /// Rotations that are left free.
    pub fn free_rotations(&self) -> i64 {
        match (self.dimensions, self.rank) {
            (3, 0) => 3,
            (3, 1) | (2, 0) => 1,
            _ => 0,
        }
    }
}

fn mean(points: &[Point]) -> Point {
    Point::from(points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64)
}

impl Measurements<'_> {
    /// Settled from there, turned about the stations where that is better.
    pub(super) fn settle_turned(&self, start: State) -> State {
        if self.frame.rank == 0 {
            return self.settle(start.places, STEPS);
        }
        let turned = |state: &State| self.settle(self.turned(state), STEPS);
        let now = turned(&start);
        if now.loss < now.likely_loss {
            return now;
        }
        let then = turned(&now);
        if then.loss < now.loss { then } else { now }
    }

    /// All places, turned or mirrored about the stations so that stations, anchors and rays fit best.
    fn turned(&self, state: &State) -> Vec<Option<Point>> {
        let loose = self.loose(state);
        let (mut from, mut onto) = (loose.stations, state.stations.clone());
        for anchor in &self.problem.anchors {
            from.push(loose.points[anchor.patch]);
            onto.push(anchor.position);
        }
        for ray in &self.problem.rays {
            let (patch, station) = (loose.points[ray.patch], state.stations[ray.from]);
            from.push(patch);
            onto.push(station + (patch - station).norm() * ray.direction);
        }
        let fit = procrustes::rotation(&from, &onto, self.frame.centre, true);
        loose.points.iter().map(|point| Some(procrustes::turn(&fit.matrix, self.frame.centre, *point))).collect()
    }

    /// Patches and stations from the path lengths, the stations as free as the patches. Stations in place keep a whole
    /// that is turned wrongly from turning: the descent ends in a minimum that has the wrong way around and the wrong
    /// shape.
    fn loose(&self, state: &State) -> Values {
        let stations_m = self.resected(state);
        let observations = self.problem.observations.clone();
        let mut problem = self.paths(state.points(), &stations_m, observations);
        problem.stations.iter_mut().for_each(|station| station.sd_m = self.frame.reach_m);
        maximum_likelihood::approach(&problem, STEPS, SETTLED_M).0
    }

    /// Stations from the patches: the same paths, with known and unknown points exchanged.
    fn resected(&self, state: &State) -> Vec<Point> {
        let exchanged = |observation: &Observation| {
            let node = |node: &Node| match *node {
                Node::Station(station) => Node::Patch(station),
                Node::Patch(patch) => Node::Station(patch),
            };
            Observation { nodes: observation.nodes.iter().map(node).collect(), ..observation.clone() }
        };
        let observations = self.problem.observations.iter().map(exchanged).collect();
        let start = vec![self.frame.centre; self.problem.stations.len()];
        let problem = self.paths(start, &state.points(), observations);
        maximum_likelihood::approach(&problem, STEPS, SETTLED_M).0.points
    }

    /// A problem of paths alone, with the delays and the period of this one.
    fn paths(&self, start: Vec<Point>, stations: &[Point], observations: Vec<Observation>) -> Problem {
        Problem {
            delay_covariance_m2: self.problem.delay_covariance_m2.clone(),
            period_sd_m: self.problem.period_sd_m,
            cancel: self.problem.cancel.clone(),
            ..Problem::new(start, self.problem.dimensions, stations, observations)
        }
    }

    /// The mirror image of the whole in the plane (in flatland the line) that stations, anchors and rays nearly span,
    /// settled; `None` where they leave a rotation free, and with it the choice of the mirror image.
    pub(super) fn mirrored(&self, state: &State) -> Option<State> {
        let Frame { middle, normal, .. } = self.frame;
        let mirror = |point: Point| point - 2.0 * normal.dot(&(point - middle)) * normal;
        let mirrored = || state.places.iter().map(|place| place.map(mirror)).collect();
        (self.frame.free_rotations() == 0).then(|| self.settle(mirrored(), STEPS))
    }
}
