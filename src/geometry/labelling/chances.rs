//! How often light over patches in place makes an arrival.
//!
//! Each bounce takes most of the light, so that a path's chance to be seen falls with its order. It lies elsewhere for
//! paths over hidden patches. Both are learned from the campaign, once: of the predicted paths of an order that no
//! other comes near, how many have an arrival, less those that chance would put there. Of orders too dense for that,
//! all arrivals that nothing else explains count as theirs.

use std::collections::{BTreeMap, BTreeSet};

use super::paths::{Dense, Graph, Paths};
use super::problem::{SensorProfiles, View};
use super::scene::Prediction;
use crate::association::Time;
use crate::units::PatchId;

/// Chances before anything is learned, by bounces from one on, and as how many paths they count.
const PRIOR: [f64; 5] = [0.95, 0.95, 0.7, 0.2, 0.1];
const PRIOR_COUNT: f64 = 8.0;
/// No chance is smaller or larger.
const RANGE: [f64; 2] = [1e-3, 0.98];
/// An arrival within this many standard deviations of a path may be its own; a path further from all others stands
/// alone.
const OWN_SD: f64 = 3.0;
const ALONE_SD: f64 = 6.0;
/// In place of a number of hidden patches: paths of a dense order, whatever they lead over.
const ANY: usize = usize::MAX;

/// A path's bounces, and how many of these are at hidden patches.
pub(super) type Class = (usize, usize);

/// Chances of paths.
pub(super) struct Chances {
    visible: BTreeSet<PatchId>,
    learned: BTreeMap<Class, f64>,
}

/// Paths that stand alone, and how many of them have an arrival.
#[derive(Default)]
struct Count {
    paths: f64,
    seen: f64,
}

impl Chances {
    /// Before anything is learned.
    pub(super) fn prior(visible: &[PatchId]) -> Self {
        Self { visible: visible.iter().copied().collect(), learned: BTreeMap::new() }
    }

    /// From all profiles of all sensors.
    pub(super) fn learned(self, graphs: &[Graph], sensors: &[SensorProfiles], bounces: usize) -> Self {
        let mut counts: BTreeMap<Class, Count> = BTreeMap::new();
        for (graph, sensor) in graphs.iter().zip(sensors) {
            for view in sensor.views().filter(|view| graph.scene.has(&view.profile.direct())) {
                self.count(graph, view, bounces, &mut counts);
            }
        }
        Self { learned: counts.into_iter().map(|(class, count)| (class, count.chance(class.0))).collect(), ..self }
    }

    /// Adds the paths of one profile.
    fn count(&self, graph: &Graph, view: View, bounces: usize, counts: &mut BTreeMap<Class, Count>) {
        let Recorded { arrivals, predictions, dense, rest_ps } = Recorded::new(graph, view, bounces);
        // What no path explains comes by chance, anywhere.
        let is_free = |arrival: &&Time| !predictions.iter().any(|path| is_own(arrival, &path.time));
        let free: Vec<&Time> = arrivals.iter().filter(is_free).collect();
        if let Some(dense) = dense {
            let late = free.iter().filter(|arrival| dense.may_come_at(arrival.time_ps, view)).count();
            let count = counts.entry((dense.bounces, ANY)).or_default();
            count.paths += dense.paths as f64;
            count.seen += late as f64;
        }
        self.count_alone(&predictions, &arrivals, free.len() as f64 / rest_ps, counts);
    }

    /// Adds the paths, in order of time, that no other comes near.
    fn count_alone(
        &self,
        predictions: &[Prediction],
        arrivals: &[Time],
        free_per_ps: f64,
        counts: &mut BTreeMap<Class, Count>,
    ) {
        for (n, Prediction { path, time, .. }) in predictions.iter().enumerate() {
            let neighbours = &predictions[n.saturating_sub(1)..(n + 2).min(predictions.len())];
            let is_near = |other: &&Prediction| (other.time.time_ps - time.time_ps).abs() < ALONE_SD * time.sd_ps;
            // The path itself is one.
            if neighbours.iter().filter(is_near).count() > 1 {
                continue;
            }
            let is_seen = arrivals.iter().any(|arrival| is_own(arrival, time));
            let by_chance = 1.0 - (-free_per_ps * 2.0 * OWN_SD * time.sd_ps).exp();
            let count = counts.entry(self.class(path)).or_default();
            count.paths += 1.0;
            count.seen += (f64::from(u8::from(is_seen)) - by_chance) / (1.0 - by_chance);
        }
    }

    /// Of a path that leads over no patch of a second layer.
    pub(super) fn of(&self, path: &[PatchId]) -> f64 {
        self.learned.get(&self.class(path)).copied().unwrap_or(PRIOR[path.len() - 1])
    }

    /// Of any path of an order that is too dense.
    pub(super) fn of_dense(&self, bounces: usize) -> f64 {
        self.learned.get(&(bounces, ANY)).copied().unwrap_or(PRIOR[bounces - 1])
    }

    pub(super) fn class(&self, path: &[PatchId]) -> Class {
        (path.len(), path.iter().filter(|patch| !self.visible.contains(patch)).count())
    }
}

impl Count {
    /// Share of the paths that are seen, the prior of their order counted in.
    fn chance(&self, bounces: usize) -> f64 {
        let share = (self.seen + PRIOR_COUNT * PRIOR[bounces - 1]) / (self.paths + PRIOR_COUNT);
        share.clamp(RANGE[0], RANGE[1])
    }
}

/// Arrivals of a profile and the paths that its record holds, the direct one among them, within the laser's first
/// period.
pub(super) struct Recorded {
    pub(super) arrivals: Vec<Time>,
    /// In order of time. An arrival's error is part of theirs: of how far it may lie from its path.
    pub(super) predictions: Vec<Prediction>,
    dense: Option<Dense>,
    /// Time that the record goes on after the first path.
    rest_ps: f64,
}

impl Recorded {
    pub(super) fn new(graph: &Graph, view: View, bounces: usize) -> Self {
        let arrivals: Vec<Time> = view.profile.arrivals.iter().map(|arrival| folded(arrival.time(), view)).collect();
        let typical_sd_ps = arrivals.iter().map(|arrival| arrival.sd_ps).sum::<f64>() / arrivals.len() as f64;
        let Paths { mut predictions, dense } = graph.recorded(view, bounces);
        predictions.push(graph.scene.predict(view.profile.direct(), view));
        let rest_ps = predictions.iter().map(|path| graph.rest_ps(view, path.time.time_ps)).fold(1.0, f64::max);
        for Prediction { time, .. } in &mut predictions {
            *time = Time { sd_ps: time.sd_ps.hypot(typical_sd_ps), ..folded(*time, view) };
        }
        predictions.sort_by(|a, b| a.time.time_ps.total_cmp(&b.time.time_ps));
        Self { arrivals, predictions, dense, rest_ps }
    }
}

/// A time within the laser's first period.
fn folded(time: Time, view: View) -> Time {
    let period_ps = view.medium().repetition_ps;
    Time { time_ps: period_ps.map_or(time.time_ps, |period_ps| time.time_ps.rem_euclid(period_ps)), ..time }
}

fn is_own(arrival: &Time, path: &Time) -> bool {
    (arrival.time_ps - path.time_ps).abs() < OWN_SD * path.sd_ps
}
