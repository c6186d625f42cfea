//! The information of all captures together about the positions of the patches.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};

use super::profile::{ProfileBound, eliminate, response};
use crate::campaign::Role;
use crate::campaign::keys::{LASER, PatchRole};
use crate::simulate::Laboratory;
use crate::units::{self, PatchId};

/// Information below this, in units of each patch's own information, counts as none.
const UNKNOWN: f64 = 1e-11;

/// Bound of all patches together.
#[derive(Clone, Debug)]
pub struct Coordinates {
    /// Patches about which there is information, in order; three coordinates each (two in flatland).
    pub patches: Vec<PatchId>,
    /// Number of coordinates of a patch.
    pub dimensions: usize,
    /// Covariance in square metres, without rotations of the visible patches that path lengths do not determine.
    pub covariance: DMatrix<f64>,
    /// Number of rotations about the stations that path lengths do not determine.
    pub turns: usize,
    /// For each patch, whether an undetermined combination of coordinates moves it. The covariance excludes such
    /// combinations.
    pub loose: Vec<bool>,
    /// Number of onsets that determine each patch.
    pub onsets: Vec<usize>,
}

/// Indices of the unknowns.
struct Unknowns {
    patches: Vec<PatchId>,
    dimensions: usize,
    /// Index of the delay of each sensor at each range; the width follows.
    sensors: BTreeMap<(String, Option<String>), usize>,
    count: usize,
}

impl Coordinates {
    pub(super) fn new(laboratory: &Laboratory, profiles: &[ProfileBound], bounces: usize) -> Self {
        let scene = laboratory.scene;
        let usable = |path: &[PatchId]| {
            path.len() <= bounces
                && path.iter().all(|patch| scene.patches.get(patch).is_some_and(|disk| disk.role != PatchRole::Mirror))
        };
        let used = |profile: &'_ ProfileBound| -> Vec<usize> {
            let sound = |&k: &usize| usable(&profile.pulses[k].path) && profile.pulses[k].time_sd_ps.is_some();
            profile.detected.iter().copied().filter(sound).collect()
        };
        let mut onsets: BTreeMap<PatchId, usize> = BTreeMap::new();
        for profile in profiles {
            for k in used(profile) {
                let mut met = profile.pulses[k].path.clone();
                met.sort_unstable();
                met.dedup();
                met.into_iter().for_each(|patch| *onsets.entry(patch).or_default() += 1);
            }
        }
        let patches: Vec<PatchId> = onsets.keys().copied().collect();
        let dimensions = usize::from(scene.dimensions);
        let mut sensors = BTreeMap::new();
        for profile in profiles {
            let place = dimensions * patches.len() + 2 * sensors.len();
            sensors.entry((profile.sensor.clone(), profile.range.clone())).or_insert(place);
        }
        let count = dimensions * patches.len() + 2 * sensors.len();
        let unknowns = Unknowns { patches, dimensions, sensors, count };
        let mut information = DMatrix::zeros(count, count);
        for profile in profiles {
            let used = used(profile);
            if !used.is_empty() {
                information += unknowns.of_profile(laboratory, profile, &used);
            }
        }
        for shooting in laboratory.shootings.iter().filter(|shooting| shooting.role == Role::Response) {
            let key = (shooting.sensor.clone(), shooting.setting.name.clone());
            let Some(&place) = unknowns.sensors.get(&key) else {
                continue;
            };
            let path_sd_ps = units::time_ps(scene.captures.path_sd_m, scene.group_index);
            let mut response = response(laboratory, shooting);
            // The time of the response is the delay plus the error of the path.
            if path_sd_ps > 0.0 {
                let pulled = response.column(0).into_owned();
                response -= &pulled * pulled.transpose() / (1.0 / (path_sd_ps * path_sd_ps) + pulled[0]);
            }
            let mut block = information.view_mut((place, place), (2, 2));
            block += response;
        }
        unknowns.solve(laboratory, &information, &onsets)
    }

    /// Square root of the sum of a patch's variances; `None` for a patch without enough information.
    #[must_use]
    pub fn sd_m(&self, patch: PatchId) -> Option<f64> {
        let place = self.patches.iter().position(|other| *other == patch).filter(|&place| !self.loose[place])?;
        let variances = (0..self.dimensions).map(|k| {
            let at = place * self.dimensions + k;
            self.covariance[(at, at)]
        });
        Some(variances.sum::<f64>().sqrt())
    }

    /// Covariance of a patch's coordinates in square metres, row by row; `None` as for its standard deviation.
    #[must_use]
    pub fn covariance_m2(&self, patch: PatchId) -> Option<Vec<Vec<f64>>> {
        let place = self.patches.iter().position(|other| *other == patch).filter(|&place| !self.loose[place])?;
        let (start, size) = (place * self.dimensions, self.dimensions);
        let block = self.covariance.view((start, start), (size, size)).into_owned();
        Some(block.row_iter().map(|row| row.iter().copied().collect()).collect())
    }

    /// Root of the mean squared position error.
    #[must_use]
    pub fn rms_m(&self) -> f64 {
        (self.covariance.trace() / self.patches.len().max(1) as f64).sqrt()
    }
}

impl Unknowns {
    /// Information of one profile: its times as functions of coordinates and delay, its width as that of the sensor.
    fn of_profile(&self, laboratory: &Laboratory, profile: &ProfileBound, used: &[usize]) -> DMatrix<f64> {
        let indices: Vec<usize> = used
            .iter()
            .map(|k| profile.detected.iter().position(|other| other == k).expect("used ones are detected"))
            .chain([profile.detected.len()])
            .collect();
        let information = eliminate(&profile.information, &indices);
        let mut slopes = DMatrix::zeros(indices.len(), self.count);
        let delay = self.sensors[&(profile.sensor.clone(), profile.range.clone())];
        for (row, &k) in used.iter().enumerate() {
            slopes[(row, delay)] = 1.0;
            for (patch, slope) in slopes_ps_m(laboratory, &profile.sensor, &profile.pulses[k].path) {
                let place = self.patches.iter().position(|other| *other == patch).expect("used paths are known");
                for axis in 0..self.dimensions {
                    slopes[(row, place * self.dimensions + axis)] += slope[axis];
                }
            }
        }
        slopes[(used.len(), delay + 1)] = 1.0;
        slopes.transpose() * information * slopes
    }

    fn solve(
        self,
        laboratory: &Laboratory,
        information: &DMatrix<f64>,
        onsets: &BTreeMap<PatchId, usize>,
    ) -> Coordinates {
        let size = self.dimensions * self.patches.len();
        if size == 0 {
            let covariance = DMatrix::zeros(0, 0);
            let (patches, dimensions) = (self.patches, self.dimensions);
            return Coordinates { patches, dimensions, covariance, turns: 0, loose: Vec::new(), onsets: Vec::new() };
        }
        let indices: Vec<usize> = (0..size).collect();
        let gauge = self.turns(laboratory);
        let turns = gauge.ncols();
        let coordinates = eliminate(information, &indices);
        // In units of each patch's own information, so that near and far patches have equal weight.
        let own = |patch: usize| {
            let places = patch * self.dimensions..(patch + 1) * self.dimensions;
            places.map(|i| coordinates[(i, i)]).sum::<f64>().sqrt()
        };
        let scale = DVector::from_fn(size, |i, _| own(i / self.dimensions));
        let scaled = DMatrix::from_fn(size, size, |i, j| coordinates[(i, j)] / (scale[i] * scale[j]));
        // Rotations, in the same units, are fixed here, and removed from the covariance afterwards.
        let fixed_turns = orthonormal(size, gauge.column_iter().map(|turn| turn.component_mul(&scale)));
        let eigen = SymmetricEigen::new(scaled + &fixed_turns * fixed_turns.transpose());
        let mut covariance = DMatrix::zeros(size, size);
        let mut loose = vec![false; self.patches.len()];
        for (k, value) in eigen.eigenvalues.iter().enumerate() {
            let vector = eigen.eigenvectors.column(k);
            if *value > UNKNOWN {
                let vector = vector.component_div(&scale);
                covariance += &vector * vector.transpose() / *value;
                continue;
            }
            for (place, loose) in loose.iter_mut().enumerate() {
                *loose |= vector.rows(place * self.dimensions, self.dimensions).norm() > 1e-3;
            }
        }
        // The visible patches define the frame: errors of hidden ones do not rotate it.
        let mut visible_turns = gauge.clone();
        for (place, patch) in self.patches.iter().enumerate() {
            if laboratory.scene.patches[patch].role == PatchRole::Hidden {
                visible_turns.rows_mut(place * self.dimensions, self.dimensions).fill(0.0);
            }
        }
        let share =
            (visible_turns.transpose() * &gauge).try_inverse().unwrap_or_else(|| DMatrix::identity(turns, turns));
        let free = DMatrix::identity(size, size) - &gauge * share * visible_turns.transpose();
        let covariance = &free * covariance * free.transpose();
        let onsets = self.patches.iter().map(|patch| onsets[patch]).collect();
        Coordinates { patches: self.patches, dimensions: self.dimensions, covariance, turns, loose, onsets }
    }

    /// Orthonormal columns: rotations of all patches about the stations that leave every station in place.
    fn turns(&self, laboratory: &Laboratory) -> DMatrix<f64> {
        let scene = laboratory.scene;
        let source = Vector3::from(scene.stations[LASER].position_m);
        let arms: Vec<Vector3<f64>> =
            scene.sensors.keys().map(|name| Vector3::from(scene.sensor_m(name)) - source).collect();
        let longest = arms.iter().copied().max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_default();
        let axes: Vec<Vector3<f64>> = if longest.norm() < 1e-9 {
            if self.dimensions == 2 { vec![Vector3::z()] } else { vec![Vector3::x(), Vector3::y(), Vector3::z()] }
        } else if self.dimensions == 3 && arms.iter().all(|arm| arm.cross(&longest).norm() < 1e-9) {
            vec![longest.normalize()]
        } else {
            Vec::new()
        };
        let turn = |axis: &Vector3<f64>| {
            let moved = self.patches.iter().flat_map(|patch| {
                let arm = Vector3::from(scene.patches[patch].position_m) - source;
                let moved = axis.cross(&arm);
                (0..self.dimensions).map(move |k| moved[k])
            });
            DVector::from_iterator(self.dimensions * self.patches.len(), moved)
        };
        let size = self.dimensions * self.patches.len();
        orthonormal(size, axes.iter().map(turn))
    }
}

/// Orthonormal columns that span the same space (Gram-Schmidt).
fn orthonormal(size: usize, columns: impl Iterator<Item = DVector<f64>>) -> DMatrix<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for mut column in columns {
        let length = column.norm();
        for other in &basis {
            column -= other * other.dot(&column);
        }
        if column.norm() > 1e-9 * length {
            basis.push(column.normalize());
        }
    }
    if basis.is_empty() { DMatrix::zeros(size, 0) } else { DMatrix::from_columns(&basis) }
}

/// Derivative of a path's time with respect to its patches, in ps per metre: sums of unit vectors from the neighbours
/// before and after.
fn slopes_ps_m(laboratory: &Laboratory, sensor: &str, path: &[PatchId]) -> Vec<(PatchId, Vector3<f64>)> {
    let scene = laboratory.scene;
    let ps_per_m = units::time_ps(1.0, scene.group_index);
    let mut points = vec![Vector3::from(scene.stations[LASER].position_m)];
    points.extend(path.iter().map(|patch| Vector3::from(scene.patches[patch].position_m)));
    points.push(Vector3::from(scene.sensor_m(sensor)));
    let slope = |k: usize| {
        let (before, after) = (points[k] - points[k - 1], points[k] - points[k + 1]);
        (before.normalize() + after.normalize()) * ps_per_m
    };
    path.iter().enumerate().map(|(k, patch)| (*patch, slope(k + 1))).collect()
}
