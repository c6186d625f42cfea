//! f-k migration of a grid, its blocks shared among threads.
//!
//! Counts are stabilised and divided by their standard deviation, so that the noise of all histograms is alike: that of
//! one point, sent through the same migration, gives the variance of each voxel. Squares of such noise are taken over
//! several records and neighbouring depths, and summed over the points with light.

use rayon::prelude::*;

use super::lattice::{Grid, Row, Summary};
use super::light_cone::first_of_each;
use super::{FWHM, Histogram, SMOOTH, STEPS, Task};
use crate::signal::fft::Complex;
use crate::signal::image::back_projection::Stabiliser;
use crate::signal::image::foreground::{self, Foreground};
use crate::signal::image::migration::{Migration, Wave, Workspace};
use crate::signal::image::threshold;

/// Squares of noise over all points, and records of noise of a point at the most and at the least.
const SQUARES: usize = 16_384;
const RECORDS: [usize; 2] = [2, 64];
/// Least standard deviation of a bin that is divided by, as a share of that of the histogram.
const LEAST: f64 = 0.5;
/// Power of the distance by which the light of a wave falls off.
const OF_WAVES: f64 = 1.0;

/// A histogram: time of its first bin, width of its bins, and its light without the smooth part.
type Light = (f64, f64, Foreground);

/// The image of a grid.
pub fn image(task: &Task<'_>, grid: &Grid) -> Summary {
    let migration = migration(task, grid);
    let lattice = grid.lattice.at(task.depths_m((0..migration.depths()).map(|bin| migration.depth_ps(bin))));
    let threshold = threshold(lattice.cells().max(1), task.params.false_alarm.get());
    let summary = Summary::new(lattice, threshold, task.params.volume);
    let variances = variances(task, grid, &migration);
    let slices = slices(task, grid, &migration);
    let (columns, depths) = (grid.lattice.columns, summary.lattice.depths_m.len());
    let row = |w: &mut Workspace, y: usize| {
        task.cancel.check();
        let values = first_of_each(&migration.values(w, y, &slices), migration.depths(), depths);
        let of_voxel = |n: usize| f64::from(variances[n % depths][y * columns + n / depths]);
        summary.row(y, values.into_iter().enumerate().map(|(n, value)| (value, of_voxel(n))))
    };
    let rows: Vec<Row> = (0..grid.lattice.rows).into_par_iter().map_init(|| migration.workspace(), row).collect();
    summary.join(rows)
}

/// The migration of the scan. Stabilised counts are roots of light, so that they fall off with half the power.
fn migration(task: &Task<'_>, grid: &Grid) -> Migration {
    let is_counts = task.histograms.iter().all(Histogram::is_counts);
    let falloff = task.params.falloff.get() * if is_counts { 0.5 } else { 1.0 };
    // Whole bins, so that each step has as many.
    let dt_ps = task.histograms[0].dt_ps();
    let step_ps = (task.width_ps / STEPS / dt_ps).floor().max(1.0) * dt_ps;
    Migration::new(task.scan(grid, step_ps), Wave { growth: falloff - OF_WAVES, response_ps: task.width_ps / FWHM })
}

/// The image, by wavenumbers of depth.
fn slices(task: &Task<'_>, grid: &Grid, migration: &Migration) -> Vec<Vec<Complex<f32>>> {
    let (stabiliser, workspace) = (Stabiliser::new(), || migration.workspace());
    let row = |w: &mut Workspace, places: &[Option<usize>]| {
        let of_point = |place: &Option<usize>| Some(light(task, &stabiliser, &task.histograms[(*place)?]));
        migration.row(w, &places.iter().map(of_point).collect::<Vec<_>>())
    };
    let rows: Vec<_> = grid.places.par_chunks(grid.lattice.columns).map_init(workspace, row).collect();
    let plane = |w: &mut Workspace, k: usize| {
        task.cancel.check();
        migration.plane(w, k, &rows)
    };
    let planes: Vec<_> = (0..migration.frequencies()).into_par_iter().map_init(workspace, plane).collect();
    // What is done with is dropped at once: at its largest the memory is that of a few volumes.
    drop(rows);
    let slice = |w: &mut Workspace, k: usize| {
        task.cancel.check();
        migration.slice(w, k, &planes)
    };
    (0..migration.wavenumbers()).into_par_iter().map_init(workspace, slice).collect()
}

/// Variances of all voxels: depths, each a plane of the grid.
fn variances(task: &Task<'_>, grid: &Grid, migration: &Migration) -> Vec<Vec<f32>> {
    let (rows, depths) = (grid.lattice.rows, migration.depths());
    let workspace = || migration.workspace();
    let records = (SQUARES / grid.places.len()).clamp(RECORDS[0], RECORDS[1]);
    let mut squares = vec![vec![0.0_f32; grid.lattice.columns * depths]; rows];
    for record in 0..records {
        let spectrum = migration.row(&mut workspace(), &[Some(noise(task, record as u64))]);
        let kernel = |w: &mut Workspace, k: usize| {
            task.cancel.check();
            migration.kernel(w, k, &spectrum)
        };
        let slices: Vec<_> = (0..migration.wavenumbers()).into_par_iter().map_init(workspace, kernel).collect();
        squares.par_iter_mut().enumerate().for_each_init(workspace, |w, (y, sums)| {
            for (column, sums) in migration.values(w, y, &slices).chunks(depths).zip(sums.chunks_mut(depths)) {
                let squares: Vec<f64> = column.iter().map(|value| value * value).collect();
                // Over a width of the response to either side.
                let means = foreground::rate(&squares, STEPS as usize);
                sums.iter_mut().zip(means).for_each(|(sum, mean)| *sum += (mean / records as f64) as f32);
            }
        });
    }
    let has_light: Vec<bool> = grid.places.iter().map(Option::is_some).collect();
    let spread = |w: &mut Workspace, depth: usize| {
        task.cancel.check();
        let plane = migration.spread(w, depth, &squares, &has_light);
        plane.into_iter().map(|variance| variance as f32).collect()
    };
    (0..depths).into_par_iter().map_init(workspace, spread).collect()
}

/// A histogram in units of its noise.
fn light(task: &Task<'_>, stabiliser: &Stabiliser, histogram: &Histogram<'_>) -> Light {
    let (first_ps, values, sd) = task.stabilised(stabiliser, histogram);
    // Where hardly a photon is expected one alone would outweigh all light.
    let least = LEAST * (sd.iter().map(|sd| sd * sd).sum::<f64>() / sd.len().max(1) as f64).sqrt();
    let scores = values.iter().zip(&sd).map(|(value, sd)| if least > 0.0 { value / sd.max(least) } else { 0.0 });
    whiten(task, histogram, first_ps, &scores.collect::<Vec<_>>())
}

/// A record of nothing but noise: signs without a pattern.
fn noise(task: &Task<'_>, record: u64) -> Light {
    let histogram = &task.histograms[0];
    let (first_ps, values) = histogram.behind(&task.times);
    let signs = (0..values.len() as u64).map(|n| if digits(record << 32 | n) >> 63 == 0 { 1.0 } else { -1.0 });
    whiten(task, histogram, first_ps, &signs.collect::<Vec<_>>())
}

/// Values of unit variance without their smooth part.
fn whiten(task: &Task<'_>, histogram: &Histogram<'_>, first_ps: f64, values: &[f64]) -> Light {
    let half = (SMOOTH * task.width_ps / histogram.dt_ps()).ceil() as usize;
    (first_ps, histogram.dt_ps(), foreground::foreground(values, &vec![1.0; values.len()], half))
}

/// Digits of a number mixed (splitmix64, Steele et al., OOPSLA 2014): the same on every machine.
fn digits(n: u64) -> u64 {
    let mut mixed = n.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}
