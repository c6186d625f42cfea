//! Positions from path lengths alone, from nothing: a start for [`maximum_likelihood`], and which other positions would
//! explain the lengths.
//!
//! A descent from one start ends in a wrong minimum where many paths are missing, or where source and sensors are
//! apart: a patch lies mirrored in the plane of its neighbours, a group is folded over, the whole is turned about the
//! stations. Hence, until the lengths are explained as well as their noise lets expect, or several starts agree:
//!
//! 1. a start (`starts`): all stations taken for one point, shortest paths and classical scaling, with or without
//!    SMACOF; or a few patches that many paths
//!    tie together, brought down from many random places;
//! 2. growth (`growth`): the other patches, one by one, by multilateration from patches and stations in place;
//! 3. orientation (`orientation`): stations are found from the patches, and the whole is turned so that they come to
//!    lie where they are;
//! 4. maximum likelihood of all from there, with Huber's loss;
//! 5. moves (`repair`): each patch is multilaterated again; a place other than its own is taken where the loss of all,
//!    settled again, falls. Patches that fit worst are taken out and grown again.
//!
//! The lowest loss wins. [`alternatives`] lists the choices that no loss decides: a patch at its second place, groups
//! that fold over (`folds`), groups that fit another way (`restarts`). A patch with too few paths stays
//! somewhere on its sphere or circle.
//!
//! Systems are dense: meant for some hundreds of patches. Not found: a second part (patches that share no path with the
//! first) without first bounces. A path that meets a patch twice does not help to place it, but counts where all are
//! settled.

mod alternatives;
mod folds;
mod growth;
mod orientation;
mod repair;
mod restarts;
mod starts;

use std::collections::BTreeMap;

use super::Point;
use super::loss::Loss;
use super::maximum_likelihood::{self, Node, Observation, Problem};
use super::multilateration::Tie;
pub use alternatives::{Alternative, Kind, alternatives};
use orientation::Frame;

/// Losses more than this many standard deviations above their mean are not those of a right solution.
const UNLIKELY: f64 = 3.0;
/// As many starts that end at the lowest loss are enough, however high it is.
const AGREED: usize = 5;
/// Losses that differ by less are the same.
const SAME: f64 = 1e-3;
/// Steps of a descent.
const STEPS: usize = 40;
/// A descent has settled when no coordinate moves further.
const SETTLED_M: f64 = 1e-6;
/// Places of one patch this many standard deviations of a length apart are not the same.
const APART: f64 = 4.0;

/// Where the patches are.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// Positions; what stations, anchors and rays leave free of frame and mirror image is arbitrary.
    pub points: Vec<Point>,
    /// Loss of all lengths, with the squares of the priors; the redescending one where that explained more.
    pub loss: f64,
    /// Lengths and priors less unknowns, free rotations given back.
    pub degrees_of_freedom: i64,
    /// Starts that were tried.
    pub starts: usize,
}

/// Places all patches; the problem's `start` is not used. Where its lengths contradict one another under Huber's loss,
/// places under the redescending loss, which bears many wrong lengths, are tried too. The better explanation is taken.
///
/// # Panics
/// Without patches or observations, and as [`maximum_likelihood::solve`].
#[must_use]
pub fn place(problem: &Problem) -> Placed {
    let placed = placed(problem);
    if problem.loss != Loss::Huber || placed.loss < likely_loss(placed.degrees_of_freedom.max(1) as f64) {
        return placed;
    }
    let redescending = Problem { loss: Loss::Redescending, ..problem.clone() };
    let other = self::placed(&redescending);
    let start = Problem { start: placed.points.clone(), ..redescending };
    let (_, loss) = maximum_likelihood::approach(&start, STEPS, SETTLED_M);
    if other.loss < loss { other } else { placed }
}

/// The place with the lowest loss of many starts.
fn placed(problem: &Problem) -> Placed {
    let measurements = Measurements::new(problem);
    let mut best: Option<State> = None;
    let (mut starts, mut agreed) = (0, 0);
    for start in measurements.starts() {
        starts += 1;
        let end = measurements.repair(measurements.settle_turned(start));
        let is_likely = end.loss < end.likely_loss;
        let ahead = best.as_ref().map_or(f64::INFINITY, |best| best.loss - end.loss);
        if ahead > SAME {
            agreed = 0;
        }
        agreed += usize::from(ahead > -SAME);
        if ahead > 0.0 {
            best = Some(end);
        }
        if is_likely || agreed >= AGREED {
            break;
        }
    }
    let mut best = best.expect("there is a start");
    if let Some(mirrored) = measurements.mirrored(&best).filter(|mirrored| mirrored.loss < best.loss - SAME) {
        best = measurements.repair(mirrored);
    }
    let degrees_of_freedom = maximum_likelihood::redundancy(problem) + measurements.frame.free_rotations();
    Placed { points: best.points(), loss: best.loss, degrees_of_freedom, starts }
}

/// The patches that have a place, all settled together.
#[derive(Clone, Debug)]
struct State {
    places: Vec<Option<Point>>,
    stations: Vec<Point>,
    delays_m: Vec<f64>,
    period_m: f64,
    loss: f64,
    /// The loss that a right solution stays below.
    likely_loss: f64,
}

impl State {
    fn points(&self) -> Vec<Point> {
        self.places.iter().map(|place| place.expect("all patches have a place")).collect()
    }

    fn position(&self, node: Node) -> Option<Point> {
        match node {
            Node::Station(station) => Some(self.stations[station]),
            Node::Patch(patch) => self.places[patch],
        }
    }
}

/// What was measured, by patch.
struct Measurements<'a> {
    problem: &'a Problem,
    /// Observations of each patch.
    of_patch: Vec<Vec<usize>>,
    /// First bounce of each patch, the median of all its measurements; and the second bounce of each pair.
    first_m: Vec<Option<f64>>,
    second_m: BTreeMap<(usize, usize), f64>,
    frame: Frame,
    apart_m: f64,
    /// Patches whose place says nothing, since nothing determines it.
    open: Vec<usize>,
}

impl<'a> Measurements<'a> {
    fn new(problem: &'a Problem) -> Self {
        let count = problem.start.len();
        assert!(count > 0 && !problem.observations.is_empty(), "there are patches and observations");
        let mut of_patch = vec![Vec::new(); count];
        let mut firsts = vec![Vec::new(); count];
        let mut seconds: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
        for (n, observation) in problem.observations.iter().enumerate() {
            let mut patches: Vec<usize> = patches(observation).collect();
            match patches[..] {
                [a] => firsts[a].push(observation.length_m),
                [a, b] => seconds.entry((a.min(b), a.max(b))).or_default().push(observation.length_m),
                _ => {}
            }
            patches.sort_unstable();
            patches.dedup();
            patches.into_iter().for_each(|patch| of_patch[patch].push(n));
        }
        let sds_m = problem.observations.iter().map(|observation| observation.sd_m).collect();
        let first_m: Vec<Option<f64>> = firsts.into_iter().map(median).collect();
        let second_m = seconds.into_iter().filter_map(|(pair, lengths_m)| Some((pair, median(lengths_m)?))).collect();
        let apart_m = APART * median(sds_m).expect("there are observations");
        Self { problem, of_patch, first_m, second_m, frame: Frame::new(problem), apart_m, open: Vec::new() }
    }

    fn count(&self) -> usize {
        self.of_patch.len()
    }

    /// About how far a patch with a first bounce is from the stations.
    fn range_m(&self, patch: usize) -> Option<f64> {
        self.first_m[patch].map(|length_m| 0.5 * length_m)
    }

    /// About how far two patches with first bounces and a second one are from each other.
    fn across_m(&self, a: usize, b: usize) -> Option<f64> {
        let length_m = self.second_m.get(&(a.min(b), a.max(b)))?;
        Some((length_m - self.range_m(a)? - self.range_m(b)?).max(0.0))
    }

    /// What ties a patch to stations and to patches that have a place.
    fn ties(&self, patch: usize, state: &State) -> Vec<Tie> {
        let mut ties: Vec<Tie> =
            self.of_patch[patch].iter().filter_map(|&n| path(&self.problem.observations[n], patch, state)).collect();
        let anchors = self.problem.anchors.iter().filter(|anchor| anchor.patch == patch);
        ties.extend(anchors.map(|anchor| Tie::Anchor { position: anchor.position, sd_m: anchor.sd_m }));
        let rays = self.problem.rays.iter().filter(|ray| ray.patch == patch);
        ties.extend(rays.map(|ray| Tie::Ray {
            from: state.stations[ray.from],
            direction: ray.direction,
            sd_rad: ray.sd_rad,
        }));
        ties
    }

    /// No patch in place.
    fn nothing(&self) -> State {
        self.settle(vec![None; self.count()], 0)
    }

    /// Maximum likelihood of the patches that have a place, from there.
    fn settle(&self, mut places: Vec<Option<Point>>, steps: usize) -> State {
        let mut start = Vec::new();
        let at: Vec<usize> = places.iter().map(|place| (start.len(), start.extend(*place)).0).collect();
        let has = |patch: usize| places[patch].is_some();
        let mut problem = Problem { start, observations: Vec::new(), ..self.problem_without_observations() };
        let all_placed = |observation: &&Observation| patches(observation).all(has);
        let observations = self.problem.observations.iter().filter(all_placed);
        problem.observations = observations.map(|observation| renumbered(observation, &at)).collect();
        problem.anchors.retain(|anchor| has(anchor.patch));
        problem.anchors.iter_mut().for_each(|anchor| anchor.patch = at[anchor.patch]);
        problem.rays.retain(|ray| has(ray.patch));
        problem.rays.iter_mut().for_each(|ray| ray.patch = at[ray.patch]);
        let freedom = maximum_likelihood::redundancy(&problem) + self.frame.free_rotations();
        let (values, loss) = maximum_likelihood::approach(&problem, steps, SETTLED_M);
        places.iter_mut().filter(|place| place.is_some()).zip(values.points).for_each(|(to, point)| *to = Some(point));
        let likely_loss = likely_loss(freedom.max(1) as f64);
        let (stations, delays_m, period_m) = (values.stations, values.delays_m, values.period_m);
        State { places, stations, delays_m, period_m, loss, likely_loss }
    }

    fn problem_without_observations(&self) -> Problem {
        let Problem { dimensions, stations, anchors, rays, delay_covariance_m2, period_sd_m, loss, cancel, .. } =
            self.problem;
        Problem {
            start: Vec::new(),
            dimensions: *dimensions,
            stations: stations.clone(),
            observations: Vec::new(),
            anchors: anchors.clone(),
            rays: rays.clone(),
            delay_covariance_m2: delay_covariance_m2.clone(),
            period_sd_m: *period_sd_m,
            loss: *loss,
            cancel: cancel.clone(),
        }
    }
}

/// The loss that a right solution with `freedom` degrees of freedom stays below.
fn likely_loss(freedom: f64) -> f64 {
    freedom + UNLIKELY * (2.0 * freedom).sqrt()
}

/// The observation with patch `n` at `positions[n]`.
fn renumbered(observation: &Observation, positions: &[usize]) -> Observation {
    let node = |node: &Node| match *node {
        Node::Patch(patch) => Node::Patch(positions[patch]),
        Node::Station(station) => Node::Station(station),
    };
    Observation { nodes: observation.nodes.iter().map(node).collect(), ..observation.clone() }
}

fn patches(observation: &Observation) -> impl Iterator<Item = usize> {
    observation.nodes.iter().filter_map(|node| match node {
        Node::Patch(patch) => Some(*patch),
        Node::Station(_) => None,
    })
}

/// The tie of a patch by a path that meets it once, and otherwise only points in place.
fn path(observation: &Observation, patch: usize, state: &State) -> Option<Tie> {
    let Observation { nodes, length_m, sd_m, delay, turns, .. } = observation;
    let mut met = (1..nodes.len() - 1).filter(|&k| nodes[k] == Node::Patch(patch));
    let (Some(here), None) = (met.next(), met.next()) else { return None };
    let mut rest_m = length_m - delay.map_or(0.0, |delay| state.delays_m[delay]) + f64::from(*turns) * state.period_m;
    for k in (0..nodes.len() - 1).filter(|&k| k != here && k + 1 != here) {
        rest_m -= (state.position(nodes[k + 1])? - state.position(nodes[k])?).norm();
    }
    let (from, to) = (state.position(nodes[here - 1])?, state.position(nodes[here + 1])?);
    Some(Tie::Path { from, to, length_m: rest_m, sd_m: *sd_m })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.len() {
        0 => None,
        n if n % 2 == 1 => Some(values[half]),
        _ => Some(0.5 * (values[half - 1] + values[half])),
    }
}

#[cfg(test)]
mod tests;
