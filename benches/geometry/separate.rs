//! Source and sensors apart, patches that are lit but not seen, rays.

use std::time::Instant;

use nalgebra::Vector3;
use periscope::geometry::maximum_likelihood::{self, Problem, Ray};
use periscope::geometry::{Point, procrustes};
use periscope::units::path_m;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::estimate::{measured, refined};
use super::measured::normal;
use super::room::{self, Information, Way};
use super::score::{Estimate, Rate, heading, row};

const DELAY_SD_PS: f64 = 10.0;
const RAY_SD_RAD: f64 = 0.002;
/// A loss that is above another by more is that of a worse minimum.
const ABOVE: f64 = 1.0;

/// Motions of the whole that no length depends on: positions are compared after the best of them.
#[derive(Clone, Copy)]
enum Free {
    /// Rotations about the one station, and mirror images.
    Rotations,
    /// The turn about the x axis, on which all stations lie, and mirror images in planes through it.
    Turn,
    Nothing,
}

impl Free {
    fn name(self) -> &'static str {
        match self {
            Self::Rotations => "rotations, mirror image",
            Self::Turn => "turn about the base, mirror image",
            Self::Nothing => "nothing",
        }
    }

    /// Dimensions of the motions.
    fn count(self) -> usize {
        match self {
            Self::Rotations => 3,
            Self::Turn => 1,
            Self::Nothing => 0,
        }
    }

    fn rms_m(self, points: &[Point], truth: &[Point]) -> f64 {
        match self {
            Self::Rotations => procrustes::rotation(points, truth, Point::origin(), true).rms_m,
            Self::Turn => rms_about_x_m(points, truth),
            Self::Nothing => rms_m(points, truth),
        }
    }
}

fn rms_m(points: &[Point], truth: &[Point]) -> f64 {
    let squares: f64 = points.iter().zip(truth).map(|(point, truth)| (point - truth).norm_squared()).sum();
    (squares / truth.len() as f64).sqrt()
}

/// Root mean square distance after the best rotation about the x axis, with or without a mirror image in a plane
/// through it.
fn rms_about_x_m(points: &[Point], truth: &[Point]) -> f64 {
    let after = |sign: f64| {
        let both = || points.iter().zip(truth).map(|(f, t)| (Vector3::new(f.x, sign * f.y, f.z), t));
        let sine: f64 = both().map(|(f, t)| f.y * t.z - f.z * t.y).sum();
        let cosine: f64 = both().map(|(f, t)| f.y * t.y + f.z * t.z).sum();
        let (sine, cosine) = (sine / sine.hypot(cosine), cosine / sine.hypot(cosine));
        let turned = both().map(|(f, _)| Point::new(f.x, cosine * f.y - sine * f.z, sine * f.y + cosine * f.z));
        rms_m(&turned.collect::<Vec<_>>(), truth)
    };
    after(1.0).min(after(-1.0))
}

/// What is set up.
struct Setup {
    name: &'static str,
    /// The source, then the sensors.
    stations: Vec<Point>,
    /// Whether the one station is source and sensor.
    is_one_point: bool,
    has_rays: bool,
    /// Whether half of 24 patches are lit and the other half seen; else all 49 are both.
    is_disjoint: bool,
    free: Free,
    noises_ps: &'static [f64],
}

impl Setup {
    fn all() -> Vec<Self> {
        let on_x = |places: &[f64]| places.iter().map(|&x| Point::new(x, 0.0, 0.0)).collect::<Vec<_>>();
        let apart = |name, stations, free| Self {
            name,
            stations,
            is_one_point: false,
            has_rays: false,
            is_disjoint: false,
            free,
            noises_ps: &[25.0],
        };
        let spanning =
            vec![Point::origin(), Point::new(0.4, 0.0, 0.0), Point::new(-0.3, 0.2, 0.0), Point::new(0.0, 0.1, 0.4)];
        vec![
            Self { noises_ps: &[25.0, 5.0], ..apart("one sensor, 8 cm apart", on_x(&[0.0, 0.08]), Free::Turn) },
            Self { noises_ps: &[25.0, 5.0], ..apart("one sensor, 0.5 m apart", on_x(&[0.0, 0.5]), Free::Turn) },
            apart("two sensors, 0.3 m to either side", on_x(&[0.0, 0.3, -0.3]), Free::Turn),
            apart("three sensors, not in a plane", spanning, Free::Nothing),
            Self { has_rays: true, ..apart("two sensors, 1 m apart, rays", on_x(&[0.0, 0.5, -0.5]), Free::Nothing) },
            Self { is_one_point: true, has_rays: true, ..apart("one point, rays", on_x(&[0.0]), Free::Nothing) },
            Self {
                is_one_point: true,
                is_disjoint: true,
                ..apart("lit and seen disjoint, one point", on_x(&[0.0]), Free::Rotations)
            },
            Self {
                has_rays: true,
                is_disjoint: true,
                ..apart("lit and seen disjoint, 0.5 m apart, rays", on_x(&[0.0, 0.5]), Free::Nothing)
            },
        ]
    }

    fn truth(&self) -> Vec<Point> {
        let all = room::rectangles();
        if self.is_disjoint { all.into_iter().step_by(2).take(24).collect() } else { all }
    }

    /// First bounces, and second bounces both ways around, each of these missing with the given chance.
    fn ways(&self, patches: usize, missing: f64, rng: &mut ChaCha8Rng) -> Vec<Way> {
        let sensors = if self.is_one_point { 0..1 } else { 1..self.stations.len() };
        let mut ways = Vec::new();
        for (sensor, a) in sensors.flat_map(|sensor| (0..patches).map(move |a| (sensor, a))) {
            for b in 0..patches {
                let is_captured = !self.is_disjoint || a % 2 == 0 && b % 2 == 1;
                if a == b && is_captured {
                    ways.push(Way { source: 0, patches: vec![a], sensor });
                } else if is_captured && !rng.random_bool(missing) {
                    ways.push(Way { source: 0, patches: vec![a, b], sensor });
                }
            }
        }
        ways
    }
}

/// Measured direction of each patch from the source.
fn rays(truth: &[Point], source: Point, rng: &mut ChaCha8Rng) -> Vec<Ray> {
    let mut ray = |(patch, point): (usize, &Point)| {
        let along = (point - source).normalize();
        let error = RAY_SD_RAD * Vector3::from_fn(|_, _| normal(rng));
        let direction = (along + error - along * along.dot(&error)).normalize();
        Ray { patch, from: 0, direction, sd_rad: RAY_SD_RAD }
    };
    truth.iter().enumerate().map(&mut ray).collect()
}

/// The estimate that is judged.
struct Judged {
    rms_m: f64,
    /// Whether its loss is above that of the descent from the truth.
    is_above: bool,
}

/// One scene.
struct Draw {
    bound_m: f64,
    /// None where the stage would refuse the scene, since no minimum is reached.
    estimate: Option<Judged>,
    /// Error of the minimum that a descent from the truth ends in.
    from_truth_m: f64,
    time_ms: f64,
}

impl Draw {
    fn new(setup: &Setup, missing: f64, noise_ps: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (truth, stations) = (setup.truth(), &setup.stations);
        let ways = setup.ways(truth.len(), missing, &mut rng);
        let (sds_m, delay_sd_m) = (vec![path_m(noise_ps, 1.0); ways.len()], path_m(DELAY_SD_PS, 1.0));
        let (mut problem, _) = measured(&truth, stations, &ways, &sds_m, delay_sd_m, &mut rng);
        let mut information = Information::of_ways(&truth, stations, &ways, &sds_m, delay_sd_m);
        if setup.has_rays {
            problem.rays = rays(&truth, stations[0], &mut rng);
            information = information.with_rays(&truth, stations[0], RAY_SD_RAD);
        }
        let begin = Instant::now();
        let solution = refined(&problem);
        let time_ms = 1e3 * begin.elapsed().as_secs_f64();
        let (near, loss) = maximum_likelihood::approach(&Problem { start: truth.clone(), ..problem }, 100, 1e-7);
        Self {
            bound_m: room::bound_of_m(&information.of_positions(), setup.free.count()),
            estimate: solution.ok().map(|solution| Judged {
                rms_m: setup.free.rms_m(&solution.points, &truth),
                is_above: solution.loss > loss + ABOVE,
            }),
            from_truth_m: setup.free.rms_m(&near.points, &truth),
            time_ms,
        }
    }
}

/// Prints the table.
pub fn print(scenes: u64) {
    let columns = [
        "set-up",
        "free, hence aligned",
        "missing",
        "noise (ps)",
        "scenes",
        "open",
        "refused",
        "bound (mm)",
        "within 2 bounds",
        "rms / bound",
        "rms / bound, from the truth",
        "loss above the truth's by more than 1",
        "ms a scene",
    ];
    heading("## Separate stations", &columns);
    for setup in Setup::all() {
        for (&noise_ps, missing) in setup.noises_ps.iter().flat_map(|noise| [(noise, 0.0), (noise, 0.5)]) {
            let one = |seed| Draw::new(&setup, missing, noise_ps, seed);
            let all: Vec<Draw> = (0..scenes).into_par_iter().map(one).collect();
            let closed: Vec<&Draw> = all.iter().filter(|draw| draw.bound_m.is_finite()).collect();
            let mean =
                |value: fn(&Draw) -> f64| closed.iter().map(|draw| value(draw)).sum::<f64>() / closed.len() as f64;
            let judged: Vec<(&Judged, f64)> =
                closed.iter().filter_map(|draw| Some((draw.estimate.as_ref()?, draw.bound_m))).collect();
            let squares: Vec<f64> =
                judged.iter().map(|(estimate, bound_m)| (estimate.rms_m / bound_m).powi(2)).collect();
            let from_truth: Vec<f64> = closed.iter().map(|draw| (draw.from_truth_m / draw.bound_m).powi(2)).collect();
            row(&[
                setup.name.to_owned(),
                setup.free.name().to_owned(),
                format!("{:.0} %", 100.0 * missing),
                noise_ps.to_string(),
                scenes.to_string(),
                (all.len() - closed.len()).to_string(),
                (closed.len() - judged.len()).to_string(),
                format!("{:.2}", 1e3 * mean(|draw| draw.bound_m)),
                Rate { hits: squares.iter().filter(|square| **square < 4.0).count(), of: closed.len() }.to_string(),
                Estimate::rms(&squares).to_string(),
                Estimate::rms(&from_truth).to_string(),
                judged.iter().filter(|(estimate, _)| estimate.is_above).count().to_string(),
                format!("{:.0}", mean(|draw| draw.time_ms)),
            ]);
        }
    }
}
