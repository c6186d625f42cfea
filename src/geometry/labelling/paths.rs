//! Which paths of light over patches in place a profile may hold.
//!
//! Paths grow with the number of patches to the power of their bounces less two. They are counted order by order. The
//! count ends at the first order that has more than 0.3 paths within a standard deviation of any time: there an arrival
//! no longer shows which path made it. That order stands as a density from its first path on; higher orders are as
//! dense and weaker. Paths that are longer than any arrival of the sensor are left out on the way.

use std::collections::BTreeSet;

use periscope_cancel::Cancel;

use super::problem::{Profile, SensorProfiles, View};
use super::scene::{DEEP, Prediction, Scene};
use crate::Point;
use crate::association::GATE;
use crate::units::PatchId;

/// Paths of one order within a standard deviation of a time, beyond which labels lose their meaning.
const DENSE: f64 = 0.3;
/// One path in this many is sampled to see how well all of its order are predicted.
const SAMPLE: usize = 64;
/// Least bounces of paths that are not direct.
pub(super) const INDIRECT: usize = 3;

/// Pairs of patches, the smaller first.
pub(super) type Pairs = BTreeSet<(PatchId, PatchId)>;

/// Patches in place as one sensor's profiles see them, with the legs between them.
pub(super) struct Graph<'a> {
    pub(super) scene: &'a Scene,
    patches: Vec<PatchId>,
    /// Times between all pairs of patches, by their positions.
    legs_ps: Vec<f64>,
    /// Patches that each exchanges light with.
    next: Vec<Vec<usize>>,
    /// Last arrival of the sensor; without end where the laser repeats.
    latest_ps: f64,
    cancel: &'a Cancel,
}

/// Paths of a profile of three and more bounces.
#[derive(Default)]
pub(super) struct Paths {
    pub(super) predictions: Vec<Prediction>,
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
    from_ps: f64,
}

impl Dense {
    /// Whether light of this order may come at a time: behind its first path, or anywhere where the laser repeats.
    pub(super) fn may_come_at(&self, time_ps: f64, view: View) -> bool {
        view.medium().repetition_ps.is_some() || time_ps > self.from_ps
    }
}

/// All paths of one order.
struct Order {
    count: usize,
    first_ps: f64,
    /// Mean of the variances of their times, from a sample.
    variance_ps2: f64,
}

/// Where the paths of a profile begin and end, by positions of patches, and the time of both legs to the stations.
struct Ends {
    lit: usize,
    seen: usize,
    time_ps: f64,
}

impl<'a> Graph<'a> {
    /// For paths of up to `bounces` bounces, without legs over closed pairs.
    pub(super) fn new(
        scene: &'a Scene,
        sensor: &SensorProfiles,
        closed: &Pairs,
        bounces: usize,
        cancel: &'a Cancel,
    ) -> Self {
        // Direct paths need no legs.
        let is_needed = |patch: &&PatchId| bounces >= INDIRECT && !scene.is_deep(**patch);
        let patches: Vec<PatchId> = scene.points.keys().filter(is_needed).copied().collect();
        let leg_ps = |a: &PatchId, b: &PatchId| sensor.medium.time_ps((scene.points[a] - scene.points[b]).norm());
        Self {
            next: patches.iter().map(|patch| open_neighbours(*patch, &patches, closed)).collect(),
            legs_ps: patches.iter().flat_map(|a| patches.iter().map(move |b| leg_ps(a, b))).collect(),
            scene,
            patches,
            latest_ps: latest_ps(sensor),
            cancel,
        }
    }

    /// Paths that may have made one of a profile's arrivals, or come within `reach_ps` of one.
    pub(super) fn near(&self, view: View, bounces: usize, reach_ps: f64) -> Paths {
        let mut paths = self.paths(view, bounces, |path_ps, sd_ps| is_near(view, path_ps, GATE * sd_ps, reach_ps));
        paths.predictions.extend(self.deep(view, bounces));
        paths.predictions.retain(|Prediction { time, .. }| is_near(view, time.time_ps, GATE * time.sd_ps, reach_ps));
        paths
    }

    /// All paths that the record holds.
    pub(super) fn recorded(&self, view: View, bounces: usize) -> Paths {
        self.paths(view, bounces, |_, _| true)
    }

    /// Time that the record of a profile goes on after some moment.
    pub(super) fn rest_ps(&self, view: View, from_ps: f64) -> f64 {
        view.medium().repetition_ps.unwrap_or(self.latest_ps - from_ps)
    }

    /// Order by order, those that `is_wanted`, given their times over the patches' centres and the standard deviation
    /// of these, at most.
    fn paths(&self, view: View, bounces: usize, is_wanted: impl Fn(f64, f64) -> bool) -> Paths {
        self.cancel.check();
        let mut paths = Paths::default();
        let Some(ends) = self.ends(view) else { return paths };
        let typical_sd_ps = median_sd_ps(view.profile);
        for bounces in INDIRECT..=bounces {
            let Some(order) = self.order(&ends, bounces, view) else { continue };
            let sd_ps = typical_sd_ps.hypot(order.variance_ps2.sqrt());
            let per_ps = order.count as f64 / self.rest_ps(view, order.first_ps).max(sd_ps);
            if per_ps * sd_ps > DENSE {
                paths.dense = Some(Dense { bounces, paths: order.count, per_ps, from_ps: order.first_ps });
                break;
            }
            self.walk(&mut vec![ends.lit], ends.seen, bounces, ends.time_ps, &mut |path, path_ps| {
                let path = self.numbers(path);
                if is_wanted(path_ps, self.sd_bound_ps(&path, view)) {
                    paths.predictions.push(self.scene.predict(path, view));
                }
            });
        }
        paths
    }

    /// `None` where the lit or the seen patch is not in place.
    fn ends(&self, view: View) -> Option<Ends> {
        let [lit, seen] = [view.profile.lit, view.profile.seen].map(|patch| self.patches.binary_search(&patch).ok());
        let (lit, seen) = (lit?, seen?);
        let leg_m = |station: Point, patch: usize| (self.scene.points[&self.patches[patch]] - station).norm();
        let legs_m = leg_m(view.sensor.source, lit) + leg_m(view.sensor.sensor, seen);
        Some(Ends { lit, seen, time_ps: view.profile.delay_ps + view.medium().time_ps(legs_m) })
    }

    /// `None` where no path has that many bounces.
    fn order(&self, ends: &Ends, bounces: usize, view: View) -> Option<Order> {
        let (mut count, mut first_ps, mut variances_ps2) = (0_usize, f64::INFINITY, Vec::new());
        self.walk(&mut vec![ends.lit], ends.seen, bounces, ends.time_ps, &mut |path, path_ps| {
            if count % SAMPLE == 0 {
                variances_ps2.push(self.scene.predict(self.numbers(path), view).time.sd_ps.powi(2));
            }
            count += 1;
            first_ps = first_ps.min(path_ps);
        });
        let variance_ps2 = variances_ps2.iter().sum::<f64>() / variances_ps2.len() as f64;
        (count > 0).then_some(Order { count, first_ps, variance_ps2 })
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
                // Patches are in order of their numbers, so that positions compare as these do.
                if path[0] != seen || path.iter().le(path.iter().rev()) {
                    visit(path, path_ps);
                }
                path.pop();
            }
            return;
        }
        self.cancel.check();
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

    fn numbers(&self, path: &[usize]) -> Vec<PatchId> {
        path.iter().map(|&patch| self.patches[patch]).collect()
    }

    /// Standard deviation of a path's time, at most, with what large patches may shift it by.
    fn sd_bound_ps(&self, path: &[PatchId], view: View) -> f64 {
        let variance_m2: f64 = path.iter().map(|patch| 4.0 * self.scene.variance_m2(*patch)).sum();
        let bound_m = variance_m2.sqrt() + self.scene.largest_m();
        view.medium().time_ps(bound_m).hypot(view.profile.delay_sd_ps)
    }

    /// Fifth bounces over patches that only hidden ones show.
    fn deep(&self, view: View, bounces: usize) -> Vec<Prediction> {
        let (lit, seen) = view.profile.pair();
        if bounces < DEEP || !self.scene.has(&[lit, seen]) {
            return Vec::new();
        }
        let paths = self.scene.deep_paths(lit, seen).filter(|path| view.profile.is_representative(path));
        paths.map(|path| self.scene.predict(path, view)).collect()
    }
}

/// Positions of the patches that one exchanges light with.
fn open_neighbours(patch: PatchId, patches: &[PatchId], closed: &Pairs) -> Vec<usize> {
    let is_open = |other: PatchId| other != patch && !closed.contains(&(patch.min(other), patch.max(other)));
    (0..patches.len()).filter(|&other| is_open(patches[other])).collect()
}

fn latest_ps(sensor: &SensorProfiles) -> f64 {
    let arrivals = sensor.profiles.iter().flat_map(|profile| &profile.arrivals);
    match sensor.medium.repetition_ps {
        Some(_) => f64::INFINITY,
        None => arrivals.map(|arrival| arrival.time_ps).fold(0.0, f64::max),
    }
}

/// Whether light at `path_ps`, read in the laser's nearest period, is within `slack_ps` of an arrival's gate, or of
/// `reach_ps` where that is wider.
fn is_near(view: View, path_ps: f64, slack_ps: f64, reach_ps: f64) -> bool {
    let medium = view.medium();
    view.profile.arrivals.iter().any(|arrival| {
        let late_ps = path_ps - arrival.time_ps;
        let off_ps = late_ps - medium.turns_ps(medium.nearest_turns(late_ps));
        off_ps.abs() <= (GATE * arrival.sd_ps).max(reach_ps) + slack_ps
    })
}

fn median_sd_ps(profile: &Profile) -> f64 {
    let mut sds_ps: Vec<f64> = profile.arrivals.iter().map(|arrival| arrival.sd_ps).collect();
    sds_ps.sort_by(f64::total_cmp);
    sds_ps[sds_ps.len() / 2]
}
