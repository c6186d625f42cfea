//! Captures of a relay wall that shows dots, plates or nothing, made here: no code is shared with what locates them.
//! The response has a tail, 1 % of its peak after 0.9 ns; the wall may have relief, and the instrument jitter from
//! point to point.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::process::Command;

use nalgebra::DMatrix;
use periscope::formats::array::Array;
use periscope::formats::hdf5;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};

/// Speed of light, m/ps.
const LIGHT: f64 = 2.997_924_58e-4;
pub const FWHM_PS: f64 = 60.0;
const SIGMA_PS: f64 = FWHM_PS / 2.354_820_045;
/// Steps of the bound's differences.
const STEP_M: f64 = 1e-5;

/// Something hidden: its place, and its photons in a mean histogram.
pub type Dot = ([f64; 3], f64);

/// How dots send light back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    /// Surfaces that face the wall: two legs, each an inverse square, and a cosine at the dot each way.
    Diffuse,
    /// Light goes back the way that it came; less at grazing angles.
    Retroreflective,
}

/// A capture to be made.
#[derive(Clone, Copy, Debug)]
pub struct Capture {
    /// Points on each side of the wall.
    pub side: usize,
    /// Half the side of the wall.
    pub half_m: f64,
    pub bins: usize,
    pub dt_ps: f64,
    pub law: Law,
    /// Dark counts of a bin, and photons of the wall's own light in its highest bin.
    pub dark: f64,
    pub wall: f64,
    /// Height of the wall's relief, a wave over the wall.
    pub relief_m: f64,
    /// Standard deviation of each histogram's time.
    pub jitter_ps: f64,
    /// Pulses of the laser in a histogram, of which each counts one photon at most: pile-up.
    pub pulses: Option<f64>,
    pub seed: u64,
}

impl Default for Capture {
    fn default() -> Self {
        Self {
            side: 8,
            half_m: 0.3,
            bins: 640,
            dt_ps: 8.0,
            law: Law::Diffuse,
            dark: 0.2,
            wall: 3e4,
            relief_m: 0.0,
            jitter_ps: 0.0,
            pulses: None,
            seed: 0,
        }
    }
}

/// The response, with a sum of 1 over picoseconds.
pub fn response(after_ps: f64) -> f64 {
    let tail = if after_ps > 0.0 { 0.06 * (1.0 - (-after_ps / 30.0).exp()) * (-after_ps / 500.0).exp() } else { 0.0 };
    ((-0.5 * (after_ps / SIGMA_PS).powi(2)).exp() + tail) / 92.2
}

/// Distance of two places.
pub fn gap_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Capture {
    pub fn wall(&self) -> Vec<[f64; 3]> {
        let along = |place: usize| (2.0 * place as f64 / (self.side - 1) as f64 - 1.0) * self.half_m;
        (0..self.side * self.side).map(|n| [along(n % self.side), along(n / self.side), 0.0]).collect()
    }

    /// Photons of a dot over a point of the wall, on any scale.
    fn strength(&self, point: [f64; 3], place: [f64; 3]) -> f64 {
        let distance_m = gap_m(point, place);
        let cosine = place[2] / distance_m;
        match self.law {
            Law::Diffuse => cosine.powi(2) / distance_m.powi(4),
            Law::Retroreflective => cosine.powi(4) / distance_m.powi(2),
        }
    }

    /// Rates of the wall's own light.
    fn own_rates(&self) -> Vec<f64> {
        let rate = |bin: usize| {
            let time_ps = (bin as f64 + 0.5) * self.dt_ps;
            self.dark + self.wall * (92.2 * response(time_ps) + 0.03 * (-time_ps / 250.0).exp())
        };
        (0..self.bins).map(rate).collect()
    }

    /// Adds the light of dots to the rates of a histogram.
    fn shine(&self, (point, shift_ps): ([f64; 3], f64), dots: &[Dot], means: &[f64], rates: &mut [f64]) {
        for ((place, photons), mean) in dots.iter().zip(means) {
            let arrival_ps = 2.0 * gap_m(point, *place) / LIGHT + shift_ps;
            let height = photons * self.strength(point, *place) / mean * self.dt_ps;
            let first = ((arrival_ps - 6.0 * SIGMA_PS) / self.dt_ps).max(0.0) as usize;
            for (bin, rate) in rates.iter_mut().enumerate().skip(first) {
                *rate += height * response((bin as f64 + 0.5) * self.dt_ps - arrival_ps);
            }
        }
    }

    /// Rates of what is counted: after a photon the counter is blind to the end of the record.
    fn counted(&self, rates: &mut [f64]) {
        let Some(pulses) = self.pulses else { return };
        let mut before = 0.0;
        for rate in rates {
            let share = *rate / pulses;
            *rate = pulses * f64::exp(-before) * (1.0 - f64::exp(-share));
            before += share;
        }
    }

    /// Mean strength of each dot over the wall.
    fn means(&self, dots: &[Dot]) -> Vec<f64> {
        let wall = self.wall();
        let mean = |place| wall.iter().map(|point| self.strength(*point, place)).sum::<f64>() / wall.len() as f64;
        dots.iter().map(|(place, _)| mean(*place)).collect()
    }

    /// Writes the scan as its authors' programs do.
    pub fn write(&self, path: &Path, dots: &[Dot]) {
        let means = self.means(dots);
        self.write_light(path, |_, at, rates| self.shine(at, dots, &means, rates));
    }

    /// The same with any hidden light, which is added to the rates of each point of the wall by its number, place and
    /// shift.
    pub fn write_light(&self, path: &Path, shine: impl Fn(usize, ([f64; 3], f64), &mut [f64])) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let wall = self.wall();
        let jitter = Normal::new(0.0, self.jitter_ps).unwrap();
        let count = wall.len();
        let mut values = vec![0.0; self.bins * count];
        let own = self.own_rates();
        for (n, point) in wall.iter().enumerate() {
            let bump_m = self.relief_m * (9.0 * point[0]).sin() * (7.0 * point[1] + 1.0).cos();
            let shift_ps = jitter.sample(&mut rng);
            let mut rates = own.clone();
            shine(n, ([point[0], point[1], bump_m], shift_ps), &mut rates);
            self.counted(&mut rates);
            for (bin, rate) in rates.into_iter().enumerate() {
                values[bin * count + n] = Poisson::new(rate).unwrap().sample(&mut rng);
            }
        }
        let arrays = [
            ("rect_data", Array::of(&[self.bins, self.side, self.side], &values)),
            ("width", Array::of(&[1, 1], &[self.half_m])),
        ];
        let mut file = BufWriter::new(File::create(path).unwrap());
        hdf5::write(&mut file, &arrays.map(|(name, array)| (name.to_owned(), array)).into()).unwrap();
    }

    /// How the light of all dots changes as a histogram is late, for each picosecond.
    fn lateness(&self, point: [f64; 3], dots: &[Dot], means: &[f64]) -> Vec<f64> {
        let step_ps = 1e-2;
        let [late, early] = [step_ps, -step_ps].map(|shift_ps| {
            let mut light = vec![0.0; self.bins];
            self.shine((point, shift_ps), dots, means, &mut light);
            light
        });
        late.iter().zip(early).map(|(late, early)| (late - early) / (2.0 * step_ps)).collect()
    }

    /// Standard deviation of the shifts of histograms in time: jitter, and the wave of the relief, whose mean square is
    /// a quarter of its height's.
    pub fn shift_sd_ps(&self) -> f64 {
        self.jitter_ps.hypot(0.5 * 2.0 * self.relief_m / LIGHT)
    }

    /// Standard deviation of each coordinate that no estimator undercuts that knows response, wall and law: the inverse
    /// Fisher matrix of all places and photons, by differences of the rates. Of the shift of each histogram it knows
    /// the standard deviation `shift_sd_ps`, 0: the shift itself.
    pub fn bound_m(&self, dots: &[Dot], shift_sd_ps: f64) -> Vec<f64> {
        let (unknowns, means) = (4 * dots.len(), self.means(dots));
        let mut fisher = DMatrix::<f64>::zeros(unknowns, unknowns);
        // Behind the wall's own light.
        let first = (800.0 / self.dt_ps) as usize;
        let own = self.own_rates();
        for point in self.wall() {
            let mut rates = own.clone();
            self.shine((point, 0.0), dots, &means, &mut rates);
            let slope = |n: usize| -> Vec<f64> {
                let (dot, axis) = (n / 4, n % 4);
                let mut ends = [dots[dot]; 2];
                for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
                    match axis {
                        3 => end.1 *= 1.0 + sign * 1e-4,
                        axis => end.0[axis] += sign * STEP_M,
                    }
                }
                let width = if axis == 3 { 2e-4 } else { 2.0 * STEP_M };
                let [up, down] = ends.map(|end| {
                    let mut light = vec![0.0; self.bins];
                    self.shine((point, 0.0), &[end], &means[dot..=dot], &mut light);
                    light
                });
                up.iter().zip(down).map(|(up, down)| (up - down) / width).collect()
            };
            let slopes: Vec<Vec<f64>> = (0..unknowns).map(slope).collect();
            let product =
                |a: &[f64], b: &[f64]| -> f64 { (first..self.bins).map(|bin| a[bin] * b[bin] / rates[bin]).sum() };
            let late = self.lateness(point, dots, &means);
            let with_shift: Vec<f64> = slopes.iter().map(|slope| product(slope, &late)).collect();
            let shift = product(&late, &late) + shift_sd_ps.powi(-2);
            for a in 0..unknowns {
                for b in 0..=a {
                    let sum = product(&slopes[a], &slopes[b]) - with_shift[a] * with_shift[b] / shift;
                    fisher[(a, b)] += sum;
                    if a != b {
                        fisher[(b, a)] += sum;
                    }
                }
            }
        }
        let covariance = fisher.cholesky().expect("all dots have light").inverse();
        (0..unknowns).filter(|n| n % 4 < 3).map(|n| covariance[(n, n)].sqrt()).collect()
    }
}

/// Dots of so many photons in a mean histogram, a factor of two either way, at least `apart_m` from one another.
pub fn dots(count: usize, photons: f64, apart_m: f64, seed: u64) -> Vec<Dot> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut dots: Vec<Dot> = Vec::new();
    while dots.len() < count {
        let mut between = |[from, to]: [f64; 2]| rng.random_range(from..to);
        let place = [between([-0.2, 0.2]), between([-0.2, 0.2]), between([0.35, 0.65])];
        let factor = between([-1.0, 1.0]).exp2();
        if dots.iter().all(|(other, _)| gap_m(*other, place) > apart_m) {
            dots.push((place, photons * factor));
        }
    }
    dots
}

/// Each dot with a second one at this distance, in some direction.
pub fn twins(dots: &[Dot], apart_m: f64, seed: u64) -> Vec<Dot> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let twin = |(place, photons): &Dot| {
        let arm: [f64; 3] = std::array::from_fn(|_| normal.sample(&mut rng));
        let norm = gap_m(arm, [0.0; 3]);
        [(*place, *photons), (std::array::from_fn(|axis| place[axis] + apart_m * arm[axis] / norm), *photons)]
    };
    dots.iter().flat_map(twin).collect()
}

/// A square plate that faces the wall, of dots 5 mm apart, with so many photons in all.
pub fn plate([x_m, y_m, depth_m]: [f64; 3], size_m: f64, photons: f64) -> Vec<Dot> {
    let count = (size_m / 0.005).round() as usize;
    let along = |n: usize| (n as f64 + 0.5) * 0.005 - 0.5 * size_m;
    let share = photons / (count * count) as f64;
    (0..count * count).map(|n| ([x_m + along(n % count), y_m + along(n / count), depth_m], share)).collect()
}

/// A plate like the letter L of three bars' width.
pub fn letter([x_m, y_m, depth_m]: [f64; 3], size_m: f64, photons: f64) -> Vec<Dot> {
    let plate = plate([x_m, y_m, depth_m], size_m, photons);
    let is_on = |place: &[f64; 3]| place[0] < x_m - size_m / 6.0 || place[1] < y_m - size_m / 6.0;
    plate.into_iter().filter(|(place, _)| is_on(place)).collect()
}

/// The near half of a sphere, of 600 dots, each with light by the square of its cosine to the wall's normal.
pub fn sphere([x_m, y_m, depth_m]: [f64; 3], radius_m: f64, photons: f64) -> Vec<Dot> {
    let turn = std::f64::consts::PI * (3.0 - 5_f64.sqrt());
    let dot = |n: usize| {
        let cosine = 1.0 - (n as f64 + 0.5) / 600.0;
        let (sine, angle) = ((1.0 - cosine * cosine).sqrt(), turn * n as f64);
        let across = [sine * angle.cos(), sine * angle.sin()];
        let place = [x_m + radius_m * across[0], y_m + radius_m * across[1], depth_m - radius_m * cosine];
        // The sum of the squares of 600 cosines is a third of their number.
        (place, photons * cosine * cosine / 200.0)
    };
    (0..600).map(dot).collect()
}

/// Runs the program; it must succeed.
pub fn periscope(folder: &Path, args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{args:?}\n{}", String::from_utf8_lossy(&output.stderr));
}
