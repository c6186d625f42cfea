//! The objective as a list of squared terms, each with its gradient.

use std::ops::Range;

use faer::Mat;
use nalgebra::Vector3;

use super::problem::{Node, Observation, Problem};
use super::shares::Whitener;
use crate::loss::Loss;
use crate::{Point, dense};

/// Positions of the unknowns in a vector: coordinates of the patches, of the stations that are not exact, delays, the
/// laser's period, common errors.
#[derive(Clone, Debug)]
pub struct Layout {
    pub dimensions: usize,
    /// Coordinates of the patches.
    pub coordinates: usize,
    /// First coordinate of each station that is not exact.
    pub stations: Vec<Option<usize>>,
    /// First delay.
    pub delays: usize,
    pub period: Option<usize>,
    /// First common error.
    pub common: usize,
    /// Number of unknowns.
    pub size: usize,
}

impl Layout {
    fn new(problem: &Problem) -> Self {
        let dimensions = problem.dimensions;
        let coordinates = problem.start.len() * dimensions;
        let mut next = coordinates;
        let mut take = |is_unknown: bool| {
            is_unknown.then(|| {
                next += dimensions;
                next - dimensions
            })
        };
        let stations = problem.stations.iter().map(|station| take(station.sd_m > 0.0)).collect();
        let delays = next;
        let end = delays + problem.delays();
        let has_period = problem.period_sd_m > 0.0 && problem.observations.iter().any(|o| o.turns != 0);
        let period = has_period.then_some(end);
        let common = end + usize::from(has_period);
        Self { dimensions, coordinates, stations, delays, period, common, size: common + problem.common() }
    }

    /// Coordinates of a patch.
    pub fn patch(&self, patch: usize) -> Range<usize> {
        patch * self.dimensions..(patch + 1) * self.dimensions
    }
}

/// Values of all unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// Positions of the patches.
    pub points: Vec<Point>,
    /// Positions of the stations.
    pub stations: Vec<Point>,
    /// Delays, as lengths.
    pub delays_m: Vec<f64>,
    /// What one laser period is longer than its nominal length.
    pub period_m: f64,
    /// Common errors, in their standard deviations.
    pub common: Vec<f64>,
}

impl Values {
    pub(super) fn start(problem: &Problem) -> Self {
        Self {
            points: problem.start.clone(),
            stations: problem.stations.iter().map(|station| station.position).collect(),
            delays_m: vec![0.0; problem.delays()],
            period_m: 0.0,
            common: vec![0.0; problem.common()],
        }
    }

    fn position(&self, node: Node) -> Point {
        match node {
            Node::Station(station) => self.stations[station],
            Node::Patch(patch) => self.points[patch],
        }
    }

    /// Measured less predicted length.
    pub(super) fn residual_m(&self, observation: &Observation) -> f64 {
        let legs = observation.nodes.windows(2);
        let path_m: f64 = legs.map(|ends| (self.position(ends[1]) - self.position(ends[0])).norm()).sum();
        let delay_m = observation.delay.map_or(0.0, |delay| self.delays_m[delay]);
        // An error that no other observation has is none that a solution knows.
        let common_m = observation.common_m(&self.common);
        observation.length_m - path_m - delay_m - common_m + f64::from(observation.turns) * self.period_m
    }

    pub(super) fn moved(&self, step: &[f64], layout: &Layout) -> Self {
        let mut values = self.clone();
        let shift = |point: &mut Point, at: usize| (0..layout.dimensions).for_each(|k| point[k] += step[at + k]);
        values.points.iter_mut().enumerate().for_each(|(patch, point)| shift(point, patch * layout.dimensions));
        let stations = values.stations.iter_mut().zip(&layout.stations);
        stations.for_each(|(point, at)| at.iter().for_each(|at| shift(point, *at)));
        values.delays_m.iter_mut().zip(&step[layout.delays..]).for_each(|(delay, step)| *delay += step);
        values.period_m += layout.period.map_or(0.0, |at| step[at]);
        values.common.iter_mut().zip(&step[layout.common..]).for_each(|(error, step)| *error += step);
        values
    }
}

/// Derivatives of a residual: unknown, value; an unknown may come twice.
pub type Terms = Vec<(usize, f64)>;

/// The squared terms: observations, then priors of anchors, rays, stations, delays, period and common errors. All in
/// standard deviations.
pub struct Rows<'a> {
    pub problem: &'a Problem,
    pub layout: Layout,
    /// Takes delays to independent numbers of variance 1.
    whitener: Mat<f64>,
    /// The same for residuals of observations.
    observations: Whitener,
    /// Number of terms.
    pub count: usize,
    /// Measurements and priors, the length of a direction not counted.
    pub data: usize,
}

impl<'a> Rows<'a> {
    /// # Panics
    /// When the problem contradicts itself, or the prior covariance of the delays is not positive definite.
    pub fn new(problem: &'a Problem) -> Self {
        problem.check();
        let layout = Layout::new(problem);
        let delays = problem.delays();
        let mut whitener = Mat::identity(delays, delays);
        if delays > 0 {
            dense::Definite::new(&problem.delay_covariance_m2)
                .expect("the prior covariance of the delays is positive definite")
                .whiten(&mut whitener);
        }
        let vectors = problem.anchors.len() + problem.rays.len() + layout.stations.iter().flatten().count();
        let scalars = problem.observations.len() + delays + usize::from(layout.period.is_some()) + problem.common();
        let count = scalars + layout.dimensions * vectors;
        let observations = Whitener::new(&problem.observations);
        Self { problem, whitener, observations, count, data: count - problem.rays.len(), layout }
    }

    /// Residual of an observation: measured less predicted length.
    pub fn residual_m(&self, values: &Values, n: usize) -> f64 {
        values.residual_m(&self.problem.observations[n])
    }

    /// Passes on the observations whose residuals, each times a factor, make that of an observation.
    pub fn for_parts(&self, n: usize, mut take: impl FnMut(usize, f64)) {
        match self.observations.terms(n) {
            Some(parts) => parts.iter().for_each(|(part, factor)| take(*part, *factor)),
            None => take(n, 1.0 / self.problem.observations[n].sd_m),
        }
    }

    /// Sum of the losses of some terms.
    pub fn cost(&self, values: &Values, which: Range<usize>) -> f64 {
        which.map(|n| self.loss(n, self.residual(values, n, None)).0).sum()
    }

    /// Loss of a term (a prior's is its square), and the weight of its square.
    pub fn loss(&self, n: usize, residual: f64) -> (f64, f64) {
        let is_observation = n < self.problem.observations.len();
        if is_observation { self.problem.loss.of(residual) } else { Loss::Squared.of(residual) }
    }

    /// A term's residual, and where asked for the derivatives of what is predicted there.
    pub fn residual(&self, values: &Values, n: usize, mut terms: Option<&mut Terms>) -> f64 {
        if let Some(terms) = &mut terms {
            terms.clear();
        }
        let Problem { observations, anchors, rays, .. } = self.problem;
        let dimensions = self.layout.dimensions;
        let Some(n) = n.checked_sub(observations.len()) else {
            let Some(parts) = self.observations.terms(n) else {
                let sd_m = observations[n].sd_m;
                if let Some(terms) = terms {
                    self.path(values, n, 1.0 / sd_m, terms);
                }
                return self.residual_m(values, n) / sd_m;
            };
            if let Some(terms) = terms {
                parts.iter().for_each(|(part, factor)| self.path(values, *part, *factor, terms));
                add_up(terms);
            }
            return parts.iter().map(|(part, factor)| factor * self.residual_m(values, *part)).sum();
        };
        let Some(n) = n.checked_sub(anchors.len() * dimensions) else {
            let (anchor, k) = (&anchors[n / dimensions], n % dimensions);
            push(terms, self.layout.patch(anchor.patch).start + k, 1.0 / anchor.sd_m);
            return (anchor.position[k] - values.points[anchor.patch][k]) / anchor.sd_m;
        };
        let Some(n) = n.checked_sub(rays.len() * dimensions) else {
            return self.direction(values, n / dimensions, n % dimensions, terms);
        };
        let uncertain = || self.layout.stations.iter().enumerate().filter_map(|(station, at)| Some((station, (*at)?)));
        let Some(n) = n.checked_sub(uncertain().count() * dimensions) else {
            let (station, at) = uncertain().nth(n / dimensions).expect("counted");
            let (prior, k) = (&self.problem.stations[station], n % dimensions);
            push(terms, at + k, 1.0 / prior.sd_m);
            return (prior.position[k] - values.stations[station][k]) / prior.sd_m;
        };
        if n < values.delays_m.len() {
            if let Some(terms) = terms {
                terms.extend((0..=n).map(|k| (self.layout.delays + k, self.whitener[(n, k)])));
            }
            return -(0..=n).map(|k| self.whitener[(n, k)] * values.delays_m[k]).sum::<f64>();
        }
        let n = n - values.delays_m.len();
        let Some(n) = n.checked_sub(usize::from(self.layout.period.is_some())) else {
            push(terms, self.layout.period.expect("its prior is a term"), 1.0 / self.problem.period_sd_m);
            return -values.period_m / self.problem.period_sd_m;
        };
        push(terms, self.layout.common + n, 1.0);
        -values.common[n]
    }

    /// Adds the derivatives of an observation's length, times a factor.
    pub fn path(&self, values: &Values, n: usize, scale: f64, terms: &mut Terms) {
        let (observation, layout) = (&self.problem.observations[n], &self.layout);
        for ends in observation.nodes.windows(2) {
            let arm = values.position(ends[1]) - values.position(ends[0]);
            // Ends that coincide pull nowhere.
            let direction = arm.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros) * scale;
            for (node, sign) in [(ends[0], -1.0), (ends[1], 1.0)] {
                if let Some(at) = self.at(node) {
                    terms.extend((0..layout.dimensions).map(|k| (at + k, sign * direction[k])));
                }
            }
        }
        terms.extend(observation.delay.map(|delay| (layout.delays + delay, scale)));
        if observation.turns != 0 {
            terms.extend(layout.period.map(|at| (at, -scale * f64::from(observation.turns))));
        }
        terms.extend(observation.common.iter().map(|(error, each_m)| (layout.common + error, scale * each_m)));
    }

    /// Adds what the bending of a path contributes to the product of the objective's second derivatives with a vector.
    /// The term has a residual, and its square a weight. A leg from a to b along u adds
    /// `-weight residual factor B (v_b - v_a)` at b and its negative at a, with `B = (I - u u') / length`.
    pub fn bend(&self, values: &Values, n: usize, (residual, weight): (f64, f64), vector: &[f64], sum: &mut [f64]) {
        if n < self.problem.observations.len() {
            self.for_parts(n, |part, factor| {
                self.bend_path(values, part, -weight * residual * factor, vector, sum);
            });
        }
    }

    fn bend_path(&self, values: &Values, n: usize, scale: f64, vector: &[f64], sum: &mut [f64]) {
        let observation = &self.problem.observations[n];
        let of = |node: Node| {
            let at = self.at(node);
            Vector3::from_fn(|k, _| at.filter(|_| k < self.layout.dimensions).map_or(0.0, |at| vector[at + k]))
        };
        for ends in observation.nodes.windows(2) {
            let arm = values.position(ends[1]) - values.position(ends[0]);
            let length_m = arm.norm();
            if length_m == 0.0 {
                continue;
            }
            let along = arm / length_m;
            let apart = of(ends[1]) - of(ends[0]);
            let across = (apart - along * along.dot(&apart)) * (scale / length_m);
            for (node, sign) in [(ends[0], -1.0), (ends[1], 1.0)] {
                if let Some(at) = self.at(node) {
                    (0..self.layout.dimensions).for_each(|k| sum[at + k] += sign * across[k]);
                }
            }
        }
    }

    /// First coordinate of a node that is not exact.
    fn at(&self, node: Node) -> Option<usize> {
        match node {
            Node::Station(station) => self.layout.stations[station],
            Node::Patch(patch) => Some(self.layout.patch(patch).start),
        }
    }

    /// Component k of a ray less the direction in which its patch lies. Unlike two angles this also knows which way the
    /// ray goes.
    fn direction(&self, values: &Values, ray: usize, k: usize, terms: Option<&mut Terms>) -> f64 {
        let ray = &self.problem.rays[ray];
        let (patch, station) = (Node::Patch(ray.patch), Node::Station(ray.from));
        let arm = values.position(patch) - values.position(station);
        let range_m = arm.norm().max(f64::MIN_POSITIVE);
        let along = arm / range_m;
        if let Some(terms) = terms {
            for (at, sign) in [(self.at(patch), 1.0), (self.at(station), -1.0)] {
                let slope = |i: usize| (f64::from(u8::from(i == k)) - along[i] * along[k]) / (range_m * ray.sd_rad);
                terms.extend(
                    at.iter().flat_map(|at| (0..self.layout.dimensions).map(move |i| (at + i, sign * slope(i)))),
                );
            }
        }
        (ray.direction[k] - along[k]) / ray.sd_rad
    }
}

/// Makes one of all derivatives by the same unknown: paths of one profile have their ends in common.
fn add_up(terms: &mut Terms) {
    terms.sort_by_key(|(unknown, _)| *unknown);
    terms.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        if is_same {
            kept.1 += next.1;
        }
        is_same
    });
}

fn push(terms: Option<&mut Terms>, at: usize, value: f64) {
    terms.into_iter().for_each(|terms| terms.push((at, value)));
}
