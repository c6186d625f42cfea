//! What scans show without errors: to start from, and to compare with.

use nalgebra::Vector3;

use super::{Experiment, Mirror, Scan};
use crate::Point;
use crate::loss::Loss;
use crate::multilateration::{self, Tie};

/// Places nearer than this many standard deviations are one.
const APART: f64 = 4.0;
/// Newton steps along the beams.
const STEPS: usize = 50;

/// Distance along each beam to the mirror, from its scan alone; `None` where light came sooner than straight from
/// source to diffuser, or no later than along the beam.
///
/// With `d = D - L` and `s = z + y`, `|d - z u| = s - z` squared is linear: `z = (s^2 - |d|^2) / (2 (s - u . d))`.
#[must_use]
pub fn per_ray(experiment: &Experiment) -> Vec<Option<f64>> {
    let distance = |scan: &Scan| {
        let (folded_m, _) = experiment.folded_m(scan);
        let arm = scan.diffuser - experiment.source();
        let distance_m = (folded_m * folded_m - arm.norm_squared()) / (2.0 * (folded_m - scan.direction.dot(&arm)));
        (distance_m > 0.0 && distance_m < folded_m).then_some(distance_m)
    };
    experiment.scans.iter().map(distance).collect()
}

/// The paper's assumption: one distance along all beams, that of least squared contradiction. `None` where no scan has
/// one of its own.
#[must_use]
pub fn equal_distances(experiment: &Experiment) -> Option<f64> {
    let own: Vec<f64> = per_ray(experiment).into_iter().flatten().collect();
    let mut distance_m = own.iter().sum::<f64>() / own.len() as f64;
    if own.is_empty() {
        return None;
    }
    for _ in 0..STEPS {
        let (mut curvature, mut slope) = (0.0, 0.0);
        for scan in &experiment.scans {
            let onward = scan.diffuser - (experiment.source() + scan.direction * distance_m);
            let residual_m = experiment.folded_m(scan).0 - distance_m - onward.norm();
            let derivative = 1.0 - scan.direction.dot(&onward.normalize());
            curvature += derivative * derivative;
            slope += derivative * residual_m;
        }
        let step_m = slope / curvature;
        distance_m += step_m;
        if step_m.abs() < 1e-12 * distance_m {
            break;
        }
    }
    (distance_m.is_finite() && distance_m > 0.0).then_some(distance_m)
}

/// Mirrors whose virtual source has the scans' lengths from the diffuser points, those with the least contradiction
/// first. The contradiction is between reflected beams and diffuser points, in squared standard deviations. Several
/// where lengths leave a choice: two scans (in space, three), diffuser points in line (in a plane). None where they are
/// too few.
#[must_use]
pub fn virtual_source(experiment: &Experiment) -> Vec<(Mirror, f64)> {
    let sphere = |scan: &Scan| {
        let (folded_m, sd_m) = experiment.folded_m(scan);
        Tie::Path { from: scan.diffuser, to: scan.diffuser, length_m: 2.0 * folded_m, sd_m: 2.0 * sd_m }
    };
    let ties: Vec<Tie> = experiment.scans.iter().map(sphere).collect();
    let apart_m = experiment.scans.iter().map(|scan| APART * experiment.folded_m(scan).1).fold(0.0, f64::max);
    let images = multilateration::candidates(&ties, experiment.dimensions, apart_m, Loss::Squared);
    let mirrors = images.iter().filter_map(|image| Mirror::between(experiment.source(), image.point));
    let mut judged: Vec<(Mirror, f64)> = mirrors.map(|mirror| (mirror, contradiction(experiment, &mirror))).collect();
    judged.sort_by(|a, b| a.1.total_cmp(&b.1));
    judged
}

/// Squared distances between where a mirror sends the beams and the diffuser points, over their variances.
fn contradiction(experiment: &Experiment, mirror: &Mirror) -> f64 {
    let square = |scan: &Scan| {
        let (folded_m, sd_m) = experiment.folded_m(scan);
        let landed = mirror.image(unfolded(experiment, scan, folded_m));
        (landed - scan.diffuser).norm_squared() / (sd_m.powi(2) + (folded_m * scan.direction_sd_rad).powi(2))
    };
    experiment.scans.iter().map(square).sum()
}

/// The mirror that turns the beams' ends onto the diffuser points, in the mean: where to start from. `None` where they
/// are there already, within their errors.
pub(super) fn from_beams(experiment: &Experiment) -> Option<Mirror> {
    // End and diffuser point lie on one normal, as far apart as twice the way from the mirror: the farther, the better
    // they tell it.
    let (mut apart, mut middle, mut variance_m2) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for scan in &experiment.scans {
        let (folded_m, sd_m) = experiment.folded_m(scan);
        let end = unfolded(experiment, scan, folded_m);
        apart += end - scan.diffuser;
        middle += 0.5 * (end.coords + scan.diffuser.coords);
        variance_m2 += sd_m.powi(2) + (folded_m * scan.direction_sd_rad).powi(2);
    }
    let normal = apart.try_normalize(APART * variance_m2.sqrt())?;
    Some(Mirror { normal, offset_m: normal.dot(&middle) / experiment.scans.len() as f64 })
}

/// Where a beam would have come to without the mirror.
fn unfolded(experiment: &Experiment, scan: &Scan, folded_m: f64) -> Point {
    experiment.source() + scan.direction * folded_m
}
