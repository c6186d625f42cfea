//! A mirror as rows of tables.

use nalgebra::{Matrix3, Vector3};

use super::scans::Scans;
use crate::geometry::Point;
use crate::geometry::mirror::Solution;
use crate::priors::covariances;
use crate::tables::{Ambiguity, Patch, PatchCovariance, Plane};
use crate::units::PatchId;

/// A mirror point is weak where its largest principal standard deviation exceeds this share of its distance: errors are
/// then no longer small.
const WEAK: f64 = 0.1;

/// Rows of all tables.
#[derive(Default)]
pub struct Tables {
    pub patches: Vec<Patch>,
    pub covariances: Vec<PatchCovariance>,
    pub planes: Vec<Plane>,
    pub ambiguities: Vec<Ambiguity>,
}

impl Tables {
    /// The likeliest mirror.
    pub fn joint(scans: &Scans, solution: &Solution) -> Self {
        let ids: Vec<PatchId> = scans
            .patches
            .iter()
            .map(|(mirror, _)| *mirror)
            .chain(scans.patches.iter().map(|(_, seen)| *seen))
            .collect();
        let count = scans.patches.len();
        let freedom = solution.degrees_of_freedom;
        let fit = |row: Patch| Patch {
            chi2_dof: (freedom > 0).then(|| solution.chi2 / freedom as f64),
            log_likelihood: Some(-0.5 * solution.chi2),
            probability: Some(1.0),
            ..row
        };
        let places = solution.points.iter().chain(&solution.diffuser).enumerate();
        let row = |(place, point): (usize, &Point)| {
            let kind = if place < count { "mirror" } else { "visible" };
            let onsets = scans.experiment.scans[place % count].arrivals.len();
            fit(row(ids[place], kind, *point, Some(solution.covariance_m2(place, place)), onsets))
        };
        let pairs = (0..ids.len()).flat_map(|a| (0..ids.len()).map(move |b| (a, b))).filter(|&(a, b)| ids[a] < ids[b]);
        let covariance = |(a, b): (usize, usize)| covariances::row(ids[a], ids[b], &solution.covariance_m2(a, b));
        let (mut patches, mut covariances): (Vec<Patch>, Vec<PatchCovariance>) =
            (places.map(row).collect(), pairs.map(covariance).collect());
        patches.sort_by_key(|row| row.patch);
        covariances.sort_by_key(|row| (row.a, row.b));
        Self {
            patches,
            covariances,
            planes: vec![plane(&ids[..count], solution)],
            ambiguities: weak(scans, solution).into_iter().collect(),
        }
    }

    /// Mirror points without errors, the likeliest first, each with what its contradiction has more, and diffuser
    /// points as given.
    pub fn places(scans: &Scans, places: &[(Vec<Option<Point>>, f64)], reasons: &mut Vec<String>) -> Self {
        let mut tables = Self::default();
        for (n, (points, more)) in places.iter().enumerate() {
            let log_likelihood = (n > 0).then_some(-0.5 * more);
            let alternative = n as i32;
            for ((mirror, _), (point, scan)) in scans.patches.iter().zip(points.iter().zip(&scans.experiment.scans)) {
                match point {
                    Some(point) => {
                        let row = row(*mirror, "mirror", *point, None, scan.arrivals.len());
                        tables.patches.push(Patch { alternative, log_likelihood, ..row });
                    }
                    None => reasons.push(format!(
                        "mirror point {mirror}: no place on its ray makes a path of the measured length; check ray, diffuser point and latency against one another"
                    )),
                }
            }
            if n > 0 {
                tables.ambiguities.push(Ambiguity {
                    kind: "flip".into(),
                    patches: scans.patches.iter().map(|(mirror, _)| *mirror).collect(),
                    alternative: Some(alternative),
                    log_likelihood,
                    sd_m: None,
                    meaning: "path lengths leave another place of the mirror, and the rays do not decide; add a scan whose diffuser point lies off the line (in space, the plane) of the others"
                        .into(),
                });
            }
        }
        let diffuser = scans.patches.iter().zip(&scans.experiment.scans);
        tables.patches.extend(diffuser.map(|((_, seen), scan)| {
            row(*seen, "visible", scan.diffuser, Some(scan.diffuser_covariance_m2), scan.arrivals.len())
        }));
        tables.patches.sort_by_key(|row| (row.alternative, row.patch));
        tables
    }
}

fn row(patch: PatchId, kind: &str, point: Point, covariance_m2: Option<Matrix3<f64>>, onsets: usize) -> Patch {
    Patch { onsets: onsets as i32, ..covariances::patch_row(patch, kind, point, covariance_m2.as_ref()) }
}

/// The mirror, on which its points lie by construction.
fn plane(patches: &[PatchId], solution: &Solution) -> Plane {
    // The table's normals point away from the frame's origin, the kernel's from the laser.
    let side = if solution.mirror.offset_m < 0.0 { -1.0 } else { 1.0 };
    let normal: Vector3<f64> = solution.mirror.normal * side;
    Plane {
        plane: 1,
        patches: patches.to_vec(),
        normal_x: normal.x,
        normal_y: normal.y,
        normal_z: normal.z,
        offset_m: solution.mirror.offset_m * side,
        normal_sd_rad: solution.normal_covariance().symmetric_eigenvalues().max().max(0.0).sqrt(),
        offset_sd_m: solution.offset_sd_m(),
        rms_m: 0.0,
        farthest: patches[0],
        farthest_m: 0.0,
        chi2: 0.0,
        degrees_of_freedom: 0,
        tilt_rad: None,
        tilt_sd_rad: None,
    }
}

/// Mirror points that the scans tell so badly that their covariance says little.
fn weak(scans: &Scans, solution: &Solution) -> Option<Ambiguity> {
    let source = scans.experiment.stations[0].position;
    let sd_m = |place: usize| solution.covariance_m2(place, place).symmetric_eigenvalues().max().max(0.0).sqrt();
    let is_weak = |place: &usize| sd_m(*place) > WEAK * (solution.points[*place] - source).norm();
    let weak: Vec<usize> = (0..scans.patches.len()).filter(is_weak).collect();
    (!weak.is_empty()).then(|| Ambiguity {
        kind: "weak".into(),
        patches: weak.iter().map(|place| scans.patches[*place].0).collect(),
        alternative: None,
        log_likelihood: None,
        sd_m: Some(weak.iter().map(|place| sd_m(*place)).fold(0.0, f64::max)),
        meaning: "these mirror points are known to no better than a tenth of their distance: the beam is hardly turned, or lands close behind the mirror; let it land farther off, or add scans"
            .into(),
    })
}
