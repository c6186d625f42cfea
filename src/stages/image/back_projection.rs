//! Filtered back-projection of any pairs, its rows of voxels shared among threads.

use rayon::prelude::*;

use super::lattice::{Row, Summary, Wall};
use super::{Histogram, Task};
use crate::parameter::Positive;
use crate::signal::image::back_projection::{Stabiliser, Trace, scores, voxel};
use crate::signal::image::threshold;
use crate::stages::stage::StageError;

/// Voxels across the path that light takes within a width of the response.
const STEPS: f64 = 4.0;
/// Largest number of voxels.
const VOXELS: f64 = 1e8;

/// The image in front of a wall.
pub fn image(task: &Task<'_>, wall: &Wall) -> Result<Summary, StageError> {
    let pitch_m = task.params.pitch_m.map_or(task.medium.path_m(task.width_ps) / STEPS, Positive::get);
    let [near_m, far_m] = [task.times.gate_ps, task.times.end_ps].map(|time_ps| 0.5 * task.medium.path_m(time_ps));
    let far_m = task.params.depth_max_m.map_or(far_m, |most| far_m.min(most.get()));
    let depths = ((far_m - near_m) / pitch_m).max(0.0);
    let lattice = wall.lattice(pitch_m);
    if depths * (lattice.columns * lattice.rows) as f64 > VOXELS {
        return Err(StageError::Refused(format!(
            "an image of {} x {} x {depths:.0} voxels is too large: {VOXELS:.0} are the most; give a larger `pitch_m` than {pitch_m:.4}, or `depth_max_m`",
            lattice.columns, lattice.rows
        )));
    }
    let depths_m: Vec<f64> = (0..depths as usize).map(|n| near_m + (n as f64 + 0.5) * pitch_m).collect();
    let lattice = lattice.at(depths_m);
    let threshold = threshold(lattice.cells().max(1), task.params.false_alarm.get());
    let summary = Summary::new(lattice, threshold, task.params.volume);
    let stabiliser = Stabiliser::new();
    let traces: Vec<Trace> = task.histograms.par_iter().map(|one| trace(task, &stabiliser, one)).collect();
    let voxel_at = |place: [usize; 3]| {
        task.cancel.check();
        let point = summary.lattice.point(place).coords.map(|along_m| task.medium.time_ps(along_m));
        let (sum, sd) = voxel(&traces, point.into());
        (sum, sd * sd)
    };
    let row = |y: usize| {
        let columns = 0..summary.lattice.columns;
        let depths = summary.lattice.depths_m.len();
        summary.row(y, columns.flat_map(|x| (0..depths).map(move |depth| [x, y, depth])).map(voxel_at))
    };
    let rows: Vec<Row> = (0..summary.lattice.rows).into_par_iter().map(row).collect();
    Ok(summary.join(rows))
}

/// Scores of a histogram behind the gate.
fn trace(task: &Task<'_>, stabiliser: &Stabiliser, histogram: &Histogram<'_>) -> Trace {
    let (first_ps, values, sd) = task.stabilised(stabiliser, histogram);
    let place_ps = |point: crate::geometry::Point| point.coords.map(|along_m| task.medium.time_ps(along_m)).into();
    Trace {
        lit: place_ps(histogram.lit),
        seen: place_ps(histogram.seen),
        first_ps,
        dt_ps: histogram.dt_ps(),
        scores: scores(&values, &sd, task.width_ps / super::FWHM / histogram.dt_ps()),
    }
}
