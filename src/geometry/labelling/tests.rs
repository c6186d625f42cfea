//! Labels of arrivals whose paths are given: a room of patches on three rectangles, laser and sensor in one point.

mod blends;
mod blind;
mod bounces;
mod hidden;
mod predicted;
mod readings;

use super::*;
use crate::footprint::Footprints;
use crate::{Point, units};
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;

const OPTIONS: Options = Options {
    bounces: 2,
    probability_min: 0.95,
    clutter_per_ns: 0.05,
    near_m: 0.0,
    hidden: HiddenPatches::Search,
    false_alarm: 1e-3,
    blend_ps: 100.0,
};

/// Patches of each rectangle.
const WALLS: [usize; 3] = [25, 16, 8];

/// Patch i at `points[i - 1]`.
struct Room {
    points: Vec<Point>,
    walls: Vec<usize>,
    /// Whether patches of one wall exchange no light, as on walls that are flat.
    flat: bool,
}

impl Room {
    /// Patches anywhere on the rectangles; their least and largest distances from the origin are 1.4 and 3 m.
    fn new(rng: &mut ChaCha8Rng, counts: [usize; 3], flat: bool) -> Self {
        let walls: Vec<usize> = (0..3).flat_map(|wall| std::iter::repeat_n(wall, counts[wall])).collect();
        let place = |wall: &usize| {
            let (u, v) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            match wall {
                0 => Point::new(-1.2 + 2.0 * u, 2.6, -0.8 + 1.6 * v),
                1 => Point::new(1.1, 1.0 + 1.4 * u, -0.8 + 1.6 * v),
                _ => Point::new(-1.0 + 1.8 * u, 1.6 + 0.7 * v, -0.9),
            }
        };
        Self { points: walls.iter().map(place).collect(), walls, flat }
    }

    fn patches(&self) -> impl Iterator<Item = PatchId> + Clone + use<> {
        1..=self.points.len() as PatchId
    }

    fn is_open(&self, a: PatchId, b: PatchId) -> bool {
        let wall = |patch: PatchId| self.walls[patch as usize - 1];
        a != b && !(self.flat && wall(a) == wall(b))
    }

    fn time_ps(&self, path: &[PatchId]) -> f64 {
        let point = |patch: PatchId| self.points[patch as usize - 1];
        let ends = point(path[0]).coords.norm() + point(path[path.len() - 1]).coords.norm();
        let between: f64 = path.windows(2).map(|leg| (point(leg[0]) - point(leg[1])).norm()).sum();
        units::time_ps(ends + between, 1.0)
    }

    /// All light of a profile over up to three patches, first light first.
    fn light(&self, lit: PatchId, seen: PatchId) -> Vec<Vec<PatchId>> {
        let over = self.patches().filter(|via| self.is_open(lit, *via) && self.is_open(*via, seen));
        let mut paths: Vec<Vec<PatchId>> = over.map(|via| vec![lit, via, seen]).collect();
        if lit == seen {
            paths.push(vec![lit]);
        } else if self.is_open(lit, seen) {
            paths.push(vec![lit, seen]);
        }
        paths.sort_by(|a, b| self.time_ps(a).total_cmp(&self.time_ps(b)));
        paths
    }
}

/// How arrivals are made of light.
#[derive(Clone, Copy)]
struct Capture {
    /// Standard deviation of their times.
    sd_ps: f64,
    /// Chance that a pair was captured, both ways or not at all.
    captured: f64,
    /// Chance that light later than the first is seen.
    later: f64,
    /// Chance that one of the two profiles of a pair has a false arrival before its first light.
    early: f64,
    /// False arrivals at any time.
    clutter_per_ns: f64,
    period_ps: Option<f64>,
}

const PLAIN: Capture =
    Capture { sd_ps: 25.0, captured: 1.0, later: 0.0, early: 0.0, clutter_per_ns: 0.0, period_ps: None };

/// An arrival with the path that made it and the periods to be added to its time; no path for a false one.
struct Made {
    lit: PatchId,
    seen: PatchId,
    arrival: Arrival,
    path: Option<Vec<PatchId>>,
    turns: i32,
}

impl Capture {
    fn of(self, room: &Room, rng: &mut ChaCha8Rng) -> Vec<Made> {
        let pairs = room.patches().flat_map(|a| room.patches().map(move |b| (a, b)));
        let captured: BTreeMap<(PatchId, PatchId), bool> =
            pairs.clone().map(|(a, b)| ((a, b), a == b || rng.random_bool(self.captured))).collect();
        let is_captured = |(a, b): &(PatchId, PatchId)| captured[&(*a.min(b), *a.max(b))];
        pairs.filter(is_captured).flat_map(|(lit, seen)| self.profile(room, lit, seen, rng)).collect()
    }

    fn profile(self, room: &Room, lit: PatchId, seen: PatchId, rng: &mut ChaCha8Rng) -> Vec<Made> {
        let light = room.light(lit, seen);
        let first_ps = light.first().map_or(f64::INFINITY, |path| room.time_ps(path));
        let last_ps = light.last().map_or(0.0, |path| room.time_ps(path));
        let mut arrivals: Vec<(f64, Option<Vec<PatchId>>)> = Vec::new();
        for (n, path) in light.into_iter().enumerate() {
            if n == 0 || rng.random_bool(self.later) {
                let noise: f64 = StandardNormal.sample(rng);
                arrivals.push((room.time_ps(&path) + self.sd_ps * noise, Some(path)));
            }
        }
        if lit < seen && rng.random_bool(self.early) {
            arrivals.push((rng.random_range(0.0..first_ps - 500.0), None));
        }
        let clutter = self.clutter_per_ns * 1e-3 * last_ps;
        if clutter > 0.0 && rng.random_bool(clutter.min(1.0)) {
            arrivals.push((rng.random_range(0.0..last_ps), None));
        }
        let turns = |time_ps: f64| self.period_ps.map_or(0, |period_ps| (time_ps / period_ps).floor() as i32);
        let folded = |time_ps: f64| time_ps - f64::from(turns(time_ps)) * self.period_ps.unwrap_or(0.0);
        arrivals.sort_by(|a, b| folded(a.0).total_cmp(&folded(b.0)));
        let made = |(time_ps, path): (f64, Option<Vec<PatchId>>)| Made {
            lit,
            seen,
            arrival: Arrival::point(
                folded(time_ps),
                self.sd_ps,
                path.as_ref().map_or(6.0, |path| 1e5_f64.powf(1.0 / path.len() as f64)),
            ),
            path,
            turns: turns(time_ps),
        };
        arrivals.into_iter().map(made).collect()
    }

    /// One sensor's profiles, laser and sensor at the origin.
    fn sensor(self, delay_ps: (f64, f64), made: &[Made]) -> SensorProfiles {
        let profile = |made: &[Made]| Profile {
            lit: made[0].lit,
            seen: made[0].seen,
            delay_ps: delay_ps.0,
            delay_sd_ps: delay_ps.1,
            arrivals: made.iter().map(|made| made.arrival).collect(),
        };
        SensorProfiles {
            medium: Medium { group_index: 1.0, repetition_ps: self.period_ps },
            source: Point::origin(),
            sensor: Point::origin(),
            dimensions: 3,
            largest_patch: 0,
            hidden_count: None,
            profiles: made.chunk_by(|a, b| (a.lit, a.seen) == (b.lit, b.seen)).map(profile).collect(),
        }
    }

    /// The verdicts on each arrival, no delay left in their times.
    fn verdicts(self, options: &Options, scene: Option<&Scene>, made: &[Made]) -> Vec<Vec<Verdict>> {
        verdicts(label(&[self.sensor((0.0, 0.0), made)], scene, options, &Cancel::never()))
    }
}

/// The verdicts on each arrival of one sensor.
fn verdicts(solution: Solution) -> Vec<Vec<Verdict>> {
    solution.verdicts.into_iter().flatten().flatten().collect()
}

/// Patches 1 and up with independent errors of `sd_m` in each coordinate.
fn scene(points: &[Point], sd_m: f64) -> Scene {
    let patches = (1..).zip(points).map(|(patch, point)| (patch, (*point, Matrix3::identity() * (sd_m * sd_m))));
    Scene::new(&patches.collect(), &BTreeMap::new(), Footprints::default(), BTreeMap::new())
}

/// By first light, by paths in place, and in the search for hidden patches.
#[test]
fn a_cancel_ends_labelling() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let room = Room::new(&mut rng, [4, 3, 3], false);
    let sensors = [PLAIN.sensor((0.0, 0.0), &PLAIN.of(&room, &mut rng))];
    let scene = scene(&room.points, 1e-4);
    let cancel = Cancel::new();
    cancel.cancel();
    for (scene, hidden) in
        [(None, HiddenPatches::None), (Some(&scene), HiddenPatches::None), (Some(&scene), HiddenPatches::Search)]
    {
        let options = Options { bounces: 3, hidden, ..OPTIONS };
        assert_eq!(Cancel::catch(|| label(&sensors, scene, &options, &cancel)), Err(periscope_cancel::Cancelled));
    }
}
