//! Which places of a wall see a shape first.

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::core::{Core, Covariance, Unknowns};
use super::{Kind, LEAST, Part, Sighting, median, spread};
use crate::Point;
use crate::axes::Scatter;
use crate::neighbours::neighbours;

/// Nearest places across which a shape grows, itself with them, and those of a start.
const NEXT: usize = 9;
const START: usize = 25;
/// Starts over the wall.
const SEEDS: usize = 64;
/// Rounds of growth, and of least squares with what lengths have in common left out.
const ROUNDS: usize = 20;
const STEPS: usize = 12;
/// Standard deviations by which a length may be off, and chi-square of a point's three coordinates: 1 of 1,000.
const FOLLOWS: f64 = 3.0;
const AT_POINT: f64 = 16.3;
/// How far the foot of a shape that still grows may lie from a point that is well known, in zones.
const LOOSE: f64 = 0.2;
/// What a place is worth, less half its squared score; what an unknown costs.
const WORTH: f64 = 0.5 * FOLLOWS * FOLLOWS;
const COST: f64 = 10.0;
/// A surface goes on where a point is so near to the foot of the shape, in zones, and goes on beyond a shape where so
/// many places do, over the root of the number of members: an eighth of a border.
const NEAR: f64 = 0.5;
const GOES_ON: f64 = 0.5;
/// Radii of spheres and cylinders to start with, over the distance.
const RADII: [f64; 3] = [0.02, 0.15, 0.5];

/// Sightings, and how they lie on the wall.
pub struct Wall<'a> {
    pub sightings: &'a [Sighting],
    /// Coordinates along the wall.
    walls: Vec<[f64; 2]>,
    near: Vec<Vec<u32>>,
}

/// A sighting with its coordinates along the wall.
#[derive(Clone, Copy)]
pub struct Member<'a> {
    pub sighting: &'a Sighting,
    pub wall: [f64; 2],
}

impl<'a> Wall<'a> {
    /// `None` where there are too few places.
    pub fn new(sightings: &'a [Sighting], cancel: &Cancel) -> Option<Self> {
        if sightings.len() < LEAST.max(START) {
            return None;
        }
        let points: Vec<Point> = sightings.iter().map(|one| one.seen).collect();
        let Scatter { middle, axes: [x, y, _], .. } = Scatter::of(&points);
        let walls = points.iter().map(|point| [x, y].map(|axis| axis.dot(&(point - middle)))).collect();
        Some(Self { sightings, walls, near: neighbours(&points, START, cancel) })
    }

    pub fn members(&self, members: &[u32]) -> Vec<Member<'a>> {
        let member = |n: &u32| Member { sighting: &self.sightings[*n as usize], wall: self.walls[*n as usize] };
        members.iter().map(member).collect()
    }

    /// Root of the mean square distance of the members from their middle, on the wall.
    pub fn reach_m(&self, members: &[u32]) -> f64 {
        let of_axis = |axis: usize| {
            let places = || members.iter().map(|n| self.walls[*n as usize][axis]);
            let middle = places().sum::<f64>() / members.len() as f64;
            places().map(|place| (place - middle).powi(2)).sum::<f64>() / members.len() as f64
        };
        (of_axis(0) + of_axis(1)).sqrt()
    }

    /// By how much lengths are off, and slopes of the distances.
    pub fn residuals(&self, core: &Core, members: &[u32]) -> (Vec<f64>, Vec<Unknowns>) {
        let sightings = || members.iter().map(|n| &self.sightings[*n as usize]);
        let residuals = sightings().map(|one| one.light.length_m - core.distance_m(&one.seen)).collect();
        (residuals, sightings().map(|one| core.slopes(&one.seen)).collect())
    }

    /// Squared scores of lengths, as if they had nothing in common.
    pub fn square(&self, core: &Core, members: &[u32]) -> f64 {
        members.iter().map(|n| score(core, &self.sightings[*n as usize]).powi(2)).sum()
    }

    /// Least squares with what lengths have in common left out: a start. `None` where the members do not determine it.
    pub fn fit(&self, start: &Core, members: &[u32]) -> Option<Core> {
        let mut core = start.clone();
        let mut square = self.square(&core, members);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let (mut information, mut gradient) = (Covariance::identity(), Unknowns::zeros());
            for one in members.iter().map(|n| &self.sightings[*n as usize]) {
                let (slopes, sd_m) = (core.slopes(&one.seen), sd_m(one));
                information += slopes * slopes.transpose() / (sd_m * sd_m);
                gradient += slopes * (score(&core, one) / sd_m);
            }
            let mut damped = information;
            (0..information.nrows()).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let next = core.moved(&damped.cholesky()?.solve(&gradient));
            let then = self.square(&next, members);
            if then < square {
                let is_done = square - then < 1e-2;
                (core, square) = (next, then);
                damping *= 0.2;
                if is_done {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        square.is_finite().then_some(core)
    }

    /// Shapes of a kind about the points of the members.
    pub fn starts(&self, kind: Kind, members: &[u32]) -> Vec<Core> {
        let sightings: Vec<&Sighting> = members.iter().map(|n| &self.sightings[*n as usize]).collect();
        let points: Vec<Point> = sightings.iter().map(|one| one.point).collect();
        let Scatter { middle, axes: [along, ..], .. } = Scatter::of(&points);
        let away: Vector3<f64> = sightings.iter().map(|one| (one.seen - one.point).normalize()).sum();
        let distance_m = median(sightings.iter().map(|one| one.light.length_m).collect());
        let across = along.cross(&away).normalize();
        let behind = |radius_m: f64| middle - away.normalize() * radius_m;
        let of_axis =
            |radius_m: f64| [along, across].map(|axis| Core::new(kind, behind(radius_m), axis, radius_m)).to_vec();
        match kind {
            Kind::Plane => vec![Core::new(kind, middle, away, 0.0)],
            Kind::Sphere => {
                RADII.map(|share| Core::new(kind, behind(share * distance_m), away, share * distance_m)).to_vec()
            }
            Kind::Cylinder => RADII.iter().flat_map(|share| of_axis(share * distance_m)).collect(),
        }
    }

    /// The shape that explains most of the free places, and these.
    pub fn largest(&self, free: &[bool], is_seed: &[bool], cancel: &Cancel) -> Option<(Core, Vec<u32>)> {
        let seeds: Vec<u32> = (0..free.len() as u32).filter(|n| free[*n as usize] && is_seed[*n as usize]).collect();
        let tries: Vec<(u32, Kind)> =
            spread(&seeds, SEEDS).into_iter().flat_map(|seed| Kind::ALL.map(|kind| (seed, kind))).collect();
        let of_try = |(seed, kind): &(u32, Kind)| {
            cancel.check();
            let about: Vec<u32> = self.near[*seed as usize].iter().copied().filter(|n| free[*n as usize]).collect();
            if about.len() < START / 2 {
                return None;
            }
            let starts = self.starts(*kind, &about).into_iter().filter_map(|start| self.fit(&start, &about));
            let start = starts.min_by(|a, b| self.square(a, &about).total_cmp(&self.square(b, &about)))?;
            self.grow(start, *seed, free)
        };
        let grown: Vec<Option<(f64, Core, Vec<u32>)>> = tries.par_iter().map(of_try).collect();
        // What was tried before does not come again from a place next to it.
        let is_new = |members: &[u32]| 2 * members.iter().filter(|n| is_seed[**n as usize]).count() > members.len();
        let grown = grown.into_iter().flatten().filter(|(.., members)| members.len() >= LEAST && is_new(members));
        // Of equals the first: the order of seeds and kinds does not depend on threads.
        let best = grown.reduce(|best, next| if next.0 > best.0 { next } else { best })?;
        let (_, core, members) = best;
        Some((core.held_at(&self.middle(&members)), members))
    }

    fn middle(&self, members: &[u32]) -> Point {
        let sum: Vector3<f64> = members.iter().map(|n| self.sightings[*n as usize].point.coords).sum();
        Point::from(sum / members.len() as f64)
    }

    /// Grows a shape from a place by neighbours that follow it, until they stay the same; and what it is worth.
    fn grow(&self, start: Core, seed: u32, free: &[bool]) -> Option<(f64, Core, Vec<u32>)> {
        let mut core = start;
        let mut members = Vec::new();
        for _ in 0..ROUNDS {
            let next = self.connected(&core, seed, free);
            if next.len() < START / 2 || next == members {
                break;
            }
            core = self.fit(&core.held_at(&self.middle(&next)), &next)?;
            members = next;
        }
        let worth = members.len() as f64 * WORTH - 0.5 * self.square(&core, &members);
        (!members.is_empty()).then(|| (worth - COST * core.unknowns() as f64, core, members))
    }

    /// Free places that follow a shape, next to one another from a place on, ascending.
    fn connected(&self, core: &Core, seed: u32, free: &[bool]) -> Vec<u32> {
        let mut is_in = vec![false; free.len()];
        let mut open = vec![seed];
        is_in[seed as usize] = true;
        while let Some(place) = open.pop() {
            for next in self.near[place as usize].iter().take(NEXT).map(|n| *n as usize) {
                if free[next] && !is_in[next] && follows(core, &self.sightings[next]) {
                    is_in[next] = true;
                    open.push(next as u32);
                }
            }
        }
        (0..free.len() as u32).filter(|n| is_in[*n as usize]).collect()
    }

    /// Whether the surface goes on smoothly beyond the members: next to these lie smooth places that do not follow
    /// the shape, though their points are near to it. Then it is a piece of a bent surface.
    pub fn goes_on(&self, core: &Core, members: &[u32]) -> bool {
        let mut is_in = vec![false; self.sightings.len()];
        members.iter().for_each(|n| is_in[*n as usize] = true);
        let mut beyond = 0;
        for next in members.iter().flat_map(|n| self.near[*n as usize].iter().take(NEXT)).map(|n| *n as usize) {
            let one = &self.sightings[next];
            if !is_in[next] && one.part == Part::Smooth && !follows(core, one) {
                is_in[next] = true;
                let gap_m = (core.foot(&one.seen).0 - one.point).norm();
                beyond += usize::from(gap_m < NEAR * one.light.zone_m);
            }
        }
        beyond as f64 > GOES_ON * (members.len() as f64).sqrt()
    }

    /// The places of each shape: of those that a place follows, the one that it follows best.
    pub fn shared(&self, cores: &[Core]) -> Vec<Vec<u32>> {
        let mut members = vec![Vec::new(); cores.len()];
        for (place, one) in self.sightings.iter().enumerate() {
            let near = cores.iter().enumerate().filter(|(_, core)| follows(core, one));
            let best = near.min_by(|(_, a), (_, b)| score(a, one).abs().total_cmp(&score(b, one).abs()));
            if let Some((shape, _)) = best {
                members[shape].push(place as u32);
            }
        }
        members
    }
}

fn sd_m(one: &Sighting) -> f64 {
    one.light.sd_m.hypot(one.light.law_m).hypot(one.light.common_m)
}

/// By how many standard deviations a length is off.
fn score(core: &Core, one: &Sighting) -> f64 {
    (one.light.length_m - core.distance_m(&one.seen)) / sd_m(one)
}

/// Whether length and point are those of the shape, and the point is known to be smooth.
fn follows(core: &Core, one: &Sighting) -> bool {
    if one.part != Part::Smooth || score(core, one).abs() > FOLLOWS {
        return false;
    }
    let off = core.foot(&one.seen).0 - one.point;
    let covariance_m2 = one.covariance_m2 + Matrix3::identity() * (LOOSE * one.light.zone_m).powi(2);
    covariance_m2.cholesky().is_some_and(|covariance| off.dot(&covariance.solve(&off)) < AT_POINT)
}
