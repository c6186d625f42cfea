//! Which places of a wall see a shape first.

use nalgebra::{Cholesky, Const, Matrix2, Matrix3, Vector2, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::core::{Core, Covariance, Unknowns};
use super::{Kind, LEAST, Part, Sighting, median, spread};
use crate::Point;
use crate::axes::Scatter;
use crate::first_return::FirstLight;
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
    /// Errors of each length and point.
    errors: Vec<Errors>,
    /// Coordinates along the wall.
    walls: Vec<[f64; 2]>,
    near: Vec<Vec<u32>>,
}

/// By how much a length and a point may be off from a shape that still grows: `None` where the point's covariance is
/// none.
struct Errors {
    sd_m: f64,
    at_point: Option<Cholesky<f64, Const<3>>>,
}

impl Errors {
    fn of(one: &Sighting) -> Self {
        let FirstLight { sd_m, law_m, common_m, zone_m, .. } = one.light;
        let covariance_m2 = one.covariance_m2 + Matrix3::identity() * (LOOSE * zone_m).powi(2);
        Self { sd_m: sd_m.hypot(law_m).hypot(common_m), at_point: covariance_m2.cholesky() }
    }
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
        let errors = sightings.iter().map(Errors::of).collect();
        Some(Self { sightings, errors, walls, near: neighbours(&points, START, cancel) })
    }

    pub fn members(&self, members: &[u32]) -> Vec<Member<'a>> {
        let member = |n: &u32| Member { sighting: &self.sightings[*n as usize], wall: self.walls[*n as usize] };
        members.iter().map(member).collect()
    }

    /// How far the members reach over the wall from their middle, and how far they would if they reached as far to all
    /// sides as to the narrow one: roots of mean squares.
    pub fn reach_m(&self, members: &[u32]) -> [f64; 2] {
        let places = || members.iter().map(|n| Vector2::from(self.walls[*n as usize]));
        let count = members.len() as f64;
        let middle = places().sum::<Vector2<f64>>() / count;
        let square =
            places().map(|place| (place - middle) * (place - middle).transpose()).sum::<Matrix2<f64>>() / count;
        let narrow_m2 = square.symmetric_eigenvalues().min().max(0.0);
        [square.trace(), 2.0 * narrow_m2].map(f64::sqrt)
    }

    /// By how much lengths are off, and slopes of the distances.
    pub fn residuals(&self, core: &Core, members: &[u32]) -> (Vec<f64>, Vec<Unknowns>) {
        let sightings = || members.iter().map(|n| &self.sightings[*n as usize]);
        let residuals = sightings().map(|one| one.light.length_m - core.distance_m(&one.seen)).collect();
        (residuals, sightings().map(|one| core.slopes(&one.seen)).collect())
    }

    /// Squared scores of lengths, as if they had nothing in common.
    pub fn square(&self, core: &Core, members: &[u32]) -> f64 {
        members.iter().map(|n| self.score(core, *n as usize).powi(2)).sum()
    }

    /// Least squares with what lengths have in common left out: a start. `None` where the members do not determine it.
    pub fn fit(&self, start: &Core, members: &[u32]) -> Option<Core> {
        let mut core = start.clone();
        let mut square = self.square(&core, members);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let (mut information, mut gradient) = (Covariance::identity(), Unknowns::zeros());
            for place in members.iter().map(|n| *n as usize) {
                let (slopes, sd_m) = (core.slopes(&self.sightings[place].seen), self.errors[place].sd_m);
                information += slopes * slopes.transpose() / (sd_m * sd_m);
                gradient += slopes * (self.score(&core, place) / sd_m);
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
                if free[next] && !is_in[next] && self.follows(core, next) {
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
            if !is_in[next] && one.part == Part::Smooth && !self.follows(core, next) {
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
        for place in 0..self.sightings.len() {
            let near = cores.iter().enumerate().filter(|(_, core)| self.follows(core, place));
            let off = |core: &Core| self.score(core, place).abs();
            let best = near.min_by(|(_, a), (_, b)| off(a).total_cmp(&off(b)));
            if let Some((shape, _)) = best {
                members[shape].push(place as u32);
            }
        }
        members
    }

    /// By how many standard deviations the length of a place is off.
    fn score(&self, core: &Core, place: usize) -> f64 {
        let one = &self.sightings[place];
        (one.light.length_m - core.distance_m(&one.seen)) / self.errors[place].sd_m
    }

    /// Whether length and point of a place are those of the shape, and the point is known to be smooth.
    fn follows(&self, core: &Core, place: usize) -> bool {
        let one = &self.sightings[place];
        if one.part != Part::Smooth || self.score(core, place).abs() > FOLLOWS {
            return false;
        }
        let off = core.foot(&one.seen).0 - one.point;
        self.errors[place].at_point.as_ref().is_some_and(|root| off.dot(&root.solve(&off)) < AT_POINT)
    }
}
