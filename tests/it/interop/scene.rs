//! Captures of a wall that shows hidden points, made here: no code is shared with what reads or solves them.

use std::path::Path;

use periscope::formats::array::{Array, Arrays};
use periscope::formats::hdf5;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};

/// Speed of light, m/ps.
pub const LIGHT: f64 = 2.997_924_58e-4;
pub const LASER: [f64; 3] = [-0.5, 0.1, 1.0];
pub const SENSOR: [f64; 3] = [0.6, 0.0, 0.9];
/// In front of the wall z = 0.
pub const HIDDEN: [[f64; 3]; 2] = [[0.25, -0.1, 0.8], [-0.2, 0.2, 1.0]];
pub const FWHM_PS: f64 = 70.0;
pub const DT_PS: f64 = 16.0;
const BINS: usize = 800;
/// Photons in the highest bin over 0.8 m each way, and dark counts of a bin.
const PEAK: f64 = 400.0;
const DARK: f64 = 0.5;

/// Which pairs of points there are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Layout {
    Confocal,
    OneLit,
    All,
}

/// A capture to be made.
#[derive(Clone, Copy, Debug)]
pub struct Made {
    pub layout: Layout,
    /// Points on each side of the wall, which is a square of a metre.
    pub side: usize,
    pub with_legs: bool,
    /// Photons, or levels with white noise.
    pub counts: bool,
    pub seed: u64,
}

pub fn gap_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Made {
    pub fn wall(&self) -> Vec<[f64; 3]> {
        let along = |place: usize| place as f64 / (self.side - 1) as f64 - 0.5;
        (0..self.side).flat_map(|x| (0..self.side).map(move |y| [along(x), along(y), 0.0])).collect()
    }

    pub fn lit(&self) -> Vec<[f64; 3]> {
        if self.layout == Layout::OneLit { vec![[0.1, 0.03, 0.0]] } else { self.wall() }
    }

    pub fn pairs(&self) -> Vec<(usize, usize)> {
        let all = |count: usize| (0..count).flat_map(|lit| (0..self.side * self.side).map(move |seen| (lit, seen)));
        match self.layout {
            Layout::Confocal => (0..self.side * self.side).map(|place| (place, place)).collect(),
            Layout::OneLit => all(1).collect(),
            Layout::All => all(self.side * self.side).collect(),
        }
    }

    /// Path length at which the first bin begins, m.
    pub fn start_m(&self) -> f64 {
        if self.with_legs { 2.4 } else { 0.6 }
    }

    /// Histograms of the pairs.
    pub fn histograms(&self) -> Vec<Vec<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let (wall, lit) = (self.wall(), self.lit());
        let sigma_ps = FWHM_PS / 2.354_820_045;
        let of_pair = |(a, b): (usize, usize)| {
            let (a, b) = (lit[a], wall[b]);
            let legs_m = if self.with_legs { gap_m(LASER, a) + gap_m(b, SENSOR) } else { 0.0 };
            (0..BINS)
                .map(|bin| {
                    let light: f64 = HIDDEN
                        .iter()
                        .map(|hidden| {
                            let (out_m, back_m) = (gap_m(a, *hidden), gap_m(*hidden, b));
                            let arrival_ps = (legs_m + out_m + back_m - self.start_m()) / LIGHT;
                            // The pulse over the bin, by the middles of eight parts.
                            let part = |k: usize| (bin as f64 + (k as f64 + 0.5) / 8.0) * DT_PS - arrival_ps;
                            let pulse = (0..8).map(|k| (-0.5 * (part(k) / sigma_ps).powi(2)).exp()).sum::<f64>() / 8.0;
                            PEAK * (0.64 / (out_m * back_m)).powi(2) * pulse
                        })
                        .sum();
                    light + DARK
                })
                .collect::<Vec<f64>>()
        };
        let means: Vec<Vec<f64>> = self.pairs().into_iter().map(of_pair).collect();
        let noise = Normal::new(0.0, 0.02 * PEAK).unwrap();
        let mut draw = |mean: f64| {
            if self.counts {
                Poisson::new(mean).unwrap().sample(&mut rng)
            } else {
                1e-4 * (mean + noise.sample(&mut rng))
            }
        };
        means.into_iter().map(|histogram| histogram.into_iter().map(&mut draw).collect()).collect()
    }

    /// Writes it as y-tal does.
    pub fn write(&self, path: &Path) {
        let histograms = self.histograms();
        let side = self.side;
        let points: Vec<usize> = if self.layout == Layout::All { vec![side; 4] } else { vec![side; 2] };
        let values: Vec<f64> = (0..BINS).flat_map(|bin| histograms.iter().map(move |one| one[bin])).collect();
        let lit = self.lit();
        let lit_axes = if self.layout == Layout::OneLit { [1, 1, 3] } else { [side, side, 3] };
        let one = |value: f64| Array::of(&[], &[value]);
        let normals = |count: usize| [0.0, 0.0, 1.0].repeat(count);
        let arrays = [
            ("H", Array::of(&[&[BINS], points.as_slice()].concat(), &values)),
            ("H_format", one(if self.layout == Layout::All { 2.0 } else { 1.0 })),
            ("laser_xyz", Array::of(&[3], &LASER)),
            ("sensor_xyz", Array::of(&[3], &SENSOR)),
            ("laser_grid_xyz", Array::of(&lit_axes, lit.as_flattened())),
            ("laser_grid_normals", Array::of(&lit_axes, &normals(lit.len()))),
            ("sensor_grid_xyz", Array::of(&[side, side, 3], self.wall().as_flattened())),
            ("sensor_grid_normals", Array::of(&[side, side, 3], &normals(side * side))),
            ("delta_t", one(DT_PS * LIGHT)),
            ("t_start", one(self.start_m())),
            ("t_accounts_first_and_last_bounces", one(f64::from(u8::from(self.with_legs)))),
        ];
        save(path, &arrays.map(|(name, array)| (name.to_owned(), array)).into());
    }
}

pub fn save(path: &Path, arrays: &Arrays) {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    hdf5::write(&mut file, arrays).unwrap();
}
