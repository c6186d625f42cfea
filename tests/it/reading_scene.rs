//! Rooms of patches that are points or centimetres wide, with third bounces close behind second ones, and their
//! records as arrays of shots: made here, by formula, with the bound of what they tell. No code is shared with what
//! reads them.

use std::fs::{self, File};

use nalgebra::{DMatrix, Vector3};
use periscope::formats::npy;
use periscope::tables::Calibration;
use periscope::units::time_ps;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, write_table};
use crate::missed::pseudo_inverse;
use crate::shape::{Sensor, Shape};

const CAMPAIGN: &str = "[campaign]\nname = 'readings'\ngroup_index = 1.0\n[sensors.s1]\n[[captures]]\nrole = 'scene'\n\
    files = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 6000.0\ngain_v = 0.0001\noffset_v = 0.0\n";
const DT_PS: f64 = 50.0;
const T0_PS: f64 = 6000.0;
const SAMPLES: usize = 360;
const SHOTS: usize = 16;
/// Codes of a second bounce.
const HEIGHT: f64 = 2000.0;
/// A first bounce is so much stronger than a second; a third weaker, by a random part of this.
const FIRST: f64 = 5.0;
const THIRD: f64 = 0.7;
/// Visible patches of a room.
pub const VISIBLE: usize = 8;
/// Points that stand for a patch's light, each with its opposite, so that the patch's place is their centre.
const SPREAD: usize = 40;
/// Half of them are on rings of so many, evenly, so that a disk has the second moments of a disk in all directions.
const IN_RING: usize = 5;
/// Step of the response that the program is given.
const STEP_PS: f64 = 2.5;
/// Its steps before its start.
const BEFORE: i32 = 100;
/// Step of the one that the records are made with, and where it begins.
const CURVE_PS: f64 = 1.0;
const CURVE_FIRST_PS: f64 = -320.0;
/// What the calibration leaves open of the delay.
const LATENCY_SD_PS: f64 = 0.1;

/// What is the matter with the instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Instrument {
    /// As it was calibrated.
    Kind,
    /// With a tail of 1 % and 600 ps that calibration did not see.
    Tail,
    /// On a slope of three standard deviations of a sample along the record.
    Slope,
}

/// A kind of scene.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Diameter of the patches.
    pub size_m: f64,
    /// Peak of a second bounce over the standard deviation of one sample of the mean.
    pub snr: f64,
    pub hidden: usize,
    pub instrument: Instrument,
}

/// Patches, visible ones first, and the strengths of light.
pub struct Room {
    pub points: Vec<Vector3<f64>>,
    disks: Vec<Disk>,
    /// Of third bounces over (first, second, third patch) against second ones.
    thirds: Vec<f64>,
}

/// A patch's direction, and points of its light about its centre.
struct Disk {
    normal: Vector3<f64>,
    spread: Vec<Vector3<f64>>,
}

/// Light of one path: delays with weights whose sum is 1, and the height of its pulse.
struct Pulse {
    path: Vec<usize>,
    arrivals: Vec<(f64, f64)>,
    height: f64,
}

impl Room {
    /// Visible patches at random, three of them behind one another so that detours are short; then hidden ones.
    pub fn draw(setting: &Setting, rng: &mut ChaCha8Rng) -> Self {
        let mut points: Vec<Vector3<f64>> = Vec::new();
        while points.len() < VISIBLE - 2 {
            let uniform = |rng: &mut ChaCha8Rng, low: f64, high: f64| rng.random_range(low..high);
            let place = Vector3::new(uniform(rng, -0.6, 0.6), uniform(rng, -0.5, 0.5), uniform(rng, 1.2, 1.8));
            if points.iter().all(|other| (other - place).norm() > 0.25) {
                points.push(place);
            }
        }
        // So far off the middle of two others that light over it comes 50 to 200 ps later.
        for pair in [[0, 1], [2, 3]] {
            let [a, b] = pair.map(|n| points[n]);
            let longer_m = 0.000_299_792_458 * rng.random_range(50.0..200.0);
            let half_m = 0.5 * (a - b).norm();
            let off_m = ((half_m + 0.5 * longer_m).powi(2) - half_m * half_m).sqrt();
            let any = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            points.push(0.5 * (a + b) + off_m * any.cross(&(b - a)).normalize());
        }
        while points.len() < VISIBLE + setting.hidden {
            let place = Vector3::from_fn(|axis, _| rng.random_range([-0.8, -0.6, 0.5][axis]..[0.8, 0.6, 1.0][axis]));
            if points.iter().all(|other| (other - place).norm() > 0.25) {
                points.push(place);
            }
        }
        let disks = points.iter().map(|point| disk(*point, setting.size_m, rng)).collect();
        let count = points.len();
        Self { disks, thirds: (0..count.pow(3)).map(|_| THIRD * rng.random_range(0.2..1.0)).collect(), points }
    }

    /// Delays and weights of the light of a path from the stations at the origin, by Lambert's law; the laser lights
    /// its patch evenly. Points of its patches are paired as if at random: factors without a common divisor with their
    /// number take each point of each patch once. Each also goes with the opposites of the others, so that patches
    /// spread the light independently.
    fn arrivals(&self, path: &[usize]) -> Vec<(f64, f64)> {
        let of_points = |n: usize, opposites: usize| {
            let at = |k: usize| {
                let turn = if k > 0 && opposites >> (k - 1) & 1 == 1 { SPREAD / 2 } else { 0 };
                self.points[path[k]] + self.disks[path[k]].spread[(n * [1, 3, 7][k] + 7 * k + turn) % SPREAD]
            };
            let cosine = |k: usize, leg: Vector3<f64>| self.disks[path[k]].normal.dot(&leg.normalize()).abs();
            let last = path.len() - 1;
            let (mut length_m, mut weight) = (at(0).norm() + at(last).norm(), cosine(last, at(last)));
            weight /= at(last).norm_squared();
            for k in 1..path.len() {
                let leg = at(k) - at(k - 1);
                length_m += leg.norm();
                weight *= cosine(k - 1, leg) * cosine(k, leg) / leg.norm_squared();
            }
            (time_ps(length_m, 1.0), weight)
        };
        let opposites = 1 << (path.len() - 1);
        let mut arrivals: Vec<(f64, f64)> = (0..SPREAD)
            .flat_map(|n| (0..opposites).map(move |bits| (n, bits)))
            .map(|(n, bits)| of_points(n, bits))
            .collect();
        let total: f64 = arrivals.iter().map(|(_, weight)| weight).sum();
        arrivals.iter_mut().for_each(|(_, weight)| *weight /= total);
        arrivals
    }

    /// All light of a profile.
    fn light(&self, lit: usize, seen: usize) -> Vec<Pulse> {
        let count = self.points.len();
        let direct = if lit == seen { vec![lit] } else { vec![lit, seen] };
        let pulse = |path: Vec<usize>, height: f64| Pulse { arrivals: self.arrivals(&path), height, path };
        let mut light = vec![pulse(direct, if lit == seen { FIRST } else { 1.0 })];
        for over in (0..count).filter(|over| ![lit, seen].contains(over)) {
            // Both ways are one path.
            let height = self.thirds[(lit.min(seen) * count + over) * count + lit.max(seen)];
            light.push(pulse(vec![lit, over, seen], height));
        }
        light
    }
}

/// A disk that faces a place between its normal to the stations and any other.
fn disk(at: Vector3<f64>, size_m: f64, rng: &mut ChaCha8Rng) -> Disk {
    let any = Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
    let normal = (any - at.normalize()).normalize();
    let first = normal.cross(&Vector3::new(0.3, 0.5, -0.8)).normalize();
    let second = normal.cross(&first);
    let half = SPREAD / 2;
    let point = |n: usize| {
        let (ring, place) = (n / IN_RING, n % IN_RING);
        let radius_m = 0.5 * size_m * ((ring as f64 + 0.5) * IN_RING as f64 / half as f64).sqrt();
        let turn = std::f64::consts::TAU * (place as f64 + 0.5 * (ring % 2) as f64) / IN_RING as f64;
        radius_m * (turn.cos() * first + turn.sin() * second)
    };
    let spread = (0..half).map(point).chain((0..half).map(|n| -point(n))).collect();
    Disk { normal, spread }
}

/// Values and slopes of a shape on a grid, and between its points the cubic that has both: off by less than a
/// millionth of the maximum.
struct Curve {
    first_ps: f64,
    knots: Vec<[f64; 2]>,
}

impl Curve {
    fn new(shape: &Shape, first_ps: f64, last_ps: f64) -> Self {
        let count = ((last_ps - first_ps) / CURVE_PS).ceil() as usize + 2;
        let knot = |n: usize| {
            let [value, slope, _] = shape.at(first_ps + n as f64 * CURVE_PS);
            [value, slope]
        };
        Self { first_ps, knots: (0..count).map(knot).collect() }
    }

    /// Value and slope; zero before the grid.
    fn at(&self, time_ps: f64) -> [f64; 2] {
        let place = (time_ps - self.first_ps) / CURVE_PS;
        if place < 0.0 {
            return [0.0; 2];
        }
        let (n, u) = (place as usize, place.fract());
        let ([a, a_slope], [b, b_slope]) = (self.knots[n], self.knots[n + 1]);
        let (a_slope, b_slope) = (CURVE_PS * a_slope, CURVE_PS * b_slope);
        let (second, third) = (3.0 * (b - a) - 2.0 * a_slope - b_slope, 2.0 * (a - b) + a_slope + b_slope);
        let value = a + u * (a_slope + u * (second + u * third));
        [value, (a_slope + u * (2.0 * second + 3.0 * u * third)) / CURVE_PS]
    }
}

impl Pulse {
    /// Samples and slopes (a picosecond) of its light in a record, for a maximum of 1.
    fn samples(&self, curve: &Curve) -> Vec<[f64; 2]> {
        let sample = |n: usize| {
            let at_ps = T0_PS + n as f64 * DT_PS;
            let arrivals =
                self.arrivals.iter().map(|(delay_ps, weight)| curve.at(at_ps - delay_ps).map(|of| weight * of));
            arrivals.fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]])
        };
        (0..SAMPLES).map(sample).collect()
    }
}

/// Every capture.
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..VISIBLE).flat_map(|lit| (0..VISIBLE).map(move |seen| (lit, seen)))
}

/// Writes the shots of a scene, and the response that the program is given; with the bound of each patch's squared
/// error.
pub fn record(room: &Room, setting: &Setting, rng: &mut ChaCha8Rng) -> (Lab, Vec<f64>) {
    let lab = Lab::bulk(0);
    fs::write(lab.campaign().join("campaign.toml"), CAMPAIGN).unwrap();
    let shape = Sensor::exponential().shape;
    let own = if setting.instrument == Instrument::Tail { shape.with_tail(600.0, 0.01) } else { shape.clone() };
    let curve = Curve::new(&own, CURVE_FIRST_PS, SAMPLES as f64 * DT_PS + T0_PS);
    let noise = HEIGHT / setting.snr;
    let mut information = Information::new(room);
    for (lit, seen) in pairs() {
        let light = room.light(lit, seen);
        let samples: Vec<Vec<[f64; 2]>> = light.iter().map(|pulse| pulse.samples(&curve)).collect();
        information.add(room, &light, &samples, noise);
        let mean = |n: usize| {
            let of_pulse = |(pulse, samples): (&Pulse, &Vec<[f64; 2]>)| pulse.height * samples[n][0];
            let slope =
                if setting.instrument == Instrument::Slope { 3.0 * noise * n as f64 / SAMPLES as f64 } else { 0.0 };
            HEIGHT * light.iter().zip(&samples).map(of_pulse).sum::<f64>() + slope
        };
        let means: Vec<f64> = (0..SAMPLES).map(mean).collect();
        let mut codes = Vec::with_capacity(SHOTS * SAMPLES);
        for mean in std::iter::repeat_n(&means, SHOTS).flatten() {
            let normal: f64 = StandardNormal.sample(rng);
            codes.push((mean + noise * (SHOTS as f64).sqrt() * normal).round() as i16);
        }
        let path = lab.campaign().join(format!("raw/L{}_P{}.npy", lit + 1, seen + 1));
        npy::write(&mut File::create(path).unwrap(), &[SHOTS as u64, SAMPLES as u64], &codes).unwrap();
    }
    write_table(&lab.path("calibration.parquet"), &[calibration(&shape, BEFORE)]);
    (lab, information.bounds_m2())
}

/// What all profiles tell of the places of patches and of the delay, at best.
struct Information {
    /// Of the patches' coordinates, m, and of the delay, ps.
    matrix: DMatrix<f64>,
}

impl Information {
    fn new(room: &Room) -> Self {
        let size = 3 * room.points.len() + 1;
        let mut matrix = DMatrix::zeros(size, size);
        matrix[(size - 1, size - 1)] = LATENCY_SD_PS.powi(-2);
        Self { matrix }
    }

    /// What one profile tells by the times of its pulses, whose strengths are unknown, as is a constant under them.
    fn add(&mut self, room: &Room, light: &[Pulse], samples: &[Vec<[f64; 2]>], noise: f64) {
        let (count, of_code) = (light.len(), HEIGHT / noise);
        let columns = DMatrix::from_fn(SAMPLES, 2 * count + 1, |n, k| match k {
            k if k < count => -of_code * light[k].height * samples[k][n][1],
            k if k < 2 * count => of_code * samples[k - count][n][0],
            _ => 1.0,
        });
        let (times, others) = (columns.columns(0, count), columns.columns(count, count + 1));
        // What strengths and the constant cannot explain of the times.
        let own = others.clone_owned().svd(true, false);
        let mut left = times.clone_owned();
        let basis = own.u.expect("asked for");
        for (column, singular) in basis.column_iter().zip(own.singular_values.iter()) {
            if *singular > 1e-9 * own.singular_values[0] {
                let along = column.transpose() * &left;
                left -= column * along;
            }
        }
        let size = self.matrix.nrows();
        let mut paths = DMatrix::zeros(count, size);
        for (k, pulse) in light.iter().enumerate() {
            let points: Vec<Vector3<f64>> = pulse.path.iter().map(|patch| room.points[*patch]).collect();
            let at = |n: usize| n.checked_sub(1).and_then(|n| points.get(n)).copied().unwrap_or_default();
            for (n, patch) in pulse.path.iter().enumerate() {
                let towards = |other: Vector3<f64>| (points[n] - other).normalize();
                let slope = towards(at(n)) + towards(at(n + 2));
                for axis in 0..3 {
                    paths[(k, 3 * patch + axis)] += time_ps(slope[axis], 1.0);
                }
            }
            paths[(k, size - 1)] = 1.0;
        }
        let seen = left * paths;
        self.matrix += seen.transpose() * seen;
    }

    /// Least squared error of each patch, turns about the stations apart.
    fn bounds_m2(&self) -> Vec<f64> {
        let places = self.matrix.nrows() - 1;
        let coupled = self.matrix.view((0, places), (places, 1));
        let delay = self.matrix[(places, places)];
        let own = self.matrix.view((0, 0), (places, places)) - coupled * coupled.transpose() / delay;
        let covariance = pseudo_inverse(&own, 3);
        (0..places / 3).map(|patch| (0..3).map(|axis| covariance[(3 * patch + axis, 3 * patch + axis)]).sum()).collect()
    }
}

/// A calibration that knows this response, from so many steps of 2.5 ps before its start on.
pub fn calibration(shape: &Shape, before: i32) -> Calibration {
    let behind = 800;
    let response: Vec<f64> = (-before..=behind).map(|i| shape.at(f64::from(i) * STEP_PS)[0]).collect();
    Calibration {
        campaign: "readings".into(),
        sensor: "s1".into(),
        shots: 1000,
        step_ps: STEP_PS,
        response_t0_ps: -f64::from(before) * STEP_PS,
        response: response.into_iter().collect(),
        latency_sd_ps: LATENCY_SD_PS,
        width_ps: 151.0,
        ..Calibration::default()
    }
}
