//! Labels with known patches: every path predicted, every onset associated.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::{Footprints, LabelOnsets, Setup, Verdict, direct, sd_ps, time_ps};
use crate::geometry::Point;
use crate::geometry::association::{Candidate, GATE, Time, associate};
use crate::stages::covariances;
use crate::tables::{Onset, Patch, PatchCovariance};
use crate::units::PatchId;

/// Alternatives told of an onset that is left open.
const ALTERNATIVES: usize = 4;

/// Known patches with their errors.
pub(super) struct Scene {
    points: BTreeMap<PatchId, Point>,
    covariances: BTreeMap<(PatchId, PatchId), Matrix3<f64>>,
    footprints: Footprints,
}

/// A predicted path, read some laser periods earlier.
struct Prediction {
    path: Vec<PatchId>,
    turns: i32,
    time: Time,
}

/// Where a profile's light comes from and goes to.
struct View<'a> {
    setup: &'a Setup,
    source: Point,
    sensor: Point,
    /// Delay that calibration left, and its standard deviation.
    delay_ps: (f64, f64),
}

impl Scene {
    /// Of the best alternative, those with a covariance; `None` if none has.
    pub(super) fn new(patches: &[Patch], between: &[PatchCovariance], footprints: Footprints) -> Option<Self> {
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
        (!points.is_empty()).then_some(Self { points, covariances: blocks, footprints })
    }

    fn knows(&self, path: &[PatchId]) -> bool {
        path.iter().all(|patch| self.points.contains_key(patch))
    }

    /// Mean length of a path over the footprints of its patches.
    fn length_m(&self, path: &[PatchId], view: &View) -> f64 {
        let (end, length_m) = path.iter().fold((view.source, 0.0), |(at, length_m), patch| {
            let point = self.points[patch];
            (point, length_m + (point - at).norm())
        });
        let shift_m = self.footprints.shift_m(view.source, path, |patch| self.points[patch], view.sensor);
        length_m + (view.sensor - end).norm() + shift_m
    }

    /// Standard deviation of a path's length from the errors of its patches.
    fn length_sd_m(&self, path: &[PatchId], view: &View) -> f64 {
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

    fn predict(&self, path: Vec<PatchId>, view: &View) -> (Vec<PatchId>, Time) {
        let (delay_ps, delay_sd_ps) = view.delay_ps;
        let time = Time {
            time_ps: time_ps(self.length_m(&path, view), view.setup) + delay_ps,
            sd_ps: time_ps(self.length_sd_m(&path, view), view.setup).hypot(delay_sd_ps),
        };
        (path, time)
    }

    /// All paths of three to `bounces` bounces from `lit` to `seen` that lead over no closed pair and over no patch twice in a row.
    fn longer(
        &self,
        lit: PatchId,
        seen: PatchId,
        bounces: i32,
        closed: &BTreeSet<(PatchId, PatchId)>,
    ) -> Vec<Vec<PatchId>> {
        let is_open = |a: PatchId, b: PatchId| a != b && !closed.contains(&(a.min(b), a.max(b)));
        let mut paths = Vec::new();
        for &k in self.points.keys().filter(|k| is_open(lit, **k)) {
            if is_open(k, seen) {
                paths.push(vec![lit, k, seen]);
            }
            if bounces >= 4 {
                let last = self.points.keys().filter(|l| is_open(k, **l) && is_open(**l, seen));
                paths.extend(last.map(|&l| vec![lit, k, l, seen]));
            }
        }
        paths
    }
}

impl LabelOnsets {
    /// For each profile of one sensor, for each onset, its labels.
    pub(super) fn predicted(
        &self,
        setup: &Setup,
        scene: &Scene,
        delay_ps: impl Fn(&Onset) -> (f64, f64),
        profiles: &[&[Onset]],
    ) -> Vec<Vec<Vec<Verdict>>> {
        let Some(sensor) = profiles.first().map(|profile| &*profile[0].sensor) else {
            return Vec::new();
        };
        let view = |profile: &[Onset]| View {
            setup,
            source: Point::from(setup.source_m),
            sensor: Point::from(setup.sensors_m[sensor]),
            delay_ps: delay_ps(&profile[0]),
        };
        let closed = self.closed(scene, &view, profiles);
        let labels = |profile: &&[Onset]| -> Vec<Vec<Verdict>> {
            let (predictions, found) = self.associated(scene, &view(profile), profile, self.bounces, &closed);
            found.into_iter().map(|candidates| self.verdicts(&candidates, &predictions)).collect()
        };
        profiles.iter().map(labels).collect()
    }

    /// Pairs whose direct light is more likely missing than seen, both ways. Third bounces may lie where it would be: they are predicted too.
    fn closed<'a>(
        &self,
        scene: &Scene,
        view: &dyn Fn(&[Onset]) -> View<'a>,
        profiles: &[&[Onset]],
    ) -> BTreeSet<(PatchId, PatchId)> {
        let (mut closed, mut open) = (BTreeSet::new(), BTreeSet::new());
        for profile in profiles.iter().filter(|profile| profile[0].lit != profile[0].seen && self.bounces >= 3) {
            let (lit, seen) = (profile[0].lit, profile[0].seen);
            let (predictions, found) = self.associated(scene, &view(profile), profile, 3, &BTreeSet::new());
            let is_direct = |candidate: &&Candidate| predictions[candidate.path].path.len() == 2;
            let direct: f64 = found.iter().flatten().filter(is_direct).map(|candidate| candidate.probability).sum();
            if direct > 0.5 {
                open.insert((lit.min(seen), lit.max(seen)));
            } else if scene.knows(&[lit, seen]) {
                closed.insert((lit.min(seen), lit.max(seen)));
            }
        }
        closed.retain(|pair| !open.contains(pair));
        closed
    }

    /// Predicted paths of a profile that lead over no closed pair, the direct one in any case, and for each onset those that may have made it.
    fn associated(
        &self,
        scene: &Scene,
        view: &View,
        profile: &[Onset],
        bounces: i32,
        closed: &BTreeSet<(PatchId, PatchId)>,
    ) -> (Vec<Prediction>, Vec<Vec<Candidate>>) {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        let mut paths = vec![direct(profile)];
        if bounces >= 3 {
            paths.extend(scene.longer(lit, seen, bounces, closed));
        }
        paths.retain(|path| scene.knows(path) && path.len() as i32 <= bounces);
        let paths = paths.into_iter().map(|path| scene.predict(path, view)).collect();
        let arrivals: Vec<Time> =
            profile.iter().map(|onset| Time { time_ps: onset.time_ps, sd_ps: sd_ps(onset) }).collect();
        let predictions = readings(paths, view.setup.repetition_ps, &arrivals);
        let times: Vec<Time> = predictions.iter().map(|prediction| prediction.time).collect();
        let found = associate(&arrivals, &times, self.clutter_per_ns * 1e-3);
        (predictions, found)
    }

    fn verdicts(&self, candidates: &[Candidate], predictions: &[Prediction]) -> Vec<Verdict> {
        let verdict = |(n, candidate): (usize, &Candidate)| {
            let Prediction { path, turns, .. } = &predictions[candidate.path];
            Verdict {
                turns: *turns,
                path: Some(path.clone()),
                residual_ps: Some(candidate.residual_ps),
                probability: candidate.probability,
                alternative: n as i32,
            }
        };
        let is_sure = candidates.first().is_some_and(|best| best.probability >= self.probability_min);
        if is_sure {
            return candidates[..1].iter().enumerate().map(verdict).collect();
        }
        let unexplained = 1.0 - candidates.iter().map(|candidate| candidate.probability).sum::<f64>();
        let open = Verdict { probability: unexplained.max(0.0), ..Verdict::open() };
        let others = candidates.iter().take(ALTERNATIVES).enumerate().map(|(n, candidate)| verdict((n + 1, candidate)));
        std::iter::once(open).chain(others).collect()
    }
}

/// Predictions near any of the arrivals, read with the laser periods that bring them there.
fn readings(paths: Vec<(Vec<PatchId>, Time)>, period_ps: Option<f64>, arrivals: &[Time]) -> Vec<Prediction> {
    let reach = |arrival: &Time, time: &Time| GATE * arrival.sd_ps.hypot(time.sd_ps);
    let mut predictions = Vec::new();
    for (path, time) in paths {
        let mut turns: Vec<i32> = arrivals
            .iter()
            .filter_map(|arrival| {
                let late_ps = time.time_ps - arrival.time_ps;
                let turns = period_ps.map_or(0.0, |period_ps| (late_ps / period_ps).round());
                let off_ps = late_ps - turns * period_ps.unwrap_or(0.0);
                (off_ps.abs() <= reach(arrival, &time)).then_some(turns as i32)
            })
            .collect();
        turns.sort_unstable();
        turns.dedup();
        predictions.extend(turns.into_iter().map(|turns| Prediction {
            path: path.clone(),
            turns,
            time: Time { time_ps: time.time_ps - f64::from(turns) * period_ps.unwrap_or(0.0), ..time },
        }));
    }
    predictions
}
