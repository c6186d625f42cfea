//! How often light over patches in place makes an onset.
//!
//! Each bounce takes most of the light, so that a path's chance to be seen falls with its order, and lies elsewhere for paths over hidden patches. Both are learned from the
//! campaign, once: of the predicted paths of an order that no other comes near, how many have an onset, less those that chance would put there. Of orders too dense
//! for that, all onsets that nothing else explains are taken for theirs.

use std::collections::{BTreeMap, BTreeSet};

use super::paths::{Dense, Graph, Paths};
use super::scene::View;
use super::{OfSensor, sd_ps};
use crate::geometry::association::Time;
use crate::tables::Onset;
use crate::units::PatchId;

/// Chances before anything is learned, by bounces from one on, and as how many paths they count.
const PRIOR: [f64; 5] = [0.95, 0.95, 0.7, 0.2, 0.1];
const PRIOR_COUNT: f64 = 8.0;
/// No chance is taken to be smaller or larger.
const RANGE: [f64; 2] = [1e-3, 0.98];
/// An onset within so many standard deviations of a path may be its own; a path further from all others is told from them.
const OWN_SD: f64 = 3.0;
const ALONE_SD: f64 = 6.0;

/// In place of a number of hidden patches: paths of a dense order, whatever they lead over.
const ANY: usize = usize::MAX;

/// Chances of paths.
pub(super) struct Chances {
    visible: BTreeSet<PatchId>,
    /// By bounces, and how many of these are at hidden patches.
    learned: BTreeMap<(usize, usize), f64>,
}

/// Paths that an onset would tell from others, and how many have one.
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
    pub(super) fn learned(self, graphs: &[Graph], sensors: &[OfSensor], bounces: usize) -> Self {
        let mut counts: BTreeMap<(usize, usize), Count> = BTreeMap::new();
        for (graph, sensor) in graphs.iter().zip(sensors) {
            for profile in sensor.profiles.iter().filter(|profile| graph.scene.knows(&super::direct(profile))) {
                self.count(graph, &sensor.view(profile), profile, bounces, &mut counts);
            }
        }
        let chance = |((bounces, hidden), count): ((usize, usize), Count)| {
            let share = (count.seen + PRIOR_COUNT * PRIOR[bounces - 1]) / (count.paths + PRIOR_COUNT);
            ((bounces, hidden), share.clamp(RANGE[0], RANGE[1]))
        };
        Self { learned: counts.into_iter().map(chance).collect(), ..self }
    }

    /// Adds the paths of one profile that lie apart from all others.
    fn count(
        &self,
        graph: &Graph,
        view: &View,
        profile: &[Onset],
        bounces: usize,
        counts: &mut BTreeMap<(usize, usize), Count>,
    ) {
        let folded = |time_ps: f64| view.setup.repetition_ps.map_or(time_ps, |period_ps| time_ps.rem_euclid(period_ps));
        let onsets: Vec<Time> =
            profile.iter().map(|onset| Time { time_ps: folded(onset.time_ps), sd_ps: sd_ps(onset) }).collect();
        let typical_ps = onsets.iter().map(|onset| onset.sd_ps).sum::<f64>() / onsets.len() as f64;
        let Paths { mut paths, dense } = graph.recorded(view, profile, bounces);
        paths.push(graph.scene.predict(super::direct(profile), view));
        let rest_ps = paths.iter().map(|(_, time)| graph.rest_ps(view, time.time_ps)).fold(1.0, f64::max);
        // An onset's error is part of how far it may lie from its path.
        let expected = |time: Time| Time { time_ps: folded(time.time_ps), sd_ps: time.sd_ps.hypot(typical_ps) };
        paths.iter_mut().for_each(|(_, time)| *time = expected(*time));
        paths.sort_by(|a, b| a.1.time_ps.total_cmp(&b.1.time_ps));
        let is_own = |onset: &Time, path: &Time| (onset.time_ps - path.time_ps).abs() < OWN_SD * path.sd_ps;
        // What no path explains comes by chance, anywhere.
        let free: Vec<&Time> =
            onsets.iter().filter(|onset| !paths.iter().any(|(_, path)| is_own(onset, path))).collect();
        let free_per_ps = free.len() as f64 / rest_ps;
        if let Some(Dense { bounces, paths, from_ps, .. }) = dense {
            let late = free.iter().filter(|onset| view.setup.repetition_ps.is_some() || onset.time_ps > from_ps);
            let count = counts.entry((bounces, ANY)).or_default();
            count.paths += paths as f64;
            count.seen += late.count() as f64;
        }
        for (n, (path, time)) in paths.iter().enumerate() {
            let beside = paths[n.saturating_sub(1)..(n + 2).min(paths.len())].iter();
            let is_beside =
                |other: &&(Vec<PatchId>, Time)| (other.1.time_ps - time.time_ps).abs() < ALONE_SD * time.sd_ps;
            // The path itself is one.
            if beside.filter(is_beside).count() > 1 {
                continue;
            }
            let is_seen = onsets.iter().any(|onset| is_own(onset, time));
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

    /// How many bounces, and how many of them at hidden patches.
    pub(super) fn class(&self, path: &[PatchId]) -> (usize, usize) {
        (path.len(), path.iter().filter(|patch| !self.visible.contains(patch)).count())
    }
}
