//! Patches in place with their errors, and the times of paths over them.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::problem::{SensorProfiles, View};
use crate::Point;
use crate::association::Time;
use crate::footprint::{Footprints, LengthSpread};
use crate::hidden::{Focus, Hidden, facing};
use crate::units::PatchId;

/// Bounces of paths over patches that only hidden ones show.
pub(super) const DEEP: usize = 5;

/// Patches in place with their errors.
#[derive(Clone, Debug)]
pub struct Scene {
    pub(super) points: BTreeMap<PatchId, Point>,
    /// Of each patch (a, a), and of two patches both ways.
    covariances_m2: BTreeMap<(PatchId, PatchId), Matrix3<f64>>,
    footprints: Footprints,
    normals: BTreeMap<PatchId, Vector3<f64>>,
    /// Patches that only hidden ones show, each with the chance that a path over it makes an arrival.
    deep: BTreeMap<PatchId, f64>,
    /// The hidden patches that show these.
    shown_by: Vec<PatchId>,
}

/// Light of one path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Mean length of the path over its patches.
    pub length_m: f64,
    /// Standard deviation of that by the errors of the patches' places.
    pub length_sd_m: f64,
    /// How far lengths are spread over the patches.
    pub spread: LengthSpread,
}

/// A path with the time at which its light is expected.
pub(super) struct Prediction {
    pub(super) path: Vec<PatchId>,
    /// Laser periods that are taken off the time.
    pub(super) turns: i32,
    pub(super) time: Time,
}

impl Scene {
    /// Of patches with the covariance of each position. `between_m2` holds covariances of two patches (rows: the
    /// first); those of other pairs are 0. `normals` are those of the walls that are known.
    #[must_use]
    pub fn new(
        patches: &BTreeMap<PatchId, (Point, Matrix3<f64>)>,
        between_m2: &BTreeMap<(PatchId, PatchId), Matrix3<f64>>,
        footprints: Footprints,
        normals: BTreeMap<PatchId, Vector3<f64>>,
    ) -> Self {
        let points = patches.iter().map(|(patch, (point, _))| (*patch, *point)).collect();
        let own = patches.iter().map(|(patch, (_, own_m2))| ((*patch, *patch), *own_m2));
        let pairs =
            between_m2.iter().flat_map(|(&(a, b), block_m2)| [((a, b), *block_m2), ((b, a), block_m2.transpose())]);
        Self {
            points,
            covariances_m2: own.chain(pairs).collect(),
            footprints,
            normals,
            deep: BTreeMap::new(),
            shown_by: Vec::new(),
        }
    }

    /// With hidden patches.
    pub(super) fn with(&self, hidden: impl Iterator<Item = (PatchId, Hidden)>) -> Self {
        let mut scene = self.clone();
        for (patch, surface) in hidden {
            scene.points.insert(patch, surface.point);
            scene.covariances_m2.insert((patch, patch), surface.covariance);
        }
        scene
    }

    /// With a patch where other light shows it; its error is independent of those of others.
    pub(super) fn moved(&self, patch: PatchId, place: &Hidden) -> Self {
        let mut scene = self.with(std::iter::once((patch, *place)));
        scene.covariances_m2.retain(|&(a, b), _| a == b || (a != patch && b != patch));
        scene
    }

    /// With a patch where other light shows it, near its own place, and an error that covers both.
    pub(super) fn stretched(&self, patch: PatchId, place: &Hidden) -> Self {
        let between_m = place.point - self.points[&patch];
        self.moved(patch, &Hidden { covariance: place.covariance + between_m * between_m.transpose(), ..*place })
    }

    /// With patches that only the hidden ones `shown_by` show.
    pub(super) fn with_deep(&self, hidden: &[(PatchId, Hidden)], shown_by: &[PatchId]) -> Self {
        let mut scene = self.with(hidden.iter().copied());
        scene.deep.extend(hidden.iter().map(|(patch, surface)| (*patch, surface.seen)));
        scene.shown_by = shown_by.to_vec();
        scene
    }

    /// Patches in place that some profile lights or sees, ascending.
    pub(super) fn visible(&self, sensors: &[SensorProfiles]) -> Vec<PatchId> {
        let profiles = sensors.iter().flat_map(|sensor| &sensor.profiles);
        let ends: BTreeSet<PatchId> = profiles.flat_map(|profile| [profile.lit, profile.seen]).collect();
        ends.into_iter().filter(|patch| self.has(&[*patch])).collect()
    }

    /// Whether only hidden patches show this one.
    pub(super) fn is_deep(&self, patch: PatchId) -> bool {
        self.deep.contains_key(&patch)
    }

    /// Chance that a path over a patch that only hidden ones show makes an arrival; `None` for other paths.
    pub(super) fn deep_chance(&self, path: &[PatchId]) -> Option<f64> {
        path.iter().find_map(|patch| self.deep.get(patch)).copied()
    }

    /// Paths over patches that only hidden ones show.
    pub(super) fn deep_paths(&self, lit: PatchId, seen: PatchId) -> impl Iterator<Item = Vec<PatchId>> {
        let pairs = || self.shown_by.iter().flat_map(|a| self.shown_by.iter().map(move |b| (*a, *b)));
        self.deep.keys().flat_map(move |x| pairs().map(move |(a, b)| vec![lit, a, *x, b, seen]))
    }

    /// Visible patches with the sides of their walls that are lit.
    pub(super) fn foci(&self, visible: &[PatchId], source: Point, dimensions: usize) -> Vec<Focus> {
        let normals: Vec<_> = visible.iter().map(|patch| self.normals.get(patch).copied()).collect();
        facing::fronts(&self.points_of(visible), &normals, source, dimensions)
    }

    pub(super) fn points_of(&self, patches: &[PatchId]) -> Vec<Point> {
        patches.iter().map(|patch| self.points[patch]).collect()
    }

    /// Whether all patches of a path are in place.
    #[must_use]
    pub fn has(&self, path: &[PatchId]) -> bool {
        path.iter().all(|patch| self.points.contains_key(patch))
    }

    /// Sum of the variances of a patch's coordinates.
    pub(super) fn variance_m2(&self, patch: PatchId) -> f64 {
        self.covariances_m2[&(patch, patch)].trace()
    }

    /// Size of the largest patch, if it is more than a point.
    pub(super) fn largest_m(&self) -> f64 {
        self.footprints.largest_m()
    }

    /// Variance that a patch's error gives to two legs: one along a direction, the other in any direction.
    pub(super) fn legs_variance_m2(&self, patch: PatchId, along: &Vector3<f64>) -> f64 {
        let block_m2 = &self.covariances_m2[&(patch, patch)];
        let along_m = along.dot(&(block_m2 * along)).max(0.0).sqrt();
        along_m * along_m + block_m2.trace() / 3.0
    }

    /// The time of a path as the profile's sensor records it, the profile's delay included.
    pub(super) fn predict(&self, path: Vec<PatchId>, view: View) -> Prediction {
        let medium = view.medium();
        let stations = [view.sensor.source, view.sensor.sensor];
        let time = Time {
            time_ps: medium.time_ps(self.length_m(&path, stations)) + view.profile.delay_ps,
            sd_ps: medium.time_ps(self.length_sd_m(&path, stations)).hypot(view.profile.delay_sd_ps),
        };
        Prediction { path, turns: 0, time }
    }

    /// The light that takes a path from a laser at `source` to a sensor.
    ///
    /// # Panics
    /// Where a patch of the path is not in place ([`Self::has`]).
    #[must_use]
    pub fn light(&self, path: &[PatchId], source: Point, sensor: Point) -> Light {
        Light {
            length_m: self.length_m(path, [source, sensor]),
            length_sd_m: self.length_sd_m(path, [source, sensor]),
            spread: self.footprints.spread(source, path, |patch| self.points[patch], sensor),
        }
    }

    /// Mean length of a path over the footprints of its patches.
    fn length_m(&self, path: &[PatchId], [source, sensor]: [Point; 2]) -> f64 {
        let (end, length_m) = path.iter().fold((source, 0.0), |(at, length_m), patch| {
            let point = self.points[patch];
            (point, length_m + (point - at).norm())
        });
        let shift_m = self.footprints.shift_m(source, path, |patch| self.points[patch], sensor);
        length_m + (sensor - end).norm() + shift_m
    }

    /// Standard deviation of a path's length from the errors of its patches.
    fn length_sd_m(&self, path: &[PatchId], stations: [Point; 2]) -> f64 {
        let slopes = self.slopes(path, stations);
        let pairs = slopes.iter().flat_map(|a| slopes.iter().map(move |b| (a, b)));
        let variance_m2: f64 = pairs
            .map(|((a, slope_a), (b, slope_b))| {
                self.covariances_m2.get(&(*a, *b)).map_or(0.0, |block_m2| slope_a.dot(&(block_m2 * slope_b)))
            })
            .sum();
        variance_m2.max(0.0).sqrt()
    }

    /// How a path's length changes as its patches move; a patch that the path meets twice has the sum.
    fn slopes(&self, path: &[PatchId], [source, sensor]: [Point; 2]) -> BTreeMap<PatchId, Vector3<f64>> {
        let mut slopes: BTreeMap<PatchId, Vector3<f64>> = BTreeMap::new();
        for (n, patch) in path.iter().enumerate() {
            let point = self.points[patch];
            let before = if n == 0 { source } else { self.points[&path[n - 1]] };
            let after = path.get(n + 1).map_or(sensor, |next| self.points[next]);
            let slope = unit(point - before) + unit(point - after);
            *slopes.entry(*patch).or_insert_with(Vector3::zeros) += slope;
        }
        slopes
    }
}

fn unit(leg: Vector3<f64>) -> Vector3<f64> {
    leg.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros)
}
