//! Which paths of light over patches in place a profile may hold.
//!
//! Paths grow with the number of patches to the power of their bounces less two. They are counted order by order, and the count ends at the first order of which more than
//! 0.3 lie within a standard deviation of any time: there an onset no longer tells which path made it. That order stands as a density from its first path on, higher ones are as dense
//! and weaker. Paths that are longer than any onset of the sensor are left out on the way. Of a path back to the lit patch and its reverse, which are equally long and make one
//! onset, one stands for both.

use super::predicted::Pairs;
use super::scene::{Scene, View};
use super::{OfSensor, sd_ps, time_ps};
use crate::geometry::association::{GATE, Time};
use crate::tables::Onset;
use crate::units::PatchId;

/// Paths of one order within a standard deviation of a time, beyond which labels lose their meaning.
const DENSE: f64 = 0.3;
/// One path of so many tells how well the others of its order are predicted.
const SAMPLE: usize = 64;
/// Least bounces of paths that are not direct.
const INDIRECT: usize = 3;
/// Bounces of paths over patches that only hidden ones show.
pub(super) const DEEP: usize = 5;

/// Patches in place as one sensor's profiles see them, with the legs between them.
pub(super) struct Graph<'a> {
    pub(super) scene: &'a Scene,
    patches: Vec<PatchId>,
    /// Times between all pairs of patches, by their positions.
    legs_ps: Vec<f64>,
    /// Patches that each exchanges light with.
    next: Vec<Vec<usize>>,
    /// Last onset of the sensor; without end where the laser repeats.
    latest_ps: f64,
}

/// Paths of a profile of three and more bounces.
#[derive(Default)]
pub(super) struct Paths {
    /// Those that were asked for.
    pub(super) paths: Vec<(Vec<PatchId>, Time)>,
    /// The first order that is too dense.
    pub(super) dense: Option<Dense>,
}

/// An order of more paths than labels can tell apart.
#[derive(Clone, Copy)]
pub(super) struct Dense {
    pub(super) bounces: usize,
    pub(super) paths: usize,
    pub(super) per_ps: f64,
    /// Time of its first path.
    pub(super) from_ps: f64,
}

impl<'a> Graph<'a> {
    /// For paths of up to `bounces` bounces, without legs over closed pairs.
    pub(super) fn new(scene: &'a Scene, sensor: &OfSensor, closed: &Pairs, bounces: usize) -> Self {
        // Direct paths need no legs.
        let is_needed = |patch: &&PatchId| bounces >= INDIRECT && !scene.is_deep(**patch);
        let patches: Vec<PatchId> = scene.points.keys().filter(is_needed).copied().collect();
        let is_open = |a: PatchId, b: PatchId| a != b && !closed.contains(&(a.min(b), a.max(b)));
        let next = |a: &PatchId| (0..patches.len()).filter(|&b| is_open(*a, patches[b])).collect();
        let leg_ps = |a: &PatchId, b: &PatchId| time_ps((scene.points[a] - scene.points[b]).norm(), sensor.setup);
        let latest_ps = match sensor.setup.repetition_ps {
            Some(_) => f64::INFINITY,
            None => sensor.profiles.iter().copied().flatten().map(|onset| onset.time_ps).fold(0.0, f64::max),
        };
        Self {
            next: patches.iter().map(next).collect(),
            legs_ps: patches.iter().flat_map(|a| patches.iter().map(move |b| leg_ps(a, b))).collect(),
            scene,
            patches,
            latest_ps,
        }
    }

    /// Paths that may have made one of a profile's onsets, or come within `reach_ps` of one.
    pub(super) fn near(&self, view: &View, profile: &[Onset], bounces: usize, reach_ps: f64) -> Paths {
        let period_ps = view.setup.repetition_ps;
        let is_near = |path_ps: f64, slack_ps: f64| {
            profile.iter().any(|onset| {
                let late_ps = path_ps - onset.time_ps;
                let off_ps = late_ps - period_ps.map_or(0.0, |period_ps| (late_ps / period_ps).round() * period_ps);
                off_ps.abs() <= (GATE * sd_ps(onset)).max(reach_ps) + slack_ps
            })
        };
        let mut found = self.paths(view, profile, bounces, |time_ps, slack_ps| is_near(time_ps, GATE * slack_ps));
        found.paths.extend(self.deep(view, profile, bounces));
        found.paths.retain(|(_, time)| is_near(time.time_ps, GATE * time.sd_ps));
        found
    }

    /// All paths that the record holds.
    pub(super) fn recorded(&self, view: &View, profile: &[Onset], bounces: usize) -> Paths {
        self.paths(view, profile, bounces, |_, _| true)
    }

    /// Time that the record of a profile goes on after some moment.
    pub(super) fn rest_ps(&self, view: &View, from_ps: f64) -> f64 {
        view.setup.repetition_ps.unwrap_or(self.latest_ps - from_ps)
    }

    /// Order by order, those that `is_asked` for, given their times over the patches' centres and how far off these may be.
    fn paths(&self, view: &View, profile: &[Onset], bounces: usize, is_asked: impl Fn(f64, f64) -> bool) -> Paths {
        let mut found = Paths::default();
        let ends = [profile[0].lit, profile[0].seen].map(|patch| self.patches.binary_search(&patch));
        let [Ok(lit), Ok(seen)] = ends else { return found };
        let ends_m = [(view.source, lit), (view.sensor, seen)]
            .map(|(station, patch)| (self.scene.points[&self.patches[patch]] - station).norm());
        let ends_ps = view.delay_ps.0 + time_ps(ends_m[0] + ends_m[1], view.setup);
        let named = |path: &[usize]| path.iter().map(|&patch| self.patches[patch]).collect::<Vec<PatchId>>();
        let mut sds_ps: Vec<f64> = profile.iter().map(sd_ps).collect();
        sds_ps.sort_by(f64::total_cmp);
        for order in INDIRECT..=bounces {
            let (mut count, mut first_ps, mut variances_ps2) = (0_usize, f64::INFINITY, Vec::new());
            self.walk(&mut vec![lit], seen, order, ends_ps, &mut |path, path_ps| {
                if count % SAMPLE == 0 {
                    variances_ps2.push(self.scene.predict(named(path), view).1.sd_ps.powi(2));
                }
                count += 1;
                first_ps = first_ps.min(path_ps);
            });
            if count == 0 {
                continue;
            }
            let sd_ps =
                sds_ps[sds_ps.len() / 2].hypot((variances_ps2.iter().sum::<f64>() / variances_ps2.len() as f64).sqrt());
            let per_ps = count as f64 / self.rest_ps(view, first_ps).max(sd_ps);
            if per_ps * sd_ps > DENSE {
                found.dense = Some(Dense { bounces: order, paths: count, per_ps, from_ps: first_ps });
                break;
            }
            self.walk(&mut vec![lit], seen, order, ends_ps, &mut |path, path_ps| {
                let path = named(path);
                if is_asked(path_ps, self.slack_ps(&path, view)) {
                    found.paths.push(self.scene.predict(path, view));
                }
            });
        }
        found
    }

    /// Calls `visit` for all paths of `bounces` bounces that begin with `path` and end at `seen`.
    fn walk(
        &self,
        path: &mut Vec<usize>,
        seen: usize,
        bounces: usize,
        so_far_ps: f64,
        visit: &mut impl FnMut(&[usize], f64),
    ) {
        let last = path[path.len() - 1];
        let leg_ps = |a: usize, b: usize| self.legs_ps[a * self.patches.len() + b];
        if path.len() + 1 == bounces {
            let path_ps = so_far_ps + leg_ps(last, seen);
            if path_ps <= self.latest_ps && self.next[last].binary_search(&seen).is_ok() {
                path.push(seen);
                if path[0] != seen || path.iter().le(path.iter().rev()) {
                    visit(path, path_ps);
                }
                path.pop();
            }
            return;
        }
        for &next in &self.next[last] {
            let path_ps = so_far_ps + leg_ps(last, next);
            // No way on is shorter than the straight one.
            if path_ps + leg_ps(next, seen) <= self.latest_ps {
                path.push(next);
                self.walk(path, seen, bounces, path_ps, visit);
                path.pop();
            }
        }
    }

    /// Standard deviation of a path's time, at most, and what large patches may shift it by.
    fn slack_ps(&self, path: &[PatchId], view: &View) -> f64 {
        let variance_m2: f64 = path.iter().map(|patch| 4.0 * self.scene.variance_m2(*patch)).sum();
        let slack_m = variance_m2.sqrt() + self.scene.largest_m();
        time_ps(slack_m, view.setup).hypot(view.delay_ps.1)
    }

    /// Fifth bounces over patches that only hidden ones show.
    fn deep(&self, view: &View, profile: &[Onset], bounces: usize) -> Vec<(Vec<PatchId>, Time)> {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        if bounces < DEEP || !self.scene.knows(&[lit, seen]) {
            return Vec::new();
        }
        let is_one = |path: &Vec<PatchId>| lit != seen || path.iter().le(path.iter().rev());
        self.scene.deep_paths(lit, seen).filter(is_one).map(|path| self.scene.predict(path, view)).collect()
    }
}
