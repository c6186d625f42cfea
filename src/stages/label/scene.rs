//! Known patches, and the paths of light over them.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::{Footprints, Setup, time_ps};
use crate::geometry::Point;
use crate::geometry::association::Time;
use crate::geometry::hidden::Hidden;
use crate::priors::covariances;
use crate::tables::{Patch, PatchCovariance};
use crate::units::PatchId;

/// Known patches with their errors.
#[derive(Clone)]
pub(super) struct Scene {
    pub(super) points: BTreeMap<PatchId, Point>,
    covariances: BTreeMap<(PatchId, PatchId), Matrix3<f64>>,
    footprints: Footprints,
    /// Of patches whose walls are known.
    pub(super) normals: BTreeMap<PatchId, Vector3<f64>>,
    /// Patches that only hidden ones show, each with the chance that a path over it makes an onset.
    deep: BTreeMap<PatchId, f64>,
    /// The hidden patches that show these.
    shown_by: Vec<PatchId>,
}

/// Where a profile's light comes from and goes to.
pub(super) struct View<'a> {
    pub(super) setup: &'a Setup,
    pub(super) source: Point,
    pub(super) sensor: Point,
    /// Delay that calibration left, and its standard deviation.
    pub(super) delay_ps: (f64, f64),
}

impl Scene {
    /// Of the best alternative, those with a covariance; `None` if none has.
    pub(super) fn new(
        patches: &[Patch],
        between: &[PatchCovariance],
        footprints: Footprints,
        normals: BTreeMap<PatchId, Vector3<f64>>,
    ) -> Option<Self> {
        let (mut points, mut blocks) = (BTreeMap::new(), BTreeMap::new());
        for row in patches.iter().filter(|patch| patch.alternative == 0) {
            let Some(own) = covariances::of_patch(row) else { continue };
            points.insert(row.patch, Point::new(row.x_m, row.y_m, row.z_m));
            blocks.insert((row.patch, row.patch), own);
        }
        for row in between {
            let block = covariances::between(row);
            blocks.insert((row.a, row.b), block);
            blocks.insert((row.b, row.a), block.transpose());
        }
        let (deep, shown_by) = (BTreeMap::new(), Vec::new());
        (!points.is_empty()).then_some(Self { points, covariances: blocks, footprints, normals, deep, shown_by })
    }

    /// With hidden patches that were found.
    pub(super) fn with(&self, hidden: impl Iterator<Item = (PatchId, Hidden)>) -> Self {
        let mut scene = self.clone();
        for (patch, found) in hidden {
            scene.points.insert(patch, found.point);
            scene.covariances.insert((patch, patch), found.covariance);
        }
        scene
    }

    /// With further patches that were found, which only the hidden ones `shown_by` show.
    pub(super) fn with_deep(&self, hidden: impl Iterator<Item = (PatchId, Hidden)>, shown_by: &[PatchId]) -> Self {
        let found: Vec<(PatchId, Hidden)> = hidden.collect();
        let mut scene = self.with(found.iter().copied());
        scene.deep.extend(found.iter().map(|(patch, found)| (*patch, found.seen)));
        scene.shown_by = shown_by.to_vec();
        scene
    }

    /// Whether only hidden patches show this one.
    pub(super) fn is_deep(&self, patch: PatchId) -> bool {
        self.deep.contains_key(&patch)
    }

    /// Chance that a path over a patch that only hidden ones show makes an onset; `None` for other paths.
    pub(super) fn deep_chance(&self, path: &[PatchId]) -> Option<f64> {
        path.iter().find_map(|patch| self.deep.get(patch)).copied()
    }

    /// Paths over patches that only hidden ones show.
    pub(super) fn deep_paths(&self, lit: PatchId, seen: PatchId) -> impl Iterator<Item = Vec<PatchId>> {
        let pairs = || self.shown_by.iter().flat_map(|a| self.shown_by.iter().map(move |b| (*a, *b)));
        self.deep.keys().flat_map(move |x| pairs().map(move |(a, b)| vec![lit, a, *x, b, seen]))
    }

    /// Sum of the variances of a patch's coordinates.
    pub(super) fn variance_m2(&self, patch: PatchId) -> f64 {
        self.covariances[&(patch, patch)].trace()
    }

    /// Size of the largest patch, if it is more than a point.
    pub(super) fn largest_m(&self) -> f64 {
        self.footprints.largest_m()
    }

    /// Standard deviation of a patch's position along a direction, and the mean of its variance over all directions.
    pub(super) fn spread(&self, patch: PatchId, along: &Vector3<f64>) -> (f64, f64) {
        let block = &self.covariances[&(patch, patch)];
        (along.dot(&(block * along)).max(0.0).sqrt(), block.trace() / 3.0)
    }

    pub(super) fn knows(&self, path: &[PatchId]) -> bool {
        path.iter().all(|patch| self.points.contains_key(patch))
    }

    /// Mean length of a path over the footprints of its patches.
    pub(super) fn length_m(&self, path: &[PatchId], view: &View) -> f64 {
        let (end, length_m) = path.iter().fold((view.source, 0.0), |(at, length_m), patch| {
            let point = self.points[patch];
            (point, length_m + (point - at).norm())
        });
        let shift_m = self.footprints.shift_m(view.source, path, |patch| self.points[patch], view.sensor);
        length_m + (view.sensor - end).norm() + shift_m
    }

    /// Standard deviation of a path's length from the errors of its patches.
    pub(super) fn length_sd_m(&self, path: &[PatchId], view: &View) -> f64 {
        let mut slopes: BTreeMap<PatchId, Vector3<f64>> = BTreeMap::new();
        for (n, patch) in path.iter().enumerate() {
            let point = self.points[patch];
            let before = if n == 0 { view.source } else { self.points[&path[n - 1]] };
            let after = path.get(n + 1).map_or(view.sensor, |next| self.points[next]);
            let unit = |other: Point| (point - other).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
            *slopes.entry(*patch).or_insert_with(Vector3::zeros) += unit(before) + unit(after);
        }
        let term = |a: &PatchId, b: &PatchId| {
            self.covariances.get(&(*a, *b)).map_or(0.0, |block| slopes[a].dot(&(block * slopes[b])))
        };
        let variance: f64 =
            slopes.keys().flat_map(|a| slopes.keys().map(move |b| (a, b))).map(|(a, b)| term(a, b)).sum();
        variance.max(0.0).sqrt()
    }

    pub(super) fn predict(&self, path: Vec<PatchId>, view: &View) -> (Vec<PatchId>, Time) {
        let (delay_ps, delay_sd_ps) = view.delay_ps;
        let time = Time {
            time_ps: time_ps(self.length_m(&path, view), view.setup) + delay_ps,
            sd_ps: time_ps(self.length_sd_m(&path, view), view.setup).hypot(delay_sd_ps),
        };
        (path, time)
    }
}
