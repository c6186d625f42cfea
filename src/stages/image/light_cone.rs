//! The light-cone transform of a grid, its blocks shared among threads.

use rayon::prelude::*;

use super::lattice::{Grid, Row, Summary};
use super::{FWHM, Histogram, SMOOTH, STEPS, Task};
use crate::signal::fft::Complex;
use crate::signal::image::foreground::{self, Foreground};
use crate::signal::image::light_cone::{LightCone, Prior, RowSpectra, Slice, Workspace};
use crate::signal::image::threshold;

/// Frequencies whose variances are computed before they take the place of the histograms' own.
const BLOCK: usize = 64;

/// The image of a grid.
pub fn image(task: &Task<'_>, grid: &Grid) -> Summary {
    let cone = cone(task, grid);
    let lattice = grid.lattice.at(task.depths_m((0..cone.depths()).map(|bin| cone.depth_ps(bin))));
    let threshold = threshold(lattice.cells().max(1), task.params.false_alarm.get());
    let summary = Summary::new(lattice, threshold, task.params.volume);
    let (slices, variances) = spectra(task, grid, &cone);
    let depths = summary.lattice.depths_m.len();
    let row = |w: &mut Workspace, y: usize| {
        task.cancel.check();
        let voxels = [cone.values(w, y, &slices), cone.variances(w, &variances[y])];
        let [values, variances] = voxels.map(|all| first_of_each(&all, cone.depths(), depths));
        summary.row(y, values.into_iter().zip(variances))
    };
    let rows: Vec<Row> = (0..grid.lattice.rows).into_par_iter().map_init(|| cone.workspace(), row).collect();
    summary.join(rows)
}

/// The first `kept` of each `count` values.
pub fn first_of_each(values: &[f64], count: usize, kept: usize) -> Vec<f64> {
    values.chunks(count).flat_map(|column| &column[..kept]).copied().collect()
}

/// The transform of the scan.
fn cone(task: &Task<'_>, grid: &Grid) -> LightCone {
    let prior = Prior {
        falloff: task.params.falloff.get(),
        signal_to_noise: task.params.signal_to_noise.get(),
        response_ps: task.width_ps / FWHM,
    };
    LightCone::new(task.scan(grid, task.width_ps / STEPS), prior)
}

/// Spectra of the image and of its variance: a slice for each frequency, and a row of all frequencies for each row.
fn spectra(task: &Task<'_>, grid: &Grid, cone: &LightCone) -> (Vec<Slice>, Vec<Vec<Complex<f64>>>) {
    let row = |w: &mut Workspace, places: &[Option<usize>]| {
        task.cancel.check();
        let histograms: Vec<_> = places.iter().map(|place| Some(light(task, &task.histograms[(*place)?]))).collect();
        let RowSpectra { values, variances } = cone.row(w, &histograms);
        (values, variances)
    };
    let workspace = || cone.workspace();
    let rows = grid.places.par_chunks(grid.lattice.columns).map_init(workspace, row);
    let (values, mut variances): (Vec<_>, Vec<_>) = rows.unzip();
    let frequencies = || (0..cone.frequencies()).into_par_iter();
    let filter = |w: &mut Workspace, k: usize| {
        task.cancel.check();
        cone.filter(w, k, &values)
    };
    let mut slices: Vec<Slice> = frequencies().map_init(workspace, filter).collect();
    // What is done with is dropped at once: at its largest the memory is that of a few volumes.
    drop(values);
    let square = |w: &mut Workspace, y: usize| {
        task.cancel.check();
        cone.square(w, y, &slices)
    };
    let squares: Vec<_> = (0..grid.lattice.rows).into_par_iter().map_init(workspace, square).collect();
    slices.iter_mut().for_each(|slice| slice.kernel = Vec::new());
    let spread = |w: &mut Workspace, k: usize, variances: &[Vec<Complex<f64>>]| {
        task.cancel.check();
        cone.spread(w, k, variances, &squares)
    };
    let mut first = 0;
    while first < cone.frequencies() {
        let block = first..(first + BLOCK).min(cone.frequencies());
        let planes: Vec<_> =
            block.clone().into_par_iter().map_init(workspace, |w, k| spread(w, k, &variances)).collect();
        block.zip(&planes).for_each(|(k, plane)| cone.keep(k, plane, &mut variances));
        first += BLOCK;
    }
    (slices, variances)
}

/// Time of the first bin behind the gate, width of a bin, and light without its smooth part.
fn light(task: &Task<'_>, histogram: &Histogram<'_>) -> (f64, f64, Foreground) {
    let (first_ps, values) = histogram.behind(&task.times);
    let variances = histogram.variances(&task.times, &values);
    let half = (SMOOTH * task.width_ps / histogram.dt_ps()).ceil() as usize;
    (first_ps, histogram.dt_ps(), foreground::foreground(&values, &variances, half))
}
