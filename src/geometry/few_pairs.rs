//! Positions from first bounces and few second ones: many starts, patches moved one by one out of wrong places, the likeliest kept.
//!
//! Where most pairs are missing, a descent from one start ends in a wrong minimum: a patch lies mirrored in the plane of its neighbours, or a group
//! is folded over. Hence, until the lengths are explained as well as their noise lets expect:
//!
//! 1. a start: shortest paths and classical scaling; the same and SMACOF; growth patch by patch from the triples of patches that span space best (`growth`);
//! 2. maximum likelihood of all from there ([`maximum_likelihood`], with Huber's loss);
//! 3. moves: each patch is multilaterated from its neighbours; a place other than its own (a mirror image among them) is taken where the loss of all
//!    patches, settled again, falls (`mending`).
//!
//! The lowest loss wins. What is left are ambiguities that no loss decides: a patch with two neighbours and its mirror image. They are named as twins.
//! A patch with fewer neighbours (in flatland, with none) stays somewhere on its sphere.
//!
//! Measured on 49 patches on three rectangles at onset noise of 25 ps (docs/geometry.md). Systems are dense: meant for some hundreds of patches. Not
//! modelled: delays (positions are a start for a fit that knows them), patches without first bounce.

mod growth;
mod mending;

use faer::Mat;

use super::maximum_likelihood::{self, Node, Observation, Problem};
use super::multilateration::Tie;
use super::t2::Length;
use super::{Point, classical, completion, smacof};

/// Most triples that are grown from.
const TRIPLES: usize = 12;
/// Losses more than this many standard deviations above their mean are not those of a right solution.
const UNLIKELY: f64 = 4.0;
/// Steps of a descent.
const STEPS: usize = 40;
/// A descent has settled when no coordinate moves further.
const SETTLED_M: f64 = 1e-6;
/// Places of one patch this many standard deviations of its lengths apart are not the same.
const APART: f64 = 4.0;

/// Measured path lengths; p0 is source and camera, at the origin.
#[derive(Clone, Copy, Debug)]
pub struct Lengths<'a> {
    /// First bounce of each patch.
    pub first: &'a [Length],
    /// Second bounces, by the positions of their patches in `first`.
    pub second: &'a [(usize, usize, Length)],
    /// 3, or 2 for flatland, where z = 0.
    pub dimensions: usize,
}

/// A second place of one patch that explains the lengths about as well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twin {
    /// The patch.
    pub patch: usize,
    /// Its other place, all other patches settled with it.
    pub point: Point,
    /// By how much the loss is higher.
    pub more: f64,
}

/// Where the patches are.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// Positions; the frame and the choice of mirror image of the whole are arbitrary.
    pub points: Vec<Point>,
    /// Huber's loss of all lengths.
    pub loss: f64,
    /// Lengths less unknowns, free rotations given back.
    pub degrees_of_freedom: i64,
    /// Starts that were tried.
    pub starts: usize,
    /// Places that the lengths do not tell from the chosen ones.
    pub twins: Vec<Twin>,
}

/// Places all patches.
///
/// # Panics
/// Without patches, when `dimensions` is neither 2 nor 3, a variance is not positive, or a pair names a patch without first bounce.
#[must_use]
pub fn place(lengths: &Lengths) -> Placed {
    let scene = Scene::new(lengths);
    let spectral = [false, true].into_iter().map(|smooth| scene.spectral(smooth));
    let grown = std::iter::once_with(|| scene.seeds()).flatten().take(TRIPLES).map(|seed| scene.grow(&seed));
    let mut best: Option<Settled> = None;
    let mut starts = 0;
    for start in spectral.chain(grown) {
        starts += 1;
        let end = scene.mend(scene.settle(start));
        let expected = end.loss < scene.likely_loss();
        if best.as_ref().is_none_or(|best| end.loss < best.loss) {
            best = Some(end);
        }
        if expected {
            break;
        }
    }
    let best = best.expect("there is a start");
    let twins = scene.twins(&best);
    Placed { points: best.points, loss: best.loss, degrees_of_freedom: scene.degrees_of_freedom(), starts, twins }
}

/// All patches at a minimum of the loss.
#[derive(Clone)]
struct Settled {
    points: Vec<Point>,
    loss: f64,
}

/// What was measured, by patch.
struct Scene<'a> {
    lengths: &'a Lengths<'a>,
    neighbours: Vec<Vec<(usize, Length)>>,
    apart_m: f64,
}

impl<'a> Scene<'a> {
    fn new(lengths: &'a Lengths<'a>) -> Self {
        assert!(lengths.dimensions == 2 || lengths.dimensions == 3, "space has 2 or 3 dimensions");
        let all = || lengths.first.iter().chain(lengths.second.iter().map(|(_, _, length)| length));
        assert!(!lengths.first.is_empty(), "there are patches");
        assert!(all().all(|length| length.variance_m2 > 0.0), "a length has a positive variance");
        let mut neighbours = vec![Vec::new(); lengths.first.len()];
        for (a, b, length) in lengths.second {
            neighbours[*a].push((*b, *length));
            neighbours[*b].push((*a, *length));
        }
        let mean = all().map(|length| length.variance_m2).sum::<f64>() / all().count() as f64;
        Self { lengths, neighbours, apart_m: APART * mean.sqrt() }
    }

    fn count(&self) -> usize {
        self.lengths.first.len()
    }

    fn range_m(&self, patch: usize) -> f64 {
        0.5 * self.lengths.first[patch].length_m
    }

    /// Lengths less unknowns; rotations about p0 are free.
    fn degrees_of_freedom(&self) -> i64 {
        let rotations = if self.lengths.dimensions == 3 { 3 } else { 1 };
        (self.count() + self.lengths.second.len() + rotations) as i64 - (self.count() * self.lengths.dimensions) as i64
    }

    /// The loss that a right solution stays below.
    fn likely_loss(&self) -> f64 {
        let freedom = self.degrees_of_freedom().max(1) as f64;
        freedom + UNLIKELY * (2.0 * freedom).sqrt()
    }

    /// Lengths of a patch to p0 and to those of its neighbours that have a place.
    fn ties(&self, patch: usize, place: impl Fn(usize) -> Option<Point>) -> Vec<Tie> {
        let tie = |over: Option<Point>, length: &Length| Tie {
            over,
            length_m: length.length_m,
            sd_m: length.variance_m2.sqrt(),
        };
        let over = |(other, length): &(usize, Length)| place(*other).map(|point| tie(Some(point), length));
        std::iter::once(tie(None, &self.lengths.first[patch]))
            .chain(self.neighbours[patch].iter().filter_map(over))
            .collect()
    }

    /// Maximum likelihood of all patches from a start.
    fn settle(&self, start: Vec<Point>) -> Settled {
        let mut places: Vec<Option<Point>> = start.into_iter().map(Some).collect();
        let loss = self.settle_placed(&mut places, STEPS);
        Settled { points: places.into_iter().flatten().collect(), loss }
    }

    /// The same of those patches that have a place.
    fn settle_placed(&self, places: &mut [Option<Point>], steps: usize) -> f64 {
        let mut start = Vec::new();
        let at: Vec<usize> = places.iter().map(|place| (start.len(), start.extend(*place)).0).collect();
        let origin = Node::Station(0);
        let observation = |patches: &[usize], length: &Length| Observation {
            nodes: std::iter::once(origin).chain(patches.iter().map(|&p| Node::Patch(at[p]))).chain([origin]).collect(),
            length_m: length.length_m,
            sd_m: length.variance_m2.sqrt(),
            delay: None,
            turns: 0,
        };
        let has = |patch: usize| places[patch].is_some();
        let first = (0..self.count()).filter(|&a| has(a)).map(|a| observation(&[a], &self.lengths.first[a]));
        let second = self.lengths.second.iter().filter(|(a, b, _)| has(*a) && has(*b));
        let observations = first.chain(second.map(|(a, b, length)| observation(&[*a, *b], length))).collect();
        let problem = Problem::new(start, self.lengths.dimensions, &[Point::origin()], observations);
        let (points, loss) = maximum_likelihood::approach(&problem, steps, SETTLED_M);
        places.iter_mut().filter(|place| place.is_some()).zip(points).for_each(|(place, point)| *place = Some(point));
        loss
    }

    /// Missing distances filled with shortest paths, then classical scaling; then SMACOF on the measured ones where asked for.
    fn spectral(&self, smooth: bool) -> Vec<Point> {
        let size = self.count() + 1;
        let mut measured_m: Mat<f64> = Mat::full(size, size, f64::NAN);
        let mut set = |i: usize, j: usize, distance_m: f64| {
            (measured_m[(i, j)], measured_m[(j, i)]) = (distance_m, distance_m);
        };
        (0..self.count()).for_each(|patch| set(0, patch + 1, self.range_m(patch)));
        for (a, b, length) in self.lengths.second {
            set(a + 1, b + 1, (length.length_m - self.range_m(*a) - self.range_m(*b)).max(0.0));
        }
        let known = |i: usize, j: usize| Some(measured_m[(i, j)]).filter(|distance_m| !distance_m.is_nan());
        let complete_m = completion::complete(size, known).expect("every patch has a distance to p0");
        let start = classical::embed(&complete_m, self.lengths.dimensions);
        if !smooth {
            return start;
        }
        let weights = Mat::from_fn(size, size, |i, j| if known(i, j).is_some() { 1.0 } else { 0.0 });
        smacof::scale(&start, &complete_m, &weights).expect("every patch has a distance to p0").points
    }
}

#[cfg(test)]
mod tests;
